"""What is left of balance at a displacement with contact forces, and what rounding leaves of it."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Protocol

import numpy as np

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.floating import Floating
from ngepc.discretisation.loads import Supports
from ngepc.model.problem import Problem
from ngepc.model.processes import Alone

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12
"""Part of the largest displacement that a gap has to exceed to be open."""

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that counts as a force where nothing else does, in a body without forces."""


class Frame(Protocol):
    """What no Newton step changes, as far as balance asks for it."""

    problem: Problem
    contact: ContactConditions
    supports: Supports
    floating: Floating
    load: np.ndarray
    free: np.ndarray
    stiffness_diagonal: np.ndarray
    row_stiffness: np.ndarray
    yield_forces: float


class Balance:
    """Forces and gaps of an iterate; the iterates of both exact methods inherit it.

    It needs nodal displacements u and nodal forces of the stress, both (nodes, N), and forces of
    the contact conditions: normal forces >= 0, with friction then tangential ones.
    """

    frame: Frame
    u: np.ndarray
    contact: np.ndarray
    internal_forces: np.ndarray

    @property
    def multipliers(self) -> np.ndarray:
        """Normal forces lambda >= 0 of the rows, shape (m,)."""
        return self.frame.contact.normal(self.contact)

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces of the body on the obstacle, friction included, shape (nodes, N)."""
        return self.frame.contact.forces(self.contact)

    @cached_property
    def missing(self) -> np.ndarray:
        """Internal plus contact minus applied forces: reactions where held."""
        return self.internal_forces + self.contact_forces - self.frame.load

    @cached_property
    def imbalance(self) -> np.ndarray:
        """``missing`` at the free components, zero elsewhere."""
        return np.where(self.frame.free, self.missing, 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """What the contact conditions leave open, ``ContactConditions.gaps``."""
        return self.frame.contact.gaps(self.u)

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.frame.contact.normal(self.gaps)

    @property
    def touching_distance(self) -> float:
        """Gaps and penetrations below it are rounding (length)."""
        return TOUCHING * self._processes.most(np.abs(self.u))

    @property
    def penetration(self) -> float:
        """The deepest penetration (length), or what opens where nothing may; 0 if feasible."""
        tied = self.frame.contact.rows.tied
        depth = np.where(tied, np.abs(self.open_gap), -self.open_gap)
        return self._processes.most(np.maximum(depth, 0.0))

    @cached_property
    def friction_work(self) -> float:
        """The sum of bound times |slip| (force times length), zero without friction."""
        return self.frame.contact.friction_work(self.contact, self.gaps, self.touching_distance)

    @property
    def _processes(self) -> Alone:
        """Those that share the body."""
        return self.frame.contact.processes

    @cached_property
    def force_scale(self) -> float:
        """The force that residuals are relative to."""
        sizes = [self._processes.norm(a) for a in (self.frame.load, self.internal_forces)]
        return max(
            *sizes,
            self.contact_defect,
            min(ROUNDING_SCALE * self.trial_forces, self.frame.yield_forces),
        )

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|, from which the true ones are what does not cancel."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return self._processes.norm(self.frame.stiffness_diagonal * size)

    @cached_property
    def residual_norm(self) -> float:
        """Norm of the forces out of balance and of the contact defect, relative."""
        imbalance = self._processes.norm(self.imbalance)
        return math.hypot(self._relative(imbalance), self.contact_residual_norm)

    @property
    def contact_residual_norm(self) -> float:
        """The part of ``residual_norm`` that contact leaves."""
        return self._relative(self.contact_defect)

    @cached_property
    def contact_defect(self) -> float:
        """Norm of what the forces of contact lack, min(lambda, k gap) without friction."""
        contact, pushed = self.frame.contact, self.frame.row_stiffness * self.gaps
        own = contact.defect(self.contact, pushed)[contact.own]
        return math.sqrt(self._processes.total(float(own @ own)))

    def _relative(self, size: float) -> float:
        """A force over ``force_scale``."""
        if size == 0 or self.force_scale == 0:  # an obstacle that pushes a body at rest
            return float(size > 0)
        return size / self.force_scale

    @property
    def rounding(self) -> float:
        """What rounding leaves of ``residual_norm``."""
        if self.trial_forces == 0 or self.force_scale == 0:
            return 0.0
        return 4 * EPSILON * self.trial_forces / self.force_scale
