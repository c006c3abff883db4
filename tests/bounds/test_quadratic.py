"""Order two: upper bounds of the energy, parabolas on finer meshes, and its rate."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.crossings import finer
from ngsolve import CF, L2, GridFunction, x, y

from ngepc import Material, Problem, lshape_problem, semismooth_newton
from ngepc.bounds.bound import error_bound
from ngepc.bounds.copies import bisected
from ngepc.bounds.of_state import bound_data_of
from ngepc.bounds.polynomials import (
    AT_NODES,
    SPLIT,
    coefficients,
    exceeding,
    excess_integrals,
    quadratics,
    square_integrals,
)
from ngepc.bounds.transfer import carried_state, on_mesh
from ngepc.geometries import block, lshape
from ngepc.goals.adaptive import solve_to
from ngepc.goals.refinement import Refinement
from ngepc.local.system import DiscreteProblem
from ngepc.studies.bounds import LIMITS
from ngepc.studies.examples import example


def fine_points(count):
    """Centres of count^2 equal parts of a triangle, barycentric."""
    i, j = (v.ravel() for v in np.indices((count, count)))
    lower = i + j < count
    corners = np.stack([i[lower] + 1 / 3, j[lower] + 1 / 3], axis=1)
    upper = i + j < count - 1
    more = np.stack([i[upper] + 2 / 3, j[upper] + 2 / 3], axis=1)
    places = np.concatenate([corners, more]) / count
    return np.column_stack([places, 1 - places.sum(axis=1)])


@pytest.mark.parametrize(
    ("spread", "accuracy"), [(0.05, 1e-6), (0.5, 1e-3), (3.0, 3e-2)]
)
def test_plastic_integrals_from_below(spread, accuracy):
    """Against many points; the more exact the less the direction turns in a triangle."""
    random = np.random.default_rng(0)
    s = random.standard_normal((40, 1, 3)) + spread * random.standard_normal((40, 3, 3))
    size = np.linalg.norm(np.matmul(fine_points(200), s), axis=2)
    exact = (np.maximum(size - 1.0, 0.0) ** 2).mean(axis=1)
    found = exceeding(s, np.ones(40), np.ones(40))
    assert (found <= exact + 1e-4 * exact + 1e-9).all()
    assert found.sum() >= (1 - accuracy) * exact.sum() * (1 - 1e-4)


@pytest.mark.parametrize("k", [3, 6])
@pytest.mark.parametrize("power", [2, 4])
@pytest.mark.parametrize(("spread", "accuracy"), [(0.05, 1e-5), (0.3, 3e-2)])
def test_plastic_integrals_from_above(spread, accuracy, power, k):
    """Of affine and quadratic functions, against many points."""
    random = np.random.default_rng(0)
    s = 2 * random.standard_normal((40, 1, 3))
    s = s + spread * random.standard_normal((40, k, 3))
    places = fine_points(60)
    values = np.matmul(places if k == 3 else quadratics(places), s)
    one = np.ones(40)
    exact = ((np.linalg.norm(values, axis=2) - 1.0) ** 2).mean(axis=1)
    found = excess_integrals(s, one, one, power)
    likely = np.isfinite(found)
    assert likely.sum() > 20
    assert (found >= exact * (1 - 1e-3 * spread)).all()
    assert found[likely].sum() <= (1 + accuracy) * exact[likely].sum()


def test_quadratic_functions_on_parts():
    """Coefficients from nodes, on the four parts, and the exact integral of the square."""
    s = np.random.default_rng(1).standard_normal((1, 6, 2))
    shares = np.random.default_rng(2).dirichlet(np.ones(3), 5)
    assert coefficients(np.matmul(AT_NODES, s)) == pytest.approx(s)
    for corners, part in zip(SPLIT[3], np.matmul(SPLIT[6], s), strict=True):
        assert quadratics(shares) @ part == pytest.approx(
            (quadratics(shares @ corners) @ s)[0]
        )
    values = np.matmul(quadratics(fine_points(100)), s)
    mean = np.einsum("tqd,tqd->t", values, values) / values.shape[1]
    assert square_integrals(s, np.ones(1)) == pytest.approx(mean, rel=1e-3)


@pytest.fixture(scope="module")
def coarse():
    return semismooth_newton(replace(lshape_problem(lshape.paper_mesh(113)), order=2))


def displacement(state):
    u = GridFunction(state.discrete.supports.space)
    u.vec.FV().NumPy()[:] = state.u.T.ravel()
    return u


def test_parabolas_are_carried_exactly(coarse):
    problem = coarse.problem
    mesh, parents = bisected(problem.mesh, np.arange(problem.mesh.ne) % 3 == 0)
    carried = carried_state(
        coarse, DiscreteProblem(on_mesh(problem, mesh, parents)), parents
    )
    old, new = displacement(coarse.state), displacement(carried)
    random = np.random.default_rng(1)
    centres = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, :2]
    nodes = np.array([[v.nr for v in element.vertices] for element in mesh.Elements()])
    points = np.einsum(
        "tk,tkc->tc", random.dirichlet(np.ones(3), mesh.ne), centres[nodes]
    )
    before = np.array(old(problem.mesh(*points.T)))
    after = np.array(new(mesh(*points.T)))
    assert np.abs(after - before).max() <= 1e-14 * np.abs(before).max()


def test_the_energy_is_no_less_than_the_integral(coarse):
    """J(u) on a mesh bisected four times, where the points are many."""
    bound = error_bound(coarse)
    result = replace(coarse, state=bound.state)
    for _ in range(4):
        mesh, parents = bisected(
            result.problem.mesh, np.ones(result.problem.mesh.ne, dtype=bool)
        )
        discrete = DiscreteProblem(on_mesh(result.problem, mesh, parents))
        result = replace(coarse, state=carried_state(result, discrete, parents))
    many = result.state
    assert bound.energy >= many.energy - 1e-9 * abs(many.energy)
    assert bound.energy - many.energy <= 0.02 * bound.total


def test_histories_may_be_affine_on_triangles():
    """Of the mesh that they belong to: on finer ones they are the same functions."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
    )
    p, tensor = 1e-3 * (0.3 + x * y), CF((1, 0.5, 0, 0.5, -1, 0, 0, 0, 0), dims=(3, 3))
    mesh = block.mesh(0.3, (1.0, 0.7))
    strain = GridFunction(L2(mesh, order=1))
    strain.Set(p)
    history = {
        "initial_plastic_strain": strain * tensor,
        "initial_hardening": 90 * strain * tensor,
    }
    loads = {"traction": {"right": (1.0, -2.0)}, "contact": "contact", "gap": 1e-3}
    problem = Problem(
        mesh, material, order=2, kinematics="plane strain", **loads, **history
    )
    bounds = [error_bound(semismooth_newton(finer(problem, k))) for k in (0, 1, 3)]
    assert bounds[0].state.at.yields.any()
    energies, lower = (
        [getattr(b, name) for b in bounds] for name in ("energy", "least_energy")
    )
    assert max(lower) < min(energies)
    assert energies == sorted(energies, reverse=True)
    assert lower == sorted(lower)
    assert bounds[0].total < 1.3 * (energies[0] - energies[2])
    with pytest.raises(ValueError, match="initial_plastic_strain varies"):
        error_bound(
            semismooth_newton(replace(problem, initial_plastic_strain=p * tensor))
        )


