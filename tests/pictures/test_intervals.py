"""The picture of an interval over the nodes."""

from dataclasses import replace

import pytest

from ngepc import plot_interval, solve_to
from ngepc.studies.examples import example


@pytest.fixture(scope="module")
def run():
    problem = replace(example("lshape", 225), order=2)
    return solve_to(problem, goal="contact_force", percent=5)


def test_the_picture_has_the_records(run):
    axes = plot_interval(run, limit=2.9).axes[0]
    upper, lower, limit = axes.get_lines()
    assert list(upper.get_xdata()) == [record.nodes for record in run.records]
    assert list(upper.get_ydata()) == [record.upper for record in run.records]
    assert list(lower.get_ydata()) == [record.lower for record in run.records]
    assert set(limit.get_ydata()) == {2.9}
    assert axes.get_ylabel() == "contact force"


def test_other_objects_are_refused(run):
    with pytest.raises(TypeError, match="run"):
        plot_interval(3)
    with pytest.raises(ValueError, match="goal"):
        plot_interval(replace(run, goal=None))
