"""Supports and loads against closed forms: springs, rollers, points, lines, pressure, corners."""

from dataclasses import replace
from functools import cache, partial
from itertools import product

import numpy as np
import pytest
from bodies import STEEL
from netgen.occ import Box, Compound, MoveTo, OCCGeometry, Rectangle, X, Y, Z
from ngsolve import CF, Mesh, ds, y, z
from pairs import every_pair

from ngepc import (
    Contact,
    Coulomb,
    Edge,
    LoadWork,
    NewtonOptions,
    Point,
    PrimalOptions,
    Problem,
    PyAMG,
    Reaction,
    Roller,
    Status,
    error_bound,
    evolve,
    goal_bound,
    gradient,
    load_cycle,
    outward_normal,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block, ring
from ngepc.model.elements import corner_vertices

OPTIONS = {semismooth_newton: NewtonOptions, primal_newton: PrimalOptions}
SOLVERS = tuple(OPTIONS)
SQUARE = block.structured_mesh(4, 4, simplices=True)
ELASTIC = replace(STEEL, yield_stress=1e6)
both = pytest.mark.parametrize("solver", SOLVERS)
orders = pytest.mark.parametrize("order", [1, 2])


def values(result):
    return result.displacement.vec.FV().NumPy()


def turned(angle, n=4):
    """The unit square about the origin, turned."""
    mesh = block.structured_mesh(n, n, simplices=True)
    c, s = np.cos(angle), np.sin(angle)
    points = np.array([list(p.p) for p in mesh.ngmesh.Points()])
    for point, (px, py, _) in zip(mesh.ngmesh.Points(), points, strict=True):
        point[0], point[1] = c * px - s * py, s * px + c * py
    return Mesh(mesh.ngmesh), np.array([[c, -s], [s, c]])


@both
@orders
def test_an_elastic_foundation_sinks_by_pressure_over_stiffness(solver, order):
    sides = {"left|right": (0, None)}
    result = solver(
        Problem(
            *(SQUARE, ELASTIC, None),
            pressure={"contact": 2.0},
            springs={"clamped": 50.0},
            prescribed=sides,
            order=order,
        )
    )
    assert result.displacement(SQUARE(0.3, 0.0))[1] == pytest.approx(-2 / 50, rel=1e-11)
    assert result.equilibrium.reactions["clamped"] == pytest.approx((0, 2), abs=1e-11)
    assert result.reaction + result.applied_force == pytest.approx((0, 0), abs=1e-11)
    assert result.primal_energy + result.dual_energy == pytest.approx(0, abs=1e-13)
    stored = (
        -0.5 * 2 * (result.displacement(SQUARE(0.3, 1.0))[1])
    )  # Clapeyron: J = -1/2 l(u)
    assert result.primal_energy == pytest.approx(-stored, rel=1e-11)


@both
def test_springs_at_points_hold_a_floating_body(solver):
    """Four springs at the corners, a force at the middle of the top: -F / sum k."""
    corners = {Point((i, j)): (7.0, 3.0) for i in (0, 1) for j in (0, 1)}
    load = {Point((0.5, 1.0)): (1.4, -0.6)}
    result = solver(Problem(SQUARE, ELASTIC, None, load, springs=corners))
    assert result.status is Status.CONVERGED
    told = [result.equilibrium.reactions[p] for p in corners]
    assert sum(told) == pytest.approx((-1.4, 0.6), abs=1e-11)
    mean = np.mean([result.displacement(SQUARE(*p.where)) for p in corners], axis=0)
    assert mean == pytest.approx((1.4 / 28, -0.6 / 12), rel=1e-9)


@both
def test_a_part_that_drifts_is_said_and_its_stresses_are_right(solver):
    """A block on a smooth floor: nothing balances a small force along the floor."""

    def lying(force):
        weight = (force, -1.0)
        floor = {"contact": "clamped", "gap": 0.0}
        return Problem(SQUARE, ELASTIC, None, body_force=weight, **floor)

    still, drifting = (solver(lying(force)) for force in (0.0, 1e-8))
    assert still.status is Status.CONVERGED
    assert drifting.status is Status.STAGNATED
    assert drifting.iterations <= still.iterations + 2
    assert "around (0.5, 0.5) is free to move as a rigid body" in drifting.message
    forces = drifting.nodal_contact_forces
    np.testing.assert_allclose(forces, still.nodal_contact_forces, atol=1e-7)
    few = OPTIONS[solver](max_iterations=drifting.iterations - 1)
    ended = solver(lying(1e-8), options=few)
    assert ended.status is Status.ITERATION_LIMIT
    assert "around (0.5, 0.5) is free to move as a rigid body" in ended.message


@both
def test_stiff_springs_approach_a_clamped_boundary(solver):
    load = {"right": (1.0, 0.5)}
    held = Problem(SQUARE, STEEL, "left", load, order=1)
    u = values(solver(held))
    distance = []
    for k in (1e6, 1e7):
        on_springs = replace(held, clamped=None, springs={"left": (k, k)})
        distance.append(np.abs(values(solver(on_springs)) - u).max())
    assert distance[0] / distance[1] == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize(
    ("solver", "order", "friction"), every_pair(SOLVERS, [1, 2], [None, Coulomb(0.2)])
)
def test_a_turned_problem_has_the_turned_solution(solver, order, friction):
    """Rollers on two oblique sides, plastic, with contact on a third one."""
    mesh, R = turned(0.4)
    load = np.array([-3.0, 0.5])
    straight = Problem(
        *(SQUARE, STEEL, None, {"right": tuple(load)}),
        prescribed={"clamped": (None, 0), "left": (0.001, None)},
        contact="contact",
        gap=1e-4,
        friction=friction,
        order=order,
    )
    oblique = replace(
        straight,
        mesh=mesh,
        traction={"right": tuple(R @ load)},
        prescribed={"clamped": Roller(), "left": Roller(tuple(-R[:, 0]), value=-0.001)},
    )
    one, two = solver(straight), solver(oblique)
    assert one.status is Status.CONVERGED
    assert two.status is Status.CONVERGED
    assert one.history.records[-1].plastic_active > 0.1
    assert one.contact_force > 0.01
    u, v = (values(r).reshape(2, -1) for r in (one, two))
    assert np.abs(R @ u - v).max() < 1e-11 * np.abs(u).max()
    assert two.contact_force == pytest.approx(one.contact_force, rel=1e-9)
    assert two.primal_energy + two.dual_energy == pytest.approx(0, abs=1e-12)
    for name in ("clamped", "left"):
        force = one.equilibrium.reactions[name]
        assert two.equilibrium.reactions[name] == pytest.approx(R @ force, abs=1e-9)


@pytest.mark.parametrize(
    ("solver", "shape", "order"),
    every_pair(SOLVERS, ["tetrahedra", "hexahedra"], [1, 2]),
)
def test_rollers_along_the_axes_are_components(solver, shape, order):
    """Three faces of a cube that meet in edges and a corner, under contact."""
    mesh = block.structured_mesh(2, 2, 2, simplices=shape == "tetrahedra")
    held = {
        "clamped": (None, None, 0.001),
        "left": (0, None, None),
        "front": (None, 0, None),
    }
    rollers = {
        "clamped": Roller(value=-0.001),
        "left": Roller(),
        "front": Roller((0, -1, 0)),
    }
    problem = Problem(
        *(mesh, STEEL, None, {"right": (-3.0, 0.5, 0.2)}),
        prescribed=held,
        contact="contact",
        gap=1e-3,
        order=order,
    )
    one, two = solver(problem), solver(replace(problem, prescribed=rollers))
    assert two.status is Status.CONVERGED
    assert one.contact_force > 0.01
    assert np.abs(values(one) - values(two)).max() < 1e-11 * np.abs(values(one)).max()
    for name, force in one.equilibrium.reactions.items():
        assert two.equilibrium.reactions[name] == pytest.approx(force, abs=1e-9)


@pytest.mark.parametrize(
    ("solver", "order"), [(semismooth_newton, 1), (primal_newton, 2)]
)
def test_a_roller_on_the_axis_of_revolution(solver, order):
    """Its facets have a normal, but no surface: the first iterate was NaN."""
    plain = Problem(
        *(SQUARE, STEEL, "clamped", {"right": (1.5, 0.5)}),
        prescribed={"left": (0, None)},
        kinematics="axisymmetric",
        order=order,
    )
    one = solver(plain)
    two = solver(replace(plain, prescribed={"left": Roller()}))
    assert two.status is Status.CONVERGED
    assert np.abs(values(one) - values(two)).max() < 1e-11 * np.abs(values(one)).max()


def test_rollers_cost_few_solves():
    mesh = block.structured_mesh(24, 24, simplices=True)
    loads = {"right": (3.0, 0.5)}
    result = semismooth_newton(
        Problem(
            mesh, STEEL, None, loads, prescribed={"clamped": Roller(), "left": Roller()}
        )
    )
    assert result.status is Status.CONVERGED
    # Few for a step and its correction, not one for each row.
    for record in result.history.records:
        assert record.back_substitutions <= 12


@both
def test_a_frictionless_core_in_a_tube(solver):
    """Lame: u_r = A (r - a^2/r) with 2 (lambda + mu) A + 2 mu A a^2/b^2 = -p."""
    mesh = ring.quarter_mesh(0.2)
    mesh.Curve(2)
    tube = Problem(
        *(mesh, ELASTIC, None),
        pressure={"outer": 1.0},
        prescribed={"inner": Roller(), "left": (0, None), "bottom": (None, 0)},
        order=2,
    )
    result = solver(tube)
    a, b = (np.linalg.norm(vertices, axis=1).mean() for vertices in ends_of(mesh))
    A = -1 / (2 * (1e3 + 1e3) + 2 * 1e3 * a**2 / b**2)
    assert result.displacement(mesh(0.0, b * (1 - 1e-9)))[1] == pytest.approx(
        A * (b - a * a / b), rel=2e-4
    )


def ends_of(mesh):
    """Coordinates of the vertices on the inner and the outer circle."""
    x = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    return [x[np.unique(corner_vertices(mesh, [name]))] for name in ("inner", "outer")]


@both
@orders
def test_supports_at_points_leave_a_uniform_stress(solver, order):
    """Statically determinate: tension sigma, held at two corners, one of them oblique."""
    sigma, nu = 0.7, 0.25
    load = {"right": (sigma, 0), "left": (-sigma, 0)}
    held = {Point((0, 0)): (0, 0), Point((1, 0)): Roller((0, 2))}
    result = solver(Problem(SQUARE, ELASTIC, None, load, prescribed=held, order=order))
    lam, mu = 1e3, 1e3
    young = mu * (3 * lam + 2 * mu) / (lam + mu)
    assert nu == lam / (2 * (lam + mu))
    strain = sigma * (1 - nu**2) / young
    assert result.displacement(SQUARE(1.0, 0.4))[0] == pytest.approx(strain, rel=1e-10)
    assert np.abs(list(result.equilibrium.reactions.values())).max() < 1e-12


@both
def test_a_force_at_a_point_is_what_the_supports_feel(solver):
    load = {Point((1.0, 0.0)): (0.1, -0.2)}
    result = solver(Problem(SQUARE, STEEL, "left", load))
    assert result.reaction == pytest.approx((-0.1, 0.2), abs=1e-12)
    moment = result.equilibrium.moment(result.equilibrium.reaction)
    assert moment == pytest.approx([0.2], abs=1e-12)


@both
@orders
def test_the_torque_at_one_support_does_the_work_of_its_rotation(solver, order):
    """An end of a bar turns about its axis: the energy is half the torque times the angle."""
    angle, axis = 1e-4, (0.0, 0.5, 0.5)
    bar = block.structured_mesh(3, 2, 2, simplices=True)
    turned = {"right": (0, -angle * (z - 0.5), angle * (y - 0.5))}
    result = solver(Problem(bar, ELASTIC, "left", prescribed=turned, order=order))
    balance = result.equilibrium
    torque = balance.moment(balance.reaction, axis, "right")
    assert torque[0] * angle == pytest.approx(2 * result.primal_energy, rel=1e-9)
    opposite = balance.moment(balance.reaction, axis, ["left"])
    assert opposite == pytest.approx(-torque, abs=1e-9 * torque[0])


@orders
def test_a_ring_under_a_force_at_its_nodes(order):
    """Axisymmetric: a force at a point is that of the whole ring."""
    problem = Problem(
        *(SQUARE, ELASTIC, "clamped", {Point((1.0, 1.0)): (0.0, -0.3)}),
        kinematics="axisymmetric",
        order=order,
    )
    assert semismooth_newton(problem).reaction[1] == pytest.approx(0.3, abs=1e-12)


@cache
def bar():
    """A block of 2 x 1 x 1/2 with named edges and a named corner."""
    body = Box((0, 0, 0), (2, 1, 0.5))
    body.faces.name = "free"
    body.faces.Min(X).name = "clamped"
    body.faces.Max(X).edges.Max(Z).name = "rim"
    body.faces.Min(Z).edges.Max(Y).name = "ledge"
    body.vertices.Max(X + Y + Z).name = "tip"
    return Mesh(OCCGeometry(body).GenerateMesh(maxh=0.5))


@both
@orders
def test_loads_along_edges_and_at_named_points(solver, order):
    """Resultant and moment of a load per length that varies, and of a force at a corner."""
    line, force = CF((0, 0, -y)), (0.0, 0.1, 0.2)
    problem = Problem(
        bar(), ELASTIC, traction={Edge("rim"): line, Point("tip"): force}, order=order
    )
    result = solver(problem)
    assert result.reaction == pytest.approx((0, -0.1, 0.5 - 0.2), abs=1e-11)
    applied = result.equilibrium.moment(result.equilibrium.applied)
    line_moment = np.cross((2, 2 / 3, 0.5), (0, 0, -0.5))
    assert applied == pytest.approx(
        line_moment + np.cross((2, 1, 0.5), force), abs=1e-11
    )


@both
def test_edges_hold_and_spring(solver):
    """A knife edge below the bar and springs along the rim share what presses on it."""
    held = {Edge("ledge"): (None, None, 0), "clamped": Roller()}
    held[Point((2.0, 0.0, 0.0))] = Roller((0, 1, 0))
    load = {Point("tip"): (0.0, 0.0, -1.0)}
    problem = Problem(
        bar(), ELASTIC, None, load, prescribed=held, springs={Edge("rim"): (0, 0, 40.0)}
    )
    result = solver(problem)
    told = result.equilibrium.reactions
    assert result.status is Status.CONVERGED
    assert told[Edge("rim")][2] + told[Edge("ledge")][2] == pytest.approx(
        1.0, abs=1e-10
    )
    rim = result.displacement.components[2]
    at = np.array([rim(bar()(2.0, t, 0.5)) for t in np.linspace(0, 1, 201)])
    assert told[Edge("rim")][2] == pytest.approx(
        -40 * np.trapezoid(at, dx=1 / 200), rel=1e-3
    )


@both
def test_two_bodies_clamped_beside_their_contact(solver):
    """The rows at clamped vertices of the first body stay, for the second one may move there."""
    lower, upper = Rectangle(1, 1).Face(), MoveTo(0, 1).Rectangle(1, 1).Face()
    for body, maxh, name in ((lower, 0.23, "lower"), (upper, 0.17, "upper")):
        body.edges.name, body.faces.maxh = "side", maxh
        body.edges.Min(X).name = f"{name} left"
    lower.edges.Max(Y).name, lower.edges.Min(Y).name = "below", "bottom"
    upper.edges.Min(Y).name, upper.edges.Max(Y).name = "above", "top"
    mesh = Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))
    problem = Problem(
        *(mesh, ELASTIC, "upper left|bottom", {"top": (0, -1.0)}),
        contact=Contact("above", "below"),
    )
    result = solver(problem)
    assert result.status is Status.CONVERGED
    first = result.rows.between(np.asarray(mesh.ngmesh.Coordinates()))
    assert np.abs(first[:, 0]).min() < 1e-12
    assert result.open_gap.min() > -1e-14
    held = (
        result.equilibrium.reactions["upper left"][1]
        + result.equilibrium.reactions["bottom"][1]
    )
    assert held == pytest.approx(1.0, rel=1e-9)


