"""One Newton step whose linear systems are solved by iterations, to what the step needs.

Contact is found by active sets: the closed rows are kept by a projection, and the set is corrected
by the signs of forces and gaps, each time from the last displacement (Hintermueller, Ito, Kunisch,
SIAM J. Optim. 13, 2002).  A few solves do for all rows together, whatever their number.  With
friction the forces of the rows are found by secants, one solve for each.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ngepc.discretisation.contact_step import with_contact
from ngepc.linalg.compliance import Compliance
from ngepc.local.closed import Closed
from ngepc.local.factors import TangentError
from ngepc.local.iterative import IterativeTangent
from ngepc.local.step import Target
from ngepc.local.system import DiscreteProblem, State

SETS = 30
"""Most active sets of one Newton step."""

FINEST = 1e-9
"""Smallest relative residual of a linear system."""

ANSWER = 3e-5
"""Largest relative residual of the systems that tell what rows with friction answer."""

SLACK = 0.3
"""What secants may leave of the conditions, as a part of what the linear systems leave."""


class InexactTarget:
    """Newton's model, minimised as exactly as the distance to the solution deserves.

    Parameters
    ----------
    discrete
        The discrete problem; with friction, what its rows answer is learned from step to step.
    forcing
        Largest relative residual of a linear system.
    tolerance
        Of the Newton iteration: linear systems are not solved beyond what it needs.
    """

    def __init__(self, discrete: DiscreteProblem, forcing: float, tolerance: float) -> None:
        self._forcing, self._tolerance, self._before = forcing, tolerance, 0.0
        self._compliance = Compliance(
            discrete.contact.grip(discrete.row_stiffness)[1],
            discrete.floating.compliance(discrete.stiffness_diagonal),
        )
        self._meet = self._sets if discrete.contact.friction is None else self._rub

    def accuracy(self, residual: float) -> float:
        """The relative residual for a step from here (Eisenstat and Walker 1996, choice 2)."""
        before, self._before = self._before, residual
        falling = 0.5 * (residual / before) ** 1.5 if before else 1.0
        return min(self._forcing, max(falling, 0.3 * self._tolerance / residual, FINEST))

    def __call__(self, here: State, tangent: IterativeTangent) -> Target:
        """The change of u, and contact there.

        Raises
        ------
        TangentError
            If a linear system or the contact with friction is not solved.
        """
        tangent.linearise(here)
        return self._meet(here, tangent, self.accuracy(here.residual_norm))

    def _sets(self, here: State, tangent: IterativeTangent, accuracy: float) -> Target:
        """Contact by active sets."""
        discrete, rows = here.discrete, here.discrete.rows
        processes = discrete.points.processes
        forces, gap = (discrete.load - here.internal_forces).ravel(), here.open_gap
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

    def _rub(self, here: State, tangent: IterativeTangent, accuracy: float) -> Target:
        """Contact with friction by secants; what they leave of the gaps is made up for at last."""
        discrete, contact, rows = here.discrete, here.discrete.contact, here.discrete.rows
        solve = partial(tangent.solve, accuracy=min(ANSWER, accuracy))
        change = solve(-here.imbalance)
        slack = SLACK * accuracy * here.residual_norm * here.force_scale
        found = with_contact(
            *(contact, solve, here.u, here.contact, change, self._compliance),
            discrete.row_stiffness,
            slack / discrete.row_stiffness.max(),
        )
        if found is None:
            raise TangentError(contact.unsolvable)
        change, forces = found
        left = here.open_gap - rows.normal @ change.ravel()
        active = (contact.normal(forces) > 0) | (left < 0) | rows.tied
        moved = Closed(discrete, active).moved(left[active])
        return Target(change + moved.reshape(change.shape), forces)
