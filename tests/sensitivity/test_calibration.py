"""Calibration from an indentation curve with noise."""

import numpy as np
import pytest
from ngsolve import x

from ngepc import Material, Problem, Schedule, evolve
from ngepc.geometries import block
from ngepc.sensitivity.calibration import Curve, calibrate

TRUTH = {"yield_stress": 2.0, "hardening": 60.0}


def indentation(
    depth: float, length: float = 1.0, stress: float = 1.0
) -> tuple[Problem, Schedule]:
    """A parabola pressed into a block in four steps, and a fifth step back, in some units."""
    constants = {"lame_lambda": 1e3, "lame_mu": 1e3} | TRUTH
    problem = Problem(
        block.structured_mesh(4, 2, size=(2.0 * length, length), simplices=True),
        Material.kinematic(**{name: stress * c for name, c in constants.items()}),
        contact="contact",
        gap=length,
        kinematics="plane strain",
        order=1,
    )
    times = (0.2, 0.5, 0.8, 1.0, 1.1)

    def changes(t: float) -> dict:
        surface = (x / length - 1) ** 2 / 2
        return {"gap": length * (surface - depth * min(t, 2 - t))}

    return problem, Schedule(times, changes)


def forces(depth: float) -> tuple[Problem, Schedule, np.ndarray]:
    problem, schedule = indentation(depth)
    return (
        problem,
        schedule,
        np.array(evolve(problem, schedule).column("contact_force")),
    )


@pytest.fixture(scope="module")
def deep():
    return forces(0.03)


def test_exact_data_give_the_constants_back(deep):
    problem, schedule, force = deep
    found = calibrate(
        problem,
        Curve(schedule, "contact_force", force),
        {"yield_stress": 5.0, "hardening": 200.0},
    )
    assert found.converged
    assert found.evaluations <= 15
    assert found.values == pytest.approx(TRUTH, rel=1e-6)
    assert found.problem.material.hardening == found.values["hardening"]


@pytest.mark.parametrize(("length", "stress"), [(1e-3, 1e6), (1e-6, 1e-9), (1e6, 1e6)])
def test_units_change_nothing(deep, length, stress):
    """Tolerances of SciPy are absolute: forces of 1e-3 were taken to be fitted at the start."""
    _, _, force = deep
    problem, schedule = indentation(0.03, length, stress)
    curve = Curve(schedule, "contact_force", stress * length * force)
    start = {"yield_stress": 5.0 * stress, "hardening": 200.0 * stress}
    found = calibrate(problem, curve, start)
    truth = {name: stress * constant for name, constant in TRUTH.items()}
    assert found.converged
    assert found.values == pytest.approx(truth, rel=1e-6)


def test_noisy_data_and_intervals(deep):
    problem, schedule, force = deep
    noise = 0.01 * force.max()
    measured = force + noise * np.random.default_rng(1).standard_normal(len(force))
    known = Curve(schedule, "contact_force", measured, noise)
    found = calibrate(problem, known, {"yield_stress": 1.0, "hardening": 20.0})
    assert found.converged
    assert found.evaluations <= 15
    assert found.condition < 100
    for name, (low, high) in found.intervals.items():
        assert low < TRUTH[name] < high
        assert high < 1.5 * low
    guessed = calibrate(
        problem, Curve(schedule, "contact_force", measured), found.values
    )
    assert guessed.values == pytest.approx(found.values, rel=1e-5)


def test_elastic_data_do_not_identify_hardening():
    problem, schedule, force = forces(2e-4)
    curve = Curve(schedule, "contact_force", force, 1e-6 * force.max())
    found = calibrate(problem, curve, {"lame_mu": 1.2e3, "hardening": 50.0})
    assert found.values["lame_mu"] == pytest.approx(1e3, rel=1e-6)
    assert np.isinf(found.condition)
    assert found.intervals["hardening"] == (0.0, np.inf)
    assert np.isfinite(found.intervals["lame_mu"]).all()
    assert "do not identify all of lame_mu, hardening" in found.message


def test_as_many_measurements_as_constants_tell_nothing_of_an_unknown_noise():
    problem, schedule = indentation(0.03)
    once = Schedule(schedule.times[-2:-1], schedule.changes)
    force = evolve(problem, once).column("contact_force")
    found = calibrate(
        problem, Curve(once, "contact_force", force), {"yield_stress": 2.5}
    )
    assert found.values["yield_stress"] == pytest.approx(2.0, rel=1e-6)
    assert found.intervals["yield_stress"] == (0.0, np.inf)
    curve = Curve(once, "contact_force", force, 0.01 * force[0])
    low, high = calibrate(problem, curve, {"yield_stress": 2.5}).intervals[
        "yield_stress"
    ]
    assert 1.5 < low < 2.0 < high < 2.5


def test_what_is_refused(deep):
    problem, schedule, force = deep
    with pytest.raises(ValueError, match="one value for each time, 5 in all"):
        Curve(schedule, "contact_force", force[:3])
    with pytest.raises(ValueError, match="noise=0"):
        Curve(schedule, "contact_force", force, 0.0)
    curve = Curve(schedule, "contact_force", force)
    with pytest.raises(ValueError, match="start names 'gap'"):
        calibrate(problem, curve, {"gap": 1.0})
    with pytest.raises(ValueError, match=r"start\['hardening'\]"):
        calibrate(problem, curve, {"hardening": 0.0})
    with pytest.raises(ValueError, match="confidence=1"):
        calibrate(problem, curve, {"hardening": 1.0}, confidence=1)
