"""What a solver gives back: a named status, the history of its steps, the fields."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import Enum


class Status(Enum):
    """How a run ended; the value is the sentence for the user."""

    CONVERGED = "The residual, computed afresh at the end, meets the tolerance."
    ITERATION_LIMIT = "The iteration limit was reached before the residual met the tolerance."
    LINESEARCH_FAILED = "No step length along the Newton direction lowers the energy enough."
    STAGNATED = "The energy no longer changes beyond rounding, the tolerance is out of reach."
    NONFINITE = "A factorisation, energy or residual became singular, NaN or infinite."
    STOPPED = "The monitor (or an interrupt) stopped the run; the state is the last one reached."

    @property
    def label(self) -> str:
        """Short name for tables and files: 'converged', 'iteration_limit', ..."""
        return self.name.lower()


@dataclass(frozen=True, kw_only=True)
class IterationRecord:
    """One Newton iterate: what monitors receive and histories keep.

    Parameters
    ----------
    iteration
        Number of Newton steps done so far; 0 is the start.
    residual_norm, contact_residual_norm, plastic_residual_norm, friction_residual_norm
        ||Psi_gamma||_{H*} and its parts on Gamma_c (z), in Omega (q) and on Gamma_c (t).
    energy
        J*_gamma(v) (dual methods) or J (primal ones), force times length.
    step_length, halvings
        alpha of the step that led here and the trials before it; 1 and 0 at the start.
    back_substitutions
        Solves with the factors of the matrix of that step; more than one with exact contact.
    contact_active, plastic_active, friction_active
        Measures (length or area or volume) of the sets where the Newton derivative of the
        contact, of the plastic and of the friction max term is not zero.
    """

    iteration: int
    residual_norm: float
    contact_residual_norm: float = 0.0
    plastic_residual_norm: float = 0.0
    friction_residual_norm: float = 0.0
    energy: float = float("nan")
    step_length: float = 1.0
    halvings: int = 0
    back_substitutions: int = 0
    contact_active: float = 0.0
    plastic_active: float = 0.0
    friction_active: float = 0.0


@dataclass
class History:
    """The records of a run, start included; columns are lists, see ``IterationRecord``."""

    records: list[IterationRecord] = field(default_factory=list)

    def append(self, record: IterationRecord) -> None:
        """Add the record of the newest iterate."""
        self.records.append(record)

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

    def as_rows(self) -> list[dict]:
        """The records as dictionaries, for tables."""
        return [asdict(record) for record in self.records]


class SolverError(RuntimeError):
    """A run that did not converge, raised on request; ``result`` keeps its last state."""

    def __init__(self, result: object) -> None:
        super().__init__(f"{result.status.value} {result.message}".strip())
        self.result = result
