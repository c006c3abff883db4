"""Meshes that follow a goal, verdicts about limits, and one line of confidence."""

import math
import re
import time
from dataclasses import replace

import pytest
from featured import CHANGES, problem_with
from ngsolve import GridFunction, VectorH1, x

from ngepc import (
    Coulomb,
    Material,
    MeanDisplacement,
    Point,
    Problem,
    Refinement,
    confidence,
    error_bound,
    evolve,
    load_cycle,
    semismooth_newton,
    solve_to,
    verdict,
)
from ngepc.bounds.outcome import strain_energy
from ngepc.geometries import block, ring
from ngepc.goals.clock import Clock
from ngepc.goals.refinement import MeshRecord
from ngepc.goals.verdicts import narrowest, outcome_of
from ngepc.local.exact import solve_exactly
from ngepc.studies.examples import example

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)
FORCE = 2.7417
"""The contact force of Example (a), from order two on 6273 nodes."""


def test_one_percent_of_the_force_is_cheap():
    solved = solve_to(
        replace(example("lshape", 225), order=2), goal="contact_force", percent=1
    )
    assert solved.reached
    assert solved.goal.percent <= 1
    assert solved.goal.lower <= FORCE <= solved.goal.upper
    assert solved.result.problem.mesh.nv <= 500
    assert solved.records[-1].lower == solved.goal.lower


def test_meshes_follow_the_goal():
    """The marked cells are those with the indicators: the intervals shrink."""
    solved = solve_to(
        replace(example("lshape", 225), order=1), goal="work", percent=2.0
    )
    widths = [record.upper - record.lower for record in solved.records]
    assert widths == sorted(widths, reverse=True)
    assert solved.relative_error == solved.goal.percent / 100


@pytest.mark.parametrize(
    ("limits", "outcome"),
    [
        ({"at_most": 2.9}, "PASS"),
        ({"at_most": 2.6}, "FAIL"),
        ({"at_least": 2.6}, "PASS"),
        ({"at_least": 2.9}, "FAIL"),
    ],
)
def test_verdicts(limits, outcome):
    problem = replace(example("lshape", 225), order=2)
    found = verdict(problem, "contact_force", **limits)
    assert found.outcome == outcome
    assert str(found).startswith(outcome)


def test_a_limit_at_the_value_is_undecided():
    problem = replace(example("lshape", 225), order=2)
    found = verdict(problem, "contact_force", at_most=FORCE, seconds=1e-6)
    assert found.outcome == "UNDECIDED"
    assert "No new mesh is started" in str(found)
    assert "seconds=1e-06" in str(found)
    few = Refinement(max_nodes=230)
    found = verdict(problem, "contact_force", at_most=FORCE, options=few)
    assert found.outcome == "UNDECIDED"
    assert "max_nodes=230" in str(found)


@pytest.mark.parametrize(
    ("data", "order"), [({}, 2), ({"order": 1}, 1), ({"friction": 0.1}, 1)]
)
def test_the_order_of_a_verdict(data, order):
    """It is two if the order is the default one and bounds cover two.

    With friction a displacement of order one at the start of the step, of a history for example,
    belongs to displacements of order one.
    """
    mesh = block.structured_mesh(3, 3, simplices=True)
    if "friction" in data:
        start = GridFunction(VectorH1(mesh, order=1))
        data = data | {"contact": "contact", "gap": 0.0, "initial_displacement": start}
    load = {"right": (0.0, 1.0)}
    plane = "two-dimensional"
    problem = Problem(mesh, MATERIAL, traction=load, kinematics=plane, **data)
    goal = MeanDisplacement("right", 1)
    few = Refinement(max_nodes=20)
    solved = solve_to(replace(problem, order=order), goal=goal, options=few)
    value = solved.goal.discrete
    found = verdict(problem, goal, at_most=value, options=few)
    assert found.outcome == "UNDECIDED"
    assert found.run.result.problem.order == order
    assert ("order=2" in str(found)) == ("order" in data)


