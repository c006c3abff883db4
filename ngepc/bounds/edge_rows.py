"""Sparse matrices whose rows belong to the unknowns of edges and of the inside of triangles.

An edge has at most two triangles, the first and the last one.  So it is known beforehand how long
each row is and where a triangle enters its numbers: nothing has to be sorted, and what both
triangles of an edge enter for one column is added up.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.bounds.element import PAIRS
from ngepc.bounds.vertex_matrix import VertexGraph

KINDS = {3: 1, 12: 3}
"""Unknowns of each edge, by the number of those of a triangle that are not at vertices."""


class EdgeRows:
    """The rows of ``unknowns`` (m, nt) that are not at the vertices of a graph, numbered from zero.

    First stand those of the edges, one or three kinds of them, then those of the triangles.
    """

    def __init__(self, graph: VertexGraph, unknowns: np.ndarray) -> None:
        self.unknowns = unknowns
        self.kinds = KINDS[len(unknowns)]
        self.count = int(unknowns.max()) + 1
        self.of_edges = self.kinds * len(graph.ends)
        self._turned = graph.turned
        place = np.arange(graph.edges.size).reshape(graph.edges.shape)
        latest = np.empty(len(graph.ends), dtype=int)
        latest[graph.edges] = place
        self._last = latest[graph.edges] == place
        m = len(unknowns)
        self.vertices = RowPattern(
            self, self._of_vertices(), (4, 3), graph.vertices, graph.components
        )
        self.others = RowPattern(
            self,
            self._of_others(),
            (2 * m - self.kinds, m),
            unknowns,
            np.zeros(1, np.int32),
        )

    def _of_vertices(self) -> np.ndarray:
        """Places (m, 3, n) of the vertices of triangles in the rows.

        In the row of an edge first stand its ends, then the vertices opposite of it.
        """
        last = self._last
        m = len(self.unknowns)
        places = np.empty((m, 3, last.shape[1]), dtype=np.int32)
        places[3 * self.kinds :] = np.arange(3)[:, None]
        of_edges = places[: 3 * self.kinds].reshape(self.kinds, 3, 3, -1)
        for k, (a, b) in enumerate(PAIRS):
            of_edges[:, k, a] = self._turned[k]
            of_edges[:, k, b] = ~self._turned[k]
            of_edges[:, k, k] = 2 + last[k]
        return places

    def _of_others(self) -> np.ndarray:
        """Places (m, m, n) of the unknowns of triangles in each other's rows.

        In the row of an edge first stand its own unknowns, then those of the first triangle.
        """
        last = self._last
        m = len(self.unknowns)
        own = 3 * self.kinds
        kind, edge = np.divmod(np.arange(own), 3)
        places = np.empty((m, m, last.shape[1]), dtype=np.int32)
        places[:] = np.arange(m)[:, None]
        for row in range(own):
            k = row % 3
            after = (edge - k) % 3
            places[row, :own] = (self.kinds * after + kind)[:, None]
            other = np.append(after > 0, np.ones(m - own, dtype=bool))
            places[row, other] += (m - self.kinds) * last[k]
        return places


class RowPattern:
    """Where triangles enter blocks of numbers in rows, and their columns.

    ``slots`` (m, ., nt) are the places of the blocks of triangles in their rows, ``lengths`` are
    those of the rows of edges and of triangles, in blocks.  The blocks of a triangle with the
    ``numbers`` k (., nt) have the columns k + ``steps``.
    """

    def __init__(
        self,
        rows: EdgeRows,
        slots: np.ndarray,
        lengths: tuple[int, int],
        numbers: np.ndarray,
        steps: np.ndarray,
    ) -> None:
        counts = rows.of_edges, rows.count - rows.of_edges
        starts = np.append(0, np.cumsum(np.repeat(lengths, counts))).astype(np.int32)
        self.places = slots + starts[rows.unknowns[:, None]]
        first = np.zeros(starts[-1], dtype=np.int32)
        first[self.places] = numbers
        self.columns = (first[:, None] + steps).ravel()
        self.width = len(steps)
        self.starts = self.width * starts


class RowSum:
    """A sparse matrix as the sum of blocks that triangles enter."""

    def __init__(self, pattern: RowPattern) -> None:
        self._pattern = pattern
        self._data = np.zeros(len(pattern.columns))

    def add(self, cells: slice, blocks: np.ndarray) -> None:
        """Add the blocks (m, ., width, n) of triangles."""
        width = self._pattern.width
        places = self._pattern.places[:, :, cells].ravel().astype(np.intp)
        places *= width
        for k in range(width):
            np.add.at(self._data[k:], places, blocks[:, :, k].ravel())

    def matrix(self, columns: int) -> csr_matrix:
        """The sum."""
        pattern = self._pattern
        parts = self._data, pattern.columns, pattern.starts
        return csr_matrix(parts, shape=(len(pattern.starts) - 1, columns))
