"""``Problem.changed`` decides as ``dataclasses.replace`` does, and looks at less."""

from dataclasses import replace

import pytest
from bodies import STEEL
from ngsolve import CF

from ngepc import Coulomb, Problem, Roller
from ngepc.geometries import block
from ngepc.model import checks

LEGAL = (
    {"gap": 0.2},
    {"gap": None, "contact": None},
    {"traction": {"left": (0, 1.0)}},
    {"pressure": {"left": 3.0}},
    {"body_force": (0, -1.0)},
    {"prescribed": {"left": (0.1, None)}, "clamped": None, "springs": {"clamped": 1.0}},
    {"prescribed": {"left": Roller((1.0, 0.0), 0.0)}},
    {"friction": 0.1},
    {"friction": Coulomb(0.3), "initial_displacement": (0, 0)},
    {"springs": {"right": 2.0}},
    {"clamped": None, "prescribed": {"clamped": (0, 0)}},
    {"initial_strain": 1e-3},
    {"initial_accumulated": 0.1},
    {"order": 2},
    {"kinematics": "two-dimensional"},
)

ILLEGAL = (
    {"gap": None},
    {"gap": float("nan")},
    {"contact": "nowhere"},
    {"traction": {"clamped": (0, 1.0)}},
    {"traction": {"left": (0, 1.0, 0)}},
    {"pressure": {"left": CF((1, 2))}},
    {"prescribed": {"clamped": (0, 1)}},
    {"friction": -0.1},
    {"initial_displacement": (0, 0)},
    {"clamped": None, "contact": None, "gap": None},
    {"springs": {"right": -2.0}},
    {"initial_accumulated": -0.1},
    {"initial_plastic_strain": CF((1, 0, 0, 1), dims=(2, 2))},
    {"order": 3},
    {"material": None},
    {"strange": 1},
)


@pytest.fixture
def problem():
    mesh = block.structured_mesh(3, 3, simplices=True)
    return Problem(mesh, STEEL, contact="contact", gap=0.1, order=1)


def names(change):
    return "-".join(change)


@pytest.mark.parametrize("change", LEGAL, ids=names)
def test_legal_changes(problem, change):
    fast = problem.changed(**change)
    plain = replace(problem, **change)
    assert type(fast) is Problem
    assert vars(fast) == vars(plain)


@pytest.mark.parametrize("change", ILLEGAL, ids=names)
def test_illegal_changes(problem, change):
    with pytest.raises((TypeError, ValueError)) as plain:
        replace(problem, **change)
    with pytest.raises(plain.type) as fast:
        problem.changed(**change)
    if "strange" not in change:
        assert str(fast.value) == str(plain.value)


def test_what_did_not_change_is_not_looked_at(problem, monkeypatch):
    def fail(*args):
        raise AssertionError("checked again")

    for name in ("check_material", "check_motions", "check_held", "check_history"):
        monkeypatch.setattr(checks, name, fail)
    problem.changed(traction={"left": (0, 1.0)}, friction=0.2)
    with pytest.raises(AssertionError):
        problem.changed(gap=0.2)


def test_a_history_is_taken_as_it_is(problem):
    left = problem.continued(initial_accumulated=0.3)
    assert left.initial_accumulated == 0.3
    assert left.gap is problem.gap
    with pytest.raises(TypeError, match="gap"):
        problem.continued(gap=0.3)
