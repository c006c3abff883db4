"""One Newton step whose linear systems are solved by iterations, to what the step needs.

Contact is found by active sets: the closed rows are kept by a projection, and the set is corrected
by the signs of forces and gaps, each time from the last displacement (Hintermueller, Ito, Kunisch,
SIAM J. Optim. 13, 2002).  A few solves do for all rows together, whatever their number.  Friction
is part of it: rows that stick are kept along their tangents, too, and those that slip push with a
force that is linearised.  Where that cycles the forces of the rows are found by secants.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from ngepc.discretisation.contact_step import with_contact
from ngepc.discretisation.rows import HELD
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.friction import SHORTEST, SOFT
from ngepc.local.closed import Closed, Rubbing
from ngepc.local.iterative import IterativeTangent
from ngepc.local.system import DiscreteProblem, State

SETS = 30
"""Most active sets of one Newton step."""

PATIENCE = 10
"""Active sets with each c."""

PART = 0.1
"""What linear systems leave, as a part of what Newton's method or the tolerance does."""

FINEST = 1e-9
"""Smallest relative residual of a linear system."""

ANSWER = 3e-5
"""Largest relative residual of the systems that tell what rows with friction answer."""

SLACK = 0.3
"""What secants may leave of the conditions, as a part of what the linear systems leave."""


class Meeting(NamedTuple):
    """A change of u, forces of the rows in balance with it, and the gaps that it leaves."""

    change: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray

    def towards(self, other: Meeting, t: float) -> Meeting:
        """A part of the way to another one."""
        return Meeting(*(a + t * (b - a) for a, b in zip(self, other, strict=True)))