def test_orders_agree(coarse):
    """Lower bounds from either order are below the energies of the other one."""
    two, one = (
        error_bound(coarse),
        error_bound(semismooth_newton(replace(coarse.problem, order=1))),
    )
    assert (
        max(one.least_energy, two.least_energy)
        < LIMITS["lshape"]
        < two.energy
        < one.energy
    )
    assert two.total < 0.4 * one.total


def test_adaptive_meshes_reach_the_rate_of_order_two(coarse):
    start = replace(lshape_problem(lshape.paper_mesh(65)), order=2)
    solved = solve_to(start, 4e-4, Refinement(max_nodes=3000))
    records = [r for r in solved.records if r.nodes > 150]
    fit = np.polyfit(
        np.log([r.nodes for r in records]), np.log([r.total for r in records]), 1
    )
    assert solved.reached
    assert fit[0] <= -1.7
    for record in solved.records:
        assert record.energy - LIMITS["lshape"] <= record.total
    assert records[-1].total <= 1.2 * (records[-1].energy - LIMITS["lshape"])


def test_the_pressure_is_zero_where_the_body_is_far_from_the_obstacle():
    """A solver of scipy for least squares with P >= 0 left pressure far from the contact zone."""
    result = semismooth_newton(replace(example("lshape", 1601), order=2))
    contact = bound_data_of(result.discrete).contact
    pressure = contact.from_rows.pressure(result.state.multipliers)
    gap = contact.slack(result.state.u)[:, :2]
    assert pressure[gap.min(axis=1) > 1e-3].max() < 1e-12 * pressure.max()


@pytest.mark.parametrize(
    ("body", "nodes", "order", "most"),
    [
        ("lshape", 833, 1, 1.15),
        ("wrench", 873, 1, 1.15),
        ("lshape", 833, 2, 1.15),
        ("wrench", 873, 2, 1.15),
    ],
)
def test_bounds_are_sharp_on_uniform_meshes(body, nodes, order, most):
    """The stress is computed on a copy that is bisected at the singular corners."""
    result = semismooth_newton(replace(example(body, nodes), order=order))
    bound = error_bound(result)
    error = bound.energy - LIMITS[body]
    assert 1 <= bound.total / error <= most

    assert bound.state.discrete.problem.mesh.nv > nodes
    assert bound.problem is result.problem
    assert len(bound.per_cell) == result.problem.mesh.ne
    assert bound.energy == pytest.approx(result.primal_energy, rel=1e-3)
