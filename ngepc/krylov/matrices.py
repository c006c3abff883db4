"""Blocks of symmetric matrices of which only the lower triangle is stored."""

from __future__ import annotations

import numpy as np
from ngsolve.la import SparseMatrixd

from ngepc.linalg.assembly import from_entries


def entries(matrix: SparseMatrixd) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of the stored entries, row by row."""
    values, columns, starts = (np.asarray(a) for a in matrix.CSR())
    counts = np.diff(starts.astype(np.int64))
    return np.repeat(np.arange(len(counts), dtype=np.int32), counts), columns, values


def block(matrix: SparseMatrixd, rows: range, columns: range) -> SparseMatrixd:
    """The stored entries within ``rows`` and ``columns`` as a matrix of that size."""
    i, j, w = entries(matrix)
    kept = (i >= rows.start) & (i < rows.stop) & (j >= columns.start) & (j < columns.stop)
    i, j = i[kept] - rows.start, j[kept] - columns.start
    return from_entries(i, j, w[kept], len(rows), len(columns))


class Mirrored:
    """A symmetric matrix with both triangles, made from its lower one.

    Parameters
    ----------
    lower
        The lower triangle; entries above the diagonal are ignored.

    Attributes
    ----------
    matrix
        The matrix with both triangles.
    """

    def __init__(self, lower: SparseMatrixd) -> None:
        i, j, _ = entries(lower)
        number = np.flatnonzero(j <= i)
        i, j = i[number], j[number]
        below = j < i
        rows, columns = np.concatenate([i, j[below]]), np.concatenate([j, i[below]])
        numbers = np.concatenate([number, number[below]])
        size = lower.height
        self.matrix = from_entries(rows, columns, numbers, size, size)
        self._number = self._values.astype(np.int64)
        self.update(lower)

    @property
    def _values(self) -> np.ndarray:
        return self.matrix.AsVector().FV().NumPy()

    def update(self, lower: SparseMatrixd) -> None:
        """Take the values of a matrix with the same pattern."""
        self._values[:] = lower.AsVector().FV().NumPy()[self._number]