def test_pressure_and_tractions_are_the_same_to_the_other_methods():
    n = outward_normal(SQUARE)
    flat = {"kinematics": "two-dimensional", "clamped": "clamped"}
    one = Problem(SQUARE, STEEL, pressure={"contact|left": 0.4}, **flat)
    two = Problem(SQUARE, STEEL, traction={"contact|left": -0.4 * n}, **flat)
    paper = [
        semismooth_newton(p, gamma=1e3).displacement.vec.FV().NumPy()
        for p in (one, two)
    ]
    assert np.abs(paper[0] - paper[1]).max() < 1e-12 * np.abs(paper[0]).max()
    bounds = [error_bound(semismooth_newton(p)).total for p in (one, two)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)


def test_pressure_is_the_traction_along_the_inner_normal():
    mesh = block.with_hole(0.3, (1.0, 1.0))
    n = outward_normal(mesh)
    by_number = Problem(
        mesh, STEEL, pressure={"hole|right": 1.5}, traction={"right": (0.1, 0)}
    )
    by_hand = Problem(
        mesh, STEEL, traction={"hole": -1.5 * n, "right": -1.5 * n + CF((0.1, 0))}
    )
    one, two = semismooth_newton(by_number), semismooth_newton(by_hand)
    assert np.abs(values(one) - values(two)).max() < 1e-15
    assert one.applied_force == pytest.approx((-1.4, 0), abs=1e-12)


