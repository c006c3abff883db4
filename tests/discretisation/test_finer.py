"""Material data that vary between the integration points have the integrals of a finer rule."""

import numpy as np
import pytest
from ngsolve import L2, CoefficientFunction, GridFunction, IfPos, exp, sin, sqrt, x, y
from teams import Jacobi, run

from ngepc import (
    Direction,
    Material,
    NewtonOptions,
    Problem,
    Voce,
    evolve,
    gradient,
    load_cycle,
    primal_newton,
    semismooth_newton,
)
from ngepc.discretisation import finer
from ngepc.discretisation.finer import seen, seen_material, unresolved_data
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.discretisation.sampled import what_is_unseen
from ngepc.geometries import block
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.model.parts import distribute

CELLS = 4
WIDTH = 0.02
HARD = 1.25
SOFT = 0.2
OPTIONS = NewtonOptions(inverse=Jacobi())
LOAD = {"contact": (0.5, -1.0)}


def strip(middle, inside=SOFT, outside=HARD, slope=0.0) -> CoefficientFunction:
    """A datum with another value in a strip of width ``WIDTH``."""
    away = sqrt((x + slope * y - middle) ** 2)
    return IfPos(WIDTH / 2 - away, inside, outside)


def pressed(*, order=1, cells=(CELLS, CELLS), simplices=True, mesh=None, **data):
    """A block with these data of its material."""
    given = {"lame_lambda": 1e3, "lame_mu": 1e3, "hardening": 10.0}
    given |= {"yield_stress": HARD}
    mesh = block.structured_mesh(*cells, simplices=simplices) if mesh is None else mesh
    load = {"contact": (0.5, -1.0, 0.0)[: mesh.dim]}
    material = Material.kinematic(**given | data)
    return Problem(mesh, material, traction=load, order=order)


def points_of(problem: Problem) -> Points:
    """The integration points of a problem."""
    return Points(problem.mesh, problem.kinematics, problem.order)


def clipped(polygon: list, inside) -> list:
    """The part of a convex polygon where an affine function is positive."""
    found = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        if inside(a) >= 0:
            found.append(a)
        if inside(a) * inside(b) < 0:
            found.append(a + (b - a) * inside(a) / (inside(a) - inside(b)))
    return found


def area(polygon: list) -> float:
    """The area of a polygon."""
    if len(polygon) < 3:
        return 0.0
    X, Y = np.transpose(polygon)
    return abs(X @ np.roll(Y, -1) - Y @ np.roll(X, -1)) / 2


def exact_means(mesh, middle, slope, inside, outside) -> GridFunction:
    """The means of an oblique strip over the triangles, by their intersections with it."""
    vertices = vertex_coordinates(mesh)
    means = GridFunction(L2(mesh, order=0))
    for number, corners in enumerate(element_nodes(mesh)[:, :3]):
        triangle = list(vertices[corners])
        part = clipped(triangle, lambda q: WIDTH / 2 - q[0] - slope * q[1] + middle)
        part = clipped(part, lambda q: WIDTH / 2 + q[0] + slope * q[1] - middle)
        share = area(part) / area(triangle)
        means.vec[number] = outside + share * (inside - outside)
    return means


@pytest.mark.parametrize(
    ("datum", "inside", "outside"),
    [("yield_stress", SOFT, HARD), ("lame_mu", 1e5, 1e3), ("hardening", 1e3, 10.0)],
)
def test_order_one_has_the_energy_of_exact_means(datum, inside, outside):
    """With affine u and constant p on triangles J is the integral of the data themselves."""
    value = strip(0.43, inside, outside, slope=0.3)
    found = semismooth_newton(pressed(**{datum: value}))
    means = exact_means(found.problem.mesh, 0.43, 0.3, inside, outside)
    exact = semismooth_newton(pressed(mesh=found.problem.mesh, **{datum: means}))
    assert found.primal_energy == pytest.approx(exact.primal_energy, rel=2e-4)
    assert np.abs(exact.primal_energy) > 1e-4


def test_energies_fall_on_nested_meshes():
    """A Galerkin method of (2.14): without the finer rule order one misses the strip at first."""
    value = strip(0.37, SOFT / 4)
    sizes = ((CELLS, CELLS), (2 * CELLS, 2 * CELLS), (4 * CELLS, 4 * CELLS))
    found = [
        semismooth_newton(pressed(cells=cells, yield_stress=value)).primal_energy
        for cells in sizes
    ]
    assert found == sorted(found, reverse=True)


@pytest.mark.parametrize(
    ("cells", "simplices", "order", "inside"),
    [
        ((4, 4), True, 2, 1e3),
        ((4, 4), False, 1, 1e-3),
        ((4, 1, 1), True, 1, 1e-3),
        ((2, 1, 1), False, 2, 1e3),
    ],
)
def test_the_integral_is_exact_and_values_stay_in_range(
    order, inside, cells, simplices
):
    """In elements that a strip crosses, of every shape, also where all their parts are cut."""
    value = strip(0.43, inside, 1.0)
    problem = pressed(order=order, cells=cells, simplices=simplices)
    points = points_of(problem)
    used = points.at(seen(value, points))
    missed = used - points.at(value)
    exact = 1 + WIDTH * (inside - 1)
    coarse = 0.03 if len(cells) == 3 else 0.002
    assert points.weights @ used == pytest.approx(exact, abs=coarse * abs(inside - 1))
    assert np.count_nonzero(missed)
    assert used.min() >= min(inside, 1.0) * (1 - 1e-12)
    assert used.max() <= max(inside, 1.0) * (1 + 1e-12)


