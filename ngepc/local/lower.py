"""Tangents as blocks on and below the diagonal, in a matrix of NGSolve.

Products wait for memory.  Half of the N x N blocks of a symmetric matrix, with one number of a
column for each block, take a third of the memory of all numbers with a column for each.  The
smoother takes products alone: sweeps of Gauss-Seidel's method go through memory backwards, too,
which takes four times as long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from ngepc.discretisation.stiffness import Blocks, Stiffness
from ngepc.discretisation.summands import Summands
from ngepc.linalg.chebyshev import Chebyshev
from ngepc.linalg.descent import Linear
from ngepc.local.iterative import FullPattern, pinned_blocks, place_among
from ngepc.model.processes import Team


class LowerStorage:
    """A tangent as blocks on and below the diagonal, see ``Storage``; ``matrix`` is itself.

    Threads make products together if there are several ``parts``, see ``Summands``.
    """

    def __init__(
        self, stiffness: Stiffness, parts: Sequence[np.ndarray | None] = (None,)
    ) -> None:
        self._stiffness = stiffness
        self._summands = Summands(stiffness, parts)
        self._blocks = self._summands.blocks

    @property
    def matrix(self) -> LowerStorage:
        """See ``Storage``."""
        return self

    def fill(self, data: Any) -> None:
        """See ``Storage``."""
        self._stiffness.values(data, self._blocks)
        self._summands.renew()

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """See ``Storage``."""
        return self._summands.times(x)

    def pin(self, nodes: np.ndarray, projections: np.ndarray) -> csr_matrix:
        """See ``Storage``."""
        stiffness = self._stiffness
        number = place_among(nodes, len(stiffness.free))
        rows = number[stiffness.rows]
        columns = number[stiffness.columns]
        pairs = np.flatnonzero((rows >= 0) | (columns >= 0))
        before = self._blocks[pairs]
        after = pinned_blocks(before, projections, rows[pairs], columns[pairs])
        self._summands.replace(pairs, after)
        return stiffness.symmetric(before - after, pairs)

    def leading(self, count: int) -> Leading:
        """The part of the matrix that belongs to the first nodes."""
        return Leading(self._stiffness, self._blocks, count)

    def level(
        self, space: csr_matrix, restriction: csr_matrix, processes: Team
    ) -> FinestLevel:
        """The level of the sum of the present tangents of all processes.

        ``space`` is the interpolation to it, ``restriction`` its transpose.
        """
        shape = self._stiffness.free.shape
        diagonal = self._stiffness.rows == self._stiffness.columns
        blocks = processes.summed(self._blocks[diagonal])
        count = np.arange(shape[0] + 1)
        inverse = bsr_matrix((np.linalg.inv(blocks), count[:-1], count))

        def multiply(x: np.ndarray) -> np.ndarray:
            """The tangent times displacements, flat."""
            return processes.summed(self.multiply(x).reshape(shape)).ravel()

        random = np.random.default_rng(0).standard_normal(shape)
        start = processes.spread(random).ravel()
        smooth = Chebyshev(multiply, inverse.dot, start, processes.dot)
        return FinestLevel(
            Summed(multiply), space, restriction, smooth.from_zero, smooth
        )


class Summed(NamedTuple):
    """A matrix by its products with vectors."""

    multiply: Linear

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return self.multiply(x)


class FinestLevel(NamedTuple):
    """A level like ``linalg.cycle.Level``, smoothed by a polynomial."""

    matrix: Summed
    space: csr_matrix
    restriction: csr_matrix
    forwards: Callable[[np.ndarray, np.ndarray], None]
    backwards: Callable[[np.ndarray, np.ndarray], None]


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
        self.pattern = FullPattern(part)
        self._matrix: csr_matrix | None = None

    def matrix(self) -> csr_matrix:
        """The matrix with the present values, always the same object."""
        self._matrix = self.pattern.matrix(self._blocks, self._matrix)
        return self._matrix
