"""Observed orders of convergence: u 2 in L2 and 1 in the energy norm, p 1, J 2.

The body of ``manufactured`` yields above a curve that cuts through elements and
touches the obstacle between vertices; the ring of ``closed_forms`` is a polygon on each mesh.
Elements of order two gain an order on curved elements where the solution is smooth; the kink of
the strains at the plastic front allows them 3/2 for the strains.
"""

import math
from functools import cache

import numpy as np
import pytest
from closed_forms import Ring
from manufactured import stress, stretched_and_pressed
from ngsolve import CF, Grad, InnerProduct, Integrate, Norm, Sym, dx, x, y
from pairs import in_turn

from ngepc import (
    Material,
    Problem,
    Status,
    outward_normal,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block, ring

CELLS = (8, 16, 32)


def solve(problem, method):
    result = (
        primal_newton(problem) if method == "primal" else semismooth_newton(problem)
    )
    assert result.status is Status.CONVERGED
    return result


def norm(difference, mesh):
    size = InnerProduct(difference, difference)
    return math.sqrt(Integrate(size * dx(bonus_intorder=6), mesh))


def orders(errors):
    """Observed orders between consecutive meshes of half the width, a row for each pair."""
    return -np.diff(np.log2(np.array(errors)), axis=0)


@cache
def exact_energy():
    return stretched_and_pressed(block.structured_mesh(32, 32, simplices=True)).energy()


@cache
def manufactured_result(n, method, order):
    """The manufactured solution and the discrete one on n x n cells."""
    mesh = block.structured_mesh(n, n, simplices=True)
    exact = stretched_and_pressed(mesh, order=order)
    return exact, solve(exact.problem, method)


@cache
def manufactured_errors(n, method, order):
    """Errors of u in L2, of eps(u), of p and of J on n x n cells."""
    exact, result = manufactured_result(n, method, order)
    mesh = exact.problem.mesh
    return (
        norm(result.displacement - exact.displacement, mesh),
        norm(Sym(Grad(result.displacement)) - exact.strain, mesh),
        norm(result.plastic_increment - exact.plastic_increment, mesh),
        abs(result.primal_energy - exact_energy()),
    )


@pytest.fixture(scope="module")
def manufactured():
    """The errors on 8 x 8, 16 x 16 and 32 x 32 cells."""
    return [manufactured_errors(n, "dual", 1) for n in CELLS]


def test_the_body_force_is_in_equilibrium_with_the_stress():
    """Its derivatives are written out; here NGSolve takes them."""
    exact = stretched_and_pressed(block.structured_mesh(4, 4, simplices=True))
    sigma = stress(exact.displacement, exact.problem.material)
    divergence = CF(tuple(sigma[i, 0].Diff(x) + sigma[i, 1].Diff(y) for i in (0, 1)))
    force = exact.problem.f
    mesh = exact.problem.mesh
    assert norm(divergence + force, mesh) < 1e-12 * norm(force, mesh)


def test_both_methods_have_the_same_errors():
    exact, primal = (manufactured_errors(4, method, 1) for method in ("dual", "primal"))
    assert primal == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(
    ("column", "least"),
    [(0, 1.8), (1, 0.95), (2, 0.95), (3, 1.9)],
    ids=["u in L2: 2", "strain: 1", "p: 1", "J: 2"],
)
def test_orders_of_the_manufactured_solution(manufactured, column, least):
    observed = orders(manufactured)[:, column]
    assert observed[-1] > least
    assert observed[0] > 0.75 * least


def test_errors_of_the_manufactured_solution_are_small(manufactured):
    u, strain, p, energy = manufactured[-1]
    exact = stretched_and_pressed(block.structured_mesh(8, 8, simplices=True))
    mesh = exact.problem.mesh
    assert u < 2e-3 * norm(exact.displacement, mesh)
    assert strain < 0.05 * norm(exact.strain, mesh)
    assert p < 0.1 * norm(exact.plastic_increment, mesh)
    assert energy < 1e-3 * abs(exact.energy())


def test_manufactured_body_is_partly_elastic_and_partly_in_contact():
    exact, result = manufactured_result(16, "dual", 1)
    plastic, contact = (
        result.history.records[-1].plastic_active,
        result.history.records[-1].contact_active,
    )
    assert 0.3 < plastic < 0.9
    assert 0.5 < contact < 0.7
    on_contact = exact.problem.mesh.Boundaries("contact")
    force = Integrate(
        exact.contact_pressure, exact.problem.mesh, definedon=on_contact, order=10
    )
    assert result.contact_force == pytest.approx(force, rel=0.02)


STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
RING = Ring(1e3, 1e3, 1.25, 100.0)


def ring_errors(maxh, pressure, method, order=1):
    """Relative errors of u in L2, of the strains, and of the integral of |p|."""
    mesh = ring.quarter_mesh(maxh)
    mesh.Curve(order)
    rollers = {"left": (0, None), "bottom": (None, 0)}
    load = {"inner": -pressure * outward_normal(mesh)}
    flat = {"kinematics": "two-dimensional", "order": order}
    problem = Problem(mesh, STEEL, None, load, prescribed=rollers, **flat)
    result, exact = solve(problem, method), RING.displacement(pressure)
    u = norm(result.displacement - exact, mesh) / norm(exact, mesh)
    if RING.radius(pressure) == RING.a:
        return (u,)
    plastic = Integrate(RING.plastic_size(pressure), mesh, order=12)
    return u, abs(Integrate(Norm(result.plastic_increment), mesh) / plastic - 1)


@pytest.mark.parametrize(
    ("method", "pressure"), in_turn(["primal", "dual"], [0.5, 1.2])
)
def test_thick_ring_under_internal_pressure(pressure, method):
    """Lamé's solution, and the elasto-plastic one: order two, the domain being a polygon."""
    errors = [ring_errors(maxh, pressure, method) for maxh in (0.1, 0.05)]
    assert (orders(errors) > 1.75).all()
    assert max(errors[-1]) < 0.02


@pytest.mark.parametrize(
    ("pressure", "least", "method"), [(0.5, 2.8, "primal"), (1.2, 2.2, "dual")]
)
def test_thick_ring_of_curved_elements_of_order_two(pressure, least, method):
    """Order three in L2 where all is elastic, above two with a plastic front."""
    errors = [
        ring_errors(maxh, pressure, method, order=2)[0] for maxh in (0.2, 0.1, 0.05)
    ]
    assert orders(errors)[-1] > least
    assert errors[-1] < 2e-4


def test_elements_of_order_two_on_the_manufactured_solution():
    """Orders above 3/2 for strains and p, and smaller errors than with as many P1 unknowns."""
    errors = [manufactured_errors(n, "dual", 2) for n in (4, 8, 16)]
    linear = manufactured_errors(32, "dual", 1)
    assert orders(errors).mean(axis=0)[1] > 1.75
    assert orders(errors).mean(axis=0)[2] > 1.75
    assert errors[-1][0] < 0.5 * linear[0]
    assert errors[-1][1] < 0.15 * linear[1]
    assert errors[-1][2] < 0.15 * linear[2]
