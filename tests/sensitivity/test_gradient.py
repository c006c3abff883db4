"""Gradients of functionals: central differences, Taylor, the envelope theorem, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, IfPos, x, y

from ngepc import Material, NewtonOptions, SolverError, lshape_problem, semismooth_newton
from ngepc.geometries import lshape
from ngepc.sensitivity.functionals import DisplacementAt, Reaction, misfit
from ngepc.sensitivity.gradient import gradient
from ngepc.sensitivity.parameters import Direction
from ngepc.studies.verification.derivatives import (
    compared,
    functionals,
    last_state,
    moved,
    once,
    random_problem,
    sizes,
)


@pytest.fixture(scope="module")
def lshape_result():
    return semismooth_newton(lshape_problem(lshape.paper_mesh(417)))


@pytest.mark.parametrize("seed", range(16))
def test_gradients_agree_with_central_differences(seed):
    part = slice(seed % 5, None, 5)
    found = [c for c in compared(random_problem(seed), every=part) if c.smooth]
    assert len(found) >= 5
    assert max(c.error for c in found) < 1e-8


@pytest.mark.parametrize("seed", [2, 5, 7, 9])
def test_taylor_remainder_is_of_second_order(seed):
    problem = random_problem(seed)
    result, amounts = once(problem), sizes(problem)
    random = np.random.default_rng(seed)
    rates = {name: amount * random.uniform(-1, 1) for name, amount in amounts.items()}
    lengths = 1e-3 * 0.5 ** np.arange(4)
    states = [
        last_state(once(moved(problem, {n: t * r for n, r in rates.items()}), result))
        for t in lengths
    ]
    for functional in functionals(problem).values():
        value = functional.slope(last_state(result)).value
        slopes = gradient(result, functional, list(rates))
        rate = sum(slopes[name] * r for name, r in rates.items())
        rest = [
            abs(functional.slope(s).value - value - t * rate)
            for s, t in zip(states, lengths, strict=True)
        ]
        assert np.polyfit(np.log(lengths), np.log(rest), 1)[0] > 1.95


def test_envelope_theorem(lshape_result):
    state = lshape_result.state
    plastic = state.at.gained
    slopes = gradient(
        lshape_result, "primal_energy", ["gap", "traction", "hardening", "yield_stress"]
    )
    expected = {
        "gap": -state.multipliers.sum(),
        "traction": -np.vdot(state.discrete.load, state.u),
        "hardening": state.discrete.points.integral(0.5 * plastic**2),
        "yield_stress": state.discrete.points.integral(plastic),
    }
    for name, value in expected.items():
        assert slopes[name] == pytest.approx(value, rel=1e-10)


def test_moving_a_support_costs_the_work_of_its_force():
    result = once(random_problem(4))
    slopes = gradient(result, "primal_energy", ["prescribed"])
    values, (support,) = result.discrete.supports.values, result.problem.prescribed
    force = [Reaction(support, i).slope(result.state).value for i in range(2)]
    components = result.problem.prescribed[support]
    assert slopes["prescribed"] == pytest.approx(np.dot(force, components), rel=1e-9)
    assert values.any()


def test_a_constant_is_the_sum_of_its_regions(lshape_result):
    left, material = IfPos(0.5 - x, 1.0, 0.0), lshape_result.problem.material
    slopes = gradient(
        lshape_result,
        "contact_force",
        {
            "left": Direction("yield_stress", left),
            "right": Direction("yield_stress", 1 - left),
            "all": Direction("yield_stress"),
        },
    )
    assert slopes["left"] + slopes["right"] == pytest.approx(slopes["all"], rel=1e-12)
    fields = replace(material, yield_stress=CF(material.yield_stress))
    other = semismooth_newton(replace(lshape_result.problem, material=fields))
    factor = gradient(other, "contact_force", ["yield_stress"])["yield_stress"]
    assert factor == pytest.approx(material.yield_stress * slopes["all"], rel=1e-8)


def test_a_load_or_gap_is_the_sum_over_its_boundaries():
    problem = random_problem(1)
    problem = replace(problem, traction={**problem.tractions, "left": (y, 0.1)})
    result = once(problem)
    (right,) = set(problem.tractions) - {"left"}
    names = ["traction", "traction:left", f"traction:{right}", "gap", "gap:contact"]
    slopes = gradient(result, "contact_force", names)
    parts = slopes["traction:left"] + slopes[f"traction:{right}"]
    assert parts == pytest.approx(slopes["traction"], rel=1e-12)
    assert slopes["gap:contact"] == pytest.approx(slopes["gap"], rel=1e-12)


def test_reactions_balance_what_changes(lshape_result):
    names = ["yield_stress", "gap"]
    force = gradient(lshape_result, "contact_force", names)
    reaction = gradient(lshape_result, Reaction("clamped", 1), names)
    for name in names:  # the obstacle of Example (a) pushes along y
        assert reaction[name] == pytest.approx(force[name], rel=1e-8)


def test_a_field_that_fits_has_no_slope(lshape_result):
    slopes = gradient(lshape_result, misfit(lshape_result.displacement), ["hardening", "gap"])
    assert slopes.functional == pytest.approx(0.0, abs=1e-25)
    assert max(map(abs, slopes.values())) < 1e-14


def test_the_answer_is_a_mapping_that_says_what_it_is_worth(lshape_result):
    slopes = gradient(lshape_result, "contact_force", "gap")
    assert list(slopes) == ["gap"]
    assert slopes.functional == pytest.approx(lshape_result.contact_force)
    assert slopes.differentiable
    assert slopes.message == ""


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ("friction", "no derivatives with friction"),
        ("young", "one of lame_lambda"),
        ("body_force", "the problem has none"),
        ("initial_plastic_strain", "the problem has none"),
        ("prescribed", "the problem has none"),
        ("traction:left", "one of load is needed"),
    ],
)
def test_parameters_that_are_refused(lshape_result, parameters, text):
    with pytest.raises(ValueError, match=text):
        gradient(lshape_result, "contact_force", parameters)


@pytest.mark.parametrize(
    ("functional", "text"),
    [
        ("force", "one of contact_force"),
        (DisplacementAt((5.0, 5.0), 0), "a point in the body"),
        (Reaction("load", 0), "does not hold component 0"),
        (Reaction("clamped", 2), "component=2"),
    ],
)
def test_functionals_that_are_refused(lshape_result, functional, text):
    with pytest.raises(ValueError, match=text):
        gradient(lshape_result, functional, "gap")


def test_forms_that_are_none(lshape_result):
    with pytest.raises(TypeError, match="integrals are needed"):
        gradient(lshape_result, lambda u, p, stress: u[0], "gap")
    with pytest.raises(TypeError, match="a name, a form or a functional"):
        gradient(lshape_result, 3.0, "gap")


def test_what_is_no_solution_has_no_derivative():
    problem = lshape_problem(lshape.paper_mesh(113))
    stopped = semismooth_newton(problem, options=NewtonOptions(max_iterations=1))
    with pytest.raises(SolverError):
        gradient(stopped, "contact_force", "gap")
    regularised = semismooth_newton(problem, 1e2)
    with pytest.raises(TypeError, match="without gamma"):
        gradient(regularised, "contact_force", "gap")


def test_friction_is_refused():
    material = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=50.0)
    problem = replace(lshape_problem(lshape.paper_mesh(113)), material=material, friction=0.1)
    result = semismooth_newton(lshape_problem(lshape.paper_mesh(113)))
    object.__setattr__(result.discrete, "problem", problem)
    with pytest.raises(ValueError, match="no derivatives with friction"):
        gradient(result, "contact_force", "gap")
