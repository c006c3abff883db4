"""Symmetric matrices with three unknowns at each vertex of a triangulation.

They consist of blocks (3, 3): one for each vertex and one for each edge, which are sums over the
triangles.  The pattern is that of the mesh, so that no entry has to be sought.  Of the unknowns
first stand those of the first component, for all vertices, then those of the next ones: sums over
components are then sums of long vectors.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BaseMatrix
from scipy.sparse import csr_matrix

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
        self.components = self.count * np.arange(3, dtype=np.int32)
        first, second = (vertices[list(ends)] for ends in zip(*PAIRS, strict=True))
        self.turned = first > second
        self.ends = np.empty((int(edges.max()) + 1, 2), dtype=np.int32)
        self.ends[edges, 0] = np.minimum(first, second)
        self.ends[edges, 1] = np.maximum(first, second)

    def starts(self) -> np.ndarray:
        """Where the rows of the entries of edges begin, see ``VertexMatrix``."""
        first = np.searchsorted(self.ends[:, 0], np.arange(self.count))
        rows = 3 * len(self.ends) * np.arange(3)[:, None] + 3 * first
        return np.append(rows.ravel(), 9 * len(self.ends)).astype(np.int32)

    def columns(self) -> np.ndarray:
        """The columns of the entries of edges."""
        columns = self.ends[:, 1, None] + self.components
        return np.tile(columns.ravel(), 3)


class VertexMatrix:
    """The sum of blocks (3, 3) of the vertices and edges of a graph.

    The rows of blocks of edges belong to the smaller vertex: first the upper rows of all blocks,
    (ne, 3) numbers, then those in the middle, then the lower ones.
    """

    def __init__(self, graph: VertexGraph) -> None:
        self._graph = graph
        self._own = np.zeros((3, 3, graph.count))
        data = np.zeros(9 * len(graph.ends))
        shape = 2 * (3 * graph.count,)
        self._above = csr_matrix((data, graph.columns(), graph.starts()), shape=shape)
        self._below = self._above.T

    def add(self, cells: slice, corners: np.ndarray) -> None:
        """Add the blocks ``corners`` (3, 3, 6, n) of the pairs ``BLOCKS`` of some triangles."""
        vertices = self._graph.vertices[:, cells].ravel()
        turned = self._graph.turned[:, cells]
        places = 3 * self._graph.edges[:, cells].ravel()
        rows = self._above.data.reshape(3, -1)
        for i, j in np.ndindex(3, 3):
            values = np.where(turned, corners[j, i, 3:], corners[i, j, 3:])
            np.add.at(rows[i, j:], places, values.ravel())
            if i <= j:
                np.add.at(self._own[i, j], vertices, corners[i, j, :3].ravel())

    def blocks(self, vertices: np.ndarray) -> np.ndarray:
        """The blocks of some vertices on the diagonal, (3, 3, .)."""
        upper = self._own[..., vertices]
        return np.where(np.tri(3, dtype=bool)[..., None], upper.swapaxes(0, 1), upper)

    def product(self, x: np.ndarray) -> np.ndarray:
        """The matrix times x (3 nv,)."""
        each = x.reshape(3, -1)
        result = np.empty_like(each)
        for i, row in enumerate(result):
            np.multiply(self._own[0, i], each[0], out=row)
            for j in (1, 2):
                row += self._own[min(i, j), max(i, j)] * each[j]
        result = result.ravel()
        result += self._above @ x
        result += self._below @ x
        return result

    def inverse_blocks(self, free: np.ndarray) -> np.ndarray:
        """Inverses (3, 3, nv) of the blocks of all vertices, zero where not ``free`` (3, nv)."""
        kept = free[:, None] & free
        blocks = np.where(kept, self.blocks(slice(None)), np.eye(3)[:, :, None])
        return np.where(
            kept, np.moveaxis(inverses(np.moveaxis(blocks, 2, 0)), 0, 2), 0.0
        )

    def inverse(self, chosen: np.ndarray) -> PartialInverse:
        """The inverse of the rows and columns of the chosen unknowns, (3, nv) booleans."""
        there = chosen.any(axis=0)
        vertices = np.flatnonzero(there)
        first, second = self._graph.ends.T
        edges = np.flatnonzero(there[first] & there[second])
        above = self._above.data.reshape(3, -1, 3)[:, edges]
        below = above.transpose(2, 0, 1)
        blocks = np.concatenate([self.blocks(vertices), below], axis=2)
        # numbers that put the unknowns of a vertex together, so that blocks are on one side
        number = (np.cumsum(chosen.T) - 1).reshape(-1, 3).T
        i = np.concatenate([vertices, second[edges]])
        j = np.concatenate([vertices, first[edges]])
        rows = np.broadcast_to(number[:, None, i], blocks.shape)
        columns = np.broadcast_to(number[:, j], blocks.shape)
        kept = chosen[:, None, i] & chosen[:, j] & (rows >= columns)
        size = int(chosen.sum())
        matrix = from_entries(rows[kept], columns[kept], blocks[kept], size, size)
        vertex, component = np.nonzero(chosen.T)
        return PartialInverse(matrix, vertex + self._graph.components[component])


class PartialInverse:
    """The inverse of a symmetric matrix of NGSolve, of which the lower triangle is stored.

    Its unknowns have the numbers ``places`` among those of a larger problem.
    """

    def __init__(self, matrix: BaseMatrix, places: np.ndarray) -> None:
        self._places = places
        self._inverse = matrix.Inverse(inverse="sparsecholesky")
        self._right = matrix.CreateColVector()
        self._left = matrix.CreateColVector()

    def solve(self, right: np.ndarray, x: np.ndarray) -> None:
        """Enter the solution for some right side into x."""
        self._right.FV().NumPy()[:] = right[self._places]
        self._left.data = self._inverse * self._right
        x[self._places] = self._left.FV().NumPy()
