"""Adaptive refinement: its options, the record of a mesh, and its result."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ngepc._deprecated import renamed
from ngepc.bounds.outcome import ErrorBound
from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.sentences import ROUNDING, counted, outward
from ngepc.goals.goal_interval import GoalBound
from ngepc.local.result import ExactResult
from ngepc.results.outcome import WithMessage

ENERGIES = ("energy", "total", "algebraic")
"""Numbers of a ``MeshRecord`` that are energies."""


@dataclass(frozen=True, kw_only=True)
class Refinement(Declared):
    """Options of adaptive refinement.

    Parameters
    ----------
    marking
        Parameter of Doerfler's marking, in (0, 1]: each pass bisects the fewest elements whose
        indicators add up to this fraction of the bound.
    max_nodes
        Largest number of vertices of a mesh.
    max_iterations
        Largest number of Newton steps on one mesh.
    """

    marking: Annotated[float, Check(require_number, least=0, strict=True, most=1)] = (
        0.25
    )
    max_nodes: Annotated[int, Check(require_integer, least=3)] = 200_000
    max_iterations: Count = 100


@dataclass(frozen=True)
class MeshRecord:
    """The record of one mesh of ``solve_to``.

    Parameters
    ----------
    nodes, iterations
        Vertices of the mesh and Newton steps on it.
    energy, total, algebraic, relative
        J(u), and the numbers of ``ErrorBound``.
    lower, upper
        The interval of the goal; NaN without one, infinite where the error bound is.
    """

    nodes: int
    iterations: int
    energy: float
    total: float
    algebraic: float
    relative: float
    lower: float = math.nan
    upper: float = math.nan


@dataclass(frozen=True, eq=False)
class BoundedResult(WithMessage):
    """The result of ``solve_to``.

    Parameters
    ----------
    result, bound
        The result on the last mesh and its error bound; on the one before, if that bound is
        infinite and the one before finite.
    tolerance
        The relative error that was asked for.
    records
        One record for each mesh.
    message
        Why it ended before the tolerance was reached, empty if it was reached; and what straight
        sides of a round body cut off: refined meshes keep them.
    goal
        The interval of the goal on the last mesh; None without a goal, and where the error bound is
        infinite.
    """

    result: ExactResult
    bound: ErrorBound
    tolerance: float
    records: list[MeshRecord]
    message: str
    goal: GoalBound | None = None

    asked = renamed("asked", "tolerance")
    found = renamed("found", "relative_error")

    @property
    def relative_error(self) -> float:
        """The relative error of the energy, or of the goal, to be compared with ``tolerance``."""
        return self.bound.relative if self.goal is None else self.goal.percent / 100

    @property
    def reached(self) -> bool:
        """Whether the error is at most the tolerance."""
        return self.relative_error <= self.tolerance

    @property
    def guaranteed(self) -> bool:
        """Whether ``relative_error`` is proved; False if data are known from samples only."""
        return self.bound.guaranteed if self.goal is None else self.goal.guaranteed

    @property
    def iterations(self) -> int:
        """Newton steps on all meshes."""
        return sum(record.iterations for record in self.records)

    def __repr__(self) -> str:
        judged = self.bound if self.goal is None else self.goal
        what = "energy" if self.goal is None else self.goal.name
        error = f"no bound of the relative error of the {what}"
        if math.isfinite(self.relative_error):
            size = outward(0.0, max(self.relative_error, ROUNDING), 3)[1]
            error = f"relative error of the {what} at most {size} ({judged.kind})"
        meshes = counted(len(self.records), "mesh", "meshes")
        finest = f"{self.result.problem.mesh.nv} nodes"
        return f"<BoundedResult: {error}, tolerance {self.tolerance:g}, {meshes}, {finest}>"
