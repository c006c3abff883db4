"""The interval of a goal: the numbers of ``goal_bound`` and how they are said."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.bounds.outcome import ErrorBound, thickened
from ngepc.checks.sentences import interval_in_words
from ngepc.goals.adjoint import Adjoint
from ngepc.goals.goal_terms import GoalTerms
from ngepc.model.problem import Problem

INFINITE = (
    "The interval is infinite, as the law does not harden: the bound does not limit strains where "
    "the body flows. A finer mesh, hardening that goes on (curves are constant beyond their last "
    "point), contact_force_bracket or displacement_bracket may give a finite one."
)


@dataclass(frozen=True, eq=False)
class GoalBound:
    """A guaranteed interval of a goal of the continuous solution.

    Parameters
    ----------
    name
        The goal.
    lower, upper
        The interval; of a contact force, which is not negative, its part from zero on.
    discrete
        The goal of the result; of a displacement at a point in a quadrilateral or hexahedron that
        of the triangle or tetrahedron that it is cut into.
    bound
        The error bound of the result.
    adjoint
        Error of the adjoint: half the squared residual between its stress and strain in the
        tangent's law (goal squared over energy).
    factor
        The lambda of the interval (goal over energy).
    per_cell
        The contribution of each cell to half the width, nonnegative up to rounding.
    pair, terms
        The admissible pair of the adjoint, and the goal as loads and contact facets; of a body of
        thickness one.
    note
        How the goal was changed to make it continuous.
    below
        By how much the interval of the proof reaches below ``lower``, >= 0.
    """

    name: str
    lower: float
    upper: float
    discrete: float
    bound: ErrorBound = field(repr=False)
    adjoint: float = field(repr=False)
    factor: float = field(repr=False)
    per_cell: np.ndarray = field(repr=False)
    pair: Adjoint = field(repr=False)
    terms: GoalTerms = field(repr=False)
    note: str = ""
    below: float = field(default=0.0, repr=False)

    @property
    def proved(self) -> tuple[float, float]:
        """The interval of the proof, that of receipts; it may go below zero."""
        return self.lower - self.below, self.upper

    @property
    def interval(self) -> tuple[float, float]:
        """``lower`` and ``upper``."""
        return self.lower, self.upper

    @property
    def width(self) -> float:
        """``upper`` less ``lower``."""
        return self.upper - self.lower

    @property
    def middle(self) -> float:
        """The middle of the interval: the best single number."""
        return (self.lower + self.upper) / 2

    @property
    def percent(self) -> float:
        """Half the width in percent of the size of the middle."""
        return half_in_percent(self.lower, self.upper)

    @property
    def guaranteed(self) -> bool:
        """Whether the interval is proved: the data are known exactly."""
        return self.bound.guaranteed

    @property
    def message(self) -> str:
        """Limits of the guarantee and replacements in the goal; empty if there are none."""
        unbounded = "" if math.isfinite(self.width) else INFINITE
        return " ".join(filter(None, (unbounded, self.note, self.bound.message)))

    @property
    def estimate(self) -> float:
        """Estimate of half the width for a smooth problem: (error x adjoint error)^(1/2).

        It is not a bound.
        """
        return math.sqrt(max(self.bound.total, 0.0) * max(self.adjoint, 0.0))

    @cached_property
    def indicators(self) -> GridFunction:
        """``per_cell`` as a function to draw."""
        mesh = self.bound.problem.mesh
        result = GridFunction(L2(mesh, order=0), name="goal_indicators")
        result.vec.FV().NumPy()[:] = self.per_cell
        return result

    @property
    def kind(self) -> str:
        """'guaranteed' or 'not proved'."""
        return "guaranteed" if self.guaranteed else "not proved"

    def __str__(self) -> str:
        return f"{self.name}: {interval_in_words(self.lower, self.upper, self.kind)}"


def half_in_percent(lower: float, upper: float) -> float:
    """Half the width of an interval in percent of the size of its middle."""
    width = upper - lower
    middle = (lower + upper) / 2
    if width == 0:
        return 0.0
    if middle == 0 or not math.isfinite(width):
        return math.inf
    return 50 * width / abs(middle)


def interval_of_elements(
    goal: GoalBound, problem: Problem, parents: np.ndarray
) -> GoalBound:
    """The interval with contributions of the elements of a problem, which ``parents`` names."""
    count = problem.mesh.ne
    of_bound = np.bincount(parents, goal.bound.per_cell, minlength=count)
    bound = replace(goal.bound, per_cell=of_bound, given=problem)
    per_cell = np.bincount(parents, goal.per_cell, minlength=count)
    return replace(goal, bound=bound, per_cell=per_cell)


def thick_goal(goal: GoalBound, problem: Problem) -> GoalBound:
    """The interval of a body of thickness one for a problem of another thickness."""
    t = problem.kinematics.thickness
    size = 1.0 if goal.terms.is_mean else t
    return replace(
        goal,
        lower=size * goal.lower,
        upper=size * goal.upper,
        discrete=size * goal.discrete,
        bound=thickened(goal.bound, problem),
        adjoint=size**2 / t * goal.adjoint,
        factor=size / t * goal.factor,
        per_cell=size * goal.per_cell,
        below=size * goal.below,
    )
