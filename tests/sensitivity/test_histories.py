"""Derivatives backwards and forwards through time steps."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.derivatives import compared
from campaigns.random_data import four_times, functionals, random_problem, sizes

from ngepc import (
    Coulomb,
    Material,
    Problem,
    Schedule,
    cold_start,
    evolve,
    load_cycle,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.sensitivity.contact import LinearContact, biactive_set
from ngepc.sensitivity.gradient import gradient, states_of
from ngepc.sensitivity.tangent import tangent, tangents_at


@pytest.mark.parametrize("seed", [9])
def test_histories_agree_with_central_differences(seed):
    """With Tresca's and with Coulomb's law; the campaign of derivatives has forty."""
    part = slice(seed % 5, None, 12)
    found = [c for c in compared(random_problem(seed), four_times, part) if c.smooth]
    assert len(found) >= 5
    assert max(c.error for c in found) < 1e-8


@pytest.mark.parametrize("seed", [32])
def test_histories_of_laws_with_data_of_their_own(seed):
    """Four steps with sub-elements, and with Hill's ellipsoid and a rate, by two data each.

    The campaign of derivatives takes all data, of more seeds.
    """
    part = slice(5, None, 8)
    found = [c for c in compared(random_problem(seed), four_times, part) if c.smooth]
    assert len(found) >= 5
    assert max(c.error for c in found) < 1e-7


@pytest.fixture(scope="module")
def cycle():
    problem = lshape_problem(lshape.paper_mesh(65))
    return evolve(problem, load_cycle(problem, [1, 0], steps=5)).raise_for_status()


def test_a_load_cycle_of_ten_steps(cycle):
    assert len(cycle.steps) == 10
    names = ["lame_mu", "yield_stress", "hardening", "traction", "gap"]
    states = [give_state() for give_state in states_of(cycle)]
    tangents = tangents_at(states, [{name: 1.0} for name in names], cycle.problem)
    found = dict(zip(names, tangents, strict=True))
    for step in (4, 9):
        slopes = gradient(cycle, "primal_energy", names, step=step)
        assert len(slopes.biactive) == step + 1
        for name in names:
            assert found[name][step].of("primal_energy") == pytest.approx(
                slopes[name], rel=1e-9
            )


def test_states_are_rebuilt_from_what_steps_keep(cycle):
    for step, give_state in list(zip(cycle.steps, states_of(cycle), strict=True))[::3]:
        state = give_state()
        assert state.multipliers.sum() == pytest.approx(
            step.record.contact_force, rel=1e-12
        )
        assert state.residual_norm < 1e-9
        at = state.discrete.points.at(step.fields.plastic_increment)
        assert np.abs(state.at.plastic_strain - at).max() < 1e-12


def test_steps_from_a_file_have_the_same_derivatives(tmp_path):
    """With Coulomb's law, whose tangential forces displacements alone do not tell."""
    problem, file = random_problem(16), tmp_path / "steps.npz"
    runs = [
        evolve(problem, load_cycle(problem, [1, 0.4]), checkpoint=file)
        for _ in range(2)
    ]
    one, two = (gradient(run, "contact_force", list(sizes(problem))) for run in runs)
    assert dict(two) == dict(one)
    assert any(one.values())


METAL = Material.metal(young=2500, poisson=0.25, yield_stress=1.5, tangent_modulus=140)

ABSENT = {
    "gap": {"contact": None, "gap": None, "friction": None},
    "friction": {"friction": None},
    "traction": {"traction": None},
    "traction:right": {"traction": {"left": (0.3, 0.0)}},
}
"""A datum, and the changes in a step that has none of it, or not on this boundary."""


@pytest.mark.parametrize("name", ABSENT)
def test_a_datum_that_one_step_lacks_counts_in_the_others(name):
    """The second of three steps has no contact, no friction or no such load."""
    datum = name.split(":")[0]

    def solved(by):
        """The history with the datum larger by an amount, the traction by a factor."""
        data = {"gap": -1e-3, "friction": 0.3, "traction": 1.0}
        data[datum] += by
        data["traction"] = {"right": (0.1 * data["traction"], data["traction"])}
        problem = Problem(block.structured_mesh(3, 3), METAL, contact="contact", **data)

        def changes(time):
            """A pressure that grows, and what is absent in the second step."""
            pressed = {"pressure": {"left": 0.3 * time}}
            return pressed | (ABSENT[name] if time == 2 else {})

        return evolve(problem, Schedule([1.0, 2.0, 3.0], changes))

    size = 1e-7 if datum == "gap" else 1e-5
    found = gradient(solved(0.0), "contact_force", [name])
    assert found.differentiable
    assert tangent(solved(0.0), name).contact_force == pytest.approx(found[name])
    ends = [solved(by).steps[-1].record.contact_force for by in (size, -size)]
    assert found[name] == pytest.approx((ends[0] - ends[1]) / (2 * size), rel=1e-6)
    with pytest.raises(ValueError, match="parameters='body_force': the problem has"):
        gradient(solved(0.0), "contact_force", ["body_force"])


