"""Intervals of goals with Tresca's friction."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import value_of
from ngsolve import x, y

from ngepc import (
    ContactForceOn,
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    Roller,
    goal_bound,
    semismooth_newton,
    solve_to,
    write_receipt,
)
from ngepc.bounds.of_state import data_on
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.goal_boundary import FrictionTerms

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=60.0
)
GOALS = ("work", "contact_force", MeanDisplacement("right", 0), Reaction("clamped", 0))


def dragged(order=1, friction=0.3 + 0.2 * x, yield_stress=1.25):
    """A plate presses the whole top, and the block is pulled under it."""
    return Problem(
        block.mesh(0.25, (1.0, 1.0)),
        replace(MATERIAL, yield_stress=yield_stress),
        traction={"right": (0.4, 0.0)},
        contact="contact",
        gap=-2e-3,
        friction=friction,
        initial_displacement=(1e-3 * x, 0.0),
        order=order,
    )


@pytest.mark.parametrize(
    ("friction", "order"), [(0.3 + 0.2 * x, 1), (0.02, 2), (2.0, 1)]
)
def test_fine_goals_are_in_the_intervals(order, friction):
    """Where some nodes slip, all slip, or all stick."""
    result = semismooth_newton(dragged(order, friction))
    fine = semismooth_newton(finer(replace(result.problem, order=2), order))
    goals = GoalProblem(result)
    for goal in GOALS:
        coarse = goals.bound_of(goal)
        assert coarse.lower <= value_of(fine, goal) <= coarse.upper
    better = goal_bound(fine, goal)
    assert max(coarse.lower, better.lower) <= min(coarse.upper, better.upper)
    assert better.width < coarse.width / 2


def test_goals_in_space():
    problem = Problem(
        block.mesh(0.5),
        replace(MATERIAL, yield_stress=1e6),
        traction={"right": (0.4, 0.1, 0.0)},
        contact="contact",
        gap=-1e-3,
        friction=0.2 + x,
        order=1,
    )
    result = semismooth_newton(problem)
    assert 0 < result.state.sliding.sum() < len(result.state.sliding)
    fine = semismooth_newton(finer(problem, 1))
    for goal in ("work", "contact_force"):
        coarse = goal_bound(result, goal)
        better = goal_bound(fine, goal)
        assert coarse.lower <= better.discrete <= coarse.upper
        assert max(coarse.lower, better.lower) <= min(coarse.upper, better.upper)


def test_sticking_is_a_support():
    """With much friction the tangential displacement is held, and intervals are as narrow."""
    stuck = replace(dragged(friction=1e3), initial_displacement=None)
    held = replace(stuck, friction=None, prescribed={"contact": (0, None)})
    one = goal_bound(semismooth_newton(stuck), "work")
    other = goal_bound(semismooth_newton(held), "work")
    assert max(one.lower, other.lower) <= min(one.upper, other.upper)
    assert one.width < 2 * other.width


def cornered(friction, order):
    """A block on springs is pushed into a corner of two walls."""
    return Problem(
        block.structured_mesh(3, 3, simplices=True),
        MATERIAL,
        None,
        springs={"right": (1e3, 1e3)},
        body_force=(-1.0, -2.0),
        contact=("left", "clamped"),
        gap=0.0,
        friction=friction,
        order=order,
    )


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("friction", [0.01, 0.5])
def test_friction_of_walls_that_meet(friction, order):
    """Four rows at two components: matrices were singular, or upper ends above 1e5."""
    result = semismooth_newton(cornered(friction, order))
    fine = semismooth_newton(finer(replace(result.problem, order=2), order))
    goals = GoalProblem(result)
    for goal in ("contact_force", ContactForceOn("left"), MeanDisplacement("right", 1)):
        found = goals.bound_of(goal)
        value = value_of(fine, goal)
        assert found.lower <= value <= found.upper
        assert found.width < 1.2 * abs(value)


def in_a_guide(n, angle, order):
    """Half of a block that a rough plate presses, held by two planes, one beside the plate."""
    c, s = math.cos(angle), math.sin(angle)
    mesh = block.structured_mesh(n, n, simplices=True)
    vertices = np.asarray(mesh.ngmesh.Coordinates())
    vertices[:] = vertices @ [[c, s], [-s, c]]
    along, up = np.array([c, s]), np.array([-s, c])
    return Problem(
        mesh,
        MATERIAL,
        None,
        prescribed={"left": Roller(), "clamped": Roller()},
        traction={"right": tuple(0.8 * along + 0.2 * up)},
        contact="contact",
        gap=2e-4 * (c * x + s * y) - 3e-4,
        friction=0.15,
        order=order,
    )


@pytest.mark.parametrize(("angle", "order"), [(0.0, 1), (0.0, 2), (0.4, 2)])
def test_a_support_beside_friction(angle, order):
    """Balance alone says 2 F for the width; a vertex that had to move and stick made it 1e14."""
    result = semismooth_newton(in_a_guide(3, angle, order))
    fine = semismooth_newton(in_a_guide(12, angle, 2))
    found = goal_bound(result, Reaction("left", 0))
    assert found.lower <= fine.equilibrium.reactions["left"][0] <= found.upper
    assert found.width < 2 * 0.15


def test_without_bound_friction_is_none():
    """F = 0 gives the interval without friction."""
    none = replace(dragged(), friction=None, initial_displacement=None)
    zero = dragged(friction=0.0)
    smooth, rubbed = (GoalProblem(semismooth_newton(body)) for body in (none, zero))
    for goal in GOALS:
        one, other = smooth.bound_of(goal), rubbed.bound_of(goal)
        assert other.interval == pytest.approx(one.interval, rel=1e-6)


def test_no_slip_exceeds_the_supremum():
    """For random slips and tractions that obey the law, on facets where all is constant."""
    rng = np.random.default_rng(2)
    result = semismooth_newton(dragged(friction=0.3))
    contact = data_on(result.discrete).contact
    count = len(contact.owner)
    F = 0.3
    factor = 1.7

    def constant(most):
        """Tangential vectors of random sizes up to a size, (facets, 2, 2)."""
        size = most * rng.uniform(-1, 1, count)
        along = contact.normal[:, ::-1] * (1, -1)
        return np.repeat((size[:, None] * along)[:, None], 2, axis=1)

    slip, z = constant(1.0), constant(2.0)
    drag = constant(F)
    left = factor * (F - np.linalg.norm(drag, axis=2))
    adjoint = constant(1.0) * left[:, :, None]
    terms = FrictionTerms(contact, slip, z, drag, adjoint)
    for sign, most in zip((1, -1), terms.of_facets(factor), strict=True):
        for _ in range(2000):
            s = constant(10 ** rng.uniform(-3, 1))
            size = np.linalg.norm(s, axis=2, keepdims=True)
            T = F * s / size
            value = sign * contact.works(adjoint, s - slip)
            value -= contact.works(T, sign * z)
            value -= factor * contact.works(T - drag, s - slip)
            assert (value <= most + 1e-12).all()


def test_meshes_follow_the_goal():
    solved = solve_to(dragged(2), goal="contact_force", percent=2)
    assert solved.reached
    assert solved.guaranteed


def test_receipts_do_not_cover_friction(tmp_path):
    interval = goal_bound(semismooth_newton(dragged()), "work")
    with pytest.raises(ValueError, match=r"friction.*: a receipt needs"):
        write_receipt(interval, tmp_path / "receipt.npz")