@pytest.mark.parametrize(
    ("solver", "order", "gap"), every_pair(SOLVERS, [1, 2], [0.0, 5e-4])
)
def test_contact_beside_a_clamped_part(solver, order, gap):
    """A block clamped at its left side, pressed on ground that begins there."""
    problem = Problem(
        *(SQUARE, STEEL, "left", {"contact": (0, -1.0)}),
        contact="clamped",
        gap=gap,
        order=order,
    )
    result = solver(problem)
    assert result.status is Status.CONVERGED
    assert result.contact_force > 0.1
    assert result.penetration < 1e-15
    assert result.primal_energy + result.dual_energy == pytest.approx(0, abs=1e-12)
    witness = primal_newton(problem)
    assert np.abs(values(result) - values(witness)).max() < 1e-11


def test_what_does_not_take_them_says_so():
    roller = Problem(SQUARE, STEEL, "left", prescribed={"clamped": Roller()})
    springs = Problem(SQUARE, STEEL, "left", springs={Point((1.0, 1.0)): (1, 1)})
    force = Problem(
        SQUARE, STEEL, "left", {Point((1.0, 1.0)): (0, 1)}, kinematics="two-dimensional"
    )
    for problem, named in (
        (roller, r"prescribed\['clamped'\]=Roller"),
        (springs, r"springs\[Point\(where=\(1.0, 1.0\)\)\]"),
        (force, r"traction\[Point\(where=\(1.0, 1.0\)\)\]"),
    ):
        with pytest.raises(ValueError, match=named):
            semismooth_newton(problem, gamma=1e3)
    for problem, named in ((springs, r"springs\[Point"), (force, r"traction\[Point")):
        with pytest.raises(ValueError, match=named):
            error_bound(semismooth_newton(problem))
    corner = Problem(SQUARE, STEEL, "left", contact="contact", gap=0.0)
    with pytest.raises(ValueError, match="contact away from supports"):
        semismooth_newton(corner, gamma=1e3)


