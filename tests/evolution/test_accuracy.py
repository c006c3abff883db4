"""Increments by accuracy: the estimate beside the error against many short steps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import stacked
from ngsolve import InnerProduct, Integrate, Trace, x, y

from ngepc import (
    Coulomb,
    Problem,
    Schedule,
    Status,
    evolve,
    load_cycle,
    lshape_problem,
    semismooth_newton,
)
from ngepc.discretisation.points import Points
from ngepc.evolution.increments import Difference
from ngepc.geometries import block, lshape
from ngepc.studies.large import indented_block
from ngepc.studies.solid_problems import NL1_CORNERS, metal

UNIT = 0.25e-4


def sphere():
    """A sphere that is pressed into a block, from the first touch on."""
    problem = indented_block(0, order=1)
    gap = problem.gap
    return problem, Schedule((1.0,), lambda t: {"gap": gap + 0.03 * (1 - t)})


def nafems_nl1():
    """NAFEMS NL1: all strains given, eight corners."""
    mesh = block.structured_mesh(1, 1)
    everywhere = "|".join(sorted(set(mesh.GetBoundaries())))
    corners = UNIT * np.array([(0, 0), *NL1_CORNERS])

    def held(t):
        strain = [np.interp(t, range(9), corners[:, i]) for i in (0, 1)]
        return {"prescribed": {everywhere: (strain[0] * x, strain[1] * y)}}

    steel = metal(250e3, 0.25, 5.0, isotropic=62.5e3)
    problem = Problem(mesh, steel, clamped=None, order=1, **held(0))
    return problem, Schedule(tuple(range(1, 9)), held)


def rubbing():
    """A block that is pressed against the floor and pulled to and fro."""
    mesh = block.structured_mesh(4, 4)
    steel = metal(210e3, 0.3, 300.0, kinematic=2000.0)
    contact = {"contact": "contact", "gap": -2e-3, "friction": Coulomb(0.3)}
    problem = Problem(mesh, steel, "clamped", order=1, **contact)

    def pushed(t):
        pull = 120 * np.interp(t, [0, 1, 2], [0, 1, -1])
        sides = {"right": (0, pull), "left": (0, pull)}
        return {"gap": -3e-3 * min(t, 1), "traction": sides}

    return problem, Schedule((1.0, 2.0), pushed)


PIECES = 4
"""Steps of the reference for each step that is compared with it."""


@pytest.mark.parametrize(
    ("make", "accuracy"), [(sphere, 0.2), (nafems_nl1, 0.05), (rubbing, 0.5)]
)
def test_the_estimate_is_within_a_factor_of_two_everywhere(make, accuracy):
    """At every end of a step with an error above a thousandth, not only at the last one."""
    problem, schedule = make()
    found = evolve(problem, schedule, accuracy=accuracy)
    assert found.status is Status.CONVERGED
    pieces = [
        np.linspace(a, b, PIECES + 1)[1:]
        for a, b in pairwise([schedule.begin, *found.times])
    ]
    times = tuple(np.concatenate(pieces).tolist())
    exact = evolve(problem, Schedule(times, schedule.changes))
    difference = Difference(found.memory.functions.points)
    for step in exact.steps:
        difference.see(step)
    compared = list(zip(found.steps, exact.steps[PIECES - 1 :: PIECES], strict=True))
    errors = np.array([difference(fine, step) for step, fine in compared[1::2]])
    estimates = np.array([step.record.time_error for step in found.steps[1::2]])
    seen = errors > 1e-3
    assert seen[-1]
    ratios = estimates[seen] / errors[seen]
    assert 0.5 < ratios.min() <= ratios.max() < 2


def test_a_step_that_yields_at_its_end_is_divided_there():
    """One step and two from an elastic state are the same if the first one stays elastic."""
    problem, schedule = rubbing()
    found = evolve(problem, schedule, accuracy=0.5)
    dissipation = found.column("dissipation")
    assert found.times[:2] == [0.4375, 0.5]  # it begins to yield after 0.4
    assert dissipation[0] > 0.05 * dissipation[1]
    assert found.steps[1].record.time_error > 1e-4


def test_what_takes_long_is_logged(caplog):
    """The steps that are solved once, and the time error of every second step that is kept."""
    problem, schedule = sphere()
    with caplog.at_level("INFO", "ngepc.evolution.increments"):
        found = evolve(problem, schedule, accuracy=0.5)
    said = [record.getMessage() for record in caplog.records]
    assert said[0].startswith("step to time 1: solved")
    errors = [text for text in said if "time error" in text]
    assert len(errors) == len(found.steps) / 2
    assert errors[-1].endswith(f"{found.time_error:.2g}")


def test_accuracy_is_reached():
    problem, schedule = sphere()
    errors = []
    counts = []
    for accuracy in (0.5, 0.05):
        found = evolve(problem, schedule, accuracy=accuracy)
        assert found.time_error <= accuracy
        errors.append(found.time_error)
        counts.append(len(found.steps))
    assert counts[0] < counts[1] < 100
    assert errors[1] < errors[0]


@pytest.mark.parametrize("between", ["two bodies", "two obstacles"])
def test_forces_that_balance_have_no_time_error_of_rounding(between):
    """The resultant of both sides is zero: one of rounding is no part of the estimate."""
    rigid_walls = Problem(
        block.structured_mesh(2, 2),
        metal(1e3, 0.3, 1e3),
        None,
        prescribed={"left": (0, None)},
        contact="clamped|contact",
        gap=0.0,
    )
    problem, changes = {
        "two bodies": (
            stacked.pressed(material=stacked.ELASTIC),
            lambda t: {"traction": {"top": (0, -t)}},
        ),
        "two obstacles": (rigid_walls, lambda t: {"gap": -1e-3 * t}),
    }[between]
    found = evolve(problem, Schedule((1.0,), changes), accuracy=0.01)
    assert len(found.steps) == 4
    assert found.steps[-1].record.contact_force > 0.1
    assert found.time_error < 1e-10


def test_elastic_steps_are_exact():
    problem = lshape_problem(lshape.paper_mesh(33))
    soft = replace(problem, pressure=None, traction={"load": (0.0, 0.1)})
    found = evolve(soft, load_cycle(soft, [1.0]), accuracy=0.01)
    assert len(found.steps) == 4
    assert found.time_error < 1e-10
    assert "time error about" in repr(found)


def test_what_cannot_be_reached_is_said():
    problem, schedule = sphere()
    found = evolve(problem, schedule, accuracy=1e-4, cuts=2)
    assert found.status is Status.STEP_LIMIT
    assert "accuracy=0.0001 was asked for" in found.message
    assert found.steps[-1].record.time == 1.0


def test_monitor_and_interruption():
    problem, schedule = sphere()
    seen = []

    def stop(step):
        seen.append(step.record.time)
        if len(seen) == 2:
            raise StopIteration

    found = evolve(problem, schedule, accuracy=0.5, monitor=stop)
    assert found.status is Status.STOPPED
    assert seen == [0.25, 0.5]


def test_ctrl_c_in_the_steps_for_the_sizes_ends_the_run():
    """It was lost: the history went on as if that step had failed."""
    problem, schedule = sphere()
    calls = []

    def pressed(record):
        raise KeyboardInterrupt

    def solver(problem, start):
        calls.append(problem)
        monitor = pressed if len(calls) == 1 else None
        return semismooth_newton(problem, start=start, monitor=monitor)

    found = evolve(problem, schedule, solver, accuracy=0.5)
    assert found.status is Status.STOPPED
    assert len(calls) == 1


def test_what_is_refused(tmp_path):
    problem, schedule = sphere()
    with pytest.raises(ValueError, match="Schedule"):
        evolve(problem, [(1.0, {})], accuracy=0.01)
    with pytest.raises(ValueError, match="accuracy"):
        evolve(problem, schedule, accuracy=1.0)
    with pytest.raises(ValueError, match="checkpoint"):
        evolve(problem, schedule, accuracy=0.1, checkpoint=tmp_path / "a.npz")
    with pytest.raises(ValueError, match="error"):
        evolve(problem, schedule, accuracy=0.1, error=0.1)


def test_both_runs_are_those_of_their_times():
    """Halved steps leave no trace, and the estimate is the difference of the two runs."""
    problem, whole = nafems_nl1()

    def over(times):
        return evolve(problem, Schedule(times, whole.changes, begin=whole.begin))

    listed = over((1.0, 2.5, 4.0))
    schedule = Schedule(listed.times, whole.changes, begin=whole.begin)
    found = evolve(problem, schedule, accuracy=0.03)
    lengths = np.diff([0.0, *found.times])
    assert lengths[0] > lengths[6]  # some are halved after others were accepted

    fine = over(tuple(found.times))
    coarse = over(tuple(found.times[1::2]))
    for mine, other in zip(found.steps, fine.steps, strict=True):
        for name in ("elastic_energy", "dissipation", "max_plastic_strain"):
            value = getattr(other.record, name)
            assert getattr(mine.record, name) == pytest.approx(value, rel=1e-12)

    difference = Difference(found.memory.functions.points)
    for step in (*listed.steps, *fine.steps):
        difference.see(step)
    apart = difference(fine.steps[-1], coarse.steps[-1])
    assert found.time_error == pytest.approx(apart, rel=1e-9)


def test_the_difference_is_relative_to_the_largest_so_far():
    """Of (int C e : e)^(1/2), and of the force of contact, each against plain numbers."""
    problem, whole = rubbing()
    first, last = evolve(problem, Schedule((0.5, 1.0), whole.changes)).steps
    points = Points(problem.mesh, problem.kinematics, problem.order)
    mu, lame = problem.material.lame_mu, problem.material.lame_lambda

    def norm(strain):
        energy = 2 * mu * InnerProduct(strain, strain) + lame * Trace(strain) ** 2
        return np.sqrt(Integrate(energy, problem.mesh, order=2))

    strains = [step.fields.elastic_strain for step in (first, last)]
    of_stress = norm(strains[1] - strains[0]) / max(norm(e) for e in strains)
    difference = Difference(points)
    difference.see(first)
    assert difference(last, first) >= of_stress * (1 - 1e-12)

    def pressed(step, force, resultant):
        given = {"contact_force": force, "contact_resultant": resultant}
        return replace(step, record=replace(step.record, **given))

    difference = Difference(points)
    difference.see(pressed(first, 0.0, [0.0, 0.0]))
    alone = difference(*(pressed(step, 0.0, [0.0, 0.0]) for step in (last, first)))
    assert alone == pytest.approx(of_stress, rel=1e-10)

    records = [step.record for step in (first, last)]
    forces = [np.array([r.contact_force, *r.contact_resultant]) for r in records]
    force, *resultant = (-2 * forces[0]).tolist()
    difference = Difference(points)
    difference.see(last)
    apart = difference(pressed(first, force, resultant), first)  # of equal strains
    sizes = [np.linalg.norm(force) for force in forces]
    assert apart == pytest.approx(3 * sizes[0] / max(sizes[1], 2 * sizes[0]), rel=1e-12)
