"""NGSolve's direct solvers by name, and whether they are there."""

from __future__ import annotations

from netgen.meshing import NgException
from ngsolve import BitArray
from ngsolve.la import BaseMatrix, SparseMatrixd

from ngepc.linalg.assembly import Placed, SparseSum

SHIPPED = ("sparsecholesky", "umfpack")
"""Those that come with NGSolve's wheels."""

DIRECT_SOLVERS = (*SHIPPED, "pardiso", "mumps", "superlu")

FROM_LOWER_TRIANGLE = ("sparsecholesky",)
"""Solvers that read symmetric storage; the others take its entries for the whole matrix."""

SOLVER_ERRORS = (NgException, RuntimeError, MemoryError)
"""What assembly and factorisation raise: NGSolve's own exception, RuntimeError where a library is
missing or gives up, MemoryError where the fill-in does not fit."""


class FactorisationError(RuntimeError):
    """A linear solver that gave up on a matrix."""


def require_solver(name: str, value: object) -> None:
    """Accept NGSolve's name of a direct solver that is here, or what has a method ``tangent``."""
    if hasattr(value, "tangent") and not isinstance(value, type):
        return
    if not isinstance(value, str) or value not in DIRECT_SOLVERS:
        raise ValueError(f"{name}={value!r}: one of {', '.join(DIRECT_SOLVERS)} is needed")
    if value in SHIPPED:
        return
    one = SparseMatrixd.CreateFromCOO([0], [0], [1.0], 1, 1)
    try:
        one.Inverse(inverse=value)
    except SOLVER_ERRORS as error:
        raise ValueError(
            f"{name}={value!r}: this installation lacks it ({error}); {' and '.join(SHIPPED)} "
            "come with NGSolve"
        ) from error


def symmetric_inverse(matrix: BaseMatrix, free: BitArray, name: str) -> BaseMatrix:
    """The inverse of some rows and columns of a matrix in symmetric storage, zero elsewhere."""
    if name not in FROM_LOWER_TRIANGLE:
        whole = SparseSum(matrix, mirrored=True)
        whole.add(Placed(matrix))
        matrix = whole.matrix()
    return matrix.Inverse(free, inverse=name)
