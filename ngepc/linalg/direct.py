"""NGSolve's direct solvers by name, and symmetric sparse sums in one pattern for them.

The constant part of (7.1) is assembled once; the Newton derivatives live on the spaces of z and q
alone and are added in place, so that the pattern and its symbolic factorisation stay.
"""

from __future__ import annotations

import numpy as np
from netgen.meshing import NgException
from ngsolve import BitArray
from ngsolve.la import BaseMatrix, SparseMatrixd
from pyngcore import Array_D_S, Array_I_S
from scipy.sparse import coo_matrix, csr_matrix, tril

from ngepc.checks.sentences import in_words

SHIPPED = ("sparsecholesky", "umfpack")  # those that come with NGSolve's wheels

DIRECT_SOLVERS = (*SHIPPED, "pardiso", "mumps", "superlu")

FROM_LOWER_TRIANGLE = ("sparsecholesky",)
"""Solvers that read symmetric storage; the others take its entries for the whole matrix."""

SOLVER_ERRORS = (NgException, RuntimeError, MemoryError)
"""What assembly and factorisation raise: NGSolve's own exception, RuntimeError where a library is
missing or gives up, MemoryError where the fill-in does not fit."""


WITHOUT_PIVOTS = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "options": {"SymmetricMode": True},
}
"""Options of SuperLU for symmetric positive definite matrices."""


class FactorisationError(RuntimeError):
    """A linear solver that gave up on a matrix."""


def require_solver(name: str, value: object) -> object:
    """``value``: NGSolve's name of a direct solver that is here, or what has a ``tangent``."""
    if hasattr(value, "tangent") and not isinstance(value, type):
        return value
    if not isinstance(value, str) or value not in DIRECT_SOLVERS:
        raise ValueError(
            f"{name}={in_words(value)}: one of {', '.join(DIRECT_SOLVERS)} is needed"
        )
    if value in SHIPPED:
        return value
    try:
        SparseMatrixd.CreateFromCOO([0], [0], [1.0], 1, 1).Inverse(inverse=value)
    except SOLVER_ERRORS as error:
        raise ValueError(
            f"{name}={in_words(value)}: this installation does not have it ({error}); "
            f"{' and '.join(SHIPPED)} come with NGSolve"
        ) from error
    return value


def symmetric_inverse(matrix: BaseMatrix, free: BitArray, name: str) -> BaseMatrix:
    """The inverse of some rows and columns of a matrix in symmetric storage, zero elsewhere."""
    if name not in FROM_LOWER_TRIANGLE:
        matrix = both_triangles(csr_matrix(tuple(map(np.asarray, matrix.CSR()))))
    return matrix.Inverse(free, inverse=name)


def lower_triangle(matrix: BaseMatrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values of the entries on and below the diagonal, row by row."""
    values, columns, starts = (np.asarray(a) for a in matrix.CSR())
    rows = np.repeat(
        np.arange(len(starts) - 1, dtype=np.int64), np.diff(starts.astype(np.int64))
    )
    columns, lower = columns.astype(np.int64), columns <= rows
    return (
        (rows, columns, values)
        if lower.all()
        else (rows[lower], columns[lower], values[lower])
    )


def both_triangles(lower: csr_matrix) -> SparseMatrixd:
    """The symmetric matrix with this lower triangle, all entries stored."""
    lower = tril(lower).tocoo()
    strict = lower.row > lower.col
    rows = np.append(lower.row, lower.col[strict])
    columns = np.append(lower.col, lower.row[strict])
    return from_entries(
        rows, columns, np.append(lower.data, lower.data[strict]), *lower.shape
    )


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
    """A matrix in symmetric storage, to which entries of its pattern can be added.

    ``mirrored`` asks for both triangles; ``values`` are the entries of the lower one, row by row.
    """

    def __init__(self, first: BaseMatrix, *, mirrored: bool = False) -> None:
        rows, columns, values = lower_triangle(first)
        self._size = first.height
        self.values = values.copy()
        self._keys = rows * self._size + columns
        self._matrix = first.CreateMatrix()
        self._source = slice(None)
        if mirrored:
            numbers = np.arange(len(rows))
            shape = (self._size, self._size)
            self._matrix = both_triangles(
                coo_matrix((numbers, (rows, columns)), shape=shape)
            )
            self._source = self._matrix.AsVector().FV().NumPy().astype(np.int64)

    def add(self, block: BaseMatrix, first: int = 0, factor: float = 1.0) -> None:
        """Add ``factor`` times a block whose row and column 0 stand at ``first`` in the sum.

        A ValueError if it has entries outside of the pattern.
        """
        rows, columns, values = lower_triangle(block)
        keys = (rows + first) * self._size + columns + first
        where = np.searchsorted(self._keys, keys)
        if not np.array_equal(self._keys.take(where, mode="clip"), keys):
            raise ValueError("block has entries outside of the pattern of the sum")
        self.values[where] += factor * values

    def matrix(self) -> BaseMatrix:
        """The matrix with the present values; always the same object."""
        self._matrix.AsVector().FV().NumPy()[:] = self.values[self._source]
        return self._matrix
