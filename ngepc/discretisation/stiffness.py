"""The stiffness matrix of the displacements as N x N blocks, one for each pair of nodes.

They stand on one pattern and are filled in place.  A direct solver that orders and eliminates nodes
instead of single components takes a third of the time.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from ngsolve import CF, H1, BaseMatrix, BilinearForm, BitArray, Mesh, dx
from ngsolve.la import SparseMatrixd
from scipy.sparse import bsr_matrix, csr_matrix, tril

from ngepc._deprecated import old_names
from ngepc.discretisation.slanted import SlantedNodes
from ngepc.linalg.direct import both_triangles, lower_triangle


class Blocks:
    """Tangents by N x N blocks on and below the diagonal: ``values``, shape (blocks, N, N)."""

    rows: np.ndarray  # nodes of the blocks, row by row, rows >= columns
    columns: np.ndarray
    free: np.ndarray  # boolean, shape (nodes, N): components that no support holds
    N: int

    def held(self, values: np.ndarray) -> np.ndarray:
        """Make rows and columns of held components those of the identity."""
        held = ~self.free.all(axis=1)
        some = np.flatnonzero(held[self.rows] | held[self.columns])
        i = self.free[self.rows[some]]
        j = self.free[self.columns[some]]
        values[some] = np.where(i[:, :, None] & j[:, None], values[some], 0.0)
        nodes, components = np.nonzero(~self.free)
        values[
            np.flatnonzero(self.rows == self.columns)[nodes], components, components
        ] = 1.0
        return values


class Stiffness(Blocks):
    """The blocks of tangents that elements add up to (``summed``), and matrices for them.

    ``data`` determine a tangent: moduli at the points, or displacements.
    """

    def __init__(self, mesh: Mesh, order: int, free: np.ndarray) -> None:
        self.mesh = mesh
        self.free = free
        self.N = free.shape[1]
        self.order = order
        self._space = H1(mesh, order=order, dim=self.N)
        # in the plane blocks are small: the matrix itself shows the pattern
        plane = mesh.dim == 2
        pattern = pattern_matrix(self._space if plane else H1(mesh, order=order))
        self._pattern = pattern if plane else None
        rows, columns, _ = lower_triangle(pattern)
        self.rows = rows.astype(np.int32)
        self.columns = columns.astype(np.int32)
        self._added = np.zeros(0, dtype=int), 0.0
        self._slanted: SlantedBlocks | None = None

    def with_added(self, added: csr_matrix) -> Stiffness:
        """The same plus a symmetric matrix, u flattened node by node.

        It couples nodes of one element only, and replaces what was added before.
        """
        other = copy(self)
        blocks = added.tobsr((self.N, self.N))
        i = np.repeat(np.arange(len(self.free)), np.diff(blocks.indptr))
        lower = i >= blocks.indices
        other._added = self.places(i[lower], blocks.indices[lower]), blocks.data[lower]
        return other

    def with_slanted(self, slanted: SlantedNodes | None) -> Stiffness:
        """The same with nodes that are held along directions that are no axes."""
        other = copy(self)
        if slanted is not None:
            other._slanted = SlantedBlocks(self, slanted)
        return other

    def places(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Where the blocks of pairs of nodes i >= j are."""
        keys, wanted = (
            r.astype(np.int64) * len(self.free) + c
            for r, c in ((self.rows, self.columns), (i, j))
        )
        return np.searchsorted(keys, wanted)

    def summed(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """The blocks without added and held entries, shape (blocks, N, N), in ``out`` if given."""
        raise NotImplementedError

    def values(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """The blocks, shape (blocks, N, N), in ``out`` if given."""
        return self.completed(self.summed(data, out))

    def completed(self, values: np.ndarray) -> np.ndarray:
        """Sums with added and held entries, in place."""
        places, blocks = self._added
        values[places] += blocks
        values = self.held(values)
        if self._slanted is not None:
            self._slanted.hold(values)
        return values

    def matrix(self, elements: np.ndarray | None = None) -> BaseMatrix:
        """A new matrix of NGSolve, of which the lower half is stored.

        With booleans ``elements`` it has the blocks that these elements touch.
        """
        if self._pattern is None or elements is not None:
            return pattern_matrix(self._space, elements)
        return self._pattern.CreateMatrix()

    def numbers(self, matrix: BaseMatrix) -> np.ndarray:
        """The numbers of the blocks of such a matrix, in ascending order."""
        rows, columns, _ = lower_triangle(matrix)
        return self.places(rows, columns)

    def entries(self, matrix: BaseMatrix) -> np.ndarray:
        """View of the blocks of such a matrix, shape (blocks, N, N)."""
        return matrix.AsVector().FV().NumPy().reshape(-1, self.N, self.N)

    def whole(self, matrix: BaseMatrix) -> SparseMatrixd:
        """Both triangles of such a matrix, number by number, for solvers that need them."""
        return both_triangles(self._lower(self.entries(matrix)))

    def symmetric(
        self, values: np.ndarray, chosen: slice | np.ndarray = slice(None)
    ) -> csr_matrix:
        """The matrix of all or some blocks, number by number, with both triangles."""
        lower = tril(self._lower(values, chosen)).tocsr()
        return (lower + tril(lower, -1).T).tocsr()

    def _lower(
        self, values: np.ndarray, chosen: slice | np.ndarray = slice(None)
    ) -> bsr_matrix:
        """The blocks on and below the diagonal, or some of them, as a matrix."""
        starts = np.searchsorted(self.rows[chosen], np.arange(len(self.free) + 1))
        shape = (self.free.size, self.free.size)
        return bsr_matrix((values, self.columns[chosen], starts), shape=shape)


class SlantedBlocks:
    """Blocks of slanted nodes: P K P' + k (1 - P) with the projectors P onto what is free.

    The stiffness k of what is held is that of the node, so that rounding errors of P matter little.
    """

    def __init__(self, blocks: Blocks, slanted: SlantedNodes) -> None:
        projectors = np.tile(np.eye(blocks.N), (len(blocks.free), 1, 1))
        projectors[slanted.nodes] = slanted.projectors
        is_slanted = np.zeros(len(blocks.free), dtype=bool)
        is_slanted[slanted.nodes] = True
        rows = blocks.rows
        columns = blocks.columns
        self._places = np.flatnonzero(is_slanted[rows] | is_slanted[columns])
        self._left = projectors[rows[self._places]]
        self._right = projectors[columns[self._places]]
        self._own = np.flatnonzero((rows == columns) & is_slanted[rows])
        self._held = np.eye(blocks.N) - projectors[rows[self._own]]

    def hold(self, values: np.ndarray) -> None:
        """Hold the nodes in ``values`` (blocks, N, N), in place."""
        stiffness = np.einsum("kii->k", values[self._own]) / values.shape[1]
        turned = np.matmul(self._left, values[self._places])
        values[self._places] = np.matmul(turned, self._right)
        values[self._own] += stiffness[:, None, None] * self._held


def pattern_matrix(space: H1, elements: np.ndarray | None = None) -> BaseMatrix:
    """A symmetric matrix with the pattern of the space, its lower triangle stored.

    Booleans ``elements`` choose those whose pattern it is.
    """
    u, v = space.TnT()
    form = BilinearForm(space, symmetric=True, symmetric_storage=True)
    chosen = None if elements is None else BitArray(elements.tolist())
    form += CF(0) * u * v * dx(definedonelements=chosen)
    return form.Assemble().mat


__getattr__ = old_names(__name__)
