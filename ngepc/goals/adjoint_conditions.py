"""The conditions of adjoints on contact: |c - z . n| <= lambda gap for a goal with the number c.

Where a displacement z violates them it is changed at single nodes, vertex by vertex, then, for
order two, edge by edge.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.contact import NORMAL_PASSES
from ngepc.bounds.coverage import BUBBLE
from ngepc.bounds.data import BoundData
from ngepc.goals.goal_terms import GoalTerms

ROUNDING = 1e-10  # tolerance of the conditions before a node is changed
EPS = 1e-15
"""Rounding errors of the conditions, relative to their terms."""
VIOLATED = 1e-6
"""The largest violation of the conditions that is left; intervals are widened by it."""


class AdjointConditions:
    """The conditions |c - z . n| <= lambda gap of adjoints, for the ``slack`` of a displacement.

    ``size`` is that of the terms of the slack, whose rounding errors it has.
    """

    def __init__(
        self, bound_data: BoundData, slack: np.ndarray, size: float = 0.0
    ) -> None:
        self.bound_data = bound_data
        self.slack = slack
        self.size = size

    def repaired(
        self, goal: GoalTerms, z: np.ndarray, factor: float, rounding: float = ROUNDING
    ) -> tuple[np.ndarray, float]:
        """Change z such that |c - z . n| <= lambda gap everywhere; return z and the least lambda.

        ``rounding`` is the tolerance of the conditions.

        At a vertex that is both supported and in contact z cannot be changed; lambda may then be
        infinite.
        """
        z = z.copy()
        contact = self.bound_data.contact
        N = self.bound_data.cells.N
        for _ in range(NORMAL_PASSES):
            mismatch = self.mismatch(goal, z)[:, :N]
            most = factor * self.slack[:, :N]
            beyond = mismatch - np.clip(mismatch, -most, most)
            rounded = rounding * self.scale(goal, z)
            if np.abs(beyond).max(initial=0.0) <= rounded:
                break
            for end in range(N):
                mismatch = self.mismatch(goal, z)[:, end]
                most = factor * self.slack[:, end]
                more = mismatch - np.clip(mismatch, -most, most)
                # the facets around a vertex have different conditions: one that is
                # satisfied but for rounding must not undo what another one asks for
                more[np.abs(more) <= rounded] = 0.0
                contact.shift(z, end, more, 1.0)
        if self.bound_data.problem.order == 2:
            self._repair_edges(goal, z, factor, rounding)
        return z, self.least(goal, z, factor)

    def _repair_edges(
        self, goal: GoalTerms, z: np.ndarray, factor: float, rounding: float
    ) -> None:
        """Change z at edges until the conditions hold between the vertices."""
        contact = self.bound_data.contact
        N = self.bound_data.cells.N
        rounded = rounding * self.scale(goal, z)
        for _ in range(NORMAL_PASSES):
            most = 0.0
            for k in range(contact.nodes.shape[1] - N):
                low, high = self._middles(goal, z, factor)
                middle = contact.edge_coefficients(self.mismatch(goal, z))
                more = (middle - np.clip(middle, low, np.maximum(low, high)))[:, k]
                more[np.abs(more) <= rounded] = 0.0
                contact.shift(z, N + k, 2 * more, BUBBLE)
                most = max(most, np.abs(more).max(initial=0.0))
            if most == 0.0:
                break

    def mismatch(self, goal: GoalTerms, z: np.ndarray) -> np.ndarray:
        """c - z . n at ``ContactFacets.nodes``, shape (facets, nodes)."""
        contact = self.bound_data.contact
        mismatch = -contact.along(z)
        mismatch[:, : self.bound_data.cells.N] += goal.factor[:, None]
        return mismatch

    def _middles(
        self, goal: GoalTerms, z: np.ndarray, factor: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the edge coefficients of c - z . n for displacements of order two.

        A parabola with Bernstein coefficients a, m, b is nonnegative if a, b >= 0 and
        m >= -(a b)^(1/2); a quadratic function on a triangle, if all coefficients are >= 0.
        """
        slack = self.slack
        middle = factor * self.bound_data.contact.edge_coefficients(slack)
        if self.bound_data.cells.N == 3:
            return -middle, middle
        mismatch = self.mismatch(goal, z)[:, :2]
        above = np.maximum(factor * slack[:, :2] - mismatch, 0.0)
        below = np.maximum(factor * slack[:, :2] + mismatch, 0.0)
        high = middle + np.sqrt(above.prod(axis=1))[:, None]
        low = -middle - np.sqrt(below.prod(axis=1))[:, None]
        return low, high

    def scale(self, goal: GoalTerms, z: np.ndarray) -> float:
        """The size of the terms of the conditions."""
        contact = self.bound_data.contact
        largest = np.abs(z[contact.nodes]).max(initial=0.0)
        return float(np.abs(goal.factor).max(initial=0.0) + largest)

    def violation(self, goal: GoalTerms, z: np.ndarray, factor: float) -> float:
        """By how much the conditions are violated, a bound of the largest |c - z . n| - lambda gap.

        Slacks at vertices that are negative because of rounding count as zero.
        """
        N = self.bound_data.cells.N
        mismatch = self.mismatch(goal, z)
        missed = np.abs(mismatch[:, :N]) - factor * self.slack[:, :N]
        worst = missed.max(initial=0.0)
        if self.bound_data.problem.order == 2 and len(mismatch):
            low, high = self._middles(goal, z, factor)
            middle = self.bound_data.contact.edge_coefficients(mismatch)
            worst = max(worst, (low - middle).max(), (middle - high).max())
        return float(worst)

    def enough(self, goal: GoalTerms) -> float:
        """The lambda for which z = 0 satisfies the conditions; infinite where a vertex touches."""
        there = np.abs(goal.factor) > 0
        gap = self.slack[there, : self.bound_data.cells.N].min(axis=1)
        if (gap <= 0).any():
            return np.inf
        return float((np.abs(goal.factor[there]) / gap).max(initial=0.0))

    def least(self, goal: GoalTerms, z: np.ndarray, factor: float) -> float:
        """``factor`` if the conditions hold up to rounding, else infinity."""
        allowed = VIOLATED * self.scale(goal, z) + EPS * factor * self.size
        return factor if self.violation(goal, z, factor) <= allowed else np.inf
