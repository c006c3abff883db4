"""Semismooth Newton on the laws of contact and friction, for the forces of a few rows.

Without tangents it is a linear complementarity problem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ngepc.linalg.friction_law import FrictionLaw
from ngepc.linalg.row_blocks import add_to_rows, of_rows
from ngepc.linalg.secants import Compliance

STEPS = 30  # Newton steps with each c
PROXIMAL_STEPS = 60  # at most, where Newton's method alone fails in a convex problem
SHORTEST = 1e-3  # the shortest step length

ROUNDED = 2e-15
"""Newton's method ends at a residual below this fraction of the largest force: rounding."""

EXACT = 1e-13
SETTLED = 1e-10
"""It also ends at steps below these fractions: at once, or if the residual no longer falls."""


class Trial(NamedTuple):
    """The equation at a change of the forces."""

    slack: np.ndarray  # c g
    beyond: np.ndarray  # x - c g minus its projection
    left: float  # norm of the residual, x minus this projection


@dataclass(frozen=True, eq=False)
class FrictionEquation:
    """x = projected(x - c g) for changes of the forces x, with g = gaps + W change."""

    law: FrictionLaw
    W: Compliance
    gaps: np.ndarray
    forces: np.ndarray
    c: np.ndarray

    def at(self, change: np.ndarray) -> Trial:
        """The slack and the residual at a change."""
        slack = self.c * (self.gaps + self.W @ change)
        x = self.forces + change
        y = x - slack
        nearest = self.law.projected(y)
        missing = x - nearest
        return Trial(slack, y - nearest, math.sqrt(missing @ missing))

    def step(self, change: np.ndarray, trial: Trial) -> np.ndarray | None:
        """One semismooth Newton step; None if its matrix is singular.

        Rows without friction that open lose all forces, rows with it their normal ones.
        """
        law = self.law
        m = len(law.cap)
        closed = (self.forces + change - trial.slack)[:m] > 0
        closed |= law.tied
        opened = np.flatnonzero(~closed)
        rows, chosen = law.with_forces(closed)
        following = -self.forces
        following[chosen] = change[chosen]
        following[opened] = -self.forces[opened]
        if not np.array_equal(following, change):
            trial = self.at(following)
        y = self.forces + following - trial.slack

        _, J = self.linearised(y, closed, rows, chosen)
        residual = trial.slack.copy()
        residual[m:] += trial.beyond[m:]
        residual[opened] = 0.0
        try:
            following[chosen] -= np.linalg.solve(J, residual[chosen])
        except np.linalg.LinAlgError:
            return None
        return following - change if np.isfinite(following).all() else None

    def linearised(
        self, y: np.ndarray, closed: np.ndarray, rows: np.ndarray, chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The slope D of the projection at y, and Id - D + D c W for the ``chosen`` forces.

        Blocks of D are those of the ``rows`` with friction; other closed rows have D = 1.
        """
        law = self.law
        blocks = law.slope(y, closed)[rows]
        J = self.c[chosen, None] * self.W.block(chosen)
        rubbing = slice(blocks.shape[0] * blocks.shape[1])
        J[rubbing] = of_rows(blocks, J[rubbing])
        add_to_rows(J, np.eye(1 + law.d) - blocks)
        return blocks, J

    def solved(self, change: np.ndarray) -> tuple[float, np.ndarray, bool]:
        """The smallest residual of Newton's method, the change there, and whether it converged.

        Steps are shortened until they lower the residual; where none does, a full step ends cycles.
        """
        # the start is left out, as no product with a zero change is needed
        best = (np.inf, change, False)
        trial = self.at(change)
        scale = np.abs(self.forces).max(initial=0.0)
        for _ in range(STEPS):
            step = self.step(change, trial)
            if step is None:
                break
            before = trial.left
            length, trial = self._shortened(change, step, max(before, ROUNDED * scale))
            left = trial.left
            change = change + length * step
            x = self.forces + change
            moved = np.abs(step).max(initial=0.0)
            size = max(scale, np.abs(x).max(initial=0.0))
            settled = moved <= SETTLED * size and left > before / 2
            if left <= ROUNDED * size or moved <= EXACT * size or settled:
                exact = change + (self.law.projected(x) - x)
                return left, np.where(x == 0, -self.forces, exact), True
            best = min(best, (left, change, False), key=lambda found: found[0])
        return best

    def _shortened(
        self, change: np.ndarray, step: np.ndarray, before: float
    ) -> tuple[float, Trial]:
        """The length of a step that ends below a residual, else 1, and the equation there."""
        whole = self.at(change + step)
        length = 1.0
        found = whole
        while length > SHORTEST and not found.left < before:
            length /= 2
            found = self.at(change + length * step)
        return (length, found) if found.left < before else (1.0, whole)

    def approached(self, change: np.ndarray) -> tuple[np.ndarray, bool]:
        """The same where all bounds are given, by proximal points: Newton's method may cycle.

        The forces minimise a convex energy then.  Springs of a ``part`` of the compliance pull
        them to where they were, and are made softer as often as Newton's method converges
        (Rockafellar, SIAM J. Control Optim. 14, 1976).
        """
        part = 1.0
        for _ in range(PROXIMAL_STEPS):
            springs = part * self.W.diagonal
            problem = replace(
                self, W=self.W.plus(springs), gaps=self.gaps - springs * change
            )
            _, found, exact = problem.solved(change)
            part *= 0.1 if exact else 5.0
            if not exact:
                continue
            change = found
            _, found, exact = self.solved(change)
            if exact:
                return found, True
        return change, False
