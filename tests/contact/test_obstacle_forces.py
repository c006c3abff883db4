"""The force of each of several obstacles, which the balance of forces knows."""

import numpy as np
import pytest
from ngsolve import y

from ngepc import (
    ContactForceOn,
    Coulomb,
    Direction,
    Material,
    Problem,
    evolve,
    goal_bound,
    primal_newton,
    semismooth_newton,
    tangent,
)
from ngepc.geometries import block, imported
from ngepc.pictures.wording import describe_problem

SOFT = Material.metal(young=1e3, poisson=0.3, yield_stress=20.0, plastic_modulus=50.0)


def in_a_corner(cells, names, **data):
    """A block that its weight, oblique, pushes into the corner of walls along its sides."""
    return Problem(
        block.structured_mesh(*cells, simplices=True),
        SOFT,
        clamped=None,
        contact=names,
        gap=0.0,
        **data,
    )


@pytest.mark.parametrize("solver", [semismooth_newton, primal_newton])
@pytest.mark.parametrize("order", [1, 2])
def test_each_wall_balances_the_load_across_it(solver, order):
    pushed = in_a_corner((4, 3), "left|clamped", body_force=(-5.0, -3.0), order=order)
    forces = solver(pushed).obstacle_forces
    assert list(forces) == ["left", "clamped"]
    assert forces["left"] == pytest.approx((5.0, 0.0), abs=1e-8)
    assert forces["clamped"] == pytest.approx((0.0, 3.0), abs=1e-8)


def test_three_walls_of_a_cube():
    """The integrals of the pressure over the walls are wrong by up to a quarter."""
    pushed = in_a_corner((3, 3, 3), "left|front|clamped", body_force=(-1.0, -2.0, -3.0))
    forces = semismooth_newton(pushed).obstacle_forces
    expected = {"left": (1, 0, 0), "front": (0, 2, 0), "clamped": (0, 0, 3)}
    for name, force in expected.items():
        assert forces[name] == pytest.approx(force, abs=1e-8)


def test_forces_with_friction_add_up_to_the_resultant():
    pushed = in_a_corner(
        (4, 3), "left|clamped", body_force=(-5.0, -3.0), friction=Coulomb(0.2)
    )
    result = semismooth_newton(pushed)
    total = sum(result.obstacle_forces.values())
    assert total == pytest.approx(result.contact_resultant, abs=1e-8)
    for name, axis in {"left": 0, "clamped": 1}.items():
        force = result.obstacle_forces[name]
        assert 0 < abs(force[1 - axis]) <= 0.2 * force[axis] + 1e-8


@pytest.mark.parametrize("law", [Coulomb, lambda bound: bound])
def test_a_smooth_wall_beside_a_rough_floor_carries_no_shear(law):
    """The mean of both coefficients acted at their common vertex."""
    mesh = block.structured_mesh(4, 3)
    friction = law(mesh.BoundaryCF({"clamped": 0.3, "left": 0.0}))
    pushed = in_a_corner(
        (4, 3), "left|clamped", body_force=(-5.0, -3.0), friction=friction
    ).changed(mesh=mesh)
    forces = semismooth_newton(pushed).obstacle_forces
    assert forces["left"][1] == 0
    assert forces["clamped"][1] == pytest.approx(3.0, rel=1e-9)
    assert 0 < forces["clamped"][0] <= 0.3 * 3.0 + 1e-9


def test_a_face_with_two_names_is_divided_where_they_meet():
    """The pressure of a plate on a block without lateral strain is the same everywhere."""
    column = Material.kinematic(
        lame_lambda=0.0, lame_mu=1e3, yield_stress=1e6, hardening=1.0
    )
    problem = Problem(
        parted_top(), column, clamped="clamped", contact="first|second", gap=-0.01
    )
    result = semismooth_newton(problem)
    forces = result.obstacle_forces
    pressure = -result.contact_resultant[1]
    assert forces["first"] == pytest.approx((0.0, -0.25 * pressure), abs=1e-8)
    assert forces["second"] == pytest.approx((0.0, -0.75 * pressure), abs=1e-8)


def parted_top():
    """A block whose top has two names, ``first`` on its first quarter."""
    mesh = block.structured_mesh(4, 2)
    named = imported.name(mesh, "first", lambda x, y: (y > 0.99) & (x < 0.26))
    return imported.name(named, "second", lambda x, y: (y > 0.99) & (x > 0.24))


def test_gaps_of_several_boundaries_are_given_once():
    """As loads are; in steps, in derivatives and in the table of a report, too."""
    together = {"contact|right": -0.004 * y, "left": 0.02 * (1 - y)}
    parts = {name: together["contact|right"] for name in ("contact", "right")}
    found = []
    for gaps in (together, parts | {"left": together["left"]}):
        pushed = in_a_corner((4, 4), "contact|right|left")
        pushed = pushed.changed(clamped="clamped", gap=gaps)
        closer = {name: gap - 0.001 * y for name, gap in gaps.items()}
        history = evolve(pushed, [(1.0, {}), (2.0, {"gap": closer})])
        result = semismooth_newton(pushed)
        change = tangent(result, {"gap": (1.0, Direction("gap", gaps))})
        forces = [*history.column("contact_force"), change.of("contact_force")]
        found.append((forces, describe_problem(pushed)))
    assert found[0] == found[1]


def test_no_obstacle_has_no_force():
    clamped = Problem(
        block.structured_mesh(2, 2), SOFT, "clamped", pressure={"contact": 1.0}
    )
    assert semismooth_newton(clamped).obstacle_forces == {}


@pytest.mark.parametrize("name", ["contact", "right"])
def test_goals_on_quadrilaterals_are_the_forces_of_obstacles(name):
    """Integrals of the pressure, which were taken, are off by up to a sixth."""
    pushed = Problem(
        block.structured_mesh(4, 4),
        SOFT,
        clamped="clamped",
        contact="contact|right",
        gap={"contact": -0.004, "right": 0.02 * (1 - y)},
        pressure={"left": 6.0},
    )
    result = semismooth_newton(pushed)
    goal = goal_bound(result, ContactForceOn(name))
    force = np.linalg.norm(result.obstacle_forces[name])
    assert goal.discrete == pytest.approx(force, rel=1e-8)
    assert goal.lower < force < goal.upper
