"""The status of a run, and the history of its steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from ngepc.checks.labelled import Labelled


class Status(Labelled):
    """How a run ended; the value is the sentence for the user."""

    CONVERGED = "The residual, computed afresh at the end, meets the tolerance."
    BOUNDED = "Newton's method was stopped because its part of the guaranteed error bound is small."
    NOT_UNIQUE = (
        "The residual meets the tolerance, but friction allows other equilibria, too."
    )
    ITERATION_LIMIT = (
        "The iteration limit was reached before the residual met the tolerance."
    )
    LINESEARCH_FAILED = (
        "No step length along the Newton direction lowers the energy enough."
    )
    STAGNATED = (
        "The energy changes by rounding errors only; the tolerance cannot be met."
    )
    NONFINITE = (
        "A linear solver failed, or an energy or residual became NaN or infinite."
    )
    LIMIT_LOAD = (
        "Plastic strains grow without bound: the loads are at or beyond a limit load."
    )
    UNHELD = "Contact forces cannot balance the loads on a part without supports: no solution."
    MESH_LIMIT = (
        "The error bound is too large, and a finer mesh is not allowed or of no help."
    )
    STEP_LIMIT = (
        "The increments are less accurate than requested; shorter ones are not allowed."
    )
    STOPPED = "The monitor (or an interrupt) stopped the run; the state is the last one reached."

    @property
    def is_success(self) -> bool:
        """Whether the run succeeded."""
        return self in (Status.CONVERGED, Status.BOUNDED, Status.NOT_UNIQUE)

    @property
    def is_solution(self) -> bool:
        """Whether the state solves the discrete problem, up to a tolerance or rounding errors."""
        return self.is_success or self in (Status.STAGNATED, Status.MESH_LIMIT)


@dataclass(frozen=True, kw_only=True)
class IterationRecord:
    """One Newton iterate: what monitors receive and histories keep.

    The active measures (length, area, volume) are those of the part of Gamma_c that the obstacle
    pushes, of the body that yields, of Gamma_c that slips.  ``snapshot()`` is the result of a run
    that had stopped here, with all its fields; monitors get it with the record, histories keep the
    numbers only.
    """

    iteration: int  # Newton steps done so far; 0 is the start
    residual_norm: float  # ||Psi_gamma||_{H*}, or the relative one of the exact methods
    contact_residual_norm: float = 0.0  # its part on Gamma_c (z)
    plastic_residual_norm: float = 0.0  # its part in Omega (q)
    energy: float = float("nan")
    """J*_gamma(v) of dual methods, else J (force times length)."""
    step_length: float = 1.0  # alpha of the step that led here
    halvings: int = 0  # trials before it
    back_substitutions: int = 0  # solves with the matrix of that step
    linear_iterations: int = 0  # of a Krylov solver in them; 0 with a direct solver
    contact_active: float = 0.0
    plastic_active: float = 0.0
    friction_active: float = 0.0
    snapshot: Callable[[], Any] | None = field(default=None, compare=False, repr=False)


Monitor = Callable[[IterationRecord], None]
"""Called with the record of each iterate; raising StopIteration stops the run."""


@dataclass
class History:
    """The records of a run, start included; columns are lists, see ``IterationRecord``."""

    records: list[IterationRecord] = field(default_factory=list)

    def column(self, name: str) -> list:
        """One field of all records."""
        return [getattr(record, name) for record in self.records]

    @property
    def residual_norms(self) -> list[float]:
        """||Psi_gamma||_{H*} of the iterates, start included."""
        return self.column("residual_norm")

    @property
    def step_lengths(self) -> list[float]:
        """Step lengths alpha^j of the Newton steps, one for each step."""
        return self.column("step_length")[1:]

    @property
    def energies(self) -> list[float]:
        """Energies of the iterates, start included."""
        return self.column("energy")

    @property
    def halvings(self) -> int:
        """Halvings of the step length in the whole run."""
        return sum(self.column("halvings"))

    @property
    def before(self) -> float | None:
        """The residual norm of the last iterate but one; None at the first one."""
        return self.records[-2].residual_norm if len(self.records) > 1 else None

    def as_rows(self) -> list[dict]:
        """The numbers of the records by their names, for tables and files."""
        return [
            {name: value for name, value in vars(record).items() if name != "snapshot"}
            for record in self.records
        ]


class SolverError(RuntimeError):
    """A run that did not converge, raised on request; ``result`` keeps its last state."""

    def __init__(self, result: object) -> None:
        super().__init__(f"{result.status.value} {result.message}".strip())
        self.result = result


class WithMessage:
    """A result that prints as its ``repr``, a summary on one line, and its message below."""

    message: str

    def __str__(self) -> str:
        return "\n".join(filter(None, (repr(self), self.message)))


class Ending(WithMessage):
    """How a run has ended, with ``raise_for_status``; base class of all results."""

    status: Status

    def raise_for_status(self: Ended) -> Ended:
        """The result itself if the run succeeded; otherwise raise a SolverError that keeps it."""
        if not self.status.is_success:
            raise SolverError(self)
        return self

    def or_interrupted(self: Ended) -> Ended:
        """The result itself; KeyboardInterrupt if it was stopped, to end a series of runs."""
        if self.status is Status.STOPPED:
            raise KeyboardInterrupt
        return self


Ended = TypeVar("Ended", bound=Ending)
