"""The part of the energy error that further iterations on the same mesh would remove.

It is bounded as the whole error is, with a discrete stress and discrete contact.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ngepc.bounds.balance import balanced_stress, spring_energy
from ngepc.bounds.convex import conjugate_of
from ngepc.bounds.coordinates import strain_coordinates
from ngepc.discretisation.factors import Factors, tangent_of
from ngepc.linalg.direct import FactorisationError
from ngepc.local.choice import DIRECT, fastest_solver
from ngepc.local.system import DiscreteProblem, State


class FewSolves:
    """A tangent by the fastest linear solver of a body, with what ``balanced_stress`` needs.

    For a few solves: where multigrid is faster than factors, these are made only if it fails.
    """

    moduli: Any = None

    def __init__(self, discrete: DiscreteProblem) -> None:
        slanted = discrete.supports.slanted is not None
        solver = DIRECT if slanted else fastest_solver(discrete)
        self._discrete = discrete
        self._tangent = tangent_of(discrete, solver)

    def update(self, moduli: Any) -> None:
        """Take the tangent with these moduli."""
        self.moduli = moduli
        self._tangent.update(moduli)

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements that answer nodal forces, as of ``Factors``."""
        try:
            return self._tangent.solve(forces)
        except FactorisationError:
            if isinstance(self._tangent, Factors):
                raise
        self._tangent = Factors(self._discrete, DIRECT)
        self._tangent.update(self.moduli)
        return self._tangent.solve(forces)

    def multiply(self, u: np.ndarray) -> np.ndarray:
        """The tangent times displacements, as of ``Factors``."""
        if isinstance(self._tangent, Factors):
            return self._tangent.multiply(u)
        return self._tangent.multiply(u.ravel()).reshape(u.shape)


def algebraic_part(state: State, tangent: Factors | FewSolves) -> float:
    """Upper bound of J(u) - J_h: the same bound with a discrete stress and discrete contact."""
    return algebraic_gap(state, *discrete_stress(state, tangent))


def discrete_forces(state: State) -> np.ndarray:
    """The nodal forces (nodes, N) of loads and contact, with friction limited by its bound."""
    contact = state.discrete.contact
    pushed = contact.forces(contact.friction.projected(state.contact))
    return state.discrete.load - pushed


def discrete_stress(
    state: State, tangent: Factors | FewSolves
) -> tuple[np.ndarray, float]:
    """A stress (points, c) near that of a state, in discrete equilibrium.

    The second result is what springs add to the bound.
    """
    z, moved = balanced_stress(state, tangent, discrete_forces(state))
    return z, spring_energy(state.discrete, moved)


def algebraic_gap(state: State, z: np.ndarray, sprung: float) -> float:
    """Upper bound of J(u) - J_h by a stress (points, c) in discrete equilibrium.

    ``sprung`` is what springs add to the bound.
    """
    discrete = state.discrete
    contact = discrete.contact
    forces = contact.friction.projected(state.contact)
    conjugate = conjugate_of(discrete.law)
    density = discrete.law.energy_density(state.at)
    density += conjugate.value(conjugate.completed(z[:, None]))[:, 0]
    gap = density - np.einsum("pc,pc->p", z, strain_coordinates(state))
    friction = contact.friction_work(forces, state.gaps, 0.0)
    in_the_body = discrete.points.integral(gap)
    return in_the_body + sprung + float(forces @ state.gaps + friction)
