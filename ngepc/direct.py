"""Direct solvers by NGSolve's names, and whether they are there."""

from __future__ import annotations

from ngsolve.la import SparseMatrixd

SHIPPED = ("sparsecholesky", "umfpack")
"""Those that come with NGSolve's wheels."""

DIRECT_SOLVERS = (*SHIPPED, "pardiso", "mumps", "superlu")


def require_direct_solver(name: str, value: object) -> None:
    """Accept NGSolve's name of a direct solver that this installation has.

    Raises
    ------
    ValueError
        If the name is unknown or the solver is missing.
    """
    if not isinstance(value, str) or value not in DIRECT_SOLVERS:
        raise ValueError(f"{name}={value!r}: one of {', '.join(DIRECT_SOLVERS)} is needed")
    if value in SHIPPED:
        return
    one = SparseMatrixd.CreateFromCOO([0], [0], [1.0], 1, 1)
    try:
        one.Inverse(inverse=value)
    except Exception as error:  # NGSolve raises bare exceptions
        raise ValueError(
            f"{name}={value!r}: this installation lacks it ({error}); {' and '.join(SHIPPED)} "
            "come with NGSolve"
        ) from error
