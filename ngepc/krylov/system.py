"""(7.1) by MINRES with a block-diagonal preconditioner.

With p eliminated it reads, on increments of u and of each part of v,

    [-A   L^T] [du]   [ 0 ]
    [ L   S  ] [dv] = [-r ],      S = diag(B_z / gamma_T + M^1'', Pi / c + B_q / gamma_T + M^2''),

symmetric and quasi-definite.  The preconditioner has a multigrid cycle for the tangent elasticity
T, which is close to A + L^T S^(-1) L, another one for the plastic block of S, and the inverses of
the surface blocks, small ones, with an approximation of L T^(-1) L^T added.  With A + L^T S^(-1) L
and S themselves the eigenvalues would lie in [-1, -0.61] and [1, 1.62] whatever A and S are.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from ngsolve.la import BaseMatrix, BaseVector, BlockMatrix, BlockVector, SparseMatrixd

from ngepc.dual.functional import DualFunctional
from ngepc.krylov import surface
from ngepc.krylov.hierarchy import levels
from ngepc.krylov.iterative import minres
from ngepc.krylov.matrices import Mirrored, block
from ngepc.krylov.multigrid import VCycle
from ngepc.krylov.solver import Krylov
from ngepc.krylov.tangent import TangentElasticity
from ngepc.linalg.assembly import Placed, SparseSum

TIGHTEST = 1e-5
"""The smallest relative residual that MINRES is asked for."""


class DualBlock:
    """One diagonal block of S, with both triangles.

    Parameters
    ----------
    constant
        Lower triangle of what neither gamma_T nor v changes.
    B
        The block of the Tichonov product.
    pattern
        A matrix with the pattern of the Newton derivative.
    """

    def __init__(self, constant: SparseMatrixd, B: SparseMatrixd, pattern: SparseMatrixd) -> None:
        self._constant, self._B = Placed(constant), Placed(B)
        self._sum = SparseSum(constant, [self._B, Placed(pattern)])
        self._mirrored = Mirrored(self._sum.matrix)
        self.matrix = self._mirrored.matrix

    def use(self, gamma_T: float) -> None:
        """Set the Tichonov parameter."""
        self._sum.entries[:] = 0.0
        self._sum.add(self._constant)
        self._sum.add(self._B, 1 / gamma_T)
        self._start = self._sum.entries.copy()

    def update(self, hessian: SparseMatrixd | None) -> None:
        """Add a Newton derivative; None for zero."""
        self._sum.entries[:] = self._start
        if hessian is not None:
            self._sum.add(Placed(hessian))
        self._mirrored.update(self._sum.matrix)


class KrylovSystem:
    """(7.1) by MINRES with a block-diagonal preconditioner.

    Parameters
    ----------
    functional
        The first functional to be used; later ones must share its blocks.
    solver
        Options.

    Attributes
    ----------
    back_substitutions, linear_iterations
        MINRES solves in the last ``step``, and their iterations.
    """

    def __init__(self, functional: DualFunctional, solver: Krylov) -> None:
        self._solver, blocks = solver, functional.blocks
        self.blocks, self.back_substitutions, self.linear_iterations = blocks, 0, 0
        self._tolerance, self._last_norm = solver.forcing, 0.0
        self._A = blocks.u_inverse.A
        saddle, u = blocks.saddle.mat, range(self._A.height)
        firsts = (blocks.Y.ndof + blocks.firsts).tolist()
        ranges = [range(a, b) for a, b in pairwise(firsts)]
        self._L = [block(saddle, part, u) for part in ranges]
        parts = zip(ranges, blocks.B, functional.penalties, strict=True)
        self._S = [DualBlock(block(saddle, k, k), B, M.pattern()) for k, B, M in parts]
        self._family = levels(blocks.spaces[-1])
        self._preconditioner: BlockMatrix | None = None
        self._free = [np.array(space.FreeDofs(), dtype=bool) for space in blocks.spaces]
        self._matrix = _saddle(self._A, self._L, [S.matrix for S in self._S])
        self.use(functional)

    def use(self, functional: DualFunctional) -> None:
        """Switch to another regularisation on the same blocks."""
        self.functional = functional
        self._tangent = TangentElasticity(functional)
        for S in self._S:
            S.use(functional.gamma_T)

    @property
    def has_factors(self) -> bool:
        """Whether there are preconditioners, so that ``direction`` can be asked for."""
        return self._preconditioner is not None

    def factorise(self, v: BaseVector | None) -> None:
        """Assemble the blocks and their preconditioners at v; None leaves the max terms out."""
        for i, (S, M) in enumerate(zip(self._S, self.functional.penalties, strict=True)):
            S.update(None if v is None else M.hessian(self.blocks.part_of(v, i)))
        q = None if v is None else self.blocks.part_of(v, len(self._S) - 1)
        family = self.blocks.u_inverse.family
        T = self._tangent.matrices(q, len(family))
        self._elastic = VCycle(T, family, self._solver.sweeps)
        self._schur = [surface.schur_complement(L, self._elastic) for L in self._L[:-1]]
        self._plastic = VCycle([self._S[-1].matrix], self._family, 1)
        self._precondition(self._free)

    def _precondition(self, free: list[np.ndarray]) -> None:
        """The block-diagonal preconditioner on the free degrees of freedom of the surface parts."""
        surfaces = [
            surface.inverse(S.matrix, schur, f)
            for S, schur, f in zip(self._S[:-1], self._schur, free[:-1], strict=True)
        ]
        self._preconditioner = _diagonal_matrix([self._elastic, *surfaces, self._plastic])

    def step(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """The Newton step (delta y, delta v) at v, where the residual is r.

        Raises
        ------
        KrylovError
            If a Krylov solver does not converge.
        """
        norm = self.functional.stationarity_norms(v, r).total
        quadratic = 0.5 * (norm / self._last_norm) ** 2 if self._last_norm > 0 else 1.0
        self._tolerance = min(self._solver.forcing, max(quadratic, TIGHTEST))
        self._last_norm = norm
        self.factorise(v)
        self.back_substitutions = self.linear_iterations = 0
        return self.direction(v, r)

    def direction(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) at v, where the residual is r, with the blocks of ``factorise``."""
        dv = self.blocks.H_vector()
        x = self._unknowns()
        self._solve((-r).Evaluate(), dv, x)
        return self._completed(x, dv)

    def _unknowns(self) -> BlockVector:
        """Zero increments of u and of the parts of v."""
        sizes = [self._A, *(S.matrix for S in self._S)]
        x = BlockVector([A.CreateColVector() for A in sizes])
        x[:] = 0.0
        return x

    def _solve(self, r: BaseVector, given: BaseVector, x: BlockVector) -> None:
        """MINRES for right-hand side (0, r) and given values where v is not free, from ``x``."""
        shift, b = self._unknowns(), self._unknowns()
        for i in range(len(self._S)):
            shift[i + 1].data = self.blocks.part_of(given, i)
            b[i + 1].data = self.blocks.part_of(r, i)
        b.data -= self._matrix * shift
        most = self._solver.max_iterations
        self.back_substitutions += 1
        self.linear_iterations += minres(
            self._matrix, self._preconditioner, b, x, self._tolerance, most
        )
        x += shift

    def _completed(self, x: BlockVector, dv: BaseVector) -> tuple[BaseVector, BaseVector]:
        """The step with the parts of v from ``x``, and D dy = Lambda* dv to full accuracy."""
        for i in range(len(self._S)):
            self.blocks.part_of(dv, i).data = x[i + 1]
        return self.blocks.primal_change(dv, x[0]), dv


def _saddle(A: SparseMatrixd, L: list[SparseMatrixd], S: list[SparseMatrixd]) -> BlockMatrix:
    first = [-1 * A, *(Li.T for Li in L)]
    rows = [
        [Li, *(Si if i == j else None for j in range(len(S)))]
        for i, (Li, Si) in enumerate(zip(L, S, strict=True))
    ]
    return BlockMatrix([first, *rows])


def _diagonal_matrix(parts: list[BaseMatrix]) -> BlockMatrix:
    n = range(len(parts))
    return BlockMatrix([[parts[i] if i == j else None for j in n] for i in n])
