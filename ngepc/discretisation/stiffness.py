"""The stiffness matrix of the displacements, filled in place and factorised again and again.

Its entries are N x N blocks, one for each pair of nodes: the direct solver orders and eliminates
nodes instead of single components, which takes a third of the time.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import H1, BaseMatrix, BilinearForm, dx
from ngsolve.la import SparseMatrixd

from ngepc.discretisation.points import CHUNK, Elements, Moduli, Points


class Stiffness:
    """The matrix B' C B on one sparsity pattern, with rows of held components as the identity.

    Parameters
    ----------
    points
        The points with their strain rows.
    free
        Boolean, shape (nodes, N): components that no support holds.
    springs
        Numbers added to the diagonal at free components, shape (nodes, N); None for none.

    Attributes
    ----------
    matrix
        The lower triangle as an NGSolve matrix of N x N blocks.
    """

    def __init__(self, points: Points, free: np.ndarray, springs: np.ndarray | None = None) -> None:
        self.points, self.N = points, points.kinematics.N
        self.matrix = pattern_matrix(H1(points.mesh, order=points.order, dim=self.N))
        rows, columns = lower_pattern(self.matrix)
        self._keys = rows * np.int64(points.scalar.ndof) + columns
        entries = self.entries
        if entries.shape[0] != len(rows):
            raise RuntimeError("the block matrix has another pattern than the scalar one")
        self._held = ~(free[rows][:, :, None] & free[columns][:, None, :])
        identity = np.zeros_like(entries, dtype=bool)
        diagonal = rows == columns
        identity[diagonal] = (~free[rows[diagonal]])[:, :, None] & np.eye(self.N, dtype=bool)
        self._added = np.where(identity, 1.0, 0.0)
        if springs is not None:
            axes = np.arange(self.N)
            own = np.where(free, springs, 0.0)[rows[diagonal]]
            self._added[np.flatnonzero(diagonal)[:, None], axes, axes] += own
        self._places = [self._places_of(block) for block in points.blocks]

    def another(self) -> Stiffness:
        """One more matrix on the same pattern."""
        other = copy(self)
        other.matrix = self.matrix.CreateMatrix()
        return other

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, shape (entries, N, N)."""
        return self.matrix.AsVector().FV().NumPy().reshape(-1, self.N, self.N)

    def whole(self) -> SparseMatrixd:
        """A matrix with both triangles, number by number, for solvers that need it."""
        N, (rows, columns) = self.N, np.divmod(self._keys, self.points.scalar.ndof)
        i, j = np.indices((N, N))
        r = (N * rows[:, None, None] + i).ravel()
        c = (N * columns[:, None, None] + j).ravel()
        values, upper = self.entries.ravel(), np.repeat(rows != columns, N * N)
        r, c = np.concatenate([r, c[upper]]), np.concatenate([c, r[upper]])
        size, values = N * self.points.scalar.ndof, np.concatenate([values, values[upper]])
        return SparseMatrixd.CreateFromCOO(r, c, values, size, size)

    def _places_of(self, block: Elements) -> tuple[np.ndarray, ...]:
        """Local pairs a >= b, the entry of each in each element, and where to transpose."""
        a, b = np.tril_indices(block.nodes.shape[1])
        i, j = block.nodes[:, a], block.nodes[:, b]
        keys = np.maximum(i, j) * np.int64(self.points.scalar.ndof) + np.minimum(i, j)
        return a, b, np.searchsorted(self._keys, keys), i < j

    def diagonal_places(self, nodes: np.ndarray) -> np.ndarray:
        """Where in ``entries`` the diagonal blocks of these nodes are."""
        return np.searchsorted(self._keys, nodes * np.int64(self.points.scalar.ndof + 1))

    def fill(self, moduli: Moduli) -> None:
        """Assemble the entries for these moduli at the points."""
        entries = np.zeros((self.N**2, len(self._keys)))
        for block, (a, b, places, turned) in zip(self.points.blocks, self._places, strict=True):
            count, k = block.nodes.shape
            for first in range(0, count, CHUNK):
                part = slice(first, first + CHUNK)
                K = self.points.element_stiffness(block, part, moduli)
                K = K.reshape(-1, k, self.N, k, self.N)[:, a, :, b, :].swapaxes(0, 1)
                swap = turned[part]
                K[swap] = K[swap].swapaxes(1, 2)
                where = places[part].ravel()
                for c, values in enumerate(K.reshape(-1, self.N**2).T):
                    entries[c] += np.bincount(where, values, minlength=len(self._keys))
        values = entries.T.reshape(-1, self.N, self.N)
        values[self._held] = 0.0
        self.entries[:] = values + self._added


def lower_pattern(matrix: BaseMatrix) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the entries on and below the diagonal, row by row."""
    _, columns, starts = (np.asarray(a) for a in matrix.CSR())
    rows = np.repeat(np.arange(len(starts) - 1, dtype=np.int64), np.diff(starts.astype(np.int64)))
    return rows, columns.astype(np.int64)


def pattern_matrix(space: H1) -> BaseMatrix:
    """A symmetric matrix with the pattern of the space."""
    u, v = space.TnT()
    form = BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += u * v * dx
    return form.Assemble().mat
