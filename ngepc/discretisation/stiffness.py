"""The stiffness matrix of the displacements for NGSolve's direct solvers, filled in place.

Its entries are N x N blocks, one for each pair of nodes: the direct solver orders and eliminates
nodes instead of single components, which takes a third of the time.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import H1
from ngsolve.la import SparseMatrixd
from scipy.sparse import csr_matrix

from ngepc.discretisation.blocks import StiffnessBlocks, pattern_matrix
from ngepc.discretisation.points import Moduli, Points
from ngepc.linalg.assembly import from_entries


class Stiffness:
    """The matrix B' C B on one sparsity pattern, with rows of held components as the identity.

    Parameters
    ----------
    points, free, added
        As for ``StiffnessBlocks``.

    Attributes
    ----------
    matrix
        The lower triangle as an NGSolve matrix of N x N blocks.
    """

    def __init__(self, points: Points, free: np.ndarray, added: csr_matrix | None = None) -> None:
        self._blocks = StiffnessBlocks(points, free, added)
        self.matrix = pattern_matrix(H1(points.mesh, order=points.order, dim=points.kinematics.N))
        if self.entries.shape[0] != len(self._blocks.rows):
            raise RuntimeError("the block matrix has another pattern than the scalar one")

    def another(self, blocks: StiffnessBlocks | None = None) -> Stiffness:
        """One more matrix on the same pattern, assembled by other blocks if there are some."""
        other = copy(self)
        other.matrix, other._blocks = self.matrix.CreateMatrix(), blocks or self._blocks
        return other

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, shape (entries, N, N)."""
        N = self._blocks.N
        return self.matrix.AsVector().FV().NumPy().reshape(-1, N, N)

    def whole(self) -> SparseMatrixd:
        """A matrix with both triangles, number by number, for solvers that need it."""
        N, rows, columns = self._blocks.N, self._blocks.rows, self._blocks.columns
        i, j = np.indices((N, N))
        r = (N * rows[:, None, None] + i).ravel()
        c = (N * columns[:, None, None] + j).ravel()
        values, upper = self.entries.ravel(), np.repeat(rows != columns, N * N)
        r, c = np.concatenate([r, c[upper]]), np.concatenate([c, r[upper]])
        size, values = N * len(self._blocks.free), np.concatenate([values, values[upper]])
        return from_entries(r, c, values, size, size)

    def diagonal_places(self, nodes: np.ndarray) -> np.ndarray:
        """Where in ``entries`` the diagonal blocks of these nodes are."""
        return np.flatnonzero(self._blocks.rows == self._blocks.columns)[nodes]

    def fill(self, moduli: Moduli) -> None:
        """Assemble the entries for these moduli at the points."""
        self.entries[:] = self._blocks.values(moduli)
