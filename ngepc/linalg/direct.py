"""Linear solvers as objects; the direct ones by NGSolve's names, and whether they are there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from ngsolve import FESpace
from ngsolve.la import BaseMatrix, SparseMatrixd

from ngepc.linalg.factors import SOLVER_ERRORS, factors

if TYPE_CHECKING:
    from ngepc.dual.functional import DualFunctional, NewtonSystem

SHIPPED = ("sparsecholesky", "umfpack")
"""Those that come with NGSolve's wheels."""

DIRECT_SOLVERS = (*SHIPPED, "pardiso", "mumps", "superlu")


class LinearSolver(Protocol):
    """What solves the linear systems of a run: ``Direct`` or ``Krylov``."""

    def primal_inverse(self, condensed: SparseMatrixd, V: FESpace) -> BaseMatrix:
        """The inverse of D condensed to u by its lower triangle."""
        ...

    def product_inverse(self, matrix: SparseMatrixd, space: FESpace) -> BaseMatrix:
        """The inverse of a symmetric positive definite matrix by its lower triangle."""
        ...

    def newton_system(self, functional: DualFunctional) -> NewtonSystem:
        """The Newton system (7.1) of a functional."""
        ...


@dataclass(frozen=True)
class Direct:
    """A direct solver.

    Parameters
    ----------
    name
        NGSolve's name of it, one that does LDL^T.

    Raises
    ------
    ValueError
        If the name is unknown or the solver is missing.
    """

    name: str = "sparsecholesky"

    def __post_init__(self) -> None:
        require_direct_solver("name", self.name)

    def primal_inverse(self, condensed: SparseMatrixd, V: FESpace) -> BaseMatrix:
        """The factors of the condensed matrix."""
        return factors(condensed, V, V.FreeDofs(), self.name)

    def product_inverse(self, matrix: SparseMatrixd, space: FESpace) -> BaseMatrix:
        """The factors of the matrix."""
        return factors(matrix, space, space.FreeDofs(), self.name)

    def newton_system(self, functional: DualFunctional) -> NewtonSystem:
        """(7.1) with one factorisation for each step."""
        from ngepc.dual.contact_newton import ConstrainedSystem
        from ngepc.dual.functional import NewtonSystem

        constrained = functional.constraint is not None
        return (ConstrainedSystem if constrained else NewtonSystem)(functional, self.name)


def linear_solver(inverse: str | LinearSolver) -> LinearSolver:
    """The object that the option ``inverse`` stands for: ``Direct`` for a name, else itself."""
    return Direct(inverse) if isinstance(inverse, str) else inverse


def require_linear_solver(name: str, value: object) -> None:
    """Accept a solver object or NGSolve's name of a direct one that this installation has.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if isinstance(value, type) or not (
        hasattr(value, "newton_system") or hasattr(value, "tangent")
    ):
        require_direct_solver(name, value)


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
    except SOLVER_ERRORS as error:
        raise ValueError(
            f"{name}={value!r}: this installation lacks it ({error}); {' and '.join(SHIPPED)} "
            "come with NGSolve"
        ) from error
