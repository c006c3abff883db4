"""Factors in the order of a sweep: the inverse of the matrix as it stands."""

import numpy as np
import pytest
from ngepc.geometries import block, lshape, wrench

from ngepc import (
    Balanced,
    Coupled,
    Material,
    NewtonOptions,
    Problem,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.contact_newton import newton_system
from ngepc.dual.functional import DualFunctional
from ngepc.linalg.assembly import from_entries
from ngepc.linalg.ordering import OrderedFactors, swept, vertices_of_dofs

STEEL = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0)


def quasi_definite(n: int, seed: int):
    """A sparse symmetric matrix of both signs by its lower triangle, and the same, dense."""
    generator = np.random.default_rng(seed)
    i, j = (k.ravel() for k in np.indices((n, n)))
    chosen = (j <= i) & ((generator.random(n * n) < 0.1) | (i == j))
    i, j = i[chosen], j[chosen]
    values = generator.standard_normal(len(i))
    values[i == j] = np.where(np.arange(n) % 2 == 0, n, -n)
    dense = np.zeros((n, n))
    dense[i, j] = dense[j, i] = values
    return from_entries(i, j, values, n, n), dense


@pytest.mark.parametrize("name", ["sparsecholesky", "umfpack"])
def test_factors_invert_the_chosen_rows_and_columns(name):
    A, dense = quasi_definite(60, 1)
    order = np.random.default_rng(2).permutation(60)[:45]
    factors, x, y = OrderedFactors(A, order, name), A.CreateColVector(), A.CreateColVector()
    x.FV().NumPy()[:] = np.random.default_rng(3).standard_normal(60)
    for factor in (1.0, -3.0):
        A.AsVector().FV().NumPy()[:] *= factor
        dense *= factor
        factors.Update()
        y.data = factors * x
        expected = np.zeros(60)
        expected[order] = np.linalg.solve(dense[np.ix_(order, order)], x.FV().NumPy()[order])
        assert y.FV().NumPy() == pytest.approx(expected, rel=1e-12, abs=1e-14)


BODIES = {
    "lshape": (lambda: lshape_problem(lshape.paper_mesh(113)), Balanced()),
    "wrench": (lambda: wrench_problem(wrench.paper_mesh(437)), Coupled(1e3)),
    "block": (
        lambda: Problem(block.mesh(maxh=0.5), STEEL, "clamped", contact="contact", gap=-0.02),
        Balanced(),
    ),
    "quadrilaterals": (
        lambda: Problem(
            block.structured_mesh(4, 2),
            STEEL,
            "clamped",
            {"right": (0, 1)},
            contact="contact",
            gap=0.0,
        ),
        Balanced(),
    ),
}


@pytest.fixture(scope="module", params=BODIES)
def functional(request):
    make, regularisation = BODIES[request.param]
    blocks = LinearBlocks(make(), regularisation, "sparsecholesky")
    return DualFunctional(blocks, regularisation, 60)


def test_newton_steps_are_those_of_the_matrix_as_it_stands(functional):
    blocks, v = functional.blocks, functional.blocks.H_vector()
    v.FV().NumPy()[:] = np.random.default_rng(4).standard_normal(len(v))
    functional.make_feasible(v)
    system = newton_system(functional, "sparsecholesky")
    system.factorise(v)
    r = functional.penalty_gradient(v)
    r.FV().NumPy()[:] += np.random.default_rng(5).standard_normal(len(r))
    swept_steps = system.solve(r)
    plain = system._sum.matrix.Inverse(blocks.X.FreeDofs(coupling=True), inverse="sparsecholesky")
    system._inverse = plain
    for a, b in zip(swept_steps, system.solve(r), strict=True):
        difference = a.CreateVector()
        difference.data = a - b
        assert difference.Norm() < 1e-9 * b.Norm()


def test_a_sweep_visits_free_vertices_by_their_coordinates(functional):
    V = functional.blocks.Y.components[0]
    points = np.asarray(V.mesh.ngmesh.Coordinates())[:, : V.mesh.dim]
    order = swept(V, V.FreeDofs())
    assert sorted(order.tolist()) == np.flatnonzero(np.array(V.FreeDofs(), dtype=bool)).tolist()
    everything = np.ones(V.ndof, dtype=bool)
    visited = points[vertices_of_dofs(V, everything)[order]][:, ::-1].tolist()
    assert visited == sorted(visited)


def test_a_run_does_not_depend_on_the_direct_solver():
    problem = lshape_problem(lshape.paper_mesh(113))
    runs = [
        semismooth_newton(problem, options=NewtonOptions(inverse=name))
        for name in ("sparsecholesky", "umfpack")
    ]
    assert runs[0].iterations == runs[1].iterations
    assert runs[1].dual_energy == pytest.approx(runs[0].dual_energy, rel=1e-10)
