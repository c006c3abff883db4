"""Bounds and intervals of goals in plane stress, where eps_zz is free at each point."""

from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import value_of
from ngsolve import CF, L2, GridFunction, x, y

from ngepc import (
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    Voce,
    confidence,
    displacement_bracket,
    error_bound,
    evolve,
    goal_bound,
    semismooth_newton,
    solve_to,
    verdict,
)
from ngepc.bounds.densities import missed
from ngepc.bounds.of_state import data_on
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem

LAME = {"lame_lambda": 1.5e3, "lame_mu": 1e3}
LINEAR = Material.kinematic(**LAME, yield_stress=1.25, hardening=1e2)
MIXED = replace(LINEAR, hardening_modulus=0.1, hardening_stiffness=3e3)
SATURATING = Material.with_law(**LAME, law=Voce(1.5, 0.5, 100.0), hardening=50.0)
MATERIALS = {"linear": LINEAR, "mixed": MIXED, "Voce": SATURATING}
SQUARE = block.mesh(0.3, (1.0, 1.0))
THIN = {"kinematics": "plane stress"}


def sheet(material=LINEAR, order=2, **data):
    """A clamped sheet that is pulled until a part of it yields, beside an obstacle."""
    given = {"traction": {"right": (1.5, 0.8)}, "contact": "contact", "gap": 2e-4}
    return Problem(SQUARE, material, order=order, **THIN | given | data)


def integrals_of_phi(state, count):
    """Integrals of phi over the cells: means of its values at the points of many parts."""
    data = data_on(state.discrete)
    law = state.discrete.law
    i, j = (v.ravel() for v in np.indices((count, count)))
    lower = i + j < count
    upper = i + j < count - 1
    corners = [np.stack([i, j], axis=1)[lower] + 1 / 3]
    corners.append(np.stack([i, j], axis=1)[upper] + 2 / 3)
    shares = np.concatenate(corners) / count
    shares = np.column_stack([shares, 1 - shares.sum(axis=1)])
    cells = len(data.cells.nodes)

    def at_points(values):
        """Values at all points of affine functions that are known at those of the rule."""
        values = np.matmul(shares, data.at_corners(np.ascontiguousarray(values)))
        return values.reshape(-1, values.shape[2])

    fine = law.of(np.repeat(3 * np.arange(cells), len(shares)))
    fine.back = at_points(law.back)
    fine.initial = at_points(law.initial)
    volume = at_points(state.at.volume[:, None])[:, 0]
    at = fine.returned(volume, at_points(state.at.deviator))
    mean = fine.energy_density(at).reshape(cells, -1).mean(axis=1)
    return data.cells.volume * mean


@pytest.mark.parametrize("name", MATERIALS)
def test_the_energy_is_above_the_integral_and_near_it(name):
    """On parts of the cells where eps_zz is affine; with one eps_zz for a cell it is farther."""
    result = semismooth_newton(sheet(MATERIALS[name]))
    state = result.state
    data = data_on(state.discrete)
    exact = integrals_of_phi(state, 40)
    found = data.phi(state)
    assert state.at.yields.any()
    assert (found >= exact - 2e-4 * exact.max()).all()
    total = error_bound(result).total
    assert 0 <= (found - exact).sum() <= 0.02 * total

    whole = copy(state.discrete.law)
    whole.across = None  # the strain across is affine on each cell
    rest = state.at, data.cells.volume, data.at_corners
    assert missed(state.discrete.law, *rest).sum() < missed(whole, *rest).sum()


@pytest.mark.parametrize("order", [1, 2])
def test_the_bound_of_an_affine_solution_is_zero(order):
    """A bar in tension that yields, with plastic strains across the sheet."""
    held = {"left": (0, None), "clamped": (None, 0)}
    problem = Problem(
        SQUARE, LINEAR, None, {"right": (2.5, 0)}, prescribed=held, order=order, **THIN
    )
    result = semismooth_newton(problem)
    bound = error_bound(result)
    assert result.state.at.yields.all()
    assert bound.total <= 1e-9 * bound.strain_energy
    moved = goal_bound(result, MeanDisplacement("right", 0))
    assert moved.lower <= moved.discrete <= moved.upper
    assert moved.width <= 1e-3 * moved.discrete


