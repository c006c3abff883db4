"""Pictures of limit loads say what the results say."""

import numpy as np
import pytest

from ngepc import (
    limit_load,
    plot_bracket,
    plot_mechanism,
    plot_residual_stress,
    shakedown_load,
)
from ngepc.checks.sentences import outward
from ngepc.pictures.collapse import moved_corners, shades
from ngepc.studies.limit_problems import cut_problem, punch_problem
from ngepc.studies.shakedown_problems import bree_problem, bree_vertices


@pytest.fixture(scope="module")
def cut():
    return limit_load(cut_problem(), 0.1)


def test_the_moved_outline_follows_the_mechanism(cut):
    """The corner of the cut goes down and out, the held sides stay."""
    axes = plot_mechanism(cut).axes[0]
    moved = np.concatenate([line.get_xydata() for line in axes.lines])
    assert moved[:, 0].min() == pytest.approx(-2)
    assert ((moved[:, 0] > 0.01) & (moved[:, 1] > 0.5) & (moved[:, 1] < 0.99)).any()
    for end in outward(cut.lower, cut.upper, 5):
        assert end in axes.get_title()
    assert axes.get_title().startswith("load factor between")


def test_the_bracket_closes(cut):
    axes = plot_bracket(cut, exact=3.7764).axes[0]
    upper, lower, exact = (line.get_ydata() for line in axes.lines)
    assert (np.diff(upper) <= 0).all()
    assert (np.diff(lower) >= 0).all()
    assert (lower <= exact[0]).all()
    assert (exact[0] <= upper).all()


def test_a_solid_goes_down_under_its_punch():
    """What is drawn moves with the velocity, and is dark where it dissipates."""
    solid = limit_load(punch_problem(), 1.0)
    cells = solid.last.data.cells
    moved = moved_corners(solid) - solid.length * cells.points[cells.nodes]
    top = cells.points[cells.nodes][:, :, 2] > -1e-9
    pressed = top & (cells.points[cells.nodes][:, :, 0] < 0.66)
    assert (moved[pressed][:, 2] < 0).all()
    density, darkest = shades(solid)
    assert 0 < darkest <= density.max()
    image = plot_mechanism(solid).axes[0].images[0].get_array()
    assert np.ptp(image[..., :3].min(axis=2)) > 100


def test_the_residual_stress_of_a_heated_plate():
    """Where it alternates between -1 and 1 at both faces, half of it remains: |dev| is (2/3)^(1/2).

    The residual stress is -Y y / 2 = -y on the plate, over the yield stress of a bar.
    """
    plate = shakedown_load(bree_problem(), bree_vertices(0.0, 2.0))
    axes = plot_residual_stress(plate).axes[0]
    values = axes.collections[0].get_array()
    assert values.max() == pytest.approx(1.0, rel=1e-3)
    assert axes.collections[0].get_clim()[0] == 0
    drawn = np.concatenate([line.get_xydata() for line in axes.lines])
    corners = np.array([v.point for v in plate.problem.mesh.vertices])
    np.testing.assert_allclose(drawn.min(axis=0), corners.min(axis=0))
    np.testing.assert_allclose(drawn.max(axis=0), corners.max(axis=0))
    titles = {
        draw(plate).axes[0].get_title()
        for draw in (plot_mechanism, plot_residual_stress)
    }
    (title,) = titles
    assert title.startswith("shakedown factor between")
    assert plot_bracket(plate).axes[0].get_ylabel() == "shakedown factor"
    with pytest.raises(TypeError, match="limit=3: the result of shakedown_load"):
        plot_residual_stress(3)


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(
        TypeError, match="limit=3: the result of limit_load or shakedown_load"
    ):
        plot_bracket(3)
    with pytest.raises(
        TypeError, match="limit=3: the result of limit_load or shakedown_load"
    ):
        plot_mechanism(3)
