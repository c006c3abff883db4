"""Bounds of bodies of thickness t: energies and forces are t times those of thickness one."""

import re
from dataclasses import replace

import numpy as np
import pytest
from featured import CYCLIC, LAW, PLAIN, PRESSED

from ngepc import (
    ContactForceOn,
    Coulomb,
    DisplacementAt,
    LoadWork,
    MeanDisplacement,
    Reaction,
    Schedule,
    confidence,
    contact_force_bracket,
    displacement_bracket,
    error_bound,
    evolve,
    goal_bound,
    semismooth_newton,
    solve_to,
    verdict,
    write_receipt,
)
from ngepc.bounds.of_state import bound_data_of
from ngepc.geometries import block
from ngepc.goals.kinds import LEGAL

T = 2.5
BODY = replace(PLAIN, contact="contact", gap=3e-4)
CHANGES = {
    "order 1": {},
    "order 2": {"order": 2},
    "plane stress": {"kinematics": "plane stress"},
    "quadrilaterals": {"mesh": block.structured_mesh(2, 2), "order": 2},
    "friction": {**PRESSED, "friction": 0.1},
    "springs": {"springs": {"contact": 200.0}, "contact": None, "gap": None},
    "law": {"material": LAW},
    "sub-elements": {"material": CYCLIC},
}


@pytest.mark.parametrize("name", CHANGES)
def test_error_bounds_grow_like_the_thickness(name):
    thin = replace(BODY, **CHANGES[name])
    thick = replace(thin, thickness=T)
    one = error_bound(semismooth_newton(thin))
    other = error_bound(semismooth_newton(thick))
    found = [other.total, other.energy, other.strain_energy, other.per_cell.sum()]
    known = [one.total, one.energy, one.strain_energy, one.per_cell.sum()]
    assert found == pytest.approx(T * np.array(known), rel=1e-9)
    assert other.relative == pytest.approx(one.relative, rel=1e-9)
    assert other.problem.thickness == T


def test_estimates_do_not_depend_on_the_thickness():
    thin = replace(BODY, friction=Coulomb(0.3))
    thick = replace(thin, thickness=T)
    line = confidence(semismooth_newton(thin))
    assert line.startswith("Estimate")
    assert confidence(semismooth_newton(thick)) == line


GOALS = [
    ("contact_force", T),
    ("work", T),
    (Reaction("clamped", 1), T),
    (LoadWork({"right": (1.0, 0.0)}), T),
    (ContactForceOn("contact"), T),
    (MeanDisplacement("right", 0), 1.0),
    (DisplacementAt((0.8, 0.45), 0), 1.0),
]


def test_every_goal_is_here():
    given = {
        goal if isinstance(goal, str) else type(goal).__name__ for goal, _ in GOALS
    }
    legal = set(re.findall(r"(\w+)(?='|\()", LEGAL))
    assert given == legal, "add it to GOALS, with what it is multiplied by"


def test_forces_grow_like_the_thickness_and_displacements_do_not():
    thin = semismooth_newton(BODY)
    thick = semismooth_newton(replace(BODY, thickness=T))
    for goal, size in GOALS:
        one = goal_bound(thin, goal)
        other = goal_bound(thick, goal)
        assert other.interval == pytest.approx(size * np.array(one.interval), rel=1e-3)
        assert other.discrete == pytest.approx(size * one.discrete, rel=1e-9)
        assert other.estimate == pytest.approx(size * one.estimate, rel=1e-3)
        assert other.bound.problem.thickness == T


def test_brackets_agree_with_intervals():
    thick = semismooth_newton(replace(BODY, thickness=T, order=2))
    load = {"right": (1.0, 0.0)}
    pairs = [
        (contact_force_bracket(thick), goal_bound(thick, "contact_force")),
        (displacement_bracket(thick, load), goal_bound(thick, LoadWork(load))),
    ]
    for bracket, interval in pairs:
        assert max(bracket.lower, interval.lower) < min(bracket.upper, interval.upper)
        assert bracket.discrete == pytest.approx(interval.discrete, rel=1e-9)


def test_meshes_are_the_same_for_every_thickness():
    thick = replace(BODY, thickness=T)
    one = solve_to(BODY, goal="contact_force", percent=60)
    records = []
    run = solve_to(thick, monitor=records.append, goal="contact_force", percent=60)
    assert run.goal.interval == pytest.approx(T * np.array(one.goal.interval), rel=1e-3)
    assert run.result.contact_force == pytest.approx(T * one.result.contact_force)
    assert run.bound.energy == pytest.approx(run.result.primal_energy)
    assert [r.nodes for r in records] == [r.nodes for r in one.records]
    assert run.records == records
    assert (records[-1].lower, records[-1].upper) == run.goal.interval
    limit = 1.5 * run.goal.upper
    assert verdict(thick, "contact_force", at_most=limit).outcome == "PASS"


def test_histories_are_refined_by_the_error():
    thick = replace(PLAIN, thickness=T)
    schedule = Schedule([1.0], lambda time: {})
    found = [evolve(problem, schedule, error=0.25) for problem in (PLAIN, thick)]
    errors = [history.steps[-1].record.error_bound for history in found]
    assert errors[1] == pytest.approx(errors[0], rel=1e-6)


def test_receipts_and_data_of_bounds_are_refused_by_name(tmp_path):
    """What is computed for a thickness of one is not taken for that of another."""
    result = semismooth_newton(replace(BODY, thickness=T))
    for given in (result, goal_bound(result, "contact_force")):
        with pytest.raises(ValueError, match=r"thickness=2\.5: a receipt needs"):
            write_receipt(given, tmp_path / "thick.npz")
    with pytest.raises(ValueError, match=r"thickness=2\.5: data of bounds need"):
        bound_data_of(result.discrete)
