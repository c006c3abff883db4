"""Which facets of two surfaces face each other: as many pairs as facets, whatever else there is."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc.discretisation.overlap import _candidates, overlap


def square(n, height, up, shift=0.0, size=1.0):
    """A flat square of 2 n n triangles that looks up or down."""
    side = size * np.linspace(0, 1, n + 1)
    X, Y = np.meshgrid(side, side, indexing="ij")
    places = np.column_stack([X.ravel() + shift, Y.ravel(), np.full(X.size, height)])
    low = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    one = np.column_stack([low, low + n + 1, low + n + 2])
    other = np.column_stack([low, low + n + 2, low + 1])
    corners = places[np.concatenate([one, other])]
    centres = corners.mean(axis=1)
    normal = (0.0, 0.0, 1.0 if up else -1.0)
    return SimpleNamespace(
        corners=corners,
        centres=centres,
        radii=np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1),
        normals=np.tile(normal, (len(corners), 1)),
        nodal=np.tile(normal, (len(corners), 3, 1)),
        areas=np.full(len(corners), (size / n) ** 2 / 2),
    )


def both(one, other):
    """Two surfaces as one."""
    names = vars(one)
    return SimpleNamespace(
        **{name: np.concatenate([names[name], vars(other)[name]]) for name in names}
    )


def pairs(one, two):
    """How many pairs there are for each facet of the first surface."""
    return sum(len(i) for i, _ in _candidates(one, two)) / len(one.areas)


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_the_pairs_of_a_facet_do_not_grow_with_the_mesh(gap):
    shift = 0.017
    found = [
        pairs(square(n, gap, False, shift), square(n - 3, 0.0, True)) for n in (20, 44)
    ]
    assert max(found) < 20
    assert found[1] == pytest.approx(found[0], rel=0.2)


@pytest.mark.parametrize("gap", [0.0, 0.4])
def test_the_whole_overlap_is_found(gap):
    shift = 0.017
    one = square(13, gap, False, shift)
    two = square(10, 0.0, True)
    found = overlap(one, two)
    assert found.weights.sum() == pytest.approx(1 - shift, rel=1e-12)
    assert found.gaps == pytest.approx(np.full(len(found.gaps), gap), abs=1e-12)


def test_a_large_facet_is_no_neighbour_of_all_small_ones():
    one = square(30, 0.0, False, 0.017)
    small = square(28, 0.0, True)
    large = square(1, 0.0, True, shift=3.0, size=2.0)
    assert pairs(one, both(small, large)) < pairs(one, small) + 3


def test_surfaces_that_look_away_have_no_pairs():
    assert not len(overlap(square(3, 0.1, True), square(3, 0.0, True)).weights)
