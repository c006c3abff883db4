"""Where data are known from samples nobody says 'guaranteed'; where they are enclosed all do."""

import json
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import L2, BSpline, GridFunction, sqrt, x

from ngepc import (
    Material,
    Problem,
    confidence,
    contact_force_bracket,
    displacement_bracket,
    error_bound,
    evolve,
    goal_bound,
    semismooth_newton,
    solve_to,
    verdict,
)
from ngepc.__main__ import main
from ngepc.cli import solve
from ngepc.geometries import block
from ngepc.pictures.answers import how_exact

# elastic, since goals of bodies that yield are integrated by a rule
MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=500.0, hardening=1e3
)
SPLINE = BSpline(2, [-1, -1, 0, 1, 2, 2], [0.0, 1.0, 1.4, 1.8, 2.0])
GAPS = {
    "polynomial": -0.002 - 0.01 * x,
    "formula": 0.01 * sqrt(1 + x) - 0.015,
    "samples": 0.01 * SPLINE(x) - 0.02,
}


@pytest.fixture(scope="module", params=GAPS)
def pressed(request):
    """A block that an obstacle presses, and whether the obstacle is enclosed."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    problem = Problem(mesh, MATERIAL, contact="contact", gap=GAPS[request.param])
    return semismooth_newton(problem), request.param != "samples"


def word(proved):
    return "guaranteed" if proved else "not proved"


def test_bounds_and_goals(pressed):
    result, proved = pressed
    bound = error_bound(result)
    goal = goal_bound(result, "contact_force")
    assert bound.guaranteed is proved
    assert bound.kind == word(proved)
    assert ("gap (at 1/128" in bound.message) is not proved
    assert goal.guaranteed is proved
    assert f", {word(proved)})" in str(goal)


def test_brackets(pressed):
    result, proved = pressed
    load = {"right": (1.0, 0.0)}
    for found in (contact_force_bracket(result), displacement_bracket(result, load)):
        assert found.guaranteed is proved
        assert ("gap (at 1/128" in found.message) is not proved


def test_a_load_that_is_sampled_is_no_proof_of_a_displacement(pressed):
    result, _ = pressed
    load = {"right": (1.0 / sqrt(2 + x), 0.0)}
    found = displacement_bracket(result, load)
    assert not found.guaranteed
    assert "traction" in found.message


def test_meshes_that_follow_the_bound(pressed):
    result, proved = pressed
    found = solve_to(result.problem, 0.2)
    assert found.guaranteed is proved
    assert f"({word(proved)})" in repr(found)
    by_goal = solve_to(result.problem, goal="contact_force", percent=20)
    assert by_goal.guaranteed is proved


def test_verdicts_and_confidence(pressed):
    result, proved = pressed
    found = verdict(result.problem, "contact_force", at_most=1e6)
    assert found.outcome == "PASS"
    assert found.guaranteed is proved
    assert f", {word(proved)})" in str(found)
    assert ("known from samples" in str(found)) is not proved
    start = "Guaranteed" if proved else "Bound from samples"
    assert confidence(result).startswith(start)


def test_histories(pressed):
    result, proved = pressed
    gap = result.problem.gap
    found = evolve(result.problem, [(1.0, {"gap": gap})], error=0.5)
    assert found.steps[-1].record.guaranteed is proved


def test_reports(pressed):
    result, proved = pressed
    said = how_exact(result)
    assert ("guaranteed" in said) is proved
    assert ("from samples" in said) is not proved


def test_the_command_line(pressed, monkeypatch, capsys):
    result, proved = pressed
    flat = replace(result.problem, kinematics="two-dimensional", order=1)
    monkeypatch.setattr(solve, "example", lambda *arguments: flat)
    assert main(["solve", "lshape"]) == 0
    out = capsys.readouterr().out
    assert f"percent, {word(proved)}" in out
    assert ("known from samples only: gap" in out) is not proved
    assert main(["solve", "lshape", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["guaranteed"] is proved


@pytest.mark.parametrize("simplices", [True, False])
def test_constants_of_elements_stay_constants_on_finer_meshes(simplices):
    """The hardening of a metal has four factors: of affine functions it would be known nowhere."""
    mesh = block.structured_mesh(4, 3, simplices=simplices)
    heated = GridFunction(L2(mesh, order=0))
    heated.vec.FV().NumPy()[:] = np.random.default_rng(1).uniform(0, 0.8, mesh.ne)
    softer = 1 - 0.3 * heated
    metal = Material.metal(
        young=1e3 * softer, poisson=0.3, yield_stress=4.0 * softer, plastic_modulus=50.0
    )
    problem = Problem(mesh, metal, contact="contact", gap=-0.01)
    result = semismooth_newton(problem)
    assert confidence(result).startswith("Guaranteed")
    # the first mesh of simplices is not enough
    aim = error_bound(result).relative * (0.8 if simplices else 2)
    refined = solve_to(problem, aim)
    assert len(refined.records) > simplices
    assert refined.guaranteed
