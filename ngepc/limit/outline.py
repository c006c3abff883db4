"""Volumes and facets of cells with their rounding errors, and trees from cell to cell.

The coordinates of the vertices are exact: they are what the body is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    minimum_spanning_tree,
)

from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.limit.enclosed import Enclosed, cross, joined_enclosures

NEAR = 1e-9
"""Length of a tree's edge from outside the body; all others are longer."""


class Outline:
    """The geometry of simplices, with rounding enclosed.

    ``areas`` (nc, N + 1, N) are the outer normals of the facets of the cells times their measures,
    ``volumes`` (nc,) the volumes, ``sizes`` (nf,) bounds of the measures of the facets.

    Parameters
    ----------
    cells
        The simplices.
    """

    def __init__(self, cells: Simplices) -> None:
        self.cells = cells
        x = Enclosed(cells.points)[cells.nodes]
        self.areas = _areas(x, cells.N)
        opposite = x[:, 1] - x[:, 0]
        # the volume is that of the edge 01 over the facet opposite to vertex 1
        height = (opposite * -self.areas[:, 1]).sum(axis=1)
        self.volumes = height * Enclosed(1 / cells.N, np.spacing(1 / cells.N))
        owner = cells.owners[:, 0]
        place = (cells.facet_of[owner] == np.arange(len(owner))[:, None]).argmax(axis=1)
        self.first = owner, place
        self.sizes = self.areas[owner, place].length()

    def measures(self) -> Enclosed:
        """The measures of the facets."""
        a = self.areas[self.first]
        return (a * a).sum(axis=1).root()


def _areas(x: Enclosed, N: int) -> Enclosed:
    """Outer normals times measures from the vertices (nc, N + 1, N) of cells."""
    result = []
    for vertices in FACETS[N]:
        first = x[:, vertices[0]]
        side = x[:, vertices[1]] - first
        if N == 2:
            turned = side[:, [1, 0]]
            result.append(turned * np.array([1.0, -1.0]))
        else:
            other = x[:, vertices[2]] - first
            result.append(cross(side, other) * 0.5)
    return joined_enclosures(result)


def connected_parts(cells: Simplices) -> np.ndarray:
    """The number of the connected part of each cell, (nc,)."""
    owners = cells.owners[~cells.outer]
    count = len(cells.nodes)
    ones = np.ones(len(owners))
    graph = coo_matrix((ones, (owners[:, 0], owners[:, 1])), shape=(count, count))
    _, parts = connected_components(graph, directed=False)
    return parts


@dataclass(frozen=True, eq=False)
class Tree:
    """A way from each cell to the outside, through facets that are as large as possible.

    Parameters
    ----------
    order
        The cells, those that are nearer to the outside later.
    facet, above
        The facet through which the way of each cell begins, and the cell behind it, -1 where it
        ends; in a part without an end outside the ways stop in a cell with the facet -1.
    """

    order: np.ndarray
    facet: np.ndarray
    above: np.ndarray

    def sums(self, values: np.ndarray) -> np.ndarray:
        """The sums of values >= 0 over all cells whose ways go through the one of each cell."""
        result = values.tolist()
        above = self.above.tolist()
        for cell in self.order.tolist():
            if above[cell] >= 0:
                result[above[cell]] += result[cell]
        return np.array(result) * (1 + len(result) * 1e-15)


def tree_from(cells: Simplices, roots: np.ndarray) -> Tree:
    """The ways of cells to the outside through these outer facets.

    In a connected part without any they lead to its largest cell.
    """
    count = len(cells.nodes)
    inside = np.flatnonzero(~cells.outer)
    first = cells.owners[inside, 0]
    second = cells.owners[inside, 1]
    largest = cells.measure.max()
    length = largest / cells.measure[inside]
    ends, doors = _ends(cells, roots)
    rows = np.concatenate([first, np.full(len(ends), count)])
    columns = np.concatenate([second, ends])
    weights = np.concatenate([length, np.full(len(ends), NEAR)])
    graph = coo_matrix((weights, (rows, columns)), shape=(count + 1, count + 1))
    least = minimum_spanning_tree(graph.tocsr())
    order, before = breadth_first_order(least, count, directed=False)
    order = order[1:][::-1]
    above = np.full(count, -1)
    above[order] = np.where(before[order] == count, -1, before[order])
    facet = np.full(count, -1)
    facet[ends] = doors
    keys = np.minimum(first, second) * count + np.maximum(first, second)
    sorting = np.argsort(keys)
    own = order[above[order] >= 0]
    wanted = np.minimum(own, above[own]) * count + np.maximum(own, above[own])
    facet[own] = inside[sorting[np.searchsorted(keys[sorting], wanted)]]
    return Tree(order, facet, above)


def _ends(cells: Simplices, roots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells in which ways end, and the outer facets there, -1 for none."""
    ends, places = np.unique(cells.owners[roots, 0], return_index=True)
    doors = roots[places]
    parts = connected_parts(cells)
    for part in np.setdiff1d(parts, parts[ends]):
        largest = np.where(parts == part, cells.volume, 0.0).argmax()
        ends = np.append(ends, largest)
        doors = np.append(doors, -1)
    return ends, doors
