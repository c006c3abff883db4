"""One Newton step whose linear systems are solved by iterations, to what the step needs.

Contact is found by active sets: the closed rows are kept by a projection, and the set is corrected
by the signs of forces and gaps, each time from the last displacement (Hintermueller, Ito, Kunisch,
SIAM J. Optim. 13, 2002).  A few solves do for all rows together, whatever their number.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ngepc.local.iterative import Closed, IterativeTangent
from ngepc.local.step import Target
from ngepc.local.system import State

SETS = 30
"""Most active sets of one Newton step."""


FINEST = 1e-9
"""Smallest relative residual of a linear system."""


class InexactTarget:
    """Newton's model, minimised as exactly as the distance to the solution deserves.

    Parameters
    ----------
    forcing
        Largest relative residual of a linear system.
    tolerance
        Of the Newton iteration: linear systems are not solved beyond what it needs.
    """

    def __init__(self, forcing: float, tolerance: float) -> None:
        self._forcing, self._tolerance, self._before = forcing, tolerance, 0.0

    def accuracy(self, residual: float) -> float:
        """The relative residual for a step from here (Eisenstat and Walker 1996, choice 2)."""
        before, self._before = self._before, residual
        falling = 0.5 * (residual / before) ** 1.5 if before else 1.0
        return min(self._forcing, max(falling, 0.3 * self._tolerance / residual, FINEST))

    def __call__(self, here: State, tangent: IterativeTangent) -> Target:
        """The change of u, and contact there.

        Raises
        ------
        ValueError
            If the problem has friction or parts that contact alone holds.
        """
        discrete, rows = here.discrete, here.discrete.rows
        processes = discrete.points.processes
        if discrete.contact.friction is not None or discrete.springs is not None:
            raise ValueError("inverse: friction and floating parts need a direct solver")
        tangent.update(discrete.law.moduli(here.at, here.yielding))
        forces = (discrete.load - here.internal_forces).ravel()
        accuracy, gap = self.accuracy(here.residual_norm), here.open_gap
        change, active, scale = np.zeros(forces.size), here.multipliers > 0, 0.0
        if not processes.any(active):
            active = gap < 0
        active |= rows.tied
        for _ in range(SETS):
            closed = processes.together(partial(Closed, discrete, active))
            fixed = closed.moved(gap[active])
            right = closed.project(forces - tangent.multiply(fixed))
            scale = scale or accuracy * processes.norm(right)
            start = closed.project(change - fixed)
            change = fixed + tangent.minimise(closed, right, start, scale)
            multipliers = np.zeros(len(rows))
            multipliers[active] = closed.forces(forces - tangent.multiply(change))
            left = gap - rows.normal @ change
            correct = np.where(active, multipliers > 0, left < -here.touching_distance) | rows.tied
            if not processes.any(correct != active):
                break
            active = correct
        multipliers = np.where(rows.tied, multipliers, np.maximum(multipliers, 0.0))
        return Target(processes.spread(change.reshape(here.u.shape)), multipliers)
