"""Brackets of contact forces and displacements hold what fine meshes find."""

from dataclasses import replace

import pytest
from campaigns.crossings import finer
from ngsolve import x

from ngepc import (
    Material,
    Problem,
    contact_force_bracket,
    displacement_bracket,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.studies.examples import example

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
)
UNIT = {"load": (0.0, 1.0)}


@pytest.fixture(scope="module")
def pair():
    problem = example("lshape", 113)
    return semismooth_newton(problem), semismooth_newton(finer(problem, 2))


@pytest.mark.parametrize("order", [1, 2])
def test_friction_with_a_given_bound(order):
    """A plate presses a block and drags it: the fine values are in the brackets."""
    problem = Problem(
        block.mesh(0.3, (1.0, 1.0)),
        MATERIAL,
        contact="contact",
        gap=-1e-3,
        friction=0.1 + 0.4 * x,
        traction={"right": (0.5, 0.0)},
        order=order,
    )
    result = semismooth_newton(problem)
    assert 0 < result.state.sliding.sum() < len(result.state.sliding)
    fine = semismooth_newton(finer(problem, 1))
    load = {"right": (1.0, 0.0)}
    if order == 1:
        coarse, better = (displacement_bracket(one, load) for one in (result, fine))
    else:
        coarse, better = (contact_force_bracket(one) for one in (result, fine))
    assert coarse.lower < better.discrete < coarse.upper
    assert max(coarse.lower, better.lower) < min(coarse.upper, better.upper)
    assert better.relative < coarse.relative


def test_contact_force(pair):
    coarse, fine = (contact_force_bracket(result) for result in pair)
    assert coarse.lower < fine.lower < fine.upper < coarse.upper
    assert coarse.lower < pair[1].contact_force < coarse.upper
    assert fine.relative < 0.55 * coarse.relative < 0.15


def test_displacement(pair):
    coarse, fine = (displacement_bracket(result, UNIT) for result in pair)
    assert coarse.lower < fine.lower < fine.discrete < fine.upper < coarse.upper
    assert fine.relative < 0.55 * coarse.relative < 0.1


def test_pressure_is_a_load_once():
    """On top of a pressure stands the load of the goal: the bracket of the same traction."""
    pulled = example("lshape", 33)
    pushed = replace(pulled, traction=None, pressure={"load": 10.0})
    by_traction = displacement_bracket(semismooth_newton(pulled), UNIT)
    bracket = displacement_bracket(semismooth_newton(pushed), UNIT)
    assert bracket.lower == pytest.approx(by_traction.lower, rel=1e-9)
    assert bracket.upper == pytest.approx(by_traction.upper, rel=1e-9)


def test_body_forces_are_goals_and_loads():
    """The mean displacement of a block that hangs, in closed form where it is one column."""
    rollers = {"left": (0, None), "right": (0, None)}
    mesh = block.structured_mesh(4, 4, simplices=True)
    column = Problem(
        mesh,
        MATERIAL,
        prescribed=rollers,
        body_force=(0.0, -0.5),
        kinematics="two-dimensional",
    )
    bracket = displacement_bracket(semismooth_newton(column), body_force=(0.0, 1.0))
    exact = -0.5 / 3e3 / 3  # f / (lambda + 2 mu) times the mean of y - y^2/2
    assert bracket.lower < exact < bracket.upper
    assert bracket.discrete == pytest.approx(exact, rel=0.05)


def test_an_obstacle_beside_a_support():
    """A clamp is a support with zeros; nearer obstacles would not leave it the normal."""
    mesh = block.structured_mesh(4, 4, simplices=True)
    pushed = {"contact": "contact", "gap": 2e-5 - 4e-4 * x}
    load = {"right": (0.3, 1.0)}
    clamped = Problem(mesh, MATERIAL, "left", load, **pushed)
    held = Problem(mesh, MATERIAL, None, load, prescribed={"left": (0, 0)}, **pushed)
    one, other = (contact_force_bracket(semismooth_newton(p)) for p in (clamped, held))
    assert 0 < one.lower < one.discrete < one.upper
    assert other.lower == pytest.approx(one.lower, rel=1e-9)
    assert other.upper == pytest.approx(one.upper, rel=1e-9)


def test_no_contact_force_where_nothing_touches():
    bracket = contact_force_bracket(semismooth_newton(example("wrench", 123)))
    assert bracket.lower == bracket.discrete == 0
    assert 0 < bracket.upper < 1e-3


def test_what_is_no_goal_is_refused(pair):
    free = semismooth_newton(replace(pair[0].problem, contact=None, gap=None))
    with pytest.raises(ValueError, match="contact=None"):
        contact_force_bracket(free)
    with pytest.raises(ValueError, match="a load is needed"):
        displacement_bracket(pair[0])
    with pytest.raises(TypeError, match="result=3"):
        contact_force_bracket(3)


def test_a_body_at_rest_has_exact_brackets():
    rest = replace(example("lshape", 33), pressure=None, traction=None)
    result = semismooth_newton(rest)
    for found in (contact_force_bracket(result), displacement_bracket(result, UNIT)):
        assert (found.lower, found.upper) == (0.0, 0.0)
        assert found.guaranteed


@pytest.mark.parametrize("n", [1, 2, 3])
def test_solutions_that_are_exact_up_to_rounding(n):
    """A bar: its error bound is some 1e-20, or zero."""
    rollers = {"left": (0, None), "clamped": (None, 0)}
    problem = Problem(
        block.structured_mesh(n, n, simplices=True),
        MATERIAL,
        None,
        prescribed=rollers,
        traction={"right": (1.0, 0.0)},
    )
    found = displacement_bracket(semismooth_newton(problem), {"right": (1.0, 0.0)})
    exact = 3.75e-4
    assert found.lower < exact < found.upper
    assert found.relative < 1e-6


def test_a_mesh_that_cannot_move_has_no_bracket():
    problem = Problem(
        block.structured_mesh(1, 1, simplices=True),
        MATERIAL,
        "clamped|left|right|contact",
        body_force=(0.0, -1.0),
        order=1,
    )
    with pytest.raises(
        RuntimeError, match="no bracket: the displacements of this mesh"
    ):
        displacement_bracket(semismooth_newton(problem), body_force=(0.0, 1.0))
