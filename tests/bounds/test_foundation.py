"""Elastic foundations in error bounds and intervals of goals."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import value_of
from ngsolve import x, y

from ngepc import (
    Material,
    MeanDisplacement,
    NewtonOptions,
    Point,
    Problem,
    Reaction,
    displacement_bracket,
    error_bound,
    goal_bound,
    semismooth_newton,
    solve_to,
    write_receipt,
)
from ngepc.bounds.of_state import data_on
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.goal_boundary import SpringSquares

ELASTIC = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1e2
)
YIELDING = replace(ELASTIC, yield_stress=1.25)
PUSHED = 2.0
STIFFNESS = 500.0
SQUARE = block.mesh(0.3, (1.0, 1.0))
CUBE = block.mesh(0.5)


def column(N, order):
    """A column without lateral motion on a foundation, pressed from above."""
    if N == 2:
        mesh = SQUARE
        held = {"left|right": (0, None)}
        load = {"contact": (0, -PUSHED)}
    else:
        mesh = CUBE
        held = {"left|right": (0, None, None), "front|back": (None, 0, None)}
        load = {"contact": (0, 0, -PUSHED)}
    springs = {"clamped": STIFFNESS}
    return Problem(
        mesh, ELASTIC, None, load, prescribed=held, springs=springs, order=order
    )


@pytest.mark.parametrize(("N", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
def test_the_bound_of_an_affine_solution_is_zero(N, order):
    """The top sinks by p (1/k + L/(lambda + 2 mu)) with the length L = 1."""
    result = semismooth_newton(column(N, order))
    bound = error_bound(result)
    sunk = PUSHED * (1 / STIFFNESS + 1 / 3e3)
    assert bound.total <= 1e-12 * bound.strain_energy
    top = goal_bound(result, MeanDisplacement("contact", N - 1))
    assert top.lower <= -sunk * (1 - 1e-9)
    assert top.upper >= -sunk * (1 + 1e-9)
    assert top.width <= 1e-5 * sunk


def bent(k, order=1, N=2):
    """A clamped body that yields, with a foundation on one side that is inclined to the load."""
    if N == 2:
        load = {"right": (1.0, 0.8)}
        return Problem(
            SQUARE, YIELDING, traction=load, springs={"contact": k}, order=order
        )
    load = {"right": (0.5, 0.3, 0.4)}
    return Problem(CUBE, YIELDING, traction=load, springs={"contact": k}, order=order)


@pytest.mark.parametrize(("k", "order"), [(30.0, 2), ((2e3, 5e2), 1), (1e6, 2)])
def test_energies_do_not_cross(k, order):
    bound = error_bound(semismooth_newton(bent(k, order)))
    fine = error_bound(semismooth_newton(finer(bound.problem, 2)))
    assert bound.state.at.yields.any()
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 1.8 * (bound.energy - fine.energy + fine.total / 2)
    assert abs(bound.algebraic) < 1e-9 * bound.total


@pytest.mark.parametrize("order", [1, 2])
def test_soft_and_stiff_foundations(order):
    """Springs without stiffness change nothing; very stiff ones are a support."""
    free = replace(bent(1.0, order), springs=None)
    without = error_bound(semismooth_newton(free))
    soft = error_bound(semismooth_newton(bent(1e-9, order)))
    assert soft.total == pytest.approx(without.total, rel=1e-6)
    stiff = error_bound(semismooth_newton(bent((1e9, 1e9), order)))
    held = replace(free, prescribed={"contact": (0, 0)})
    rigid = error_bound(semismooth_newton(held))
    assert stiff.energy == pytest.approx(rigid.energy, rel=1e-5)
    assert rigid.total < stiff.total < 2.3 * rigid.total


def test_stopped_results_have_an_algebraic_part():
    result = semismooth_newton(bent(2e3), options=NewtonOptions(max_iterations=1))
    solved = semismooth_newton(bent(2e3))
    bound = error_bound(result)
    behind = result.primal_energy - solved.primal_energy
    assert 0 < behind <= bound.algebraic
    assert bound.least_energy < error_bound(solved).energy


@pytest.mark.parametrize("order", [1, 2])
def test_fine_goals_are_in_the_intervals(order):
    problem = replace(
        bent((2e3, 5e2), order),
        springs={"left": (2e3, 5e2)},
        contact="contact",
        gap=1e-4 + 1e-3 * x,
    )
    goals = GoalProblem(semismooth_newton(problem))
    fine = semismooth_newton(finer(replace(problem, order=2), 2))
    for goal in (
        "work",
        "contact_force",
        MeanDisplacement("left", 1),
        Reaction("clamped", 0),
    ):
        coarse = goals.bound_of(goal)
        assert coarse.lower <= value_of(fine, goal) <= coarse.upper
    better = goal_bound(fine, goal)
    assert max(coarse.lower, better.lower) <= min(coarse.upper, better.upper)
    assert better.width < coarse.width / 3


def test_goals_in_space():
    problem = replace(bent(2e3, N=3), material=ELASTIC)
    result = semismooth_newton(problem)
    fine = semismooth_newton(finer(replace(problem, order=2), 1))
    for goal in ("work", Reaction("clamped", 2)):
        coarse = goal_bound(result, goal)
        better = goal_bound(fine, goal)
        assert coarse.lower <= better.discrete <= coarse.upper
        assert max(coarse.lower, better.lower) <= min(coarse.upper, better.upper)


def test_the_bracket_of_the_energy_agrees():
    result = semismooth_newton(bent(2e3))
    bracket = displacement_bracket(result, {"right": (1.0, 0.8)})
    interval = goal_bound(result, "work")
    assert bracket.lower < interval.middle < bracket.upper
    assert interval.width < bracket.upper - bracket.lower


def test_no_displacement_exceeds_the_supremum_of_the_springs():
    """At random displacements of the foundation, and at the best one."""
    rng = np.random.default_rng(1)
    foundation = data_on(semismooth_newton(bent((3.0, 7.0), 2)).discrete).foundation
    own, adjoint = rng.normal(size=(2, *foundation.nodes.shape, 2))
    factor = 0.7
    squares = SpringSquares.of(foundation, own, adjoint)
    count = foundation.owner.max() + 1
    for sign, parts in zip((1, -1), squares.parts(factor, count), strict=True):
        pull = factor * own + sign * adjoint
        best = -pull / (2 * factor)
        trials = [best, *(best + rng.normal(size=best.shape) for _ in range(50))]
        values = [
            (-foundation.works(pull, v) - factor * foundation.works(v, v)).sum()
            for v in trials
        ]
        assert values[0] == pytest.approx(parts.sum())
        assert max(values) == values[0]
    assert squares.width(factor) == pytest.approx(
        sum(part.sum() for part in squares.parts(factor, count))
    )


def test_meshes_follow_the_bound_and_the_goal():
    solved = solve_to(bent(2e3), relative_error=0.02)
    assert solved.reached
    solved = solve_to(bent(2e3, 2), goal="work", percent=2)
    assert solved.reached
    assert solved.guaranteed


def test_what_is_not_covered_is_refused(tmp_path):
    result = semismooth_newton(bent(1e3 * (1 + y + x)))
    with pytest.raises(
        ValueError, match=r"springs\['contact'\] varies inside boundary"
    ):
        error_bound(result)
    corner = {Point((1.0, 1.0)): (10.0, 10.0)}
    result = semismooth_newton(replace(bent(1.0), springs=corner))
    with pytest.raises(ValueError, match=r"springs.*: a bound needs"):
        error_bound(result)
    with pytest.raises(ValueError, match=r"springs.*: a receipt needs"):
        write_receipt(semismooth_newton(bent(1.0)), tmp_path / "receipt.npz")
