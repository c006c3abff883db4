"""NGSolve's CG and MINRES, with an error where they do not converge."""

from __future__ import annotations

import contextlib
import math

from ngsolve import InnerProduct
from ngsolve.krylovspace import CGSolver, MinResSolver
from ngsolve.la import BaseMatrix, BaseVector


class KrylovError(RuntimeError):
    """A Krylov solver that did not reach its tolerance."""


def minres(
    A: BaseMatrix, P: BaseMatrix, b: BaseVector, x: BaseVector, tolerance: float, most: int
) -> int:
    """Solve A x = b with a symmetric A, from the given x and in place.

    Parameters
    ----------
    A, P
        The matrix and its symmetric positive definite preconditioner.
    b, x
        Right-hand side and first guess.
    tolerance
        Bound for the residual in the norm of P, relative to that of b.
    most
        Most iterations.

    Returns
    -------
    int
        The number of iterations.

    Raises
    ------
    KrylovError
        If that many do not suffice, or the residual is NaN.
    """
    return _solve(MinResSolver, A, P, b, x, tolerance, most)


def conjugate_gradients(
    A: BaseMatrix, P: BaseMatrix, b: BaseVector, x: BaseVector, tolerance: float, most: int
) -> int:
    """The same for a symmetric positive definite A; see ``minres``."""
    return _solve(CGSolver, A, P, b, x, tolerance, most)


def _solve(
    method: type,
    A: BaseMatrix,
    P: BaseMatrix,
    b: BaseVector,
    x: BaseVector,
    tolerance: float,
    most: int,
) -> int:
    scale, r = _size(P, b), b.CreateVector()
    if scale == 0:
        x[:] = 0.0
        return 0
    r.data = b - A * x
    bound, reached = tolerance * scale, _size(P, r)
    if reached <= bound:
        return 0
    solver = method(mat=A, pre=P, tol=0.0, atol=bound, maxiter=most + 1)
    if math.isfinite(reached):
        with contextlib.suppress(ZeroDivisionError, ValueError):  # a breakdown
            solver.Solve(rhs=b, sol=x, initialize=False)
        reached = solver.residuals[-1]
    if not reached <= bound:
        raise KrylovError(
            f"{method.name} did not converge: the relative residual is {reached / scale:.3g} after "
            f"{len(solver.residuals) - 1} iterations, {tolerance:.3g} was asked for"
        )
    return len(solver.residuals) - 1


def _size(P: BaseMatrix, r: BaseVector) -> float:
    """<r, P r>^(1/2)."""
    riesz = r.CreateVector()
    riesz.data = P * r
    return math.sqrt(abs(InnerProduct(r, riesz)))