def test_smooth_data_and_polynomials_are_left_alone():
    for value in (1 + 0.5 * sin(3 * x), exp(x), 1 / (1 + x + y), 1 + x * x, 2.0):
        points = points_of(pressed(order=2, cells=(8, 8)))
        assert seen(value, points) is value


def test_both_exact_methods_have_the_same_data():
    problem = pressed(order=2, yield_stress=strip(0.37), lame_mu=strip(0.6, 1e5, 1e3))
    local = semismooth_newton(problem)
    primal = primal_newton(problem)
    assert primal.primal_energy == pytest.approx(local.primal_energy, rel=1e-9)
    assert primal.dual_energy == pytest.approx(-local.primal_energy, rel=1e-6)


def test_data_of_a_law_and_an_initial_strain_too():
    law = Voce(HARD, strip(0.37, 10.0), 2.0)
    mesh = block.structured_mesh(CELLS, CELLS, simplices=True)
    material = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=law)
    problem = Problem(mesh, material, traction=LOAD, order=1)
    points = points_of(problem)
    saturation = points.at(seen_material(material, points).law.saturation)
    assert saturation.max() > HARD
    warm = Problem(mesh, material, initial_strain=strip(0.43, 1e-3, 0.0), order=1)
    swelling = points.weights @ law_of(warm, points).swelling
    assert swelling == pytest.approx(3 * 1e-3 * WIDTH, rel=0.02)


def test_histories_remember_by_the_same_data():
    """Held at its load the body does not change: alpha_2 = k p by the k of the law."""
    problem = pressed(hardening=strip(0.37, 100.0, 10.0))
    history = evolve(problem, [(1.0, {}), (2.0, {})])
    last, held = history.steps[-2:]
    assert held.record.dissipation == pytest.approx(0.0, abs=1e-12)
    assert held.record.elastic_energy == pytest.approx(last.record.elastic_energy)


def solved_once(problem):
    return semismooth_newton(problem)


def solved_in_steps(problem):
    return evolve(problem, load_cycle(problem, [1.0, 0.0, -1.0]))


@pytest.mark.parametrize("solved", [solved_once, solved_in_steps])
def test_data_are_looked_at_once(solved, monkeypatch):
    """Steps, their memory and the message share what the points miss."""
    looked = []
    projected = finer._with_projections

    def counted(value, *others):
        looked.append(value)
        return projected(value, *others)

    monkeypatch.setattr(finer, "_with_projections", counted)
    problem = pressed(yield_stress=strip(0.37), hardening=strip(0.43))
    assert "yield_stress, hardening vary" in solved(problem).message
    assert looked == [problem.material.yield_stress, problem.material.hardening]


def test_values_that_are_not_legal_are_refused_where_they_are():
    problem = pressed(yield_stress=strip(0.43, -100.0))
    with pytest.raises(ValueError, match="yield_stress falls to -"):
        semismooth_newton(problem)


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_match_differences(order):
    value = strip(0.37)
    result = semismooth_newton(pressed(order=order, yield_stress=value))
    constant = Direction("yield_stress", 1.0)
    found = gradient(
        result, "primal_energy", {"factor": Direction("yield_stress"), "sum": constant}
    )
    step = 1e-4
    for name, change in (("factor", value), ("sum", 1.0)):
        energies = [
            semismooth_newton(
                pressed(order=order, yield_stress=value + k * step * change)
            ).primal_energy
            for k in (1, -1)
        ]
        difference = (energies[0] - energies[1]) / (2 * step)
        assert found[name] == pytest.approx(difference, rel=1e-4)


def test_other_derivatives_are_refused_by_name():
    result = semismooth_newton(pressed(yield_stress=strip(0.37)))
    for direction in (Direction("yield_stress", sin(x)), Direction("shape", (x, 0))):
        with pytest.raises(ValueError, match="between the integration points"):
            gradient(result, "primal_energy", {"theta": direction})


def test_the_message_says_what_remains_unseen():
    problem = pressed(yield_stress=strip(0.37), hardening=10 + sin(x))
    said = "yield_stress (at 1/48 of each edge of an element)"
    assert said in what_is_unseen(problem)
    message = semismooth_newton(problem).message
    assert said in message
    assert "Between integration points yield_stress varies:" in message
    both = unresolved_data(pressed(yield_stress=strip(0.37), hardening=strip(0.43)))
    assert "yield_stress" in both
    assert "hardening vary:" in both


def test_two_processes_have_the_same_energy():
    problem = pressed(yield_stress=strip(0.43))
    whole = semismooth_newton(problem, options=OPTIONS).primal_energy

    def energy(comm: object) -> float:
        mesh = distribute(problem.mesh if comm.rank == 0 else None, comm)
        own = Problem(mesh, problem.material, traction=LOAD, order=1)
        return semismooth_newton(own, options=OPTIONS).primal_energy

    assert run(2, energy) == pytest.approx([whole, whole], rel=1e-12)
