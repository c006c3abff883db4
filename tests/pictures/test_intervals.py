"""The picture of an interval over the nodes."""

from dataclasses import replace
from itertools import pairwise

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from ngepc import plot_interval, solve_to
from ngepc.pictures.style import Picture, counts_along
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


@pytest.mark.parametrize("counts", [(225, 368), (120, 6400), (1000, 1000)])
def test_numbers_of_nodes_can_be_read(counts):
    figure = Picture(figsize=(4.8, 3.6))
    axes = figure.subplots()
    axes.plot(counts, (1.0, 2.0), "o-")
    counts_along(axes, "nodes")
    FigureCanvasAgg(figure).draw()
    least, most = axes.get_xlim()
    shown = [
        text
        for text in axes.get_xticklabels()
        if least <= text.get_position()[0] <= most
    ]
    numbers = [float(text.get_text().replace(",", "")) for text in shown]
    boxes = [text.get_window_extent() for text in shown]
    assert numbers == [text.get_position()[0] for text in shown]
    assert len(set(numbers)) >= 3 or counts[0] == counts[1]
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