def test_derivatives_with_an_oblique_roller():
    """By a factor of what is prescribed, and by a constant: central differences."""

    def solved(scale=1.0, mu=1e3):
        held = {"left": (0, 0), "right": Roller((1.0, 2.0), 0.002 * scale)}
        material = replace(STEEL, lame_mu=mu)
        return semismooth_newton(Problem(SQUARE, material, None, prescribed=held))

    slopes = gradient(solved(), "primal_energy", ["prescribed", "lame_mu"])
    for name, plus, minus, step in (
        ("prescribed", solved(1.001), solved(0.999), 2e-3),
        ("lame_mu", solved(mu=1000.5), solved(mu=999.5), 1.0),
    ):
        difference = (plus.primal_energy - minus.primal_energy) / step
        assert slopes[name] == pytest.approx(difference, rel=1e-6)


def test_derivatives_of_the_reaction_of_a_roller():
    """Its forces are those of its rows; along an axis it is a prescribed component."""

    def solved(support, mu=1e3):
        held = {"left": support, "clamped": Roller((0.2, 1.0))}
        material = replace(STEEL, lame_mu=mu)
        load = {"right": (3.0, 0.5)}
        return semismooth_newton(Problem(SQUARE, material, None, load, prescribed=held))

    slanted = Roller((1.0, 0.4), 0.002)
    result = solved(slanted)
    for place, component in product(("left", "clamped"), (0, 1)):
        reaction = Reaction(place, component)
        force = result.equilibrium.reactions[place][component]
        assert reaction.slope(result.state).value == pytest.approx(force, rel=1e-9)
        found = gradient(result, reaction, "lame_mu")["lame_mu"]
        more, less = (
            solved(slanted, mu).equilibrium.reactions[place][component]
            for mu in (1000.5, 999.5)
        )
        assert found == pytest.approx(more - less, rel=1e-5)
    along, across = (
        gradient(solved(support), Reaction("left", 0), ["lame_mu", "traction"])
        for support in (Roller(), (0, None))
    )
    assert along == pytest.approx(across, rel=1e-9, abs=1e-9)
    with pytest.raises(ValueError, match="does not hold component 1"):
        gradient(solved(Roller()), Reaction("left", 1), "lame_mu")


