"""A symmetric multigrid V-cycle with Galerkin coarse matrices and vertex by vertex smoothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import BitArray
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.dual.fractional import to_dense
from ngepc.krylov.hierarchy import Level
from ngepc.krylov.matrices import entries
from ngepc.linalg.assembly import from_entries
from ngepc.linalg.operators import SquareOperator


class VCycle(SquareOperator):
    """An approximate inverse of a symmetric positive definite matrix on vector-valued P1.

    Each level smooths by block Gauss-Seidel, forth before and back after the coarse correction;
    a block holds all components at one vertex.  The coarsest level is factorised; without a
    family of meshes that is the only one.

    Parameters
    ----------
    matrices
        The matrix, both triangles, degrees of freedom component by component.  More than one:
        on the next coarser meshes the others take its place, and the last one on the rest.
    family
        The meshes, finest first.  Degrees of freedom that are not free are zero in the result.
    sweeps
        Gauss-Seidel sweeps before and after each coarse correction.
    """

    def __init__(
        self, matrices: Sequence[SparseMatrixd], family: Sequence[Level], sweeps: int
    ) -> None:
        A, *others = matrices
        super().__init__(A)
        self._A, self._sweeps, self._coarse = A, sweeps, None
        self._level, *coarser = family
        if not coarser:
            free = BitArray(self._level.free.tolist())
            self._inverse = A.Inverse(free, inverse="sparsecholesky")
            return
        self._P, self._P_T = self._level.P, self._level.P_T
        self._smoother = A.CreateBlockSmoother(self._level.vertex_blocks)
        coarse = [self._P_T @ (M @ self._P) for M in others or [A]]
        self._coarse = VCycle(coarse, coarser, sweeps)
        self._residual = A.CreateColVector()
        self._right, self._correction = (self._P.CreateRowVector() for _ in range(2))

    def Mult(self, b: BaseVector, x: BaseVector) -> None:
        """One cycle for A x = b from x = 0."""
        if self._coarse is None:
            x.data = self._inverse * b
            return
        x[:] = 0.0
        self._smoother.Smooth(x, b, self._sweeps)
        self._residual.data = b - self._A * x
        self._right.data = self._P_T * self._residual
        self._correction.data = self._coarse * self._right
        x.data += self._P * self._correction
        self._smoother.SmoothBack(x, b, self._sweeps)

    def compliance(self, L: SparseMatrixd) -> np.ndarray:
        """L C L^T, dense, with the additive counterpart C of the cycle (Bramble, Pasciak, Xu).

        C is the sum over the levels of P D^(-1) P^T, D the blocks of the vertices, P the
        prolongation to the finest mesh, and of the inverse on the coarsest level.  It is
        spectrally equivalent to A^(-1) whatever the mesh width.

        Parameters
        ----------
        L
            A matrix with as many columns as A.
        """
        if self._coarse is not None:
            return to_dense(L @ self._block_inverse() @ L.CreateTranspose()) + (
                self._coarse.compliance(L @ self._P)
            )
        result = np.zeros((L.height, L.height))
        e, x = L.CreateColVector(), L.CreateRowVector()
        for column in range(L.height):
            e[:] = 0.0
            e[column] = 1.0
            x.data = self._inverse * (L.T * e)
            e.data = L * x
            result[:, column] = e.FV().NumPy()
        return result

    def _block_inverse(self) -> SparseMatrixd:
        """D^(-1), zero where a degree of freedom is not free."""
        free, n = self._level.free, self._level.prolongation.fine
        i, j, values = entries(self._A)
        inside = (i % n == j % n) & free[i] & free[j]
        i, j, values = i[inside], j[inside], values[inside]
        d = len(free) // n
        D = np.zeros((n, d, d))
        D[i % n, i // n, j // n] = values
        fixed = np.flatnonzero(~free)
        D[fixed % n, fixed // n, fixed // n] = 1.0
        inverse = np.linalg.inv(D)[i % n, i // n, j // n]
        return from_entries(i, j, inverse, len(free), len(free))
