"""The straight simplices of a mesh and their facets, as arrays.

Facet k of a cell lies opposite its vertex k, its vertices are ``FACETS[N][k]`` of the cell.  The
vertices of a facet stand in ascending order; its normal points out of the cell that is found first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from functools import reduce

import numpy as np
from ngsolve import Mesh

from ngepc.model.elements import (
    determinants,
    element_nodes,
    inverses,
    vertex_coordinates,
)

EDGES = {
    2: ((0, 1),),
    3: ((1, 2), (0, 2), (0, 1)),
    4: ((2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)),
}
"""The ends of the edges of a simplex, by the number of its vertices."""

# local vertices of facet k in N dimensions
FACETS = {2: ((1, 2), (2, 0), (0, 1)), 3: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}


class Simplices:
    """Geometry and neighbours of straight triangles or tetrahedra.

    ``points`` (nv, N) are the vertices, ``nodes`` (nt, N + 1) those of each cell with a positive
    determinant, ``jacobian`` (nt, N, N) has x_i - x_0 as columns, with ``det``, ``inverse`` and
    ``volume``; ``gradients`` (nt, N + 1, N) are those of the hat functions.  Of the facets
    ``facets`` (nf, N) are the vertices, ascending, ``measure`` and ``normal`` (nf, N) the size and
    the unit normal, ``owners`` (nf, 2) the cells, -1 where ``outer``.  ``facet_of`` (nt, N + 1) are
    the facets of each cell, ``sign`` is 1 for the first cell of a facet and -1 for the second,
    ``place`` (nt, N + 1, N) is the position of the cell's vertices of facet k among those of the
    facet, and ``slot`` is N facet + place.
    """

    mesh: Mesh | None = None  # the argument of ``of``

    def __init__(self, points: np.ndarray, nodes: np.ndarray) -> None:
        self.N = points.shape[1]
        self.points = points
        self.nodes = nodes.copy()
        x = self.points.take(self.nodes, axis=0)
        self.jacobian = np.ascontiguousarray((x[:, 1:] - x[:, :1]).transpose(0, 2, 1))
        self.det = determinants(self.jacobian)
        turned = self.det < 0
        self.nodes[turned, 1:] = self.nodes[turned, :0:-1]
        self.jacobian[turned] = self.jacobian[turned, :, ::-1]
        self.det = np.abs(self.det)
        self.inverse = inverses(self.jacobian)
        self.volume = self.det / math.factorial(self.N)
        first = -self.inverse.sum(axis=1, keepdims=True)
        self.gradients = np.concatenate([first, self.inverse], axis=1)
        vertices = self.nodes[:, FACETS[self.N]]
        self.place = np.zeros(vertices.shape, dtype=int)
        for other in range(self.N):
            self.place += vertices > vertices[..., other, None]
        ascending = sorted_rows(vertices.reshape(-1, self.N))
        keys = self.key(ascending)
        self._keys, self._first, numbers = np.unique(
            keys, return_index=True, return_inverse=True
        )
        self.slot = self.N * numbers.reshape(len(vertices), -1, 1) + self.place
        is_first = self._first[numbers] == np.arange(len(keys))
        self.facets = ascending[self._first]
        self.facet_of = numbers.reshape(len(vertices), -1)
        self.sign = np.where(is_first, 1.0, -1.0).reshape(self.facet_of.shape)
        self.owners = np.full((len(self.facets), 2), -1)
        self.owners[numbers, np.where(is_first, 0, 1)] = np.arange(len(keys)) // (
            self.N + 1
        )
        self.outer = self.owners[:, 1] < 0
        owner, k = np.divmod(self._first, self.N + 1)
        out = -self.gradients[owner, k]
        size = np.linalg.norm(out, axis=1)
        self.measure = self.N * self.volume[owner] * size
        self.normal = out / size[:, None]

    @classmethod
    def of(cls, mesh: Mesh) -> Simplices:
        """The simplices of a mesh of straight triangles or tetrahedra."""
        nodes = element_nodes(mesh)[:, : mesh.dim + 1]
        cells = cls(vertex_coordinates(mesh).copy(), nodes)
        cells.mesh = mesh
        return cells

    def key(self, vertices: np.ndarray) -> np.ndarray:
        """A unique integer for each facet, from its ascending vertices."""
        result = vertices[:, 0].astype(np.int64)
        for column in vertices.T[1:]:
            result = result * len(self.points) + column
        return result

    def facets_between(self, vertices: np.ndarray) -> np.ndarray:
        """Numbers of the facets with these vertices, in any order."""
        return np.searchsorted(self._keys, self.key(np.sort(vertices, axis=1)))

    def at_nodes(self, values: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """Sums (nv, N) at the vertices of values (..., N) given for ``vertices`` (...)."""
        return sums_at(vertices, values, len(self.points))

    def sums(self, moments: np.ndarray) -> np.ndarray:
        """Sums over both sides of each facet, (N nf, N), of vectors at ``slot`` (nt, .., N)."""
        return sums_at(self.slot, moments, self.facets.size)

    def means_of_sides(self, moments: np.ndarray) -> np.ndarray:
        """Means over the sides of each facet, (nf, N, N), of moments outward of its first cell.

        ``moments`` (nt, N + 1, N or 1, N) are outward of each cell; one of a facet is that at each
        of its vertices.
        """
        signed = moments * self.sign[:, :, None, None]
        count = np.where(self.outer, 1.0, 2.0)[:, None, None]
        if moments.shape[2] == 1:
            sums = sums_at(self.facet_of, signed, len(self.facets))[:, None]
        else:
            sums = self.sums(signed).reshape(-1, self.N, self.N)
        return np.broadcast_to(sums / count, (len(count), self.N, self.N))

    def around(self, chosen: np.ndarray, rings: int) -> np.ndarray:
        """Numbers of the chosen cells and of ``rings`` (one or more) rings of cells around them."""
        corners = [self.nodes[:, k].copy() for k in range(self.N + 1)]
        there = np.zeros(len(self.points), dtype=bool)
        for _ in range(rings):
            there[self.nodes[chosen]] = True
            chosen = np.flatnonzero(reduce(np.logical_or, [there[v] for v in corners]))
        return chosen


def sums_at(places: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, N) of vectors (..., N) at ``places`` (...)."""
    columns = values.reshape(places.size, -1).T
    flat = places.ravel()
    return np.stack([np.bincount(flat, v, minlength=count) for v in columns], axis=1)


