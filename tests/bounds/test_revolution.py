"""Error bounds of bodies of revolution: closed forms, exact cases, integrals, admissibility."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaigns.crossings import Crossing, finer
from campaigns.rings import rectangle
from ngsolve import CF, sin, x, y

from ngepc import (
    Material,
    Problem,
    Tabulated,
    contact_force_bracket,
    error_bound,
    goal_bound,
    semismooth_newton,
    solve_to,
    write_receipt,
)
from ngepc.bounds.of_state import data_on
from ngepc.bounds.polynomials import SPLIT, quadratics, triangle_rule
from ngepc.bounds.ring_element import RR, RZ, TO_COORDINATES, TT, ZZ, RingElement
from ngepc.bounds.ring_energy import RingEnergy, quadratics_at
from ngepc.bounds.ring_integrals import OverRadius
from ngepc.bounds.simplices import Simplices
from ngepc.linalg.bernstein import bernstein_values, from_lattice, lattice_points
from ngepc.model.kinematics import AXISYMMETRIC

ELASTIC = Material.kinematic(
    lame_lambda=3.0, lame_mu=2.0, yield_stress=1e6, hardening=0.5
)
YIELDING = replace(ELASTIC, yield_stress=0.4)


def body(mesh, material, clamped=None, **data):
    return Problem(mesh, material, clamped, kinematics="axisymmetric", **data)


def tube(maxh, order, inner=1.0, material=ELASTIC):
    """A tube in plane strain of the thickness 1 and the height 0.6 under the pressure 1."""
    mesh = rectangle(maxh, inner, inner + 1, 0.6)
    flat = {"bottom|top": (None, 0)}
    return body(mesh, material, pressure={"left": 1.0}, prescribed=flat, order=order)


def least_energy_of(inner):
    """Half of minus the work of the pressure in the solution A r + B/r of Lame."""
    outer = inner + 1
    bulk = 2 * (ELASTIC.lame_lambda + ELASTIC.lame_mu)
    shear = 2 * ELASTIC.lame_mu
    # sigma_rr = bulk A - shear B / r^2
    matrix = [[bulk, -shear / inner**2], [bulk, -shear / outer**2]]
    A, B = np.linalg.solve(matrix, [-1.0, 0.0])
    return -math.pi * inner * 0.6 * (A * inner + B / inner)


@pytest.mark.parametrize(
    ("inner", "order", "most"),
    [
        *((0.05, 1, 1.06), (1.0, 1, 1.01), (30.0, 1, 1.001)),
        *((0.05, 2, 1.1), (1.0, 2, 1.03), (30.0, 2, 1.01)),
    ],
)
def test_the_energy_of_a_tube_lies_within_the_bounds(inner, order, most):
    bound = error_bound(semismooth_newton(tube(0.3, order, inner)))
    least = least_energy_of(inner)
    error = bound.energy - least
    assert bound.guaranteed
    assert 0 < error <= bound.total <= most * error
    assert bound.per_cell.min() >= -1e-9 * bound.total


@pytest.mark.parametrize("material", [ELASTIC, YIELDING])
@pytest.mark.parametrize("order", [1, 2])
def test_the_bound_of_a_homogeneous_strain_is_zero(material, order):
    """A solid cylinder is pressed between plates without friction."""
    mesh = rectangle(0.4, 0.0, 1.0, 0.8)
    lying = {"bottom": (None, 0)}
    data = {"contact": "top", "gap": -0.2, "prescribed": lying, "order": order}
    result = semismooth_newton(body(mesh, material, **data))
    bound = error_bound(result)
    assert bound.total <= 1e-10 * bound.strain_energy
    assert result.state.at.yields.all() == (material is YIELDING)
    assert np.ptp(bound.pressure) <= 1e-8 * bound.pressure.max()


def loaded(order, material=YIELDING):
    """A cylinder under its weight, rotating, sheared at its side, and indented on the axis."""
    return body(
        rectangle(0.35, 0.0, 1.0, 0.8),
        material,
        "bottom",
        traction={"right": (0.2 * y, 0.1)},
        body_force=(0.3 * x, -0.2),
        contact="top",
        gap=x**2 / 4 - 0.1,
        order=order,
    )


@pytest.mark.parametrize("order", [1, 2])
def test_the_stress_does_the_work_of_the_loads(order):
    """Of loads and pressure, in displacements that vanish on the clamped boundary."""
    result = semismooth_newton(loaded(order))
    bound = error_bound(result)
    bound_data = data_on(bound.state.discrete)
    cells = bound_data.cut.cells
    k = bound_data.degree
    shares, weights = triangle_rule(12)
    corners = cells.points[cells.nodes]
    r, z = np.moveaxis(np.matmul(shares, corners), 2, 0)
    stress = bernstein_values(k, shares) @ from_lattice(2, k) @ bound.admissible
    top = np.linspace(0, 1, 2001)
    P = vertex_function(bound, cells)
    for u, v, gradient in virtual_displacements():
        (rr, rz), (zr, zz) = gradient(r, z)
        shear = (rz + zr) / 2
        zero = np.zeros_like(rr)
        strain = np.array(
            [[rr, shear, zero], [shear, zz, zero], [zero, zero, u(r, z) / r]]
        )
        coordinates = np.einsum("dij,ijtq->tqd", AXISYMMETRIC.basis, strain)
        work = stress[..., 0] * np.einsum("iitq->tq", strain)
        work += np.einsum("tqd,tqd->tq", stress[..., 1:], coordinates)
        inner = cells.volume @ (work @ weights)
        force = (0.3 * r * u(r, z) - 0.2 * v(r, z)) * r
        outer = cells.volume @ (force @ weights)
        s, w = np.polynomial.legendre.leggauss(8)
        side = 0.4 * (s + 1)
        outer += 0.4 * w @ (0.2 * side * u(1, side) + 0.1 * v(1, side))
        pressed = top * P(top) * v(top, 0.8)
        outer -= np.sum((pressed[1:] + pressed[:-1]) / 2) / 2000
        assert abs(inner - outer) <= 1e-6 * abs(outer)


def vertex_function(bound, cells):
    """The contact pressure on the top by the radius."""
    ends = data_on(bound.state.discrete).contact.nodes[:, :2]
    r = cells.points[ends.ravel(), 0]
    order = np.argsort(r)
    return lambda at: np.interp(at, r[order], bound.pressure.ravel()[order])


def virtual_displacements():
    """Components, and their derivatives by r and z."""
    yield (
        lambda r, z: r * z,
        lambda r, z: z**2 + r * z,
        lambda r, z: ((z, r), (z, 2 * z + r)),
    )
    yield (
        lambda r, z: r**2 * z,
        lambda r, z: r**2 * z,
        lambda r, z: ((2 * r * z, r**2), (2 * r * z, r**2)),
    )


@pytest.mark.parametrize("k", [2, 3])
def test_stresses_of_the_element_are_in_equilibrium(k):
    """Differences in place of derivatives; and S vanishes on the axis."""
    random = np.random.default_rng(k)
    corners = random.random((4, 3, 2))
    corners[0, 0, 0] = 0.0
    corners[1, :2, 0] = 0.0
    force = (
        random.random((4, 3, 2))
        if k == 3
        else random.random((4, 1, 2)) + np.zeros((4, 3, 2))
    )
    element = RingElement(corners, force, k)
    numbers = random.random((4, element.free, 1))

    def at(places):
        rows, load = element.rows(places)
        return np.matmul(rows, numbers[:, None])[..., 0] + load

    shares = random.dirichlet((2, 2, 2), 5)
    places = np.matmul(shares, corners)
    step = 1e-5
    by_r, by_z = (
        (at(places + move) - at(places - move)) / (2 * step)
        for move in step * np.eye(2)
    )
    r = places[..., 0]
    f = np.matmul(shares, force)
    hoop = at(places)[..., TT] / r
    radial = by_r[..., RR] + by_z[..., RZ] - hoop + r * f[..., 0]
    axial = by_r[..., RZ] + by_z[..., ZZ] + r * f[..., 1]
    size = np.abs(at(places)).max() / np.ptp(corners, axis=1).min()
    assert np.abs(radial).max() <= 1e-7 * size
    assert np.abs(axial).max() <= 1e-7 * size
    assert np.abs(at(corners)[0, 0]).max() <= 1e-12
    assert np.abs(at(corners)[1, :2]).max() <= 1e-12


def integral_over_radius(corners, values):
    """Of the square of a function with these values at the six nodes of ``quadratics``."""
    corners = np.array([corners], dtype=float)
    edges = corners[0, 1:] - corners[0, 0]
    area = np.array([abs(np.linalg.det(edges)) / 2])
    shares = np.concatenate([np.eye(3), (1 - np.eye(3)) / 2])
    coefficients = np.linalg.inv(quadratics(shares)) @ values(*(shares @ corners[0]).T)
    form = lambda Y, _: Y[..., 0] ** 2  # noqa: E731
    Y = coefficients[None, :, None]
    return float(
        OverRadius(quadratics_at, form, 2, Y, corners[:, :, 0], area).bound()[0]
    )


def test_squares_over_the_radius_are_integrated_from_above():
    """By logarithms: beside the axis, and with one vertex or one edge on it."""
    tiny = 1e-4
    beside = integral_over_radius([(tiny, 0), (1, 0), (1, 1)], lambda r, z: 0 * r + 1)
    width = 1 - tiny
    exact = (width + tiny * math.log(tiny)) / width
    assert exact <= beside * (1 + 1e-14) <= exact * (1 + 1e-9)
    at_vertex = integral_over_radius([(0, 0), (1, 1), (0.05, 1)], lambda r, z: z)
    exact = math.log(20) / 3
    assert exact <= at_vertex * (1 + 1e-14) <= exact * (1 + 1e-9)
    at_edge = integral_over_radius([(0, 0), (1, 0), (0, 1)], lambda r, z: r * (1 + z))
    exact = 1 / 6 + 1 / 12 + 1 / 60  # int r (1 + 2 z + z^2)
    assert at_edge == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("material", [ELASTIC, YIELDING, "table"])
def test_energies_are_bounded_as_fine_rules_integrate_them(material):
    """phi of a displacement of order two and phi* of a quadratic stress, on and off the axis."""
    if material == "table":
        law = Tabulated([0.0, 0.05, 0.5], [0.4, 0.6, 0.9])
        material = replace(YIELDING, law=law)
    problem = body(rectangle(0.6, 0.0, 1.0, 0.8), material, "bottom", order=2)
    result = semismooth_newton(problem)
    discrete = result.discrete
    random = np.random.default_rng(3)
    u = 0.2 * random.standard_normal(discrete.free.shape)
    state = discrete.state(np.where(discrete.free, u, 0.0))
    cells = Simplices.of(problem.mesh)
    energy = RingEnergy(state, cells)
    places, weights = fine_rule(5)
    r = energy.radii @ places.T
    strain = (quadratics(places) @ energy.strain) / r[..., None]
    _, density = energy.at(strain, np.arange(len(r)))
    measure = 2 * math.pi * cells.volume[:, None] * r * weights
    exact = (measure * density).sum(axis=1)
    found = energy.elastic() - energy.flow(1e-4 * abs(exact.sum()))
    assert (found >= exact - 1e-5 * exact.max()).all()
    assert found.sum() <= exact.sum() * (1 + 3e-4)

    bound_data = data_on(discrete)
    conjugate = bound_data.conjugate
    count = len(bound_data.cut.cells.nodes)
    numbers = random.standard_normal((count, bound_data.stresses.element.free))
    corners = bound_data.cut.cells.points[bound_data.cut.cells.nodes]
    nodal = basis_values(bound_data, numbers)
    coefficients = from_lattice(2, 3) @ nodal
    area = bound_data.cut.cells.volume
    radii = corners[:, :, 0]
    upper = conjugate.ring_integrals(coefficients, radii, area, 0.0)
    r = radii @ places.T
    z = bernstein_values(3, places) @ coefficients / r[..., None]
    density = conjugate.value(conjugate.completed(z))
    exact = 2 * math.pi * area * ((r * density) @ weights)
    assert (upper >= exact * (1 - 1e-4)).all()
    assert upper.sum() <= 1.02 * exact.sum()


def basis_values(bound_data, numbers):
    """Coordinates of r sigma at the nodes of the triangles."""
    element = bound_data.stresses.element
    rows, load = element.rows(np.matmul(lattice_points(2, 3), element.corners))
    values = np.matmul(rows, numbers[:, None, :, None])[..., 0] + load
    return values @ TO_COORDINATES.T


def fine_rule(levels):
    """Points and weights of a rule on the parts of a triangle."""
    parts = np.eye(3)[None]
    for _ in range(levels):
        parts = np.matmul(SPLIT[3], parts[:, None]).reshape(-1, 3, 3)
    shares, weights = triangle_rule(6)
    places = np.matmul(shares, parts).reshape(-1, 3)
    return places, np.tile(weights, len(parts)) / len(parts)


def with_history(order):
    """Data of an earlier step."""
    p = (0.02, 0.01, 0, 0.01, -0.03, 0, 0, 0, 0.01)
    material = Material.isotropic(
        lame_lambda=3.0,
        lame_mu=2.0,
        yield_stress=0.4,
        hardening_modulus=1.0,
        hardening_stiffness=0.5,
    )
    problem = replace(loaded(order, material), initial_hardening=0.2)
    return replace(problem, initial_plastic_strain=CF(p, dims=(3, 3)))


def with_table(order):
    law = Tabulated([0.0, 0.05, 0.5], [0.4, 0.6, 0.9])
    return loaded(order, replace(YIELDING, law=law))


def warmed(order):
    swelling = CF((0.03, 0, 0, 0, 0.03, 0, 0, 0, 0.01), dims=(3, 3))
    return replace(loaded(order), initial_strain=swelling)


@pytest.mark.parametrize(
    ("make", "order"),
    [(loaded, 1), (loaded, 2), (with_history, 1), (with_table, 2), (warmed, 1)],
)
def test_energies_of_two_meshes_do_not_cross(make, order):
    problem = make(order)
    bounds = [error_bound(semismooth_newton(p)) for p in (problem, finer(problem, 1))]
    pair = Crossing(None, *bounds)
    assert list(pair.failures) == []
    assert pair.effectivity <= 1.4


def test_adaptive_meshes_reach_a_guaranteed_error():
    solved = solve_to(loaded(2), relative_error=0.01)
    assert solved.reached
    assert solved.bound.guaranteed
    assert len(solved.records) > 1


@pytest.mark.parametrize(
    ("word", "change"),
    [
        ("springs", {"springs": {"left": 1.0}}),
        ("friction", {"friction": 0.1}),
        ("traction", {"traction": {"right": (sin(3 * y), 0.0)}}),
        ("body_force", {"body_force": (x * y, 0.0)}),
        ("supports", {"contact": "top", "prescribed": {"top": (0.0, None)}}),
    ],
)
def test_what_is_not_covered_is_refused_by_name(word, change):
    problem = replace(loaded(1), **change)
    with pytest.raises(ValueError, match=word):
        error_bound(semismooth_newton(problem))


@pytest.mark.parametrize(
    "made",
    [
        lambda result: goal_bound(result, "contact_force"),
        contact_force_bracket,
        lambda result: write_receipt(result, "receipt.npz"),
    ],
)
def test_goals_brackets_and_receipts_are_refused(made):
    with pytest.raises(ValueError, match="axisymmetric"):
        made(semismooth_newton(loaded(1)))
