"""How points are shared out among processes."""

import numpy as np
import pytest

from ngepc.model.parts import partition


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_parts_are_alike_and_lie_together(count):
    """As many points each, up to one for each cut; along a line the parts are intervals."""
    points = np.random.default_rng(count).uniform(size=(200, 2)) * [10.0, 1.0]
    part = partition(points, count)
    sizes = np.bincount(part, minlength=count)
    assert len(sizes) == count
    assert np.ptp(sizes) <= count
    if count <= 5:
        order = part[np.argsort(points[:, 0])]
        assert np.count_nonzero(np.diff(order)) == count - 1


def test_the_longest_extent_is_cut():
    points = np.random.default_rng(1).uniform(size=(60, 3)) * [1.0, 1.0, 9.0]
    part = partition(points, 2)
    assert points[part == 0][:, 2].max() <= points[part == 1][:, 2].min()
