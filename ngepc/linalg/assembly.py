"""A symmetric sparse matrix that is a constant plus blocks that change in every Newton step.

The constant part of (7.1) is assembled once; the Newton derivatives live on the spaces of z and q
alone and are added in place, so that the pattern and its symbolic factorisation stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve.la import SparseMatrixd
from pyngcore import Array_D_S, Array_I_S


@dataclass(frozen=True)
class Placed:
    """A symmetric block whose row and column 0 stand at ``first`` in the large matrix."""

    matrix: SparseMatrixd
    first: int = 0

    def lower_triangle(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Keys row * size + column and values of the entries on and below the diagonal."""
        values, columns, starts = (np.asarray(a) for a in self.matrix.CSR())
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts.astype(np.int64)))
        keys = (rows + self.first) * np.int64(size) + (columns + self.first)
        lower = columns <= rows
        return (keys, values) if lower.all() else (keys[lower], values[lower])


def from_entries(
    rows: np.ndarray, columns: np.ndarray, values: np.ndarray, height: int, width: int
) -> SparseMatrixd:
    """The sparse matrix with these entries.

    ``SparseMatrixd.CreateFromCOO`` reads numpy arrays one Python number at a time, which takes ten
    times as long as all else that it does.
    """
    kinds = (Array_I_S, Array_I_S, Array_D_S)
    arrays = [kind(len(rows)) for kind in kinds]
    for array, given in zip(arrays, (rows, columns, values), strict=True):
        array.NumPy()[:] = given
    return SparseMatrixd.CreateFromCOO(*arrays, height, width)


def repeated(A: SparseMatrixd, times: int) -> SparseMatrixd:
    """The block-diagonal matrix with ``times`` copies of A."""
    values, columns, starts = (np.asarray(a) for a in A.CSR())
    n = len(starts) - 1
    rows = np.repeat(np.arange(n), np.diff(starts.astype(np.int64)))
    shifts = n * np.repeat(np.arange(times), len(values))
    i, j = (np.tile(index, times) + shifts for index in (rows, columns.astype(np.int64)))
    return from_entries(i, j, np.tile(values, times), times * n, times * n)


def diagonal_block(A: SparseMatrixd, first: int, last: int, factor: float = 1.0) -> SparseMatrixd:
    """Rows and columns ``first`` to ``last`` - 1 of a symmetric matrix, times ``factor``."""
    values, columns, starts = (np.asarray(a) for a in A.CSR())
    starts = starts.astype(np.int64)[first : last + 1]
    rows = np.repeat(np.arange(last - first, dtype=np.int32), np.diff(starts))
    values, columns = values[starts[0] : starts[-1]], columns[starts[0] : starts[-1]]
    inside = columns >= first  # the lower triangle ends at the diagonal
    n = last - first
    return from_entries(rows[inside], columns[inside] - first, factor * values[inside], n, n)


def sorted_once(keys: np.ndarray) -> np.ndarray:
    """The different keys in ascending order; for many integers faster than ``np.unique``."""
    keys = np.sort(keys)
    return keys[np.r_[True, keys[1:] != keys[:-1]]] if len(keys) else keys


class SparseSum:
    """The sum of placed symmetric blocks, lower triangle only, in one fixed pattern.

    Parameters
    ----------
    largest
        A matrix of the size of the sum, in symmetric storage.
    blocks
        Blocks whose patterns, together with that of ``largest``, make the pattern of the sum.
    """

    def __init__(self, largest: SparseMatrixd, blocks: Sequence[Placed]) -> None:
        size = self._size = largest.height
        self._keys, _ = Placed(largest).lower_triangle(size)
        patterns = [b.lower_triangle(size)[0] for b in blocks]
        more = [keys[~self._has(keys)] for keys in patterns]
        if not any(len(keys) for keys in more):
            self.matrix = largest.CreateMatrix()
            return
        self._keys = sorted_once(np.concatenate([self._keys, *more]))
        rows, columns = np.divmod(self._keys, size)
        self.matrix = from_entries(rows, columns, np.zeros(len(rows)), size, size)

    def _has(self, keys: np.ndarray) -> np.ndarray:
        where = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return self._keys[where] == keys

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, row by row; assign to its slice to restore a copy."""
        return self.matrix.AsVector().FV().NumPy()

    def add(self, block: Placed, factor: float = 1.0) -> None:
        """Add ``factor`` times a block, whose pattern must be within that of the sum."""
        keys, values = block.lower_triangle(self._size)
        if len(keys):
            self.entries[self._where(keys)] += factor * values

    def cross(self, dofs: np.ndarray) -> Cross:
        """The rows and columns ``dofs``."""
        chosen = np.zeros(self._size, dtype=bool)
        chosen[dofs] = True
        rows, columns = np.divmod(self._keys, self._size)
        where = np.flatnonzero(chosen[rows] | chosen[columns])
        return Cross(self, where, rows[where], columns[where])

    def _where(self, keys: np.ndarray) -> np.ndarray:
        first, last = np.searchsorted(self._keys, (keys[0], keys[-1]))
        return first + np.searchsorted(self._keys[first : last + 1], keys)


@dataclass(frozen=True)
class Cross:
    """Some rows and columns of a sum.

    Parameters
    ----------
    sum
        The sum.
    where, rows, columns
        Numbers of the stored entries among those of the sum, their rows and columns.
    """

    sum: SparseSum
    where: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def values(self) -> np.ndarray:
        """A copy of the entries."""
        return self.sum.entries[self.where]

    def add_product(self, values: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
        """Add C x to y, where C has these entries, on both sides of the diagonal, and no others."""
        below = self.rows != self.columns
        np.add.at(y, self.rows, values * x[self.columns])
        np.add.at(y, self.columns[below], (values * x[self.rows])[below])

    def decouple(self, dofs: np.ndarray) -> None:
        """Replace the rows and columns ``dofs``, some of these, by those of the identity."""
        i, j = np.isin(self.rows, dofs), np.isin(self.columns, dofs)
        entries = self.sum.entries
        entries[self.where[i | j]] = 0.0
        entries[self.where[i & (self.rows == self.columns)]] = 1.0
