"""The tangent B' C B: the matrices of elements, and their sums by blocks of nodes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.discretisation.element_strains import Elements
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.stiffness import Stiffness
from ngepc.linalg.cores import in_order
from ngepc.linalg.morton import along_curve
from ngepc.model.elements import vertex_coordinates


class ElementPart(NamedTuple):
    """Some ``count`` elements of one shape, whose matrices are in memory at the same time."""

    block: Elements
    chosen: slice | np.ndarray
    count: int

    @property
    def elements(self) -> Elements:
        """The elements, views of the block or copies."""
        return self.block.of(self.chosen)


def parts_for_matrices(points: Points) -> Iterator[ElementPart]:
    """Parts of the elements, in space such that the elements of a part are near each other.

    Then few blocks belong to several parts.  Refined meshes have the children of an element far
    from each other.
    """
    for block in points.blocks:
        chunks = block.matrix_chunks
        order = None
        if points.mesh.dim == 3 and len(chunks) > 1:
            corners = vertex_coordinates(points.mesh)[block.nodes[:, :4]]
            order = along_curve(corners.mean(axis=1))
        for chunk in chunks:
            chosen = chunk if order is None else np.sort(order[chunk])
            yield ElementPart(block, chosen, len(block.nodes[chunk]))


class Gather(NamedTuple):
    """Which blocks some elements touch, and how they are summed from pairs of nodes.

    Rows of the ``matrix`` are those of the blocks ``touched``, its columns the rows with N numbers
    that matrices (elements, k N, k N) consist of.
    """

    touched: np.ndarray
    matrix: csr_matrix

    def summed(self, matrices: Iterator[np.ndarray], N: int) -> np.ndarray:
        """The sums over the elements of ``Elements.stiffness``, shape (blocks, N, N)."""

        def sums(K: np.ndarray) -> np.ndarray:
            """The sums of blocks of such matrices, flat."""
            return (self.matrix @ K.reshape(-1, N)).reshape(-1, N * N)

        blocks, turned = map(sums, matrices)
        blocks += turned @ transpose_and_trace(N)
        return blocks.reshape(-1, N, N)


def transpose_and_trace(N: int) -> np.ndarray:
    """The map of a matrix G to G' + tr G I, both flat, from the right, shape (N^2, N^2)."""
    unit = np.eye(N)
    transpose = np.einsum("ad,bc->cdab", unit, unit)
    trace = np.einsum("cd,ab->cdab", unit, unit)
    return (transpose + trace).reshape(N * N, -1)


class ElementStiffness(Stiffness):
    """B' C B, summed element by element, for moduli at the points."""

    def __init__(self, points: Points, free: np.ndarray) -> None:
        super().__init__(points.mesh, points.order, free)
        self._parts = list(parts_for_matrices(points))
        most = max(part.count * part.block.nodes.shape[1] ** 2 for part in self._parts)
        self._ones = np.ones(self.N * most)
        self._gathers = list(in_order(self._gather, self._parts))
        self._rows_first = list(self._first_touched())

    def _gather(self, part: ElementPart) -> Gather:
        """How the blocks of some elements are summed.

        The block of nodes i >= j takes the pair (a, b) of an element with its nodes in this order.
        """
        nodes = part.block.nodes[part.chosen]
        count, k = nodes.shape
        N = self.N
        a, b = np.tril_indices(k)
        i = nodes[:, a]
        j = nodes[:, b]
        first_row = np.where(i >= j, N * k * a + b, N * k * b + a)
        first_row = first_row + N * k**2 * np.arange(count)[:, None]
        places = self.places(np.maximum(i, j), np.minimum(i, j)).ravel()
        order = np.argsort(places, kind="stable")
        places = places[order]
        first = np.flatnonzero(np.diff(places, prepend=-1))
        starts = np.append(first, len(order)).astype(np.int32)
        matrix = self._by_rows(starts, first_row.ravel()[order], nodes.shape)
        return Gather(places[first], matrix)

    def _first_touched(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Rows of blocks of each part that no earlier part has touched, and the others.

        The first ones are written without being read.
        """
        seen = np.zeros(len(self.rows), dtype=bool)
        for gather in self._gathers:
            there = seen[gather.touched]
            yield np.flatnonzero(~there), np.flatnonzero(there)
            seen[gather.touched] = True

    def _by_rows(
        self, starts: np.ndarray, first: np.ndarray, shape: tuple[int, int]
    ) -> csr_matrix:
        """``Gather.matrix`` of (elements, k); ``first``: the columns of first rows of blocks."""
        N = self.N
        count, k = shape
        sizes = np.diff(starts)
        numbers = np.arange(len(first)) - np.repeat(starts[:-1], sizes)
        # the N rows of a block stand behind each other, with equally many entries
        places = np.repeat(N * starts[:-1], sizes) + numbers
        columns = np.empty(N * len(first), dtype=np.int32)
        for c in range(N):
            columns[places + c * np.repeat(sizes, sizes)] = first + c * k
        ends = np.append(0, np.cumsum(np.repeat(sizes, N))).astype(np.int32)
        shape = (N * len(sizes), N * count * k**2)
        return csr_matrix((self._ones[: len(columns)], columns, ends), shape=shape)

    def summed(self, data: Moduli, out: np.ndarray | None = None) -> np.ndarray:
        """See ``Stiffness``."""
        if out is None:
            out = np.empty((len(self.rows), self.N, self.N))
        items = as_items(out)

        def enter(number: int) -> tuple[np.ndarray, np.ndarray]:
            """Write what is fresh of the blocks of a part; where the others are, and these."""
            gather = self._gathers[number]
            fresh, others = self._rows_first[number]
            blocks = gather.summed(self._parts[number].elements.stiffness(data), self.N)
            items[gather.touched[fresh]] = as_items(blocks)[fresh]
            return gather.touched[others], blocks[others]

        for seen, blocks in in_order(enter, range(len(self._parts))):
            out[seen] += blocks
        return out


def as_items(blocks: np.ndarray) -> np.ndarray:
    """A view of blocks (k, N, N) as k items without numbers inside: NumPy moves them faster.

    It does not keep Python's lock for them either.
    """
    size = blocks[0].nbytes if len(blocks) else 1
    return blocks.reshape(-1).view(np.dtype((np.void, size)))
