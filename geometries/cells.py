"""Cells of mesh files: their shapes, facets and orientation, and how they are cut into simplices.

Corners are numbered as VTK, gmsh, Abaqus and CalculiX number them.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

SHAPES = {
    "line": (1, 2),
    "triangle": (2, 3),
    "quad": (2, 4),
    "tetra": (3, 4),
    "pyramid": (3, 5),
    "wedge": (3, 6),
    "hexahedron": (3, 8),
}
"""Name of a cell without the number of its nodes -> dimension and corners."""

FACETS = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    (3, 5): ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    (3, 6): ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    (3, 8): (
        (0, 3, 2, 1),
        (4, 5, 6, 7),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
    ),
}
"""(dimension, corners) -> corners of each facet, those of solids outward."""

_TURNED = {
    (2, 3): (0, 2, 1),
    (2, 4): (0, 3, 2, 1),
    (3, 4): (0, 2, 1, 3),
    (3, 5): (0, 3, 2, 1, 4),
    (3, 6): (0, 2, 1, 3, 5, 4),
    (3, 8): (0, 3, 2, 1, 4, 7, 6, 5),
}

_EDGES_AT_FIRST = {4: (1, 2, 3), 5: (1, 3, 4), 6: (1, 2, 3), 8: (1, 3, 4)}
"""Corners of a solid cell -> the ends of three edges at its first corner, right-handed."""


class Group(NamedTuple):
    """Cells of one shape and one name: their dimension, the name and corners, (k, corners)."""

    dimension: int
    name: str
    cells: np.ndarray


def oriented(cells: np.ndarray, points: np.ndarray, N: int) -> np.ndarray:
    """The cells of one shape, each with the order of corners that NGSolve calls positive.

    NGSolve's reference tetrahedron is a mirror image of the one of mesh files.
    """
    k = cells.shape[1]
    x = points[cells]
    if N == 2:
        a = x[:, 1, :2] - x[:, 0, :2]
        b = x[:, -1, :2] - x[:, 0, :2]
        size = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    else:
        edges = [x[:, corner] - x[:, 0] for corner in _EDGES_AT_FIRST[k]]
        size = np.linalg.det(np.stack(edges, axis=1))
    if (N, k) == (3, 4):
        size = -size
    return np.where((size < 0)[:, None], cells[:, _TURNED[N, k]], cells)


def facet_rows(corners: np.ndarray) -> np.ndarray:
    """Sorted corners of facets, shape (k, 4), -1 before those with fewer."""
    rows = np.full((len(corners), 4), -1)
    rows[:, : corners.shape[1]] = corners
    return np.sort(rows, axis=1)


def facets_of(groups: Iterable[Group], N: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all facets of the cells, -1 for none, (k, 4), as often as there are cells at it.

    With their ``facet_rows``.
    """
    corners = [np.zeros((0, 4), dtype=int)]
    for group in groups:
        for facet in FACETS[N, group.cells.shape[1]]:
            some = np.full((len(group.cells), 4), -1)
            some[:, : len(facet)] = group.cells[:, facet]
            corners.append(some)
    found = np.concatenate(corners)
    return found, np.sort(found, axis=1)


def with_simplices(
    groups: list[Group], points: np.ndarray
) -> tuple[list[Group], np.ndarray]:
    """Solid cells and their facets cut into tetrahedra and triangles, and the points with more.

    Quadrilaterals are cut from the corner with the smallest number, so that neighbours agree;
    hexahedra and wedges get a point in their middle (compare Dompierre et al., IMR 1999).
    """
    cut = []
    for group in groups:
        cells = group.cells
        corners = cells.shape[1]
        if group.dimension == 2:
            new = _triangles(cells)
        elif corners == 4:
            new = cells
        elif corners == 5:
            top = np.repeat(cells[:, 4:], 2, axis=0)
            new = np.column_stack([_triangles(cells[:, :4]), top])
        else:
            middles = len(points) + np.arange(len(cells))
            points = np.concatenate([points, points[cells].mean(axis=1)])
            parts = []
            for facet in FACETS[3, corners]:
                sides = _triangles(cells[:, facet])
                each = len(sides) // len(cells)
                parts.append(np.column_stack([sides, np.repeat(middles, each)]))
            new = np.concatenate(parts)
        cut.append(Group(group.dimension, group.name, new))
    return cut, points


def _triangles(facets: np.ndarray) -> np.ndarray:
    """Triangles as they are; two for each quadrilateral, one after the other."""
    if facets.shape[1] == 3:
        return facets
    turn = np.arange(4) + facets.argmin(axis=1)[:, None]
    first, second, third, fourth = np.take_along_axis(facets, turn % 4, axis=1).T
    halves = [[first, second, third], [first, third, fourth]]
    return np.array(halves).transpose(2, 0, 1).reshape(-1, 3)
