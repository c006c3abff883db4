"""The result of path-following: one record for each gamma and the last solution."""

from __future__ import annotations

from dataclasses import dataclass

from ngepc.dual.result import DualResult
from ngepc.path.state import PathStep
from ngepc.results.outcome import Ending, Status


@dataclass(frozen=True, eq=False)
class PathResult(Ending):
    """What ``follow_path`` returns.

    Parameters
    ----------
    status, message
        How the path ended; the message says what was seen and what to try.
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
