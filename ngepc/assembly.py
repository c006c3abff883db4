"""A symmetric sparse matrix that is a constant plus blocks that change in every Newton step.

The constant part of (7.1) is assembled once; the Newton derivatives live on the spaces of z and q
alone and are added in place, so that the pattern and its symbolic factorisation stay.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve.la import SparseMatrixd


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


def repeated(A: SparseMatrixd, times: int) -> SparseMatrixd:
    """The block-diagonal matrix with ``times`` copies of A."""
    values, columns, starts = (np.asarray(a) for a in A.CSR())
    n = len(starts) - 1
    rows = np.repeat(np.arange(n), np.diff(starts.astype(np.int64)))
    shifts = n * np.repeat(np.arange(times), len(values))
    i, j = (np.tile(index, times) + shifts for index in (rows, columns.astype(np.int64)))
    return SparseMatrixd.CreateFromCOO(
        i.astype(np.int32), j.astype(np.int32), np.tile(values, times), times * n, times * n
    )


class SparseSum:
    """The sum of placed symmetric blocks, lower triangle only, in one fixed pattern.

    Parameters
    ----------
    size
        Number of rows.
    blocks
        Blocks whose patterns together make the pattern of the sum.
    """

    def __init__(self, size: int, blocks: Sequence[Placed]) -> None:
        self._size = size
        self._keys = np.unique(np.concatenate([b.lower_triangle(size)[0] for b in blocks]))
        rows = (self._keys // size).astype(np.int32)
        columns = (self._keys % size).astype(np.int32)
        self.matrix = SparseMatrixd.CreateFromCOO(rows, columns, np.zeros(len(rows)), size, size)

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, row by row; assign to its slice to restore a copy."""
        return self.matrix.AsVector().FV().NumPy()

    def add(self, block: Placed, factor: float = 1.0) -> None:
        """Add ``factor`` times a block, whose pattern must be within that of the sum."""
        keys, values = block.lower_triangle(self._size)
        if len(keys):
            self.entries[self._where(keys)] += factor * values

    def _where(self, keys: np.ndarray) -> np.ndarray:
        first, last = np.searchsorted(self._keys, (keys[0], keys[-1]))
        return first + np.searchsorted(self._keys[first : last + 1], keys)