@cache
def fine_result(name):
    """The solution of order two on a finer mesh."""
    return semismooth_newton(finer(sheet(MATERIALS[name]), 2))


@pytest.mark.parametrize(
    ("order", "name"), [(1, "linear"), (2, "mixed"), (1, "Voce"), (2, "Voce")]
)
def test_energies_do_not_cross(name, order):
    bound = error_bound(semismooth_newton(sheet(MATERIALS[name], order)))
    fine = error_bound(fine_result(name))
    assert bound.state.at.yields.any()
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 1.6 * (bound.energy - fine.least_energy)
    assert abs(bound.algebraic) < 1e-6 * bound.total
    assert bound.per_cell.min() > -1e-9 * bound.total


@pytest.mark.parametrize(("order", "name"), [(2, "linear"), (1, "mixed"), (2, "Voce")])
def test_fine_goals_are_in_the_intervals(name, order):
    """And as near to them as in plane strain: the strain across is chosen well."""
    material = MATERIALS[name]
    result = semismooth_newton(sheet(material, order))
    goals = ("work", "contact_force", Reaction("clamped", 1))
    found = list(map(GoalProblem(result).bound_of, goals))
    for goal, interval in zip(goals, found, strict=True):
        value = value_of(fine_result(name), goal)
        assert interval.lower < value < interval.upper
    long = semismooth_newton(sheet(material, order, kinematics="plane strain"))
    assert found[0].percent < 1.5 * goal_bound(long, "work").percent


def test_finer_meshes_have_narrower_intervals():
    coarse = goal_bound(semismooth_newton(sheet()), "contact_force")
    fine = goal_bound(fine_result("linear"), "contact_force")
    assert max(coarse.lower, fine.lower) <= min(coarse.upper, fine.upper)
    assert fine.width < coarse.width / 3


@pytest.mark.parametrize("order", [1, 2])
def test_initial_strains(order):
    """sigma_zz = 0 does no work in an initial strain across the sheet."""
    heated = sheet(order=order, initial_strain=3e-4)
    bounds = [error_bound(semismooth_newton(finer(heated, k))) for k in (0, 2)]
    best = error_bound(semismooth_newton(finer(replace(heated, order=2), 2)))
    for bound in bounds:
        assert bound.least_energy < best.least_energy * (1 - 1e-9 * order)
        assert best.energy <= bound.energy
    assert bounds[1].total < bounds[0].total / 4


def test_affine_histories():
    strain = GridFunction(L2(SQUARE, order=1))
    strain.Set(2e-4 * (0.3 + x * y))
    tensor = CF((1, 0.5, 0, 0.5, -0.7, 0, 0, 0, -0.3), dims=(3, 3))
    problem = sheet(
        initial_plastic_strain=strain * tensor,
        initial_hardening=90 * strain * tensor,
        initial_strain=3e-4,
    )
    results = [semismooth_newton(finer(problem, k)) for k in (0, 2)]
    coarse, fine = (error_bound(result) for result in results)
    assert coarse.least_energy < fine.least_energy < fine.energy < coarse.energy
    interval = goal_bound(results[0], "work")
    assert interval.lower <= value_of(results[1], "work") <= interval.upper


def test_meshes_and_verdicts():
    problem = sheet()
    solved = solve_to(problem, relative_error=0.01)
    assert solved.reached
    assert solved.bound.guaranteed
    by_goal = solve_to(problem, goal="work", percent=5)
    assert by_goal.reached
    high = by_goal.goal.upper
    assert verdict(problem, "work", at_most=1.1 * high).outcome == "PASS"


def test_brackets_and_confidence():
    result = semismooth_newton(sheet())
    assert confidence(result).startswith("Guaranteed")
    work = displacement_bracket(result, {"right": (1.5, 0.8)})
    interval = goal_bound(result, "work")
    assert work.lower < interval.middle < work.upper
    assert interval.width < work.upper - work.lower


def test_histories_with_bounds():
    """Each step has a bound; the meshes of the steps are refined for it."""
    steps = [(0.5, {}), (1.0, {"gap": 0.0}), (1.5, {"traction": {}})]
    history = evolve(sheet(MIXED), steps, error=0.05).raise_for_status()
    assert max(history.column("error_bound")) <= 0.05
    assert history.column("guaranteed") == [True] * 3