def test_the_number_of_an_initial_strain_that_a_load_cycle_scales():
    """It is that of the problem, not those of the steps: 2 and 0.5 times as large."""
    steel = Material.metal(
        young=2600.0, poisson=0.3, yield_stress=1.3, plastic_modulus=100.0
    )
    body = Problem(block.structured_mesh(2, 2), steel, contact="contact", gap=0.0)

    def cycle_of(strain, factors=(2, 0.5)):
        heated = body.changed(clamped="clamped", initial_strain=strain)
        return evolve(heated, load_cycle(heated, factors))

    strain, h = 1e-3, 1e-7
    for step in (0, 1):
        ends = [cycle_of(strain + k * h).column("contact_force")[step] for k in (-1, 1)]
        found = gradient(cycle_of(strain), "contact_force", "initial_strain", step=step)
        expected = (ends[1] - ends[0]) / (2 * h)
        assert found["initial_strain"] == pytest.approx(expected, rel=1e-5)
        factors = (2, 0.5)[: step + 1]
        forward = tangent(cycle_of(strain, factors), "initial_strain").contact_force
        assert forward == pytest.approx(expected, rel=1e-5)


def test_the_regularised_method_has_no_derivatives():
    problem = lshape_problem(lshape.paper_mesh(113))
    dual = evolve(problem, [(1.0, {})], cold_start(semismooth_newton, gamma=1e2))
    with pytest.raises(ValueError, match="steps of the exact methods are needed"):
        gradient(dual, "contact_force", "gap")
    mixed = evolve(problem, [(1.0, {}), (2.0, {})])
    mixed.steps[1] = replace(mixed.steps[1], contact=None)
    with pytest.raises(ValueError, match="steps of the exact methods are needed"):
        gradient(mixed, "contact_force", "gap")
    primal = evolve(problem, [(1.0, {})], primal_newton)
    exact = evolve(problem, [(1.0, {})])
    slopes = [gradient(run, "contact_force", "gap")["gap"] for run in (primal, exact)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-7)


def test_one_step_is_a_history_of_one():
    problem = random_problem(6)
    names = list(sizes(problem))
    history = evolve(problem, [(1.0, {})])
    for functional in functionals(problem).values():
        one = tangent(history, "gap").of(functional)
        assert gradient(history, functional, names)["gap"] == pytest.approx(
            one, rel=1e-9
        )


def test_a_body_that_waits_is_biactive():
    problem = lshape_problem(lshape.paper_mesh(113))
    waiting = evolve(problem, [(1.0, {}), (2.0, {}), (3.0, {"gap": 0.11})])
    slopes, yields = (
        gradient(waiting, "contact_force", "gap"),
        states_of(waiting)[0]().at.yields,
    )
    assert not slopes.differentiable
    assert (
        f"Step 2: 0 contact rows and {yields.sum()} points are biactive"
        in slopes.message
    )
    assert slopes.message.startswith("Step 2")
    assert tangent(waiting, "gap").message == slopes.message


def test_which_rows_are_biactive_does_not_depend_on_units():
    """A block that is pressed and pushed aside: some rows stick, some slip, none is between."""

    def biactive(unit):
        metal = Material.kinematic(
            lame_lambda=1e3 * unit,
            lame_mu=1e3 * unit,
            yield_stress=50.0 * unit,
            hardening=100.0 * unit,
        )
        mesh = block.structured_mesh(4, 4, simplices=True)
        pressed = {"contact": "contact", "gap": -5e-3, "friction": Coulomb(0.3)}
        load = {"right": (0.0, 0.0), "left": (1.5 * unit, 0.0)}
        problem = Problem(mesh, metal, "clamped", traction=load, order=1, **pressed)
        state = semismooth_newton(problem).raise_for_status().state
        contact = LinearContact(state)
        return contact.slips, biactive_set(contact)

    slips, one = biactive(1.0)
    others, small = biactive(1e-6)
    assert slips.any()
    np.testing.assert_array_equal(slips, others)
    for mine, other in zip(one, small, strict=True):
        np.testing.assert_array_equal(mine, other)
    assert len(one.kinks) == 0