def test_the_force_of_springs():
    """It is no reaction, but the work of -k, and the integral of -k u."""
    bedded = Problem(
        SQUARE,
        STEEL,
        None,
        springs={"clamped": (300.0, 400.0)},
        traction={"right": (0.5, 0.3)},
        pressure={"contact": 1.0},
    )
    result = semismooth_newton(bedded)
    force = result.equilibrium.reactions["clamped"][1]
    found = goal_bound(result, LoadWork({"clamped": (0.0, -400.0)}))
    assert found.discrete == pytest.approx(force, rel=1e-9)
    slopes = gradient(result, lambda u, p, s: -400.0 * u[1] * ds("clamped"), "pressure")
    assert slopes.functional == pytest.approx(force, rel=1e-9)
    for refused in (goal_bound, partial(gradient, parameters="pressure")):
        with pytest.raises(
            ValueError, match="springs is the integral of -k u: LoadWork"
        ):
            refused(result, Reaction("clamped", 1))


def test_derivatives_with_springs_and_pressure():
    """Adjoint against central differences."""

    def solved(scale=1.0, mu=1e3):
        problem = Problem(
            *(
                SQUARE,
                replace(STEEL, lame_mu=mu),
                None,
                {Point((1.0, 0.5)): (0.2, 0.0)},
            ),
            pressure={"contact": 1.5 * scale},
            springs={"clamped": (200.0, 300.0)},
            contact="right",
            gap=1e-3,
        )
        return semismooth_newton(problem)

    found = gradient(solved(), "primal_energy", ["pressure", "lame_mu"])
    told = {name: float(found[name]) for name in ("pressure", "lame_mu")}
    h = 1e-4
    by_scale = (solved(1 + h).primal_energy - solved(1 - h).primal_energy) / (2 * h)
    by_mu = (
        solved(mu=1e3 + 0.1).primal_energy - solved(mu=1e3 - 0.1).primal_energy
    ) / 0.2
    assert told["pressure"] == pytest.approx(by_scale, rel=1e-6)
    assert told["lame_mu"] == pytest.approx(by_mu, rel=1e-5)


