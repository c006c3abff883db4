"""A symmetric sparse matrix that is a constant plus blocks that change in every Newton step.

The constant part of (7.1) is assembled once; the Newton derivatives live on the spaces of z and q
alone and are added in place, so that the pattern and its symbolic factorisation stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve.la import BaseMatrix, SparseMatrixd
from pyngcore import Array_D_S, Array_I_S


@dataclass(frozen=True)
class Placed:
    """A symmetric block whose row and column 0 stand at ``first`` in the large matrix."""

    matrix: BaseMatrix
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
    arrays = [kind(len(rows)) for kind in (Array_I_S, Array_I_S, Array_D_S)]
    for array, given in zip(arrays, (rows, columns, values), strict=True):
        array.NumPy()[:] = given
    return SparseMatrixd.CreateFromCOO(*arrays, height, width)


class SparseSum:
    """The sum of placed symmetric blocks in one fixed pattern.

    ``largest`` has the size of the sum and symmetric storage; its pattern and those of the blocks
    make that of the sum.  ``mirrored`` asks for both triangles in any case; ``values`` are the
    entries of the lower one, row by row.
    """

    def __init__(
        self, largest: BaseMatrix, blocks: Sequence[Placed] = (), *, mirrored: bool = False
    ) -> None:
        size = self._size = largest.height
        self._keys, _ = Placed(largest).lower_triangle(size)
        more = [keys[~self._has(keys)] for keys, _ in (b.lower_triangle(size) for b in blocks)]
        if mirrored or any(len(keys) for keys in more):
            self._keys = np.unique(np.concatenate([self._keys, *more]))
            self._matrix, self._source = _both_triangles(self._keys, size)
        else:
            self._matrix, self._source = largest.CreateMatrix(), slice(None)
        self.values = np.zeros(len(self._keys))

    def _has(self, keys: np.ndarray) -> np.ndarray:
        where = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return self._keys[where] == keys

    def add(self, block: Placed, factor: float = 1.0) -> None:
        """Add ``factor`` times a block; a ValueError if it has entries outside of the pattern."""
        keys, values = block.lower_triangle(self._size)
        if len(keys):
            first, last = np.searchsorted(self._keys, (keys[0], keys[-1]))
            where = first + np.searchsorted(self._keys[first : last + 1], keys)
            if where[-1] == len(self._keys) or (self._keys[where] != keys).any():
                raise ValueError("block has entries outside of the pattern of the sum")
            self.values[where] += factor * values

    def matrix(self) -> BaseMatrix:
        """The matrix with the present values; always the same object."""
        self._matrix.AsVector().FV().NumPy()[:] = self.values[self._source]
        return self._matrix


def _both_triangles(keys: np.ndarray, size: int) -> tuple[SparseMatrixd, np.ndarray]:
    """A matrix with a lower triangle and its mirror image, and which key each entry stands for."""
    rows, columns = np.divmod(keys, size)
    number, strict = np.arange(len(keys)), np.flatnonzero(rows > columns)
    i, j = np.append(rows, columns[strict]), np.append(columns, rows[strict])
    matrix = from_entries(i, j, np.append(number, strict), size, size)
    return matrix, matrix.AsVector().FV().NumPy().astype(np.int64)
