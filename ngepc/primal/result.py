"""An iterate of the primal solver, and what it gives back: fields, forces, energies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.balance import Balance
from ngepc.discretisation.pointfunctions import interpolated
from ngepc.primal.energy import ReducedEnergy
from ngepc.results.exact import DiscreteSolution


@dataclass(frozen=True, eq=False)
class PrimalState(Balance):
    """An iterate: displacements and contact forces, see ``Balance``, and the discrete energy."""

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


class PrimalResult(DiscreteSolution):
    """The last state of ``primal_newton``, see ``DiscreteSolution``."""

    state: PrimalState
    method_label = "exact (primal)"

    @cached_property
    def dual_energy(self) -> float:
        """-J at the solution by an identity that only the solution satisfies.

        J = 1/2 (l(u, p) + int beta |p| - contact forces . N u + <reactions, prescribed u>) without
        friction; with friction its work is added.  The sum with ``primal_energy`` is a measure of
        what is left.
        """
        state = self.state
        fixed = np.where(state.frame.free, 0.0, state.missing)
        work = np.vdot(fixed - state.contact_forces, state.u)
        friction = -state.contact @ state.gaps + state.multipliers @ state.open_gap
        return -0.5 * (state.reduced.first_order_energy(state.u) + float(work)) - friction

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        reduced = self.state.reduced
        reduced.set(self.state.u)
        return interpolated(self.problem, reduced.mapping.plastic_increment)