def test_histories_scale_and_remember_them(tmp_path):
    problem = Problem(
        *(SQUARE, STEEL, None, {Point((1.0, 0.0)): (0.1, 0.0)}),
        pressure={"contact": 2.0},
        springs={"left": 100.0},
        prescribed={"clamped": Roller(value=0.001)},
    )
    file = tmp_path / "steps.npz"
    history = evolve(problem, load_cycle(problem, [1, 0], steps=2), checkpoint=file)
    history.raise_for_status()
    pressed = history.reactions("clamped")[:, 1]
    assert pressed == pytest.approx([1, 2, 1, 0], abs=1e-9)
    again = evolve(problem, load_cycle(problem, [1, 0], steps=2), checkpoint=file)
    assert again.reactions("clamped") == pytest.approx(history.reactions("clamped"))
    softer = replace(problem, springs={"left": 99.0})
    with pytest.raises(ValueError, match="belongs to other work"):
        evolve(softer, load_cycle(softer, [1, 0], steps=2), checkpoint=file)


def test_iterative_solvers_take_them():
    pytest.importorskip("pyamg")
    problem = Problem(
        *(SQUARE, STEEL, None, {"right": (3.0, 0.5)}),
        prescribed={"clamped": Roller()},
        springs={"left": 1e3},
        contact="contact",
        gap=1e-4,
    )
    exact = semismooth_newton(problem)
    result = semismooth_newton(problem, options=NewtonOptions(inverse=PyAMG()))
    assert result.status is Status.CONVERGED
    assert (
        np.abs(values(result) - values(exact)).max()
        < 1e-8 * np.abs(values(exact)).max()
    )
