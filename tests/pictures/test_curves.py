"""Curves of load histories: any two quantities of a history, and what its steps know of contact."""

from functools import lru_cache

import numpy as np
import pytest

from ngepc import (
    DisplacementAt,
    evolve,
    load_cycle,
    lshape_problem,
    plot_curve,
    semismooth_newton,
)
from ngepc.geometries import lshape
from ngepc.pictures import UnitNames


@lru_cache
def history():
    body = lshape_problem(lshape.paper_mesh(225))
    return evolve(body, load_cycle(body, [1.0], 4))


def tip(fields):
    return fields.displacement(fields.problem.mesh(0.25, 0.5))[1]


def line(figure):
    return np.array(figure.axes[0].lines[0].get_data())


def test_force_over_displacement():
    figure = plot_curve(history(), tip, "applied_force_y", xlabel="displacement")
    x, y = line(figure)
    np.testing.assert_allclose(y, 10 * 0.5 * np.arange(1, 5) / 4, rtol=1e-12)
    np.testing.assert_allclose(x, history().values(tip))
    assert (np.diff(x) > 0).all()
    axes = figure.axes[0]
    assert axes.get_xlabel() == "displacement"
    assert axes.get_ylabel() == "force of the loads, component y"


def test_reactions_balance_the_loads():
    """On every axis: supports, loads and obstacles add up to zero."""
    names = ("reaction_y:clamped", "applied_force_y", "contact_resultant_y")
    total = sum(line(plot_curve(history(), "time", name))[1] for name in names)
    np.testing.assert_allclose(total, 0.0, atol=1e-9)


def test_words_have_units_where_they_are_given():
    units = UnitNames("mm", "MPa")
    axes = plot_curve(history(), y="max_contact_pressure", units=units).axes[0]
    assert axes.get_ylabel() == "largest contact pressure (MPa)"
    assert axes.get_xlabel() == "time"
    both = plot_curve({"a": history(), "b": history()}, [1, 2, 3, 4]).axes[0]
    assert [t.get_text() for t in both.get_legend().get_texts()] == ["a", "b"]


@pytest.mark.parametrize(
    ("x", "message"),
    [
        ("force", "the quantities are time, cuts, iterations, contact_force"),
        ("reaction_z", "the quantities are"),
        ("reaction_x:top", "the reactions of clamped"),
        ([1, 2], "2 numbers: one for each of the 4 steps"),
    ],
)
def test_unknown_quantities_are_named(x, message):
    with pytest.raises(ValueError, match=message):
        plot_curve(history(), x)


@pytest.mark.parametrize(
    ("y", "message"),
    [
        (DisplacementAt((1.0, 0.5), 0), r"y=DisplacementAt.*a function of the fields"),
        (None, "y=None: a sequence of numbers, one for each step, a name"),
    ],
)
def test_what_is_no_quantity_is_refused_by_name(y, message):
    with pytest.raises(TypeError, match=message):
        plot_curve(history(), y=y)


def test_steps_know_their_contact_pressure():
    """The forces of the rows are kept: the integral of the pressure is the contact force."""
    steps = history().steps
    for step in steps:
        solution = step.solution
        assert solution.contact_force == pytest.approx(step.record.contact_force)
        assert solution.residual_norm < 1e-9
        largest = step.contact_pressure.vec.FV().NumPy().max()
        assert largest == pytest.approx(step.record.max_contact_pressure)
    single = semismooth_newton(steps[-1].problem, start=steps[-1].fields.displacement)
    np.testing.assert_allclose(
        steps[-1].contact_pressure.vec.FV().NumPy(),
        single.contact_pressure.vec.FV().NumPy(),
        atol=1e-6 * steps[-1].record.max_contact_pressure,
    )
