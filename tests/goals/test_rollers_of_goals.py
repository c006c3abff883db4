"""Intervals of goals of bodies on rollers, and the reactions of rollers."""

import math

import numpy as np
import pytest
from bodies import STEEL, moved_by
from campaigns.crossings import finer
from campaigns.intervals import value_of

from ngepc import (
    LoadWork,
    NewtonOptions,
    Problem,
    Reaction,
    Roller,
    confidence,
    contact_force_bracket,
    displacement_bracket,
    error_bound,
    goal_bound,
    semismooth_newton,
    solve_to,
    verdict,
    write_receipt,
)
from ngepc.geometries import block
from ngepc.goals.adjoint import LOOSEST
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.kinds import MEETING
from ngepc.goals.receipt import LOSS
from ngepc.goals.roller_motion import motion_of_support, moved

EXACT = NewtonOptions(tolerance=1e-12)
TURN = np.array([[math.sqrt(3), -1.0], [1.0, math.sqrt(3)]]) / 2
"""By 30 degrees."""
UPRIGHT = np.eye(2)
THREE = {"left": Roller(value=1e-3), "clamped": Roller(), "right": Roller(value=2e-3)}


def plate(turn=UPRIGHT, order=1, **changes):
    """A quarter of a plate with a hole between three rollers, which an obstacle presses."""
    data = {
        "clamped": None,
        "prescribed": THREE,
        "traction": {"right": tuple(turn @ [0.0, 0.4])},
        "contact": "contact",
        "gap": -1e-3,
        "body_force": tuple(turn @ [0.2, -0.1]),
        "kinematics": "plane strain",
        "order": order,
    }
    mesh = moved_by(turn, block.with_hole(0.2, (1.0, 1.0)))
    return Problem(mesh, STEEL, **{**data, **changes})


def solved(problem):
    return semismooth_newton(problem, options=EXACT).raise_for_status()


def along(turn):
    """The work of a unit traction to the right of the body."""
    return LoadWork({"contact": tuple(turn[:, 0])})


@pytest.mark.parametrize(
    ("order", "changes"),
    [
        (1, {}),
        (2, {"kinematics": "plane stress"}),
        (2, {"springs": {"hole": 50.0}}),
        (1, {"friction": 0.05}),
    ],
    ids=str,
)
def test_a_turned_body_has_the_same_intervals(order, changes):
    """As far as the values of held rows are solved."""
    here = GoalProblem(solved(plate(order=order, **changes)))
    there = GoalProblem(solved(plate(TURN, order, **changes)))
    for goals in ((along(UPRIGHT), along(TURN)), ("contact_force", "contact_force")):
        first, second = map(GoalProblem.bound_of, (here, there), goals)
        near = LOOSEST * first.width
        assert first.lower < first.discrete < first.upper
        assert second.discrete == pytest.approx(first.discrete, rel=1e-8)
        assert second.lower == pytest.approx(first.lower, abs=near)
        assert second.upper == pytest.approx(first.upper, abs=near)


@pytest.mark.parametrize("order", [1, 2])
def test_reactions_turn_with_the_body(order):
    here = goal_bound(solved(plate(order=order)), Reaction("left", 0))
    there = solved(plate(TURN, order))
    for component in (0, 1):
        found = goal_bound(there, Reaction("left", component))
        part = TURN[component, 0]
        known = there.equilibrium.reactions["left"][component]
        assert found.discrete == pytest.approx(known, rel=1e-8)
        assert found.discrete == pytest.approx(part * here.discrete, rel=1e-8)
        assert found.width == pytest.approx(part * here.width, rel=1e-3)
        assert found.percent > 0.1
        assert found.note == ""


def test_reactions_and_loads_are_in_balance():
    """The intervals of all supports and of the obstacle together contain minus the load."""
    goals = GoalProblem(solved(plate(TURN, 2)))
    pressed = goals.bound_of("contact_force")
    for component in (0, 1):
        found = [goals.bound_of(Reaction(name, component)) for name in THREE]
        push = -TURN[component, 1]
        load = TURN[component] @ [0.0, 0.4]
        area = 1 - math.pi * 0.3**2 / 4
        middle = sum(goal.middle for goal in found) + push * pressed.middle
        width = sum(goal.width for goal in found) + abs(push) * pressed.width
        body = TURN[component] @ [0.2, -0.1]
        assert middle + load + area * body == pytest.approx(0, abs=width / 2 + 0.02)


