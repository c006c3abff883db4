"""One Newton step whose linear systems are solved iteratively, with adaptive accuracy.

Contact is found by active sets: the closed rows are kept by a projection, and the set is corrected
by the signs of forces and gaps, each time from the last displacement (Hintermueller, Ito, Kunisch,
SIAM J. Optim. 13, 2002).  A few solves are sufficient for all rows together, for any number of
them.  Friction is part of it: rows that stick are kept along their tangents, too, and those that
slip push with a force that is linearised.  Where that cycles the forces of the rows are found by
secants.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ngepc.discretisation.contact_step import with_contact
from ngepc.discretisation.rows import HELD
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.friction import SOFT
from ngepc.linalg.friction_equation import SHORTEST
from ngepc.linalg.secants import Compliance
from ngepc.local.closed import Closed, TangentialRows
from ngepc.local.iterative import IterativeTangent
from ngepc.local.system import DiscreteProblem, State

SETS = 30
"""Largest number of active sets of one Newton step."""

PATIENCE = 10
"""Active sets with each c."""

PART = 0.1
"""Residual of linear systems, as a part of the expected one of Newton's method or of the
tolerance."""

FINEST = 1e-9
"""Smallest relative residual of a linear system."""

CLOSER = 1e-2
"""Factor of the relative residual where a step does not lower the energy."""


class ContactResponse(NamedTuple):
    """A change of u, the forces of the rows in balance with it, and the resulting gaps."""

    change: np.ndarray
    forces: np.ndarray
    gaps: np.ndarray


class InexactTarget:
    """Newton's model, minimised with an accuracy that follows the residual.

    ``forcing`` is the largest relative residual of a linear system; none is solved beyond what the
    ``tolerance`` of the Newton iteration needs.
    """

    def __init__(
        self, discrete: DiscreteProblem, forcing: float, tolerance: float
    ) -> None:
        self._forcing = forcing
        self._tolerance = tolerance
        self._body = discrete
        self._contact = discrete.contact
        free = discrete.free.ravel()
        tangential = discrete.rows.tangential
        moved = np.asarray(abs(tangential[:, np.flatnonzero(free)]).sum(axis=1)).ravel()
        self._movable = (moved > HELD).reshape(discrete.rows.tangents.shape[:2])

    @cached_property
    def _compliance(self) -> Compliance:
        """A guess of the compliance of all rows: a dense matrix, which few problems need."""
        return self._body.compliance()

    def closer(self) -> InexactTarget | None:
        """One that solves linear systems more accurately, None at the finest."""
        if self._forcing <= FINEST:
            return None
        closer = copy(self)
        closer._forcing = CLOSER * self._forcing
        return closer

    def accuracy(self, residual: float, before: float | None) -> float:
        """The relative residual for a step from here (Eisenstat and Walker 1996, choice 2).

        It is a small part of the residual that Newton's method is expected to leave, so that the
        steps do not depend on how the linear systems are solved.  ``before`` is the residual one
        iterate earlier.
        """
        falling = PART * (residual / before) ** 2 if before else 1.0
        return max(
            min(self._forcing, falling), PART * self._tolerance / residual, FINEST
        )

    def __call__(
        self, here: State, tangent: IterativeTangent, before: float | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The change of u, and the contact forces after it; FactorisationError for none."""
        tangent.linearise(here)
        accuracy = self.accuracy(here.residual_norm, before)
        rough = self._contact.friction.d > 0
        try:
            at, settled = self._sets(here, tangent, accuracy)
        except FactorisationError:
            if not rough:
                raise
            settled = False
        if rough and not settled:
            if self._contact.processes.size > 1:
                raise FactorisationError(
                    "friction on a distributed mesh: no active set was found; try smaller steps"
                )
            return with_contact(here, tangent.solve, self._compliance)
        change = self._contact.processes.spread(at.change.reshape(here.u.shape))
        return change, self._contact.friction.projected(at.forces)

    def _sets(
        self, here: State, tangent: IterativeTangent, accuracy: float
    ) -> tuple[ContactResponse, bool]:
        """Contact and friction by active sets: the best found, and whether it is the solution.

        Each set minimises Newton's model with these closed rows, with friction linearised at the
        last forces; linear systems are solved up to residual forces of size ``scale``.  Without
        friction the sets end, too, where the last displacement solves the system of a set that
        only opens rows: rows whose forces are smaller than that accuracy would open and close.
        """
        contact = self._contact
        processes = self._contact.processes
        scale = 0.0
        if contact.friction.d:
            scale = accuracy * here.residual_norm * here.force_scale
        at = ContactResponse(np.zeros(here.u.size), here.contact, here.gaps)
        active = self._first_set(here)
        out_of_balance = (here.body.load - here.internal_forces).ravel()
        for number in range(SETS):
            c = SOFT[number // PATIENCE % len(SOFT)] * here.discrete.row_stiffness
            trial_forces = at.forces - c * at.gaps
            projection = partial(self._closed, active, trial_forces, c)
            closed = processes.together(projection)

            # Newton's model with these rows closed: u = fixed + what the rows allow.
            multiply = closed.stiffened(tangent.multiply)
            fixed = closed.moved(here.gaps[closed.numbers])
            loads = out_of_balance - closed.slipping(here.gaps)
            right = closed.unbalanced(loads - multiply(fixed))
            start = closed.project(at.change - fixed)
            before = tangent.linear_iterations
            scale = scale or accuracy * processes.norm(right)
            change = fixed + tangent.minimise(closed, right, start, scale)
            gaps = here.gaps - contact.matrix @ change
            forces = closed.forces(loads - multiply(change), gaps)
            found = ContactResponse(change, forces, gaps)
            at, whole = self._shortened(at, found, c) if number else (found, True)

            # The rows that press by these forces and gaps are closed in the next set.
            pressing = contact.normal(at.forces - c * at.gaps)
            rounding = contact.normal(c) * here.touching_distance
            closes = (pressing > np.where(active, 0.0, rounding)) | contact.rows.tied
            settled = whole and contact.defect(at.forces, c * at.gaps) <= scale
            if settled and not processes.any(closes != active):
                return at, True
            moved = contact.friction.d or tangent.linear_iterations > before
            if not moved and not processes.any(closes & ~active):
                return at, False
            active = closes
        return at, False

    def _first_set(self, here: State) -> np.ndarray:
        """The rows that press or penetrate, and tied rows."""
        penetrated = here.open_gap < -here.touching_distance
        return (here.multipliers > 0) | penetrated | self._contact.rows.tied

    def _closed(self, active: np.ndarray, y: np.ndarray, c: np.ndarray) -> Closed:
        """Closed rows, and their tangential behaviour for the trial forces y = x - c g."""
        contact = self._contact
        tangential_rows = None
        if contact.friction.d:
            along = contact.tangential(c)[:, 0]
            tangential_rows = TangentialRows.by(
                contact.friction, active, self._movable, y, along
            )
        return Closed(self._body, active, tangential_rows)

    def _shortened(
        self, at: ContactResponse, found: ContactResponse, c: np.ndarray
    ) -> tuple[ContactResponse, bool]:
        """The shortened step that decreases the defect, and whether it is a full step.

        If no length decreases it, the full step is taken.  Forces are in balance along the whole
        step, so that a length needs no solve.
        """
        before = self._contact.defect(at.forces, c * at.gaps)
        nearer = found
        length = 1.0
        while length > SHORTEST:
            if self._contact.defect(nearer.forces, c * nearer.gaps) < before:
                return nearer, length == 1
            length /= 2
            nearer = ContactResponse(
                *(a + length * (b - a) for a, b in zip(at, found, strict=True))
            )
        return found, True
