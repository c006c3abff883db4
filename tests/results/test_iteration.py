"""One Newton step whose line search is shorter than one, and states that are no numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc import Material, NewtonOptions, Problem, Status, semismooth_newton
from ngepc.geometries import block
from ngepc.local.solver import RepeatedSolver
from ngepc.results import iteration
from ngepc.results.ending import end_of
from ngepc.results.iteration import newton_step
from ngepc.results.outcome import History


class FixedTarget:
    """A target that is the same everywhere, with ``better`` for steps that are refused."""

    def __init__(self, *step, better=None):
        self._step = step
        self._better = better

    def __call__(self, here, tangent, before):
        return self._step

    def closer(self):
        return self._better


def test_contact_forces_go_as_far_as_the_displacements(monkeypatch):
    """phi'(t) = t - 1/2: half of the step, half of the change of the contact forces."""
    monkeypatch.setattr(iteration, "contact_work", lambda *_: (lambda t: 0.0, 0.0))
    monkeypatch.setattr(iteration, "slope_rounding", lambda *_: 1e-14)
    processes = SimpleNamespace(dot=lambda a, b: 0.5)
    here = SimpleNamespace(
        body=SimpleNamespace(load=0.0, contact=SimpleNamespace(processes=processes)),
        contact=np.array([1.0, 3.0]),
        penetration=0.0,
        touching_distance=1.0,
        along=lambda change: (lambda t: t, lambda t, contact: (t, contact)),
    )
    target = FixedTarget(np.ones(2), np.array([2.0, 7.0]))
    (t, contact), length, _ = newton_step(here, None, target, None)
    assert t == length == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(contact, [1.0 + t, 3.0 + 4.0 * t])


def test_a_step_that_does_not_lower_the_energy_is_repeated_with_a_closer_one(
    monkeypatch,
):
    accepted = (SimpleNamespace(), 0.5, 3)
    asked = []

    def searched(here, change, forces):
        asked.append(forces)
        return accepted if forces == "close" else None

    monkeypatch.setattr(iteration, "searched", searched)
    target = FixedTarget(None, "rough", better=FixedTarget(None, "close"))
    assert newton_step(None, None, target, None) == accepted
    assert asked == ["rough", "close"]
    assert newton_step(None, None, FixedTarget(None, "rough"), None) is None


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["residual_norm", "energy"])
def test_no_numbers_end_a_run(name, wrong):
    here = SimpleNamespace(residual_norm=1.0, energy=1.0)
    setattr(here, name, wrong)
    status, message = end_of(here, History([None]), 1e-8, 10)
    assert status is Status.NONFINITE
    assert "NaN or infinite" in message


def test_rounding_inside_an_obstacle_is_no_reason_for_a_full_step():
    """A step from there was taken in full, where it raises the energy: a run was lost."""
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=1.0, plastic_modulus=1.0)
    problem = Problem(
        block.structured_mesh(4, 4, simplices=True),
        soft,
        traction={"right": (20.0, 20.0)},
        contact="contact",
        gap=0.0,
        order=2,
    )
    before = semismooth_newton(problem, options=NewtonOptions(max_iterations=5)).state
    u = before.u.copy()
    u[..., 1] += np.where(before.discrete.free[..., 1], 1e-11 * np.abs(u).max(), 0.0)
    inside = before.discrete.state(u, contact=before.contact)
    assert inside.penetration > inside.touching_distance
    one = RepeatedSolver(NewtonOptions(max_iterations=1)).solve_from(inside)
    assert one.history.records[1].step_length < 0.5