def test_no_mesh_is_begun_that_would_end_too_late(monkeypatch):
    """Meshes of n nodes that take n seconds: 10, 20, 40; the next one would end at 150."""
    ends = iter([0.0, 10.0, 30.0, 70.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(ends))
    clock = Clock(149.0)
    too_late = []
    for nodes in (10, 20, 40):
        clock.after(nodes)
        too_late.append(clock.too_late)
    assert too_late == [False, False, True]
    assert "about 1.5e+02 s, seconds=149" in clock.ending


@pytest.mark.parametrize("above", [True, False])
def test_a_limit_satisfies_itself(above):
    """As "at most" and as "at least"; what the whole interval does not decide is undecided."""
    sign = 1.0 if above else -1.0
    for ends, outcome in {
        (0.0, 0.0): "PASS",
        (-1.0, 0.0): "PASS",
        (0.0, 1.0): "UNDECIDED",
        (-1.0, 1.0): "UNDECIDED",
        (1e-9, 1.0): "FAIL",
    }.items():
        lower, upper = sorted(sign * end for end in ends)
        assert outcome_of(lower, upper, 0.0, above) == outcome


def test_a_body_that_touches_nothing_has_no_force_above_zero():
    mesh = block.structured_mesh(3, 3, simplices=True)
    problem = Problem(mesh, MATERIAL, pressure={"right": 0.1}, contact="contact", gap=1)
    assert verdict(problem, "contact_force", at_most=0.0).outcome != "FAIL"
    assert verdict(problem, "contact_force", at_least=0.0).outcome == "PASS"
    first = solve_to(problem, goal="contact_force").goal
    limit = 0.1 * first.upper
    assert verdict(problem, "contact_force", at_most=limit).outcome == "PASS"
    assert verdict(problem, "contact_force", at_least=limit).outcome == "FAIL"


def test_a_percentage_is_that_of_a_goal():
    with pytest.raises(ValueError, match="percent=5: a goal is needed with it"):
        solve_to(example("lshape", 33), percent=5)


def test_one_limit_is_needed():
    with pytest.raises(ValueError, match="at_most"):
        verdict(example("lshape", 33), "contact_force")


def test_without_an_interval_it_is_said_who_estimates():
    rough = square(contact="contact", gap=-0.01, friction=Coulomb(0.3))
    with pytest.raises(ValueError, match=r"given bound F.*; confidence\(result\)"):
        verdict(rough, "contact_force", at_most=1.0)


def square(**data):
    return Problem(block.mesh(0.4, (1.0, 0.7)), MATERIAL, **data)


@pytest.mark.parametrize(
    ("data", "start"),
    [
        ({}, "Guaranteed: the stress after the last step"),
        ({"contact": "contact", "gap": 1.0}, "Estimate, not guaranteed: the stress"),
        ({"springs": {"contact": 1.0}}, "Guaranteed: the stress after the last step"),
        (
            {"springs": {Point((1.0, 0.7)): (1.0, 1.0)}},
            "The last step, from the state where it starts: Estimate",
        ),
    ],
)
def test_histories_have_their_line(data, start):
    problem = square(traction={"right": (1.0, 0.0)}, order=1, **data)
    line = confidence(evolve(problem, [(0.5, {}), (1.0, {})]))
    assert line.startswith(start)
    assert "\n" not in line


@pytest.mark.parametrize(
    ("problem", "word"),
    [
        (lambda: square(traction={"contact": (0.0, -1.0)}), "Guaranteed"),
        (lambda: square(traction={"contact": (0.0, -1 / (1 + x))}), "Bound from"),
        (
            lambda: square(contact="contact", gap=-0.01, friction=Coulomb(0.3)),
            "Estimate by one refinement",
        ),
        (
            lambda: square(
                contact="contact", gap=-0.01, friction=Coulomb(0.3), order=1
            ),
            "Estimate by another order",
        ),
        (
            lambda: replace(problem_with("prisms"), order=2),
            "Estimate by elements of order one",
        ),
    ],
)
def test_every_problem_has_its_line(problem, word):
    assert confidence(semismooth_newton(problem())).startswith(word)


def test_large_solids_are_estimated_by_recovered_stresses(monkeypatch):
    """A solve on the refined mesh took a minute from 3,072 tetrahedra with friction."""
    monkeypatch.setattr("ngepc.goals.confidence.LARGEST", 10)

    def solved_on(n):
        mesh = block.structured_mesh(n, n, n, simplices=True)
        load = {"right": (1.0, 0.3, 0.5)}
        rubs = {"contact": "contact", "gap": 1e-4, "friction": Coulomb(0.3)}
        return semismooth_newton(
            Problem(mesh, MATERIAL, traction=load, order=2, **rubs)
        )

    coarse, fine = solved_on(2), solved_on(4)
    line = confidence(coarse)
    assert line.startswith("Estimate by recovered stresses, not guaranteed: the energy")
    told = float(re.search(r"about ([\d.e-]+) percent", line)[1])
    change = coarse.primal_energy - fine.primal_energy
    assert 0.5 < told / (100 * change / strain_energy(coarse.state)) < 2


@pytest.mark.parametrize("feature", sorted(CHANGES))
def test_every_feature_has_its_line(feature):
    result = semismooth_newton(problem_with(feature))
    line = confidence(result)
    assert line.startswith(("Guaranteed: ", "Estimate by "))
    assert "percent" in line
    assert line.endswith(".")
    assert ".." not in line


@pytest.mark.parametrize("law", ["anisotropic yield", "cyclic hardening"])
def test_two_bodies_with_any_law_have_a_bound(law):
    """The meshes match on a copy, also where no indicators say which elements stand out."""
    problem = replace(problem_with("two bodies"), **CHANGES[law])
    coarse = error_bound(semismooth_newton(problem))
    fine = solve_to(problem, 0.2).bound
    assert coarse.guaranteed
    assert max(coarse.least_energy, fine.least_energy) < min(coarse.energy, fine.energy)


def test_the_steps_of_a_bound_and_of_an_estimate_are_logged(caplog):
    """Three stresses for a body of order two in space; none for one without a bound."""
    cube = block.structured_mesh(1, 1, 1, simplices=True)
    pulled = Problem(cube, MATERIAL, traction={"contact": (0, 0, 1.0)}, order=2)
    varying = pulled.changed(material=replace(MATERIAL, lame_mu=1e3 + x))
    found = []
    for problem in (pulled, varying):
        caplog.clear()
        with caplog.at_level("INFO", "ngepc"):
            confidence(semismooth_newton(problem))
        said = [record.getMessage() for record in caplog.records]
        of_bound = sum(text.startswith("stress of an error bound") for text in said)
        found.append((of_bound, any("for an estimate by" in text for text in said)))
    assert found == [(3, False), (0, True)]


def test_the_solver_of_an_estimate_suits_the_finer_mesh(monkeypatch):
    """Factors of a solid with friction that is refined once take several times longer."""
    pytest.importorskip("pyamg")
    used = []

    def solve(*given):
        result = solve_exactly(*given)
        used.append(result.linear_solver)
        return result

    monkeypatch.setattr("ngepc.goals.confidence.solve_exactly", solve)
    cube = block.structured_mesh(3, 3, 3, simplices=True)
    pulled = Problem(
        cube,
        replace(MATERIAL, lame_mu=1e3 + x),
        traction={"contact": (0, 0, 1.0)},
        order=2,
    )
    result = semismooth_newton(pulled)
    assert confidence(result).startswith("Estimate by one refinement")
    assert (result.linear_solver, used) == ("sparsecholesky", ["PyAMG"])


def test_the_estimate_of_a_curved_body_is_that_of_the_displacements():
    """Lame's tube: refined elements are curved, too, or the estimate is that of the polygon.

    u(a) = (1 + nu) p a ((1 - 2 nu) a^2 + b^2)/(E (b^2 - a^2)), and J is minus half the work.
    """
    a, b = 1.0, 2.0
    mesh = ring.quarter_mesh(0.3, a, b)
    mesh.Curve(2)
    metal = {"young": 1e3, "poisson": 0.3, "yield_stress": 1e3, "plastic_modulus": 0}
    problem = Problem(
        mesh,
        Material.metal(**metal),
        None,
        pressure={"inner": 1.0},
        prescribed={"left": (0, None), "bottom": (None, 0)},
    )
    result = semismooth_newton(problem)
    moved = 1.3e-3 * a * (0.4 * a**2 + b**2) / (b**2 - a**2)
    energy = -math.pi / 4 * a * moved
    error = 100 * abs(result.primal_energy / energy - 1)
    line = confidence(result)
    assert line.startswith("Estimate by one refinement")
    told = float(re.search(r"changes by ([\d.e-]+) percent", line)[1])
    assert 0.5 * error < told < 2 * error


def test_confidence_in_a_step_whose_hardening_falls_below_zero_between_points():
    """The hardening of the first step is a polynomial, and negative beside what has yielded."""
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=5.0, tangent_modulus=50.0
    )
    problem = Problem(
        block.structured_mesh(3, 2),
        metal,
        traction={"right": (2.0, -6.0)},
        kinematics="axisymmetric",
    )
    line = confidence(evolve(problem, load_cycle(problem, [1.0, 0.5])))
    assert "Estimate by one refinement, not guaranteed" in line


