"""The state of a path: a record for each gamma, the result, the checkpoint on disk."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from ngepc.checks.declared import Declared
from ngepc.checks.kinds import require_path
from ngepc.dual.functional import DualFunctional, DualIterate
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import DualSpaces
from ngepc.model.problem import Problem
from ngepc.results import checkpoint
from ngepc.results.files import check_writable
from ngepc.results.outcome import Ending, IterationRecord, Status
from ngepc.results.stored import array_of, reading, stored_record


@dataclass(frozen=True, kw_only=True)
class PathStep:
    """The record of one value of gamma on a path."""

    gamma: float
    iterations: int
    path_value: float  # V_gamma, the energy J*_gamma (force times length)
    change: float | None
    """Relative change of V_gamma since the last gamma; None for the first gamma."""
    residual_norm: float  # ||Psi_gamma||, and its parts
    contact_residual_norm: float
    plastic_residual_norm: float
    halvings: int
    status: Status  # how the Newton steps ended

    @classmethod
    def after(cls, before: list[PathStep], result: DualResult) -> PathStep:
        """The record of a result that follows these steps."""
        here = DualIterate(result.functional, result.v, result.y)
        change = None
        if before:
            value = before[-1].path_value
            rise = abs(here.energy - before[-1].path_value)
            change = 0.0 if rise == 0 else rise / abs(value) if value else math.inf
        contact, plastic = here.norms.tolist()
        return cls(
            gamma=result.regularisation.gamma,
            iterations=result.iterations,
            path_value=here.energy,
            change=change,
            residual_norm=here.residual_norm,
            contact_residual_norm=contact,
            plastic_residual_norm=plastic,
            halvings=result.history.halvings,
            status=result.status,
        )


@dataclass(frozen=True, eq=False)
class PathResult(Ending):
    """What ``follow_path`` returns.

    Parameters
    ----------
    status, message
        How the path ended, and a message: what happened, and what to try.
    steps
        One record for each gamma, a last one that failed included.
    last
        The result of Algorithm 7.1 for the last gamma, with all fields.
    """

    status: Status
    message: str
    steps: tuple[PathStep, ...]
    last: DualResult

    @property
    def outer_iterations(self) -> int:
        """Number of values of gamma."""
        return len(self.steps)

    @property
    def inner_iterations(self) -> list[int]:
        """Newton steps for each gamma."""
        return [step.iterations for step in self.steps]

    @property
    def total_inner_iterations(self) -> int:
        """Newton steps of the whole path."""
        return sum(self.inner_iterations)

    @property
    def gammas(self) -> list[float]:
        """gamma_0, gamma_1, ..."""
        return [step.gamma for step in self.steps]

    @property
    def gamma_end(self) -> float:
        """The last gamma."""
        return self.steps[-1].gamma

    @property
    def path_values(self) -> list[float]:
        """V_gamma = J*_gamma at the inexact solution, for each gamma (force times length)."""
        return [step.path_value for step in self.steps]

    @property
    def residual_norms(self) -> list[float]:
        """||Psi_gamma||_{H*} at the inexact solution, for each gamma."""
        return [step.residual_norm for step in self.steps]


class PathStore:
    """The checkpoint of a path, or None; OSError before any work if it cannot be written.

    It belongs to a problem, the spaces and all options but the limits.
    """

    def __init__(
        self,
        path: Path | str | None,
        problem: Problem,
        spaces: DualSpaces,
        options: Declared,
    ) -> None:
        self._path = None if path is None else require_path("checkpoint", path)
        if self._path is not None:
            if not self._path.parent.is_dir():
                raise FileNotFoundError(
                    f"checkpoint {self._path}: there is no such folder"
                )
            check_writable(self._path)
            settings = asdict(replace(options, max_outer_iterations=1)) | {
                "spaces": repr(spaces)
            }
            settings["newton"]["max_iterations"] = 1
            self._fingerprint = checkpoint.work_fingerprint("path", problem, **settings)

    def load(self) -> tuple[list[PathStep], dict]:
        """The steps on disk, and the arguments that restore the last result; none without a file.

        ValueError if the file is damaged or belongs to other work.
        """
        saved = (
            None
            if self._path is None
            else checkpoint.load(self._path, self._fingerprint)
        )
        if saved is None:
            return [], {}
        with reading(self._path):
            rows = saved.record["steps"]
            steps = [stored_record(self._path, PathStep, row) for row in rows]
            history = saved.record["history"]
            records = [
                stored_record(self._path, IterationRecord, row) for row in history
            ]
            kept = {"records": records, "status": steps[-1].status}
            return steps, kept | {"arrays": saved.arrays}

    def restored(self, functional: DualFunctional, kept: dict) -> DualResult:
        """The last result of the steps on disk; ValueError if its array has another shape."""
        size = len(functional.blocks.H_vector())
        v = array_of(self._path, kept["arrays"], "v", size)
        return DualResult.restored(functional, v, kept["status"], kept["records"])

    def save(self, steps: list[PathStep], last: DualResult) -> None:
        """Write the steps and the last result atomically, if it has converged."""
        if self._path is not None and last.status is Status.CONVERGED:
            records = [asdict(step) | {"status": step.status.name} for step in steps]
            record = {"steps": records, "history": last.history.as_rows()}
            checkpoint.save(
                self._path, self._fingerprint, record, {"v": last.v.FV().NumPy()}
            )
