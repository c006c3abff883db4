"""The object that replaces a direct solver: Krylov methods with multigrid for every block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ngsolve import FESpace
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.checks.arguments import require_integer, require_number
from ngepc.krylov.hierarchy import levels
from ngepc.krylov.iterative import conjugate_gradients
from ngepc.krylov.matrices import Mirrored
from ngepc.krylov.multigrid import VCycle
from ngepc.linalg.operators import SquareOperator

if TYPE_CHECKING:
    from ngepc.dual.functional import DualFunctional
    from ngepc.krylov.system import KrylovSystem


@dataclass(frozen=True, kw_only=True)
class Krylov:
    """MINRES for (7.1) and CG for D and B, each block with a multigrid V-cycle.

    The meshes of the cycle are those that ``mesh.Refine()`` has made of a coarse one; a mesh that
    was never refined has one level, whose blocks are factorised.  Counts stay bounded over meshes
    and gamma_T with ``PointwisePlasticStrain()``.  docs/howto/large_bodies.md

    Parameters
    ----------
    forcing
        Relative residual that MINRES stops at, in (0, 1); near the solution it falls with the
        square of the Newton residual.
    accuracy
        Relative residual of the CG solves with D, in (0, 1); each of them is corrected once more.
    max_iterations
        Most iterations of one Krylov solve; more end the run with LINEAR_SOLVER_FAILED, or raise
        ``KrylovError`` where there is no iterate yet.
    sweeps
        Gauss-Seidel sweeps before and after each coarse correction, for displacements; q has one.

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    forcing: float = 1e-3
    accuracy: float = 1e-8
    max_iterations: int = 500
    sweeps: int = 2

    def __post_init__(self) -> None:
        for name in ("forcing", "accuracy"):
            if require_number(name, getattr(self, name), 0, strict=True) >= 1:
                raise ValueError(f"{name}={getattr(self, name)!r}: a number in (0, 1) is needed")
        require_integer("max_iterations", self.max_iterations, 1)
        require_integer("sweeps", self.sweeps, 1)

    def primal_inverse(self, condensed: SparseMatrixd, V: FESpace) -> ConjugateGradients:
        """The inverse of D condensed to u by its lower triangle."""
        return ConjugateGradients(condensed, V, self, self.accuracy)

    def product_inverse(self, matrix: SparseMatrixd, space: FESpace) -> ConjugateGradients:
        """The inverse of a symmetric positive definite matrix on a P1 space."""
        return ConjugateGradients(matrix, space, self, 1e-8)

    def newton_system(self, functional: DualFunctional) -> KrylovSystem:
        """The Newton system that this solver solves."""
        from ngepc.krylov.contact import ConstrainedKrylovSystem
        from ngepc.krylov.system import KrylovSystem

        constrained = functional.constraint is not None
        return (ConstrainedKrylovSystem if constrained else KrylovSystem)(functional, self)


class ConjugateGradients(SquareOperator):
    """An inverse by CG, for vectors whose first entries belong to the space.

    Parameters
    ----------
    lower
        The lower triangle of a symmetric positive definite matrix.
    space
        Its P1 space.
    solver
        Options of the cycle.
    accuracy
        Relative residual to be reached.

    Attributes
    ----------
    A
        The matrix with both triangles.
    family
        The meshes of the cycle, finest first.
    """

    def __init__(
        self, lower: SparseMatrixd, space: FESpace, solver: Krylov, accuracy: float
    ) -> None:
        mirrored = Mirrored(lower)
        super().__init__(mirrored.matrix)
        self._lower, self._solver, self._accuracy = lower, solver, accuracy
        self._mirrored, self.A = mirrored, mirrored.matrix
        self.family = levels(space)
        self._P = VCycle([self.A], self.family, solver.sweeps)

    def Update(self) -> None:
        """Take new values of the matrix."""
        self._mirrored.update(self._lower)
        self._P = VCycle([self.A], self.family, self._solver.sweeps)

    def Mult(self, b: BaseVector, x: BaseVector) -> None:
        """x = A^(-1) b; entries beyond the space become zero."""
        x[:] = 0.0
        self.improve(b, x)

    def improve(self, b: BaseVector, x: BaseVector) -> int:
        """The same from a first guess in ``x``; returns the number of iterations.

        Raises
        ------
        KrylovError
            If CG does not converge.
        """
        own = slice(0, self.A.height)
        most = self._solver.max_iterations
        return conjugate_gradients(self.A, self._P, b[own], x[own], self._accuracy, most)
