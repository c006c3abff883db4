"""Stresses in equilibrium with nodal forces, by a tangent, also of parts that float."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg

from ngepc.bounds.coordinates import Displaced, stress_coordinates
from ngepc.bounds.nearby import strain_nearby
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem, State

BALANCED = 1e-12
PASSES = 2
"""Tolerance of equilibrium relative to the largest nodal force, and the most corrections."""

FLOATING_STEPS = 20
"""Most steps of conjugate gradients where parts float."""

REDUCED = 1e-10
"""Their tolerance: rounding errors move the parts in longer runs."""

SPRING_PASSES = 30
"""Most solves after them, until weak springs carry no more than rounding errors."""


def balanced_stress(
    state: State, tangent: Factors, load: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stresses (points, c) near those of a state, in equilibrium with nodal forces (nodes, N).

    The defect of the nodal forces is corrected by a tangent.  Together with the stresses, the
    springs at the displacement of the state plus the second result carry the forces.
    """
    discrete = state.discrete
    floating = discrete.floating
    moved = np.zeros_like(state.u)
    z = stress_coordinates(*discrete.law.stress(state.at))
    forces = state.internal_forces
    for _ in range(1 if floating.centres else PASSES):
        missing = discrete.supports.kept(load - forces)
        allowed = BALANCED * np.abs(forces).max()
        if np.abs(missing).max() <= allowed:
            break
        if tangent.moduli is None and not floating.centres:
            strain = strain_nearby(state, missing, allowed)
            if strain is not None:
                change = state.moduli.stress(strain[:, 0], strain[:, 1:])
                z = z + stress_coordinates(*change)
                break
        factorise(state, tangent)
        if floating.centres:
            change = without_weak_springs(discrete, tangent, missing)
        else:
            change = tangent.solve(missing)
        moved = moved + change
        z = z + Displaced.of(discrete, change).stress_change(tangent)
        forces = forces + tangent.multiply(change) - floating.springs * change
    return z, moved


def without_weak_springs(
    discrete: DiscreteProblem, tangent: Factors, forces: np.ndarray
) -> np.ndarray:
    """Displacements that answer nodal forces (nodes, N), in balance on floating parts.

    The weak springs that the tangent has on these parts are left out, by conjugate gradients, which
    also converge where the springs are as stiff as a part that yields.  In the end what springs
    still carry is given back to the body until only rounding errors are left.  Rigid motions of the
    parts are arbitrary.
    """
    supports = discrete.supports
    springs = discrete.floating.springs

    def held(u: np.ndarray) -> np.ndarray:
        """The forces of the tangent without the springs at displacements (nodes, N)."""
        return supports.kept(tangent.multiply(u) - springs * u)

    shape = 2 * (forces.size,)
    K = LinearOperator(shape, matvec=lambda u: held(u.reshape(forces.shape)).ravel())
    M = LinearOperator(
        shape, matvec=lambda r: tangent.solve(r.reshape(forces.shape)).ravel()
    )
    wanted = supports.kept(forces)
    found, _ = cg(K, wanted.ravel(), rtol=REDUCED, maxiter=FLOATING_STEPS, M=M)
    found = found.reshape(forces.shape)
    before = np.inf
    for _ in range(SPRING_PASSES):
        missing = wanted - held(found)
        left = np.abs(missing).max(initial=0.0)
        if left >= before:
            break
        before = left
        found = found + tangent.solve(missing)
    return found


def spring_energy(discrete: DiscreteProblem, u: np.ndarray) -> float:
    """The energy of the springs at displacements (nodes, N)."""
    return 0.5 * float(np.vdot(u, discrete.supports.pull(u)))


def factorise(state: State, tangent: Factors) -> None:
    """Factorise the tangent at the state, unless it has factors already."""
    if tangent.moduli is None:
        tangent.update(state.moduli)
