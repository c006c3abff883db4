"""The laws of contact and friction as small dense problems for the forces of rows.

Semismooth Newton on the equations of ``friction_law`` solves them; without tangents block principal
pivoting does.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ngepc.linalg.box import in_box
from ngepc.linalg.contact_states import can_be_enumerated, equilibria
from ngepc.linalg.friction_equation import FrictionEquation
from ngepc.linalg.friction_law import FrictionLaw
from ngepc.linalg.row_blocks import of_rows
from ngepc.linalg.secants import Compliance

SOFT = (0.3, 0.03)
"""c times the compliance of a row; a second value is tried if Newton's method cycles."""


class FrictionCone(FrictionLaw):
    """The laws of ``FrictionLaw``, and the forces that meet them."""

    def of(self, rows: np.ndarray) -> FrictionCone:
        """The law of some rows."""
        law = self.cap[rows], self.coefficient[rows], self.tied[rows]
        return FrictionCone(*law, self.d, self.independent)

    def __call__(
        self, W: Compliance, gaps: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """The ``SmallProblem`` of ``secants``; where Newton's method fails the best that it saw."""
        if self.is_box:
            change, exact = in_box(W, gaps, forces, *self.box)
            if exact or self.d == 0:
                return change, exact
        compliance = self._along(W)
        best = (np.inf, np.zeros_like(forces))
        zero = np.zeros_like(forces)
        for start, soft in product((lambda: zero, lambda: stuck_change(W, gaps)), SOFT):
            equation = FrictionEquation(self, W, gaps, forces, soft / compliance)
            left, change, exact = equation.solved(start())
            if exact:
                return change, True
            best = min(best, (left / soft, change), key=lambda found: found[0])
        if self.enumerable:
            S = W.block(np.arange(len(gaps)))
            for found in self.equilibria(S, gaps, forces, S.diagonal())[:1]:
                equation = FrictionEquation(self, W, gaps, forces, SOFT[0] / compliance)
                _, change, exact = equation.solved(found - forces)
                if exact:
                    return change, True
        if self.is_convex:
            equation = FrictionEquation(self, W, gaps, forces, SOFT[0] / compliance)
            return equation.approached(self.projected(forces) - forces)
        return self.projected(forces + best[1]) - forces, False

    def response(
        self, W: Compliance, gaps: np.ndarray, forces: np.ndarray
    ) -> np.ndarray:
        """The ``Response`` of ``secants``."""
        equation = FrictionEquation(self, W, gaps, forces, SOFT[0] / self._along(W))
        y = forces - equation.c * gaps
        closed = (y[: len(self.cap)] > 0) | self.tied
        rows, chosen = self.with_forces(closed)
        blocks, J = equation.linearised(y, closed, rows, chosen)
        right = np.diag(equation.c[chosen])
        rubbing = slice(blocks.shape[0] * blocks.shape[1])
        right[rubbing] = of_rows(blocks, right[rubbing])
        A = np.zeros((len(gaps), len(gaps)))
        A[np.ix_(chosen, chosen)] = np.linalg.solve(J, right)
        return A

    def _along(self, W: Compliance) -> np.ndarray:
        """The compliance of each force, the same for all tangents of a row."""
        n, t = self.split(W.diagonal)
        return np.append(n, np.repeat(t.mean(axis=1), self.d))

    @property
    def enumerable(self) -> bool:
        """Whether all states of the rows can be tried: Coulomb's law on few rows in the plane.

        States do not determine forces that depend on each other.
        """
        by_pressure = self.d == 1 and not self.given.any() and self.independent
        return by_pressure and can_be_enumerated(self.cap, self.tied)

    def equilibria(
        self, S: np.ndarray, gaps: np.ndarray, forces: np.ndarray, sizes: np.ndarray
    ) -> np.ndarray:
        """All forces that meet the law of an ``enumerable`` cone, (count, n), nearest first.

        ``gaps`` are those that ``forces`` leave, ``sizes`` the compliances that gaps are judged by.
        """
        law = self.coefficient, self.cap, self.tied
        found = equilibria(S, gaps, forces, *law, sizes)
        apart = found - forces
        return found[np.argsort(np.einsum("ki,ij,kj->k", apart, S, apart))]


def stuck_change(W: Compliance, gaps: np.ndarray) -> np.ndarray:
    """The change of the forces after which all rows are closed and stick."""
    return -np.linalg.lstsq(W.block(np.arange(len(gaps))), gaps, rcond=None)[0]
