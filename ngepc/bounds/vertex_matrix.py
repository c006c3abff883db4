"""Symmetric matrices with three unknowns at each vertex of a triangulation.

They consist of blocks (3, 3): one for each vertex and one for each edge, which are sums over the
triangles.  The pattern is that of the mesh, so that no entry has to be sought.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BaseMatrix
from scipy.sparse import bsr_matrix

from ngepc.bounds.element import PAIRS
from ngepc.linalg.direct import from_entries
from ngepc.model.elements import inverses

BLOCKS = np.array([(0, 0), (1, 1), (2, 2), *PAIRS]).T
"""The pairs of vertices of a triangle: each with itself, then those of the edges."""


class VertexGraph:
    """Vertices and edges of triangles with ``vertices`` (3, nt) and ``edges`` (3, nt).

    Edges are numbered in the order of their ``ends`` (ne, 2), the smaller vertex first.
    """

    def __init__(self, vertices: np.ndarray, edges: np.ndarray) -> None:
        self.vertices = vertices
        self.edges = edges
        self.count = int(vertices.max()) + 1
        first, second = (vertices[list(ends)] for ends in zip(*PAIRS, strict=True))
        self.turned = first > second
        self.ends = np.empty((int(edges.max()) + 1, 2), dtype=np.int32)
        self.ends[edges, 0] = np.minimum(first, second)
        self.ends[edges, 1] = np.maximum(first, second)


class VertexSums:
    """Collects the blocks of triangles, some triangles after the others, and adds them up.

    One array for each entry of a block: large ones would be new memory on each mesh.
    """

    def __init__(self, graph: VertexGraph) -> None:
        self._graph = graph
        shape = graph.vertices.shape
        self._own = [[np.empty(shape) for _ in range(i + 1)] for i in range(3)]
        self._between = [[np.empty(shape) for _ in range(3)] for _ in range(3)]

    def enter(self, cells: slice, corners: np.ndarray) -> None:
        """Take the blocks ``corners`` (3, 3, 6, n) of the pairs ``BLOCKS`` of some triangles."""
        own = corners[:, :, :3]
        between = corners[:, :, 3:]
        turned = self._graph.turned[:, cells]
        for i, j in np.ndindex(3, 3):
            values = np.where(turned, between[j, i], between[i, j])
            self._between[i][j][:, cells] = values
            if j <= i:
                self._own[i][j][:, cells] = own[i, j]

    def matrix(self) -> VertexMatrix:
        """The sums."""
        graph = self._graph
        at = graph.vertices.ravel()
        diagonal = np.empty((graph.count, 3, 3))
        for i, row in enumerate(self._own):
            for j, values in enumerate(row):
                sums = np.bincount(at, values.ravel(), graph.count)
                diagonal[:, i, j] = diagonal[:, j, i] = sums
        at = graph.edges.ravel()
        edges = np.empty((len(graph.ends), 3, 3))
        for i, row in enumerate(self._between):
            for j, values in enumerate(row):
                edges[:, i, j] = np.bincount(at, values.ravel(), len(edges))
        return VertexMatrix(diagonal, edges, graph.ends)


class VertexMatrix:
    """The matrix with the blocks ``diagonal`` (nv, 3, 3) and ``edges`` (ne, 3, 3).

    Rows of the latter belong to the first of the ``ends`` (ne, 2) of each edge.
    """

    def __init__(
        self, diagonal: np.ndarray, edges: np.ndarray, ends: np.ndarray
    ) -> None:
        self._diagonal = diagonal
        self._edges = edges
        self._ends = ends
        starts = np.searchsorted(ends[:, 0], np.arange(len(diagonal) + 1))
        size = diagonal[..., 0].size
        above = bsr_matrix((edges, ends[:, 1], starts), shape=(size, size))
        self._above = above.tocsr()
        self._below = self._above.T

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix times x (3 nv,)."""
        own = np.einsum("nij,nj->ni", self._diagonal, x.reshape(-1, 3))
        return own.ravel() + self._above @ x + self._below @ x

    def inverse_blocks(self, vertices: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Inverses (., 3, 3) of the blocks of some vertices, zero where not ``free`` (., 3)."""
        kept = free[:, :, None] & free[:, None]
        blocks = np.where(kept, self._diagonal[vertices], 0.0)
        held, component = np.nonzero(~free)
        blocks[held, component, component] = 1.0
        return np.where(kept, inverses(blocks), 0.0)

    def inverse(self, chosen: np.ndarray) -> PartialInverse:
        """The inverse of the rows and columns of the chosen unknowns, (3 nv,) booleans."""
        there = chosen.reshape(-1, 3).any(axis=1)
        vertices = np.flatnonzero(there)
        edges = np.flatnonzero(there[self._ends].all(axis=1))
        first, second = self._ends[edges].T
        blocks = np.concatenate(
            [self._diagonal[vertices], self._edges[edges].swapaxes(1, 2)]
        )
        rows = np.concatenate([vertices, second])[:, None, None]
        columns = np.concatenate([vertices, first])[:, None, None]
        i = 3 * rows + np.arange(3)[:, None]
        j = 3 * columns + np.arange(3)
        kept = chosen[i] & chosen[j] & (i >= j)
        number = np.cumsum(chosen) - 1
        size = int(chosen.sum())
        places = (number[np.broadcast_to(k, kept.shape)[kept]] for k in (i, j))
        matrix = from_entries(*places, blocks[kept], size, size)
        return PartialInverse(matrix, np.flatnonzero(chosen))


class PartialInverse:
    """The inverse of a symmetric matrix of NGSolve, of which the lower triangle is stored.

    Its unknowns have the numbers ``places`` among those of a larger problem.
    """

    def __init__(self, matrix: BaseMatrix, places: np.ndarray) -> None:
        self._places = places
        self._inverse = matrix.Inverse(inverse="sparsecholesky")
        self._right = matrix.CreateColVector()
        self._left = matrix.CreateColVector()

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The solution for some right side, zero for all other unknowns."""
        self._right.FV().NumPy()[:] = right[self._places]
        self._left.data = self._inverse * self._right
        result = np.zeros_like(right)
        result[self._places] = self._left.FV().NumPy()
        return result
