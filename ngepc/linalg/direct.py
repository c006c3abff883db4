"""NGSolve's direct solvers by name, and symmetric sparse sums in one pattern for them.

The constant part of (7.1) is assembled once; the Newton derivatives live on the spaces of z and q
alone and are added in place, so that the pattern and its symbolic factorisation stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from netgen.meshing import NgException
from ngsolve import BitArray
from ngsolve.la import BaseMatrix, SparseMatrixd
from pyngcore import Array_D_S, Array_I_S

SHIPPED = ("sparsecholesky", "umfpack")  # those that come with NGSolve's wheels

DIRECT_SOLVERS = (*SHIPPED, "pardiso", "mumps", "superlu")

FROM_LOWER_TRIANGLE = ("sparsecholesky",)
"""Solvers that read symmetric storage; the others take its entries for the whole matrix."""

SOLVER_ERRORS = (NgException, RuntimeError, MemoryError)
"""What assembly and factorisation raise: NGSolve's own exception, RuntimeError where a library is
missing or gives up, MemoryError where the fill-in does not fit."""


class FactorisationError(RuntimeError):
    """A linear solver that gave up on a matrix."""


def require_solver(name: str, value: object) -> object:
    """``value``: NGSolve's name of a direct solver that is here, or what has a ``tangent``."""
    if hasattr(value, "tangent") and not isinstance(value, type):
        return value
    if not isinstance(value, str) or value not in DIRECT_SOLVERS:
        raise ValueError(f"{name}={value!r}: one of {', '.join(DIRECT_SOLVERS)} is needed")
    if value in SHIPPED:
        return value
    one = SparseMatrixd.CreateFromCOO([0], [0], [1.0], 1, 1)
    try:
        one.Inverse(inverse=value)
    except SOLVER_ERRORS as error:
        raise ValueError(
            f"{name}={value!r}: this installation lacks it ({error}); {' and '.join(SHIPPED)} "
            "come with NGSolve"
        ) from error
    return value


def symmetric_inverse(matrix: BaseMatrix, free: BitArray, name: str) -> BaseMatrix:
    """The inverse of some rows and columns of a matrix in symmetric storage, zero elsewhere."""
    if name not in FROM_LOWER_TRIANGLE:
        whole = SparseSum(matrix, mirrored=True)
        whole.add(Placed(matrix))
        matrix = whole.matrix()
    return matrix.Inverse(free, inverse=name)


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
        found = (block.lower_triangle(size)[0] for block in blocks)
        more = [keys[~self._places(keys)[1]] for keys in found]
        if mirrored or any(len(keys) for keys in more):
            self._keys = np.unique(np.concatenate([self._keys, *more]))
            self._matrix, self._source = _both_triangles(self._keys, size)
        else:
            self._matrix, self._source = largest.CreateMatrix(), slice(None)
        self.values = np.zeros(len(self._keys))

    def _places(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the keys are among those of the sum, and which of them are there."""
        where = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return where, self._keys[where] == keys

    def add(self, block: Placed, factor: float = 1.0) -> None:
        """Add ``factor`` times a block; a ValueError if it has entries outside of the pattern."""
        keys, values = block.lower_triangle(self._size)
        where, known = self._places(keys)
        if not known.all():
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
