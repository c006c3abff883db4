"""V-cycles of multigrid: Gauss-Seidel forwards before the coarse correction, backwards after it.

Products with large matrices are made in two halves, by threads if there are any.  The sweeps are
not split: PyAMG's compiled loops keep Python's lock, so that two threads would take turns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, vstack
from scipy.sparse.linalg import splu

from ngepc.linalg.cores import in_order
from ngepc.linalg.direct import WITHOUT_PIVOTS

SWEEPS = 2
"""Sweeps before and after the coarse correction."""

LARGE = 10_000
"""Unknowns from which on products are split."""

Sweep = Callable[..., None]
"""The compiled loop of Gauss-Seidel's method.

The arrays of a CSR matrix, x, the right-hand side, and first, last and step among the unknowns.
"""


class Product:
    """A CSR matrix times vectors, two halves of its rows by two threads; its values may change."""

    def __init__(self, matrix: csr_matrix) -> None:
        rows = matrix.shape[0]
        starts = matrix.indptr
        middle = int(np.searchsorted(starts, starts[-1] // 2))
        self._halves = [matrix]
        if rows >= LARGE:
            ends = (0, middle), (middle, rows)
            self._halves = [rows_of(matrix, *pair) for pair in ends]

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate(list(in_order(lambda half: half @ x, self._halves)))


def rows_of(matrix: csr_matrix, first: int, last: int) -> csr_matrix:
    """Some rows of a CSR matrix, with the same arrays of values and columns."""
    start = matrix.indptr[first]
    entries = slice(start, matrix.indptr[last])
    starts = matrix.indptr[first : last + 1] - start
    part = csr_matrix((last - first, matrix.shape[1]))
    part.indptr = starts
    part.indices = matrix.indices[entries]  # SciPy's constructor would copy them
    part.data = matrix.data[entries]
    return part


def block_rows(matrix: bsr_matrix, first: int, last: int) -> bsr_matrix:
    """Some block rows of a matrix."""
    starts = matrix.indptr[first : last + 1]
    entries = slice(starts[0], starts[-1])
    arrays = (matrix.data[entries], matrix.indices[entries], starts - starts[0])
    shape = (matrix.blocksize[0] * (last - first), matrix.shape[1])
    return bsr_matrix(arrays, shape=shape)


class Sweeps:
    """Sweeps of Gauss-Seidel's method in ascending order, in place."""

    def __init__(self, matrix: csr_matrix, sweep: Sweep) -> None:
        self._sweep = sweep
        self._arrays = matrix.indptr, matrix.indices, matrix.data

    def __call__(self, x: np.ndarray, right: np.ndarray) -> None:
        """Sweep some times."""
        for _ in range(SWEEPS):
            self._sweep(*self._arrays, x, right, 0, len(x), 1)


class Level:
    """A level: its matrix, the interpolation to it from the next one, and the sweeps.

    ``restriction`` is the transpose of the interpolation ``space``.  Backwards is forwards with all
    unknowns numbered from the end: loops through memory in descending order take four times as
    long.
    """

    def __init__(
        self,
        matrix: csr_matrix,
        space: csr_matrix | bsr_matrix,
        restriction: csr_matrix | bsr_matrix,
        sweep: Sweep,
    ) -> None:
        self.matrix = Product(matrix)
        self.space = space
        self.restriction = restriction
        self.forwards = Sweeps(matrix, sweep)
        self._backwards = Sweeps(from_the_end(matrix), sweep)

    def backwards(self, x: np.ndarray, right: np.ndarray) -> None:
        """The adjoint of ``forwards``, in place."""
        y = x[::-1].copy()
        self._backwards(y, right[::-1].copy())
        x[:] = y[::-1]


def from_the_end(matrix: csr_matrix) -> csr_matrix:
    """A square matrix with rows and columns numbered from the end."""
    count = matrix.shape[0]
    columns = count - 1 - matrix.indices[::-1]
    starts = matrix.indptr[-1] - matrix.indptr[::-1]
    return csr_matrix((matrix.data[::-1].copy(), columns, starts), shape=matrix.shape)


def level_and_coarser(
    make: Callable[..., Level],
    matrix: csr_matrix,
    space: bsr_matrix,
    restriction: bsr_matrix,
) -> tuple[Level, csr_matrix]:
    """A level by ``make(matrix, space, restriction)``, and the matrix of the next coarser one.

    Products of small blocks take a third of the time of those of single numbers.  Large matrices
    are multiplied in two halves of the coarse rows, by threads if there are any.
    """
    size = space.blocksize[0]
    blocks = matrix.tobsr((size, size))
    count = len(restriction.indptr) - 1
    middle = count // 2 if matrix.shape[0] >= LARGE else count
    ends = [(0, middle), (middle, count)] if middle < count else [(0, count)]

    def product(first: int, last: int) -> csr_matrix:
        """The rows of the coarser matrix that belong to some block rows."""
        return (block_rows(restriction, first, last) @ blocks @ space).tocsr()

    work = [partial(product, *pair) for pair in ends]
    work.append(partial(make, matrix, space, restriction))
    *products, level = in_order(lambda task: task(), work)
    return level, vstack(products, format="csr")


def coarsest_solver(matrix: csr_matrix) -> Callable[[np.ndarray], np.ndarray]:
    """Solutions with factors of a matrix, zero for unknowns without entries.

    Interpolation from an aggregate with few nodes has columns of zeros.  The matrix is symmetric
    and positive definite, so that no pivots are needed.
    """
    kept = np.flatnonzero(matrix.diagonal())
    part = matrix if len(kept) == len(matrix.indptr) - 1 else matrix[kept][:, kept]
    solve = splu(part.tocsc(), **WITHOUT_PIVOTS).solve

    def solution(right: np.ndarray) -> np.ndarray:
        """The solution for a right-hand side."""
        x = np.zeros_like(right)
        x[kept] = solve(right[kept])
        return x

    return solution


def v_cycle(
    levels: Sequence[Level], coarsest: Callable[[np.ndarray], np.ndarray], r: np.ndarray
) -> np.ndarray:
    """The cycle from zero for a right-hand side: a symmetric positive definite map of it."""
    if not levels:
        return coarsest(r)
    level, *coarser = levels
    x = np.zeros_like(r)
    level.forwards(x, r)
    left = level.restriction @ (r - level.matrix @ x)
    x += level.space @ v_cycle(coarser, coarsest, left)
    level.backwards(x, r)
    return x
