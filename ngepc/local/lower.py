"""Tangents as blocks on and below the diagonal, in a matrix of NGSolve.

Products wait for memory.  Half of the N x N blocks of a symmetric matrix, with one number of a
column for each block, take a third of the memory of all numbers with a column for each.  The
smoother takes products alone: sweeps of Gauss-Seidel's method go through memory backwards, too,
which takes four times as long.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from ngsolve import BaseMatrix
from scipy.sparse import csr_matrix

from ngepc.discretisation.stiffness import Blocks, Stiffness
from ngepc.linalg.chebyshev import Chebyshev
from ngepc.local.iterative import FullPattern, pinned_blocks, place_among


class LowerStorage:
    """A tangent as blocks on and below the diagonal, see ``Storage``; ``matrix`` is itself."""

    def __init__(self, stiffness: Stiffness) -> None:
        self._stiffness = stiffness
        self._matrix = stiffness.matrix()
        self._blocks = stiffness.entries(self._matrix)
        self._right, self._left = (self._matrix.CreateColVector() for _ in range(2))

    @property
    def matrix(self) -> LowerStorage:
        """See ``Storage``."""
        return self

    def fill(self, data: Any) -> None:
        """See ``Storage``."""
        self._stiffness.values(data, self._blocks)

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """See ``Storage``."""
        return self._applied(self._matrix, x)

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return self.multiply(x)

    def pin(self, nodes: np.ndarray, projections: np.ndarray) -> csr_matrix:
        """See ``Storage``."""
        stiffness = self._stiffness
        number = place_among(nodes, len(stiffness.free))
        rows = number[stiffness.rows]
        columns = number[stiffness.columns]
        pairs = np.flatnonzero((rows >= 0) | (columns >= 0))
        before = self._blocks[pairs]
        after = pinned_blocks(before, projections, rows[pairs], columns[pairs])
        self._blocks[pairs] = after
        return stiffness.symmetric(before - after, pairs)

    def leading(self, count: int) -> Leading:
        """The part of the matrix that belongs to the first nodes."""
        return Leading(self._stiffness, self._blocks, count)

    def level(self, space: csr_matrix, restriction: csr_matrix) -> FinestLevel:
        """The level of the present values, with the interpolation to it."""
        jacobi = self._matrix.CreateSmoother()

        def divide(r: np.ndarray) -> np.ndarray:
            """The inverse of the blocks on the diagonal times r."""
            return self._applied(jacobi, r)

        smooth = Chebyshev(self.multiply, divide, len(self._left.FV().NumPy()))
        return FinestLevel(self, space, restriction, smooth, smooth)

    def _applied(self, operator: BaseMatrix, x: np.ndarray) -> np.ndarray:
        self._right.FV().NumPy()[:] = x
        operator.Mult(self._right, self._left)
        return self._left.FV().NumPy().copy()


class FinestLevel(NamedTuple):
    """A level like ``linalg.cycle.Level``, smoothed by a polynomial."""

    matrix: LowerStorage
    space: csr_matrix
    restriction: csr_matrix
    forwards: Chebyshev
    backwards: Chebyshev


class Leading:
    """Rows and columns of the first nodes as a CSR matrix of both triangles.

    Their blocks are the first ones of the lower triangle.
    """

    def __init__(self, stiffness: Stiffness, blocks: np.ndarray, count: int) -> None:
        part = Blocks()
        first = slice(0, int(np.searchsorted(stiffness.rows, count)))
        part.rows = stiffness.rows[first]
        part.columns = stiffness.columns[first]
        part.free = stiffness.free[:count]
        part.N = stiffness.N
        self._blocks = blocks[first]
        self._pattern = FullPattern(part)
        self._matrix: csr_matrix | None = None

    def matrix(self) -> csr_matrix:
        """The matrix with the present values, always the same object."""
        self._matrix = self._pattern.matrix(self._blocks, self._matrix)
        return self._matrix
