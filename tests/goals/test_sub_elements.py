"""Intervals of goals with sub-elements: each has a part of the stress and its own supremum."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.intervals import fine_problem, value_of

from ngepc import Material, Overlay, Problem, goal_bound, semismooth_newton
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.sub_elements import shares_of

TWO_MU = 2e3
HARDENING = 2e2
PLAIN = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=TWO_MU / 2, yield_stress=5.0, hardening=HARDENING
)
SHARE = TWO_MU / (TWO_MU + HARDENING)
ONE = replace(PLAIN, hardening=0.0, overlay=Overlay([SHARE], [5.0]))
"""The law of ``PLAIN`` in one step."""
TWO = replace(ONE, yield_stress=3.0, overlay=Overlay([0.4, 0.4], [3.0, 7.0]))
GOALS = ("work", "contact_force")


def pressed(material, order, **data):
    """A block that is pulled below an obstacle that presses it."""
    data = {"contact": "contact", "gap": -2e-4, "order": order} | data
    mesh = block.structured_mesh(4, 3, size=(1.0, 0.7), simplices=True)
    return Problem(mesh, material, traction={"right": (5.0, -1.0)}, **data)


def intervals(problem):
    """The intervals of all goals of a problem."""
    goals = GoalProblem(semismooth_newton(problem))
    return [goals.bound_of(goal) for goal in GOALS]


@pytest.mark.parametrize(("order", "wider"), [(1, 1.5), (2, 2.2)])
def test_the_interval_is_near_that_of_the_same_law(order, wider):
    for one, other in zip(
        intervals(pressed(PLAIN, order)), intervals(pressed(ONE, order)), strict=True
    ):
        assert max(one.lower, other.lower) < min(one.upper, other.upper)
        assert other.width < wider * one.width
        assert other.guaranteed


@pytest.mark.parametrize(
    ("order", "kinematics"), [(1, "plane stress"), (2, "plane strain")]
)
def test_fine_values_lie_inside(order, kinematics):
    problem = pressed(TWO, order, kinematics=kinematics)
    result = semismooth_newton(problem)
    assert result.state.at.parts[1].yields.any()
    fine = semismooth_newton(fine_problem(problem))
    for goal, found in zip(GOALS, intervals(problem), strict=True):
        assert found.lower < value_of(fine, goal) < found.upper
    assert found.per_cell.min() > -1e-9 * found.width


def test_fine_values_in_space():
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    problem = Problem(mesh, TWO, traction={"right": (3.0, 0.0, 1.5)}, order=1)
    result = semismooth_newton(problem)
    assert result.state.at.yields.any()
    found = goal_bound(result, "work")
    fine = semismooth_newton(fine_problem(problem))
    assert found.lower < value_of(fine, "work") < found.upper


def test_no_strain_exceeds_the_sum_of_the_suprema():
    """Of one cell, for random strains: the sum over the sub-elements is an upper bound."""
    goals = GoalProblem(semismooth_newton(pressed(TWO, 1)))
    found = goals.bound_of("work")
    factor = found.factor
    integrand = goals._of_bound.integrand(found.pair)
    law = goals.bound_data.discrete.law
    state = goals.bound.state
    base = integrand.elements[0]
    above, _ = integrand.bounds(factor)
    rng = np.random.default_rng(5)
    tau, sigma, strain, trace = (
        getattr(base, name).mean(axis=1) for name in ("tau", "sigma", "strain", "trace")
    )
    volume = base.size
    mean, stress = law.stress(state.at)
    for _ in range(300):
        size = 10 ** rng.uniform(-6, -2, (len(volume), 1))
        e = size * rng.normal(size=(len(volume), 4))
        at = law.returned(state.at.volume + e[:, 0], state.at.deviator + e[:, 1:])
        new_mean, new = law.stress(at)
        value = (tau * e).sum(axis=1) - trace[:, 0] * (new_mean - mean)
        value -= (strain * (new - stress)).sum(axis=1)
        value -= factor * (e[:, 0] * (new_mean - sigma[:, 0]))
        value -= factor * (e[:, 1:] * (new - sigma[:, 1:])).sum(axis=1)
        assert (volume * value <= above + 1e-12).all()


def test_the_split_adds_up_and_stays_inside():
    goals = GoalProblem(semismooth_newton(pressed(TWO, 1)))
    law = goals.bound_data.discrete.law
    rng = np.random.default_rng(1)
    stress = rng.normal(size=(len(law.two_mu), 3, 4)) * 10.0
    split = shares_of(law, stress)
    assert sum(split) == pytest.approx(stress[..., 1:], abs=1e-9)
    for own, bound in zip(split, (0.4 * 3.0, 0.4 * 7.0), strict=False):
        size = np.linalg.norm(own, axis=2)
        assert size.max() < bound
        assert size.max() > (1 - 1e-9) * bound
