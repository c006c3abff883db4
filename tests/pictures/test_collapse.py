"""Pictures of limit loads say what the results say."""

import numpy as np
import pytest

from ngepc import limit_load, plot_bracket, plot_mechanism
from ngepc.studies.limit_problems import cut_problem, punch_problem


@pytest.fixture(scope="module")
def cut():
    return limit_load(cut_problem(), 0.1)


def test_the_moved_outline_follows_the_mechanism(cut):
    """The corner of the cut goes down and out, the held sides stay."""
    axes = plot_mechanism(cut).axes[0]
    moved = np.concatenate([line.get_xydata() for line in axes.lines])
    assert moved[:, 0].min() == pytest.approx(-2)
    assert ((moved[:, 0] > 0.01) & (moved[:, 1] > 0.5) & (moved[:, 1] < 0.99)).any()
    assert f"{cut.lower:.5g}" in axes.get_title()


def test_the_bracket_closes(cut):
    axes = plot_bracket(cut, exact=3.7764).axes[0]
    upper, lower, exact = (line.get_ydata() for line in axes.lines)
    assert (np.diff(upper) <= 0).all()
    assert (np.diff(lower) >= 0).all()
    assert (lower <= exact[0]).all()
    assert (exact[0] <= upper).all()


def test_what_cannot_be_drawn_is_refused():
    solid = limit_load(punch_problem(), 1.0)
    with pytest.raises(ValueError, match="limit has a solid"):
        plot_mechanism(solid)
    with pytest.raises(TypeError, match="limit=3: the result of limit_load"):
        plot_bracket(3)
