"""Loads and obstacles narrower than the points of a rule: seen, integrated, and said."""

import math

import numpy as np
import pytest
from campaigns.hidden import Hidden
from ngsolve import (
    BND,
    CF,
    H1,
    VOL,
    GridFunction,
    IfPos,
    Integrate,
    Parameter,
    dx,
    exp,
    sin,
    specialcf,
    sqrt,
    x,
    y,
)

from ngepc import Material, Problem, error_bound, semismooth_newton
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.sampling import Scan
from ngepc.geometries import block

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e3
)
SPOT = IfPos(0.01 - sqrt((x - 0.55) ** 2), -50.0, 0.0)


@pytest.mark.parametrize(
    "value",
    [
        2.0,
        CF((1, 2)),
        x * x + 2 * y - x / 3,
        Parameter(2) * x,
        -3 * specialcf.normal(2),
        (x - 0.5) ** 2,
    ],
)
def test_polynomials_are_known(value):
    assert is_polynomial(value)


@pytest.mark.parametrize("value", [sin(x), IfPos(x, 1, 2), sqrt(x), 1 / (1 + x), SPOT])
def test_other_functions_are_not(value):
    assert not is_polynomial(value)


def test_finite_element_functions_are_known():
    mesh = block.mesh(0.5, (1.0, 0.7))
    assert is_polynomial(GridFunction(H1(mesh)) * x)


@pytest.mark.parametrize(
    ("kind", "value", "exact", "part"),
    [
        (VOL, IfPos(0.01 - sqrt((x - 0.55) ** 2), 1.0, 0.0), 0.014, 4e-3),
        (
            VOL,
            IfPos(1e-4 - (x - 0.55) ** 2 - (y - 0.33) ** 2, 1.0, 0.0),
            math.pi * 1e-4,
            4e-3,
        ),
        (BND, IfPos(0.01 - sqrt((x - 0.55) ** 2), 1.0, 0.0), 0.04, 1e-4),
    ],
)
def test_what_rules_miss_is_integrated(kind, value, exact, part):
    scan = Scan(block.mesh(0.3, (1.0, 0.7)), value, kind)
    rules = [scan.rule(number) for number in scan.hidden.tolist()]
    found = sum(float(rule.weights @ rule.values[:, 0]) for rule in rules)
    assert len(rules) > 0
    assert found == pytest.approx(exact, rel=part)


def test_smooth_parts_of_an_element_are_integrated_together():
    """A kink: |x - 0.55|, with a few percent of the points that all parts would need."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    scan = Scan(mesh, sqrt((x - 0.55) ** 2), VOL)
    rules = [scan.rule(number) for number in scan.hidden.tolist()]
    found = sum(float(rule.weights @ rule.values[:, 0]) for rule in rules)
    assert len(rules) == 4
    assert found == pytest.approx((0.05**2 + 0.45**2) / 2, rel=1e-5)
    every = 3 * len(rules[0].corners)
    assert max(len(rule.weights) for rule in rules) < every / 3


@pytest.mark.parametrize("kind", [VOL, BND])
def test_what_one_sample_sees_is_no_part_of_a_smooth_group(kind):
    """Spots around one centre or one corner of the lattice are cut out of any group."""
    mesh = block.structured_mesh(1, 1, simplices=True)
    scan = Scan(mesh, sin(7 * x) + 0.1, kind)
    number = int(scan.hidden[0])
    usual = scan.rule(number)
    for place in usual.corners[len(usual.corners) // 2][[0, -1]]:
        point = scan.at(number, place[None], CF((x, y)))[0]
        away = (x - float(point[0])) ** 2 + (y - float(point[1])) ** 2
        spotted = sin(7 * x) + 0.1 + IfPos(1e-8 - away, 1.0, 0.0)
        rule = Scan(mesh, spotted, kind).rule(number)
        nearest, before = (
            np.abs(r.shares - place).max(axis=1).min() for r in (rule, usual)
        )
        assert nearest < 0.03 / scan.count
        assert nearest < before / 4


def test_smooth_functions_are_left_to_the_rules():
    mesh = block.mesh(0.1, (1.0, 0.7))
    assert len(Scan(mesh, exp(-x * y), VOL).hidden) == 0


def test_a_narrow_load_pushes():
    """The spot has the resultant -1; rules of moderate order saw nothing of it."""
    mesh = block.structured_mesh(8, 8, simplices=True)
    problem = Problem(mesh, MATERIAL, traction={"contact": (0, SPOT)})
    result = semismooth_newton(problem)
    pushed = float(result.discrete.load[: mesh.nv, 1].sum())
    bound = error_bound(result)
    assert pushed == pytest.approx(-1.0, rel=1e-3)
    assert result.primal_energy < -1e-4
    assert not bound.guaranteed
    assert "traction" in bound.message


def test_polynomials_are_proofs():
    data = {"traction": {"contact": (0.0, -1.0 - x)}, "body_force": (x * y, 0.5)}
    bound = error_bound(
        semismooth_newton(Problem(block.mesh(0.5, (1.0, 0.7)), MATERIAL, **data))
    )
    assert bound.guaranteed
    assert bound.message == ""


def test_an_obstacle_between_the_points_is_cleared():
    """A spike of a fiftieth of a cell: the displacement is moved below its tip."""
    width = 0.006
    spike = IfPos(width - sqrt((x - 0.57) ** 2), 1 - sqrt((x - 0.57) ** 2) / width, 0.0)
    mesh = block.mesh(0.35, (1.0, 0.7))
    problem = Problem(mesh, MATERIAL, contact="contact", gap=0.01 - 0.03 * spike)
    bound = error_bound(semismooth_newton(problem))
    u = bound.state.discrete.supports.function(bound.state.u)
    assert u(mesh(0.57, 0.7))[1] <= -0.02 + 1e-6


def test_random_problems_do_not_contradict_their_bounds(tmp_path):
    """The first ones of the campaign."""
    campaign = Hidden(tmp_path, count=3)
    records = [campaign.solve(1, number) for number in (1, 2, 5)]
    assert not any(r["failure"] or r["refused"] for r in records)
    assert min(r["margin"] for r in records) >= 0


def test_integrals_of_a_form_agree():
    """Nodal forces are those of NGSolve's forms with a rule of high order."""
    mesh = block.mesh(0.3, (1.0, 0.7))
    value = sin(9 * x) * exp(y)
    problem = Problem(mesh, MATERIAL, order=2, body_force=(value, 1.0))
    load = semismooth_newton(problem).discrete.load
    exact = Integrate(value * dx(bonus_intorder=20), mesh)
    assert np.isclose(load[: mesh.nv, 0].sum(), exact, rtol=1e-6)
