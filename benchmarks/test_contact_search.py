"""Processor time and memory of the contact search: two flat surfaces that lie on each other.

    python -m pytest benchmarks/test_contact_search.py -s
    python -m pytest benchmarks/test_contact_search.py -s --large

Each line is a process of its own, so that its peak of memory is that of the search; the second
command adds 100,352 facets on each side.  Nothing is asserted about times: the overlap has the
area of the square that both surfaces cover.
"""

import resource
import time
from multiprocessing import get_context
from types import SimpleNamespace

import numpy as np
import pytest

from ngepc.discretisation.overlap import overlap

SIZES = (40, 80, 112)
LARGEST = 224


def flat(cells, height, up, shift=0.0):
    """A unit square of 2 cells^2 triangles that looks up or down, as a surface of the search."""
    side = np.linspace(0, 1, cells + 1)
    X, Y = np.meshgrid(side, side, indexing="ij")
    Z = np.full(X.size, height)
    places = np.column_stack([X.ravel() + shift, Y.ravel(), Z])

    rows = np.arange(cells)[:, None] * (cells + 1)
    low = (rows + np.arange(cells)).ravel()
    across = low + cells + 2
    right = np.column_stack([low, low + cells + 1, across])
    left = np.column_stack([low, across, low + 1])
    corners = places[np.concatenate([right, left])]

    centres = corners.mean(axis=1)
    distances = np.linalg.norm(corners - centres[:, None], axis=2)
    normal = (0.0, 0.0, 1.0 if up else -1.0)
    return SimpleNamespace(
        corners=corners,
        centres=centres,
        radii=distances.max(axis=1),
        normals=np.tile(normal, (len(corners), 1)),
        nodal=np.tile(normal, (len(corners), 3, 1)),
        areas=np.full(len(corners), 0.5 / cells**2),
    )


def peak():
    """The largest memory of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def search(cells, shift):
    """Area of the overlap, its points, seconds, MB at the end and before."""
    upper = flat(cells, 0.0, False, shift)
    lower = flat(cells, 0.0, True)
    before = peak()
    begin = time.process_time()
    found = overlap(upper, lower)
    seconds = time.process_time() - begin
    return found.weights.sum(), len(found.weights), seconds, peak(), before


@pytest.mark.parametrize("cells", [*SIZES, LARGEST])
def test_two_flat_surfaces(cells, pytestconfig, capsys):
    if cells == LARGEST and not pytestconfig.getoption("--large"):
        pytest.skip("only with --large")
    shift = 0.37 / cells
    with get_context("spawn").Pool(1) as process:
        area, points, seconds, most, before = process.apply(search, (cells, shift))
    assert area == pytest.approx(1 - shift, rel=1e-10)
    with capsys.disabled():
        facets = f"{2 * cells**2:,} facets on each side"
        memory = f"{most:,.0f} MB ({before:,.0f} MB before)"
        print(f"\n{facets}: {points:,} points, {seconds:.1f} s, {memory}")
