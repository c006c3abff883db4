"""One Newton step whose line search is shorter than one, and states that are no numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc import Status
from ngepc.results import iteration
from ngepc.results.iteration import end_of, newton_step


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
    target = lambda *_: (np.ones(2), np.array([2.0, 7.0]))  # noqa: E731
    (t, contact), length, _ = newton_step(here, None, target, None)
    assert t == length == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(contact, [1.0 + t, 3.0 + 4.0 * t])


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ["residual_norm", "energy"])
def test_no_numbers_end_a_run(name, wrong):
    here = SimpleNamespace(residual_norm=1.0, energy=1.0)
    setattr(here, name, wrong)
    status, message = end_of(here, None, SimpleNamespace(records=[0]), 1e-8, 10)
    assert status is Status.NONFINITE
    assert "NaN or infinite" in message
