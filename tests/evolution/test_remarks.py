"""What a history says at its end about strains, contact and data."""

import numpy as np
import pytest
from ngsolve import sin, x

from ngepc import Material, Problem, Schedule, evolve, load_cycle, semismooth_newton
from ngepc.evolution.remarks import strain_and_rotation
from ngepc.geometries import block
from ngepc.results.remarks import few_facets

METAL = Material.metal(
    young=1000.0, poisson=0.3, yield_stress=1.0, tangent_modulus=100.0
)


def pulled(**data):
    return Problem(block.structured_mesh(3, 3), METAL, **data)


def test_nothing_is_said_of_small_strains():
    history = evolve(pulled(body_force=(0.0, -0.5)), Schedule.listed([(1.0, {})]))
    assert history.message == ""
    assert str(history) == repr(history)


def test_strains_are_those_of_the_largest_displacement():
    """They are said although the body is unloaded at the end."""
    problem = pulled(body_force=(0.0, -10.0))
    history = evolve(problem, load_cycle(problem, [1.0, 0.9], steps=1))
    assert "At time 1: Strains reach" in history.message
    assert history.message in str(history)


def test_sizes_are_those_of_a_result():
    result = semismooth_newton(pulled(body_force=(1.0, -1.0)))
    strain, rotation = strain_and_rotation(result.fields)
    assert strain == pytest.approx(result.largest_strain, rel=1e-12)
    assert rotation == pytest.approx(result.largest_rotation, rel=1e-12)


def test_contact_that_never_happens_is_said():
    problem = pulled(body_force=(0.0, 0.1), contact="contact", gap=1.0)
    history = evolve(problem, load_cycle(problem, [0.5, 1.0], steps=1))
    assert not np.any(history.column("contact_force"))
    assert "Nothing touches the obstacle in any step." in history.message


def test_contact_in_one_step_is_enough():
    problem = pulled(body_force=(0.0, 0.1), contact="contact", gap=-0.001)
    steps = [(1.0, {"gap": -0.001}), (2.0, {"gap": 1.0})]
    history = evolve(problem, Schedule.listed(steps))
    assert "Nothing touches" not in history.message


def test_contact_on_few_facets_is_said_of_the_largest_force():
    """As in a result of that step; also where the contact is open at the end."""
    problem = pulled(contact="contact", gap=0.0)
    gaps = [x - 0.51, x - 0.52, 1.0]
    steps = [(float(time), {"gap": gap}) for time, gap in enumerate(gaps, 1)]
    history = evolve(problem, Schedule.listed(steps))
    forces = history.column("contact_force")
    assert forces[1] > forces[0] > forces[2] == 0
    one = history.steps[1].solution
    said = few_facets(one.contact_facets, one.contact_nodes)
    assert said.startswith(f"Too few facets are in contact ({one.contact_facets} whole")
    assert f"At time 2: {said} Strains reach" in history.message
    assert history.message.count("At time") == 1


def test_contact_on_four_facets_is_enough():
    assert few_facets(4, 5) == few_facets(0, 0) == ""


def test_data_known_from_samples_are_said():
    problem = pulled(body_force=(0.0, 0.1 * sin(3 * x)))
    history = evolve(problem, load_cycle(problem, [1.0], steps=1))
    assert "body_force" in history.message


def test_strains_around_the_axis_count():
    """u_r / r of a body of revolution is a strain, too."""
    ring = block.structured_mesh(2, 2, size=(0.01, 0.01))
    problem = Problem(ring, METAL, kinematics="axisymmetric", body_force=(0.0, -1.0))
    result = semismooth_newton(problem)
    strain, _ = strain_and_rotation(result.fields)
    assert strain == pytest.approx(result.largest_strain, rel=1e-12)