@pytest.mark.parametrize("simplices", [False, True])
def test_confidence_in_a_body_that_expands_freely(simplices):
    """Its energy is a rounding error, which is no error of 100 percent."""
    mesh = block.structured_mesh(4, 4, simplices=simplices)
    metal = Material.metal(young=1e3, poisson=0.3, yield_stress=5, tangent_modulus=50)
    free = {"left": (0, None), "clamped": (None, 0)}
    heated = Problem(
        mesh,
        metal,
        None,
        prescribed=free,
        initial_strain=1e-3,
        kinematics="plane stress",
    )
    start = "Guaranteed: " if simplices else "Estimate by one refinement"
    line = confidence(semismooth_newton(heated))
    assert line.startswith(start)
    assert "the body is free of stress, up to rounding errors." in line
    line = confidence(semismooth_newton(replace(heated, clamped="right")))
    assert line.startswith(start)
    assert "free of stress" not in line


@pytest.mark.parametrize("friction", [None, Coulomb(0.3)])
def test_travel_before_contact_does_not_make_a_result_better(friction):
    """The work of the loads on a travel of 100 widths is 60,000 times the strain energy."""
    lines = {
        confidence(
            semismooth_newton(
                square(
                    clamped=None,
                    contact="clamped",
                    gap=travel,
                    prescribed={"left": (0, None)},
                    traction={"contact": (0.0, -2.0 - 6.0 * x)},
                    friction=friction,
                    order=1,
                )
            )
        )
        for travel in (0.0, 1.0, 100.0)
    }
    assert len(lines) == 1


def test_without_an_interval_on_the_last_mesh_the_narrowest_is_named():
    unknown = MeshRecord(9, 1, 0.0, math.inf, 0.0, math.inf, -math.inf, math.inf)
    wide = replace(unknown, nodes=5, lower=-1.0, upper=3.0)
    narrow = replace(unknown, nodes=7, lower=0.5, upper=1.25)
    assert narrowest([unknown]) == "no interval"
    found = narrowest([wide, narrow, unknown])
    assert found == "no interval on the last mesh (0.5 to 1.25 on 7 nodes)"
