"""An iterate of the primal solver: displacements, contact forces, and what is left of balance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ngepc.primal.energy import ReducedEnergy

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12
"""Part of the largest displacement that a gap has to exceed to be open."""

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that counts as a force where nothing else does, in a body without forces."""


@dataclass(frozen=True, eq=False)
class PrimalState:
    """Displacements and contact forces with everything that follows from them.

    Parameters
    ----------
    reduced
        The discrete energy.
    u
        Nodal displacements, shape (nodes, N).
    contact
        Forces of the contact conditions: normal forces >= 0, with friction then tangential ones.
    """

    reduced: ReducedEnergy
    u: np.ndarray
    contact: np.ndarray

    @cached_property
    def energy(self) -> float:
        """J, smallest over p, and friction (force times length)."""
        reduced = self.reduced
        friction = reduced.contact.friction_work(self.contact, self.gaps, self.touching_distance)
        return reduced.energy(self.u) + friction

    @property
    def multipliers(self) -> np.ndarray:
        """Normal forces >= 0 of the rows, shape (m,)."""
        return self.reduced.contact.normal(self.contact)

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress, shape (nodes, N)."""
        return self.reduced.internal_forces(self.u)

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces of the body on the obstacle, friction included, shape (nodes, N)."""
        return self.reduced.contact.forces(self.contact)

    @cached_property
    def missing(self) -> np.ndarray:
        """Internal plus contact minus applied forces: reactions where held."""
        return self.internal_forces + self.contact_forces - self.reduced.load

    @cached_property
    def imbalance(self) -> np.ndarray:
        """``missing`` at the free components, zero elsewhere."""
        return np.where(self.reduced.free, self.missing, 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """What the contact conditions leave open, ``ContactConditions.gaps``."""
        return self.reduced.contact.gaps(self.u)

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.reduced.contact.normal(self.gaps)

    @property
    def touching_distance(self) -> float:
        """Gaps and penetrations below it are rounding (length)."""
        return TOUCHING * float(np.abs(self.u).max(initial=0.0))

    @property
    def penetration(self) -> float:
        """The deepest penetration (length), 0 for a feasible displacement."""
        return float(np.maximum(-self.open_gap, 0.0).max(initial=0.0))

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|, from which the true ones are what does not cancel."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return float(np.linalg.norm(self.reduced.stiffness_diagonal * size))

    @cached_property
    def force_scale(self) -> float:
        """The force that residuals are relative to."""
        sizes = np.linalg.norm(self.reduced.load), np.linalg.norm(self.internal_forces)
        small = min(ROUNDING_SCALE * self.trial_forces, self.reduced.yield_forces)
        return float(max(*sizes, small))

    @cached_property
    def residual_norm(self) -> float:
        """Forces out of balance and what the forces of contact lack, relative."""
        pushed = self.reduced.row_stiffness * self.gaps
        defect = self.reduced.contact.defect(self.contact, pushed)
        size = math.hypot(np.linalg.norm(self.imbalance), np.linalg.norm(defect))
        if size == 0 or self.force_scale == 0:
            return float(size > 0)
        return size / self.force_scale

    @property
    def rounding(self) -> float:
        """What rounding leaves of ``residual_norm``."""
        if self.trial_forces == 0:
            return 0.0
        return 4 * EPSILON * self.trial_forces / self.force_scale
