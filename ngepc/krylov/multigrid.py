"""A symmetric multigrid V-cycle with Galerkin coarse matrices and vertex by vertex smoothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import BitArray
from ngsolve.la import BaseMatrix, BaseVector, SparseMatrixd

from ngepc.krylov.hierarchy import Prolongation


class VCycle(BaseMatrix):
    """An approximate inverse of a symmetric positive definite matrix on vector-valued P1.

    Each level smooths by block Gauss-Seidel, forth before and back after the coarse correction;
    a block holds all components at one vertex.  The coarsest level is factorised; without a
    family of meshes that is the only one.

    Parameters
    ----------
    A
        The matrix, both triangles, degrees of freedom component by component.
    free
        Its free degrees of freedom, boolean; the others are zero in the result.
    family
        Prolongations, coarsest first.
    sweeps
        Gauss-Seidel sweeps before and after each coarse correction.
    """

    def __init__(
        self, A: SparseMatrixd, free: np.ndarray, family: Sequence[Prolongation], sweeps: int
    ) -> None:
        super().__init__()
        self._A, self._sweeps, self._coarse = A, sweeps, None
        if not family:
            self._inverse = A.Inverse(BitArray(free.tolist()), inverse="sparsecholesky")
            return
        *coarser, last = family
        self._P = last.matrix(free)
        self._P_T = self._P.CreateTranspose()
        self._smoother = A.CreateBlockSmoother(_vertex_blocks(free, last.fine))
        coarse_free = last.coarse_part(free)
        self._coarse = VCycle(self._P_T @ (A @ self._P), coarse_free, coarser, sweeps)
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

    def Height(self) -> int:
        """Number of rows."""
        return self._A.height

    def Width(self) -> int:
        """Number of columns."""
        return self._A.height

    def CreateVector(self, col: bool) -> BaseVector:
        """A vector of the right size."""
        return self._A.CreateColVector()

    def IsComplex(self) -> bool:
        """False."""
        return False


def _vertex_blocks(free: np.ndarray, vertices: int) -> list[list[int]]:
    """The free degrees of freedom at each vertex that has any."""
    components = free.reshape(-1, vertices)
    numbers = np.arange(free.size).reshape(components.shape)
    if components.all():
        return numbers.T.tolist()
    blocks = (n[f].tolist() for n, f in zip(numbers.T, components.T, strict=True))
    return [block for block in blocks if block]
