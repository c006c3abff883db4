"""Morton's curve."""

import numpy as np
import pytest

from ngepc.linalg.morton import along_curve


def grid(size, dimension):
    """The cells of a square or cube by whole numbers, in some order."""
    axes = np.meshgrid(*dimension * [np.arange(size)], indexing="ij")
    cells = np.column_stack([axis.ravel() for axis in axes])
    return np.random.default_rng(3).permutation(cells)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("side", [2, 4])
def test_consecutive_cells_of_a_grid_fill_cubes(dimension, side):
    cells = grid(8, dimension)
    ordered = cells[along_curve(cells)].reshape(-1, side**dimension, dimension)
    low = ordered.min(axis=1)
    assert (np.ptp(ordered, axis=1) == side - 1).all()
    assert (low % side == 0).all()
    assert len(np.unique(low, axis=0)) == len(low)


def test_the_order_follows_the_points_wherever_they_are():
    points = np.random.default_rng(4).random((200, 3))
    order = along_curve(points)
    assert sorted(order) == list(range(200))
    assert (along_curve(1e-3 * points + [5.0, -2.0, 1e3]) == order).all()


def test_points_at_one_place_keep_their_order():
    assert along_curve(np.ones((5, 3))).tolist() == [0, 1, 2, 3, 4]
