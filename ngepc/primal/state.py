"""An iterate of the primal solver: displacements, contact forces, and what is left of balance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ngepc.discretisation.balance import Balance
from ngepc.primal.energy import ReducedEnergy


@dataclass(frozen=True, eq=False)
class PrimalState(Balance):
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

    @property
    def frame(self) -> ReducedEnergy:
        """The discrete energy, see ``Balance``."""
        return self.reduced

    @cached_property
    def energy(self) -> float:
        """J, smallest over p, and friction (force times length)."""
        return self.reduced.energy(self.u) + self.friction_work

    @property
    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        self.reduced.set(self.u)
        return self.reduced.mapping.flowing()

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress, shape (nodes, N)."""
        return self.reduced.internal_forces(self.u)