class InexactTarget:
    """Newton's model, minimised as exactly as the distance to the solution deserves.

    ``forcing`` is the largest relative residual of a linear system; none is solved beyond what the
    ``tolerance`` of the Newton iteration needs.
    """

    def __init__(self, discrete: DiscreteProblem, forcing: float, tolerance: float) -> None:
        self._forcing, self._tolerance, self._before = forcing, tolerance, 0.0
        self._compliance, self._contact = discrete.compliance(), discrete.contact
        free, tangential = discrete.free.ravel(), discrete.rows.tangential
        moved = np.asarray(abs(tangential[:, np.flatnonzero(free)]).sum(axis=1)).ravel()
        self._movable = (moved > HELD).reshape(discrete.rows.tangents.shape[:2])

    def accuracy(self, residual: float) -> float:
        """The relative residual for a step from here (Eisenstat and Walker 1996, choice 2).

        It is a small part of what Newton's method itself is about to leave, so that its steps do
        not depend on how the linear systems are solved.
        """
        before, self._before = self._before, residual
        falling = PART * (residual / before) ** 2 if before else 1.0
        return max(min(self._forcing, falling), PART * self._tolerance / residual, FINEST)

    def __call__(self, here: State, tangent: IterativeTangent) -> tuple[np.ndarray, np.ndarray]:
        """The change of u, and contact there; FactorisationError if they are not found."""
        tangent.linearise(here)
        accuracy, rough = self.accuracy(here.residual_norm), self._contact.friction.d > 0
        try:
            at, settled = self._sets(here, tangent, accuracy)
        except FactorisationError:
            if not rough:
                raise
            at, settled = None, False
        if rough and not settled:
            return self._secants(here, tangent, accuracy, at)
        change = self._contact.processes.spread(at.change.reshape(here.u.shape))
        nothing = np.zeros_like(at.forces)
        return change, at.forces - self._contact.defect(at.forces, nothing)

    def _sets(
        self, here: State, tangent: IterativeTangent, accuracy: float
    ) -> tuple[Meeting, bool]:
        """Contact and friction by active sets: the best found, and whether it is the solution."""
        contact, processes = self._contact, self._contact.processes
        rough = contact.friction.d > 0
        scale = accuracy * here.residual_norm * here.force_scale if rough else 0.0
        at = Meeting(np.zeros(here.u.size), here.contact, here.gaps)
        active, touching = here.multipliers > 0, here.touching_distance
        if not processes.any(active):
            active = here.open_gap < 0
        active |= contact.rows.tied
        for number in range(SETS):
            c = SOFT[number // PATIENCE % len(SOFT)] * here.discrete.row_stiffness
            found, scale = self._solved(here, tangent, at, active, c, accuracy, scale)
            at, length = self._shortened(at, found, c) if number else (found, 1.0)
            pressing = contact.normal(at.forces - c * at.gaps)
            closes = pressing > np.where(active, 0.0, contact.normal(c) * touching)
            closes |= contact.rows.tied
            settled = length == 1 and self._defect(at, c) <= scale
            if settled and not processes.any(closes != active):
                return at, True
            active = closes
        return at, False

    def _solved(
        self,
        here: State,
        tangent: IterativeTangent,
        at: Meeting,
        active: np.ndarray,
        c: np.ndarray,
        accuracy: float,
        scale: float,
    ) -> tuple[Meeting, float]:
        """Newton's model with these closed rows, friction linearised at what was found last.

        And the norm of forces that is left, ``scale`` or, if it is zero, a part of those here.
        """
        discrete, rubbing = here.discrete, self._rubbing(active, at.forces - c * at.gaps, c)
        closed = self._contact.processes.together(partial(Closed, discrete, active, rubbing))
        multiply = closed.stiffened(tangent.multiply)
        fixed = closed.moved(here.gaps[closed.numbers])
        loads = (discrete.load - here.internal_forces).ravel() - closed.slipping(here.gaps)
        right, start = closed.project(loads - multiply(fixed)), closed.project(at.change - fixed)
        scale = scale or accuracy * self._contact.processes.norm(right)
        change = fixed + tangent.minimise(closed, right, start, scale)
        gaps = here.gaps - self._contact.matrix @ change
        return Meeting(change, closed.forces(loads - multiply(change), gaps), gaps), scale

    def _shortened(self, at: Meeting, found: Meeting, c: np.ndarray) -> tuple[Meeting, float]:
        """The step that lowers the defect, and its length; all of it where none does.

        All on the way is in balance, so that no length costs a solve.
        """
        before, length = self._defect(at, c), 1.0
        while length > SHORTEST:
            nearer = found if length == 1 else at.towards(found, length)
            if self._defect(nearer, c) < before:
                return nearer, length
            length /= 2
        return found, 1.0

    def _defect(self, at: Meeting, c: np.ndarray) -> float:
        defect = self._contact.defect(at.forces, c * at.gaps)[self._contact.own]
        return float(np.sqrt(self._contact.processes.total(float(defect @ defect))))

    def _rubbing(self, active: np.ndarray, y: np.ndarray, c: np.ndarray) -> Rubbing | None:
        """What closed rows do by the trial forces y = x - c g; None without friction."""
        if not self._contact.friction.d:
            return None
        tangents = self._contact.tangential(c)[:, 0]
        return Rubbing.by(self._contact.friction, active, self._movable, y, tangents)

    def _secants(
        self, here: State, tangent: IterativeTangent, accuracy: float, at: Meeting | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Contact with friction by secants; what they leave of the gaps is made up for at last."""
        discrete, contact, rows = here.discrete, here.discrete.contact, here.discrete.rows
        if contact.processes.size > 1:
            raise FactorisationError(
                "friction on parts: no active set was found; try smaller load steps"
            )
        solve = partial(tangent.solve, accuracy=min(ANSWER, accuracy))
        if at is None:
            at = Meeting(solve(-here.imbalance), here.contact, here.gaps)
        slack = SLACK * accuracy * here.residual_norm * here.force_scale
        start, slack = at.change.reshape(here.u.shape), slack / discrete.row_stiffness.max()
        found = with_contact(here, solve, start, at.forces, self._compliance, slack)
        if found is None:
            raise FactorisationError(contact.unsolvable)
        change, forces = found
        left = here.open_gap - rows.normal @ change.ravel()
        active = (contact.normal(forces) > 0) | (left < 0) | rows.tied
        moved = Closed(discrete, active).moved(left[active])
        return change + moved.reshape(change.shape), forces
