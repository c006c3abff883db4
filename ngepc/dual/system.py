"""The Newton system (7.1).

Its first row is negated: the second derivative of the saddle function S is then symmetric and
quasi-definite, so that LDL^T needs no pivoting.
"""

from __future__ import annotations

from ngsolve.la import BaseVector

from ngepc.dual.functional import DualFunctional
from ngepc.dual.penalty import ActiveTerms
from ngepc.linalg.direct import FROM_LOWER_TRIANGLE, SOLVER_ERRORS, FactorisationError, SparseSum


class NewtonSystem:
    """(7.1) in one fixed sparsity pattern: constant part, B / gamma_T, Newton derivatives.

    ``use`` changes to another functional on the same blocks; ``inverse`` is NGSolve's name of the
    direct solver.
    """

    def __init__(self, functional: DualFunctional, inverse: str) -> None:
        self._solver, self._inverse, self._blocks = inverse, None, functional.blocks
        self._first = self._blocks.Y.ndof
        blocks, mirrored = self._blocks, inverse not in FROM_LOWER_TRIANGLE
        parts = blocks.B, functional.penalty.pattern()
        self._sum = SparseSum(blocks.saddle.mat, parts, self._first, mirrored=mirrored)
        self.use(functional)

    def use(self, functional: DualFunctional) -> None:
        """Switch to another gamma.  ValueError if the functional is on other blocks."""
        if functional.blocks is not self._blocks:
            raise ValueError("functional has blocks of its own: one on the same blocks is needed")
        self.functional = functional
        self._sum.values[:] = 0.0
        self._sum.add(self._blocks.saddle.mat)
        self._sum.add(self._blocks.B, self._first, 1 / functional.weights.tichonov)
        self._constant = self._sum.values.copy()

    def factorise(self, terms: ActiveTerms | None) -> None:
        """Assemble and factorise the Newton matrix; None leaves the nonsmooth terms out.

        FactorisationError if the direct solver gives up.
        """
        self._sum.values[:] = self._constant
        if terms is not None:
            self._sum.add(terms.hessian(), self._first)
        matrix = self._sum.matrix()
        try:
            self._invert(matrix)
        except SOLVER_ERRORS as error:
            raise FactorisationError(
                f"{self._solver} could not factorise the Newton matrix: {error}"
            ) from error

    def _invert(self, matrix: object) -> None:
        if self._inverse is None:
            free = self._blocks.X.FreeDofs(coupling=True)
            self._inverse = matrix.Inverse(free, inverse=self._solver)
        else:
            self._inverse.Update()

    def solve(self, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) of (7.1) for the right hand side (0, r), with the last factors."""
        blocks, ny = self._blocks, self._blocks.Y.ndof
        right, x = (blocks.saddle.mat.CreateColVector() for _ in range(2))
        right[:] = 0.0
        right.Range(ny, blocks.X.ndof).data = r
        x.data = self._inverse * right
        x.data += blocks.saddle.harmonic_extension * x
        return tuple((1.0 * x.Range(*ends)).Evaluate() for ends in ((0, ny), (ny, blocks.X.ndof)))
