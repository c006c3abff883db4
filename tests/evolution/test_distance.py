"""The distance of a history to the steps of the continuous problem."""

import re
from dataclasses import replace

import numpy as np
import pytest
from featured import problem_with

from ngepc import (
    Material,
    Norton,
    Problem,
    Voce,
    confidence,
    error_bound,
    evolve,
    load_cycle,
)
from ngepc.bounds.copies import bisected
from ngepc.bounds.transfer import on_mesh
from ngepc.geometries import block

ELASTIC = {"lame_lambda": 1.5e3, "lame_mu": 1e3, "yield_stress": 5.0}
MATERIALS = {
    "kinematic": Material.kinematic(**ELASTIC, hardening=1e2),
    "isotropic": Material(
        **ELASTIC, hardening=0.0, hardening_modulus=2.0, hardening_stiffness=1.0
    ),
    "rate": Material(**ELASTIC, hardening=1e2, rate=Norton(20.0, 3.0)),
}
CYCLE = [0.7, 1.0, 0.0, -1.0]


def pulled(material, **data):
    """A plate that is pulled at its top."""
    mesh = block.mesh(0.3, (1.0, 0.7))
    load = {"contact": (2.0, -6.0)}
    return Problem(mesh, material, traction=load, order=1, **data)


def run(problem):
    """A cycle of loads."""
    return evolve(problem, load_cycle(problem, CYCLE))


def finer(problem):
    """The problem on cells that are bisected, and which cell each of them lies in."""
    everywhere = np.ones(problem.mesh.ne, dtype=bool)
    mesh, parents = bisected(problem.mesh, everywhere)
    return on_mesh(problem, mesh, parents), parents


def state_of(step):
    """Mean stress, deviator and plastic strain on the cells, and the law."""
    state = step.solution.state
    law = state.discrete.law
    mean, deviator = law.stress(state.at)
    return mean, deviator, law.initial + state.at.plastic_strain, state.discrete


def distance(coarse, fine, inside):
    """The norm of the difference of two steps, as the bound has it."""
    mean, deviator, p, _ = state_of(coarse)
    other_mean, other_deviator, other_p, discrete = state_of(fine)
    law = discrete.law
    k = coarse.problem.material.hardening
    d = deviator[inside] - other_deviator
    density = (mean[inside] - other_mean) ** 2 / law.bulk
    density += (d**2).sum(axis=1) / law.two_mu
    density += k * ((p[inside] - other_p) ** 2).sum(axis=1)
    return np.sqrt(discrete.points.integral(density))


@pytest.mark.parametrize("name", list(MATERIALS))
def test_the_distance_is_bounded_after_each_step(name):
    """Beside the same cycle on a finer mesh, whose own distance is added."""
    problem = pulled(MATERIALS[name])
    refined, inside = finer(problem)
    coarse = run(problem)
    fine = run(refined)
    bound = coarse.distance_bound
    found = [
        distance(a, b, inside) for a, b in zip(coarse.steps, fine.steps, strict=True)
    ]
    assert bound.guaranteed
    assert bound.message == ""
    assert (np.array(found) <= bound.by_step + fine.distance_bound.by_step).all()
    assert found[0] > 0.3 * bound.by_step[0]
    assert bound.value == bound.by_step[-1]
    assert (np.diff(bound.by_step) >= 0).all()
    assert fine.distance_bound.value < bound.value
    printed = re.search(r"at most (\S+) \(guaranteed\)", str(bound)).group(1)
    assert bound.value <= float(printed) < 1.01 * bound.value


@pytest.mark.parametrize("order", [1, 2])
def test_steps_of_order_one_have_a_bound_with_isotropic_hardening(order):
    """With order two the history varies inside elements; the refusal says so."""
    plate = replace(pulled(MATERIALS["isotropic"]), order=order)
    last = run(plate).steps[-1].solution
    if order == 1:
        assert error_bound(last).guaranteed
        return
    with pytest.raises(ValueError, match=r"initial_hardening varies .*order=1"):
        error_bound(last)


def test_with_contact_it_is_an_estimate():
    pushed = pulled(MATERIALS["kinematic"], contact="contact", gap=0.0)
    bound = evolve(pushed, [(1.0, {})]).distance_bound
    assert not bound.guaranteed
    assert "contact" in bound.message
    assert str(bound).endswith(bound.message)
    two = evolve(problem_with("two bodies"), [(1.0, {})]).distance_bound
    assert two.message == "Not proved for unilateral contact."


def test_finer_meshes_have_the_same_material():
    """Their copies of the data are no change between steps; other data are one."""
    plate = pulled(MATERIALS["kinematic"])
    history = evolve(plate, load_cycle(plate, [1.0]), error=0.4)
    assert history.steps[-1].record.nodes > plate.mesh.nv
    assert history.distance_bound.guaranteed
    other = {"material": Material.kinematic(**ELASTIC, hardening=2e2)}
    changed = evolve(plate, [(1.0, {}), (2.0, other)]).distance_bound
    assert "a material that changes between steps" in changed.message


def test_springs_may_not_change():
    held = pulled(MATERIALS["kinematic"], springs={"contact": 10.0})
    bound = evolve(held, [(1.0, {}), (2.0, {})]).distance_bound
    assert bound.guaranteed
    stiffer = {"springs": {"contact": 20.0}}
    bound = evolve(held, [(1.0, {}), (2.0, stiffer)]).distance_bound
    assert "springs that change between steps" in bound.message


@pytest.mark.parametrize("name", ["Voce"])
def test_hardening_that_varies_inside_elements_has_an_estimate(name):
    """Of order two: its means on elements are taken.  The error is a norm of stresses."""
    materials = MATERIALS | {
        "Voce": Material.with_law(
            lame_lambda=1.5e3, lame_mu=1e3, law=Voce(5.0, 2.0, 50.0), hardening=1e2
        )
    }
    problem = replace(pulled(materials[name]), order=2)
    schedule = load_cycle(problem, CYCLE)
    history = evolve(problem, schedule)
    bound = history.distance_bound
    assert not bound.guaranteed
    assert "its means on elements are taken" in bound.message
    assert (np.diff(bound.by_step) > 0).all()
    kept = evolve(problem, schedule, error=0.9).distance_bound
    assert "means" not in kept.message
    assert bound.by_step == pytest.approx(kept.by_step, rel=0.2)
    line = confidence(history)
    assert line.startswith("Estimate, not guaranteed: the stress after the last step")


def test_the_first_step_needs_no_means():
    """Its bound is that of its solution: nothing has hardened before."""
    problem = replace(pulled(MATERIALS["isotropic"]), order=2)
    history = evolve(problem, [(1.0, {})])
    total = error_bound(history.steps[0].solution).total
    bound = history.distance_bound
    assert bound.value == pytest.approx(np.sqrt(2 * total), rel=1e-9)
    assert "means" not in bound.message


def test_the_squares_of_the_steps_add_up():
    """Steps are discretised with data of the ones before, and have the bounds of single results."""
    history = run(pulled(MATERIALS["kinematic"], contact="contact", gap=0.0))
    alone = [error_bound(step.solution).total for step in history.steps]
    squares = 2 * np.cumsum(alone)
    assert history.distance_bound.by_step == pytest.approx(np.sqrt(squares), rel=1e-12)