def sorted_rows(numbers: np.ndarray) -> np.ndarray:
    """Numbers (n, N) in ascending order within rows; for N = 2 without calls for each row."""
    if numbers.shape[1] != 2:
        return np.sort(numbers, axis=1)
    first, second = numbers.T
    return np.column_stack([np.minimum(first, second), np.maximum(first, second)])


def stable_order(numbers: np.ndarray) -> np.ndarray:
    """The stable ``argsort`` of nonnegative integers (n,), by sorting numbers that all differ."""
    places = np.arange(len(numbers))
    return np.sort(numbers * len(numbers) + places) % max(len(numbers), 1)


def marked(indicators: np.ndarray, share: float) -> np.ndarray:
    """The fewest cells whose indicators add up to a share of the sum, as booleans (Doerfler)."""
    order = np.argsort(-indicators)
    sums = np.cumsum(np.maximum(indicators[order], 0.0))
    result = np.zeros(len(indicators), dtype=bool)
    result[order[: np.searchsorted(sums, share * sums[-1]) + 1]] = True
    return result


def of_cells(values: np.ndarray, chosen: np.ndarray | slice) -> np.ndarray:
    """Values (cells, ...) on the chosen cells, in the same order in memory.

    ``values[chosen]`` puts those of each cell together, also where those of all cells were.
    """
    if isinstance(chosen, slice) or values.ndim == 1:
        return values[chosen]
    last = values.transpose(*range(1, values.ndim), 0)
    if not last.flags.c_contiguous:
        return values[chosen]
    numbers = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
    return last.take(numbers, axis=-1).transpose(-1, *range(values.ndim - 1))


def sliced(whole: object, chosen: np.ndarray | slice, names: Sequence[str]) -> object:
    """A copy whose attributes ``names`` are restricted to the chosen cells."""
    part = copy(whole)
    found = {name: of_cells(getattr(whole, name), chosen) for name in names}
    vars(part).update(found)
    return part


def by_cells(count: int, *shape: int) -> np.ndarray:
    """A new array (cells, ...) in which the values of all cells stand together in memory.

    Sums of few products for each cell are then sums of long vectors.
    """
    return np.moveaxis(np.empty((*shape, count)), -1, 0)


def stored_by_cells(values: np.ndarray) -> np.ndarray:
    """The same values (cells, ...) in this order."""
    result = by_cells(*values.shape)
    result[:] = values
    return result
