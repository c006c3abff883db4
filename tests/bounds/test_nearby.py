"""Residuals on bisected copies, balanced by stresses on few cells."""

import numpy as np
import pytest

from ngepc import Material, Problem, semismooth_newton
from ngepc.bounds.copies import bisected
from ngepc.bounds.equilibration import laplacian_inverses
from ngepc.bounds.nearby import strain_nearby
from ngepc.bounds.transfer import carried_state, discrete_on
from ngepc.geometries import block
from ngepc.model.elements import inverses, solutions

METAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=1.0, hardening=1e2
)


def copied_state(order, cells=24):
    """The displacement of a pulled square on a copy with one bisected element in a corner."""
    mesh = block.structured_mesh(cells, cells, size=(1.0, 1.0), simplices=True)
    traction = {"contact": (0.3, 1.0)}
    result = semismooth_newton(Problem(mesh, METAL, traction=traction, order=order))
    chosen = np.arange(mesh.ne) == mesh.ne - 1
    finer, parents = bisected(mesh, chosen)
    discrete = discrete_on(result, finer, parents)
    return carried_state(result, discrete, parents)


def forces_of(state, strain):
    """The nodal forces of the stresses that the tangent has at these strains, where free."""
    forces = state.discrete.points.forces(
        *state.moduli.stress(strain[:, 0], strain[:, 1:])
    )
    return np.where(state.discrete.free, forces, 0.0)


@pytest.mark.parametrize("order", [1, 2])
def test_stresses_on_few_cells_balance_the_residual_of_a_copy(order):
    """The residual of a solution on new nodes is in equilibrium with stresses around them."""
    state = copied_state(order)
    discrete = state.discrete
    missing = np.where(discrete.free, discrete.load - state.internal_forces, 0.0)
    allowed = 1e-10 * np.abs(state.internal_forces).max()
    assert np.abs(missing).max() > 1e3 * allowed
    strain = strain_nearby(state, missing, allowed)
    np.testing.assert_allclose(forces_of(state, strain), missing, rtol=0, atol=allowed)
    assert np.count_nonzero(strain.any(axis=1)) <= 0.1 * len(strain)


def test_no_stresses_on_few_cells_balance_a_force():
    state = copied_state(1)
    force = np.zeros_like(state.u)
    inner = np.abs(state.discrete.problem.mesh.ngmesh.Coordinates()[:, :2] - 0.5)
    force[inner.sum(axis=1).argmin()] = 1.0, 0.0
    assert strain_nearby(state, force, 1e-10) is None


@pytest.mark.parametrize("size", [2, 3, 4])
def test_inverses_of_small_matrices(size):
    matrices = np.random.default_rng(0).normal(size=(50, size, size))
    unit = np.broadcast_to(np.eye(size), matrices.shape)
    np.testing.assert_allclose(matrices @ inverses(matrices), unit, atol=1e-11)


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_solutions_of_small_systems(size):
    """Positive definite matrices times what is found are the right sides."""
    random = np.random.default_rng(0)
    roots = random.normal(size=(50, 2, size, size))
    matrices = roots @ roots.swapaxes(2, 3) + 0.1 * np.eye(size)
    right = random.normal(size=(50, 2, size))
    found = np.einsum("tqij,tqj->tqi", matrices, solutions(matrices, right))
    np.testing.assert_allclose(found, right, atol=1e-11)


@pytest.mark.parametrize("corners", [1, 2, 5, 8, 9])
def test_inverse_laplacians_belong_to_their_own_graphs(corners):
    """Rings and fans of corners, numbered at random, one of them held."""
    random = np.random.default_rng(0)
    blocks = []
    for _ in range(40):
        order = random.permutation(corners)
        ends = np.stack([order, np.roll(order, -1)], axis=1)
        L = np.zeros((corners, corners))
        for i, j in ends[: corners - random.integers(2)].tolist():
            L[i, j] = L[j, i] = -1.0 * (i != j)
        L += np.diag(-L.sum(axis=1))
        L[0, 0] += 1.0
        blocks.append(L)
    found = laplacian_inverses(np.stack(blocks, axis=2))
    wanted = np.moveaxis(np.linalg.inv(blocks), 0, 2)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