@pytest.mark.parametrize("order", [1, 2])
def test_intervals_hold_fine_values(order):
    """Of rollers in several directions, with values, and a side held along its tangent."""
    supports = {
        "left": Roller(value=1e-3),
        "clamped": Roller((0.2, 0.9)),
        "right": Roller(tuple(TURN[:, 1]), 5e-4),
    }
    load = {"right": tuple(TURN @ [1.2, 0.0]), "contact": (0.3, 0.6)}
    problem = plate(
        TURN, order, prescribed=supports, traction=load, contact=None, gap=None
    )
    fine = solved(finer(problem, 1))
    goals = GoalProblem(solved(problem))
    for goal in (
        along(TURN),
        *(Reaction(name, k) for name in supports for k in (0, 1)),
    ):
        found = goals.bound_of(goal)
        assert found.lower < value_of(fine, goal) < found.upper
    assert goal_bound(fine, goal).width < found.width


def test_a_motion_moves_one_support_and_no_other():
    d = np.array([0.6, 0.8])
    m = np.array([-0.28, 0.96])
    unit = np.array([1.0, 0.0])
    assert moved([d], [], unit) == pytest.approx(0.6 * d)
    w = moved([d], [m], unit)
    assert w @ d == pytest.approx(d @ unit)
    assert w @ m == pytest.approx(0)
    assert moved([d, m], [], unit) == pytest.approx(unit)


def test_supports_that_share_a_vertex_along_one_direction_share_its_force():
    problem = plate(
        TURN,
        clamped="left",
        prescribed={"clamped": Roller()},
        contact=None,
        gap=None,
        traction={"right": (1.0, 0.2)},
    )
    motion, shared = motion_of_support(problem, "clamped", 1)
    assert shared
    n = -TURN[:, 1]
    sizes = np.unique(np.round(motion @ n, 12))
    assert sizes == pytest.approx([n[1], n[1] / 2, 0.0])
    assert goal_bound(solved(problem), Reaction("clamped", 1)).note == MEETING
    with pytest.raises(ValueError, match="does not hold component 1"):
        motion_of_support(plate(), "left", 1)


def test_solve_to_verdict_and_brackets():
    """What is made from intervals and bounds takes rollers, too."""
    problem = plate(TURN, 2)
    run = solve_to(problem, goal=Reaction("left", 0), percent=5.0)
    assert run.reached
    assert run.result.problem.rollers
    value = run.goal.middle
    assert verdict(problem, Reaction("left", 0), at_most=value + 1.0).outcome == "PASS"
    result = solved(problem)
    assert confidence(result).startswith("Guaranteed")
    force = contact_force_bracket(result)
    assert force.lower < force.discrete < force.upper
    moved_right = displacement_bracket(result, {"contact": tuple(TURN[:, 0])})
    assert moved_right.lower < moved_right.discrete < moved_right.upper


def test_receipts_of_rollers_along_axes_are_those_of_components(tmp_path):
    result = solved(plate())
    least, upper = write_receipt(result, tmp_path / "energy.npz")
    bound = error_bound(result)
    assert least < bound.least_energy < bound.energy < upper
    assert upper - least < (1 + LOSS) * bound.total
    found = goal_bound(result, Reaction("left", 0))
    lower, upper = write_receipt(found, tmp_path / "goal.npz")
    assert lower < found.discrete < upper
    with pytest.raises(ValueError, match=r"prescribed.*a receipt needs"):
        write_receipt(goal_bound(solved(plate(TURN)), along(TURN)), tmp_path / "no.npz")


@pytest.mark.parametrize("order", [1, 2])
def test_a_solid_on_slanted_rollers(order):
    """A turned cube: the same intervals, but for the search of suprema and bisected edges."""
    tilt = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    supports = {"left": Roller(value=1e-3), "back": Roller(), "clamped": Roller()}
    values = []
    for turn in (np.eye(3), tilt):
        mesh = moved_by(turn, block.mesh(0.6))
        load = {
            "right": tuple(turn @ [1.5, 0.3, 0.2]),
            "contact": tuple(turn @ [0, 0, 1]),
        }
        problem = Problem(mesh, STEEL, None, load, prescribed=supports, order=order)
        found = goal_bound(solved(problem), LoadWork({"right": tuple(turn[:, 0])}))
        values.append((found.lower, found.upper))
    width = values[0][1] - values[0][0]
    assert values[1] == pytest.approx(values[0], abs=0.2 * width)


def test_a_reaction_that_the_loads_determine_alone():
    """The adjoint is a rigid motion, whose energy is rounding of either sign."""
    problem = plate(
        TURN,
        prescribed={"clamped": Roller()},
        traction={"contact": tuple(TURN @ [0.3, -0.7])},
        body_force=None,
        springs={"right": 1e3},
        contact=None,
        gap=None,
        order=2,
    )
    result = solved(problem)
    for component in (0, 1):
        found = goal_bound(result, Reaction("clamped", component))
        wanted = 0.7 * TURN[component, 1]
        assert found.lower <= wanted <= found.upper
        assert found.upper - found.lower < 1e-8 * abs(wanted)
