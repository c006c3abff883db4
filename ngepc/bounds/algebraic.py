"""The part of the energy error that further iterations on the same mesh would remove.

It is bounded as the whole error is, with a discrete stress and discrete contact.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.convex import conjugate_of
from ngepc.bounds.data import balanced_stress, spring_energy, strain_coordinates
from ngepc.discretisation.factors import Factors
from ngepc.local.system import State


def algebraic_part(state: State, tangent: Factors) -> float:
    """Upper bound of J(u) - J_h: the same bound with a discrete stress and discrete contact."""
    return algebraic_gap(state, *discrete_stress(state, tangent))


def discrete_forces(state: State) -> np.ndarray:
    """The nodal forces (nodes, N) of loads and contact, with friction limited by its bound."""
    contact = state.discrete.contact
    pushed = contact.forces(contact.friction.projected(state.contact))
    return state.discrete.load - pushed


def discrete_stress(state: State, tangent: Factors) -> tuple[np.ndarray, float]:
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
