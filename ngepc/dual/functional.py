"""The regularised dual functional J*_gamma, its residual and the Newton system (7.1).

With y = (u, p) and v = (z, q) everything comes from the saddle function

    S(y, v) = -1/2 <D y, y> - l(y) + <Lambda y - [psi, 0], v> + M^1(z) + M^2(q) + T(v),

concave in y, convex in v:  J*_gamma(v) = max_y S(y, v), attained where D y = Lambda* v - l, and
Psi_gamma = Lambda y - [psi, 0] + M(v) + B v / gamma_T there.  Its second derivative is (7.1)
with the first row negated: symmetric and quasi-definite, so that LDL^T needs no pivoting.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.contact import ContactConstraint
from ngepc.dual.regularisation import Regularisation, check_shifts
from ngepc.linalg.assembly import Placed, SparseSum
from ngepc.linalg.factors import SOLVER_ERRORS, factors
from ngepc.parallel import total

ROUNDING_SAMPLES = 2


@dataclass(frozen=True)
class ResidualNorms:
    """||Psi_gamma||_{H*} of the parts of v, by their Poisson problems.

    Parameters
    ----------
    by_part
        Part name -> norm; 'contact', 'friction' and 'plastic', those that there are.
    """

    by_part: dict[str, float]

    @property
    def total(self) -> float:
        """Norm of the whole residual."""
        return math.sqrt(sum(norm**2 for norm in self.by_part.values()))


class DualFunctional:
    """J*_gamma of (D_gamma) on the discrete spaces, for one regularisation.

    Parameters
    ----------
    blocks
        The linear part; it can be shared along a path in gamma.
    regularisation
        The parameters of the nonsmooth and Tichonov terms.
    quadrature_points
        Points for the nonsmooth terms on elements that a kink crosses.

    Attributes
    ----------
    penalties
        The nonsmooth terms, one for each part of v.
    constraint
        The term z <= 0 of exact contact; None with a contact penalty or without contact.
    """

    def __init__(
        self, blocks: LinearBlocks, regularisation: Regularisation, quadrature_points: int
    ) -> None:
        check_shifts(blocks.problem, regularisation)
        regularisation = regularisation.resolved(blocks.problem)
        self.blocks, self.regularisation = blocks, regularisation
        self.gamma_T = regularisation.gamma_tichonov
        self.penalties = [
            part.penalty(blocks.problem, regularisation, space, quadrature_points)
            for part, space in zip(blocks.parts, blocks.spaces, strict=True)
        ]
        constraints = (M for M in self.penalties if isinstance(M, ContactConstraint))
        self.constraint = next(constraints, None)

    @property
    def residual_unit(self) -> float:
        """The unit of ||Psi_gamma||_{H*}, length^(N/2 + 1) of the reference units."""
        return self.regularisation.units.length ** (self.blocks.problem.N / 2 + 1)

    def penalty(self, v: BaseVector) -> float:
        """M^1(z) + M^2(q)."""
        parts = enumerate(self.penalties)
        return sum(M.energy(self.blocks.part_of(v, i)) for i, M in parts)

    def tichonov(self, v: BaseVector, w: BaseVector) -> float:
        """b(v, w) / gamma_T."""
        return InnerProduct(self.tichonov_gradient(w), v)

    def tichonov_gradient(self, v: BaseVector) -> BaseVector:
        """B v / gamma_T as a functional on H."""
        g = self.blocks.psi.CreateVector()
        for i, B in enumerate(self.blocks.B):
            self.blocks.part_of(g, i).data = 1 / self.gamma_T * (B * self.blocks.part_of(v, i))
        return g

    def smooth_energy(self, y: BaseVector, v: BaseVector) -> float:
        """F*(Lambda* v) - (psi, z) + T(v), with y the solution of D y = Lambda* v - l."""
        conjugate = self.blocks.conjugate(y, v) - InnerProduct(self.blocks.psi, v)
        return conjugate + self.tichonov(v, v) / 2

    def active(self, v: BaseVector) -> dict[str, float]:
        """Part name -> measure of its active set: contact, yielding, slip."""
        return {
            part.name: M.active(self.blocks.part_of(v, i))
            for i, (part, M) in enumerate(zip(self.blocks.parts, self.penalties, strict=True))
        }

    def linear_residual(self, y: BaseVector, v: BaseVector) -> BaseVector:
        """Lambda y + s(q, .) - [psi, 0] + B v / gamma_T."""
        r = v.CreateVector()
        r.data = self.blocks.conjugate_gradient(y, v) - self.blocks.psi
        r += self.tichonov_gradient(v)
        return r

    def penalty_gradient(self, v: BaseVector) -> BaseVector:
        """M(v) as a functional on H."""
        g = self.blocks.psi.CreateVector()
        for i, M in enumerate(self.penalties):
            self.blocks.part_of(g, i).data = M.gradient(self.blocks.part_of(v, i))
        return g

    def residual(self, y: BaseVector, v: BaseVector) -> BaseVector:
        """Psi_gamma = Lambda y - [psi, 0] + M(v) + B v / gamma_T as a functional on H."""
        r = self.linear_residual(y, v)
        r += self.penalty_gradient(v)
        return r

    def rounding(self, y: BaseVector) -> ResidualNorms:
        """What rounding in D y = Lambda* v - l leaves of the residual, whatever solver finds y.

        Each entry of D y is uncertain by EPSILON |D| |y|, and D^(-1) may amplify that by lambda/h.
        The norms of Lambda D^(-1) e are averaged over a few e of that size with random signs.
        """
        sizes, signs = self.blocks.rounding_of(y), np.random.default_rng(0)
        e, squares = self.blocks.load.CreateVector(), Counter()
        for _ in range(ROUNDING_SAMPLES):
            e.FV().NumPy()[:] = sizes.FV().NumPy() * signs.choice((-1.0, 1.0), len(sizes))
            image = (self.blocks.Lambda * self.blocks.primal_response(e)).Evaluate()
            by_part = self.residual_norms(image).by_part
            squares.update({name: norm**2 / ROUNDING_SAMPLES for name, norm in by_part.items()})
        return ResidualNorms({name: math.sqrt(square) for name, square in squares.items()})

    def stationarity_norms(self, v: BaseVector, r: BaseVector) -> ResidualNorms:
        """Norms of the residual r at v, with the multiplier of exact contact added."""
        if self.constraint is None:
            return self.residual_norms(r)
        number, natural = self.penalties.index(self.constraint), r.CreateVector()
        natural.data = r
        z, part = self.blocks.part_of(v, number), self.blocks.part_of(natural, number)
        part.data = self.constraint.stationary(z, part)
        return self.residual_norms(natural)

    def make_feasible(self, v: BaseVector) -> None:
        """Project z onto z <= 0 where exact contact asks for it, in place."""
        if self.constraint is not None:
            self.constraint.project(self.blocks.part_of(v, self.penalties.index(self.constraint)))

    def longest_step(self, v: BaseVector, dv: BaseVector) -> float:
        """The largest alpha that keeps v + alpha dv feasible, infinity without constraint."""
        if self.constraint is None:
            return math.inf
        number = self.penalties.index(self.constraint)
        z, dz = self.blocks.part_of(v, number), self.blocks.part_of(dv, number)
        return self.constraint.longest_step(z, dz)

    def residual_norms(self, r: BaseVector) -> ResidualNorms:
        """<r, B^(-1) r>^(1/2) of each part."""
        norms = {}
        for i, (part, inverse) in enumerate(
            zip(self.blocks.parts, self.blocks.B_inverse, strict=True)
        ):
            component = self.blocks.part_of(r, i)
            riesz = component.CreateVector()
            riesz.data = inverse * component
            square = total(InnerProduct(riesz, component), self.blocks.problem.mesh)
            norms[part.name] = math.sqrt(max(0.0, square))
        return ResidualNorms(norms)


class FactorisationError(RuntimeError):
    """A direct solver that gave up on a Newton matrix."""


class NewtonSystem:
    """(7.1) in one fixed sparsity pattern: constant part, B / gamma_T, Newton derivatives.

    Parameters
    ----------
    functional
        The first functional to be used; later ones must share its blocks.
    inverse
        NGSolve's name of the direct solver.

    Attributes
    ----------
    back_substitutions
        Solves with the factors in the last ``step``.
    linear_iterations
        Iterations of a Krylov solver in them: none.
    """

    linear_iterations = 0

    def __init__(self, functional: DualFunctional, inverse: str) -> None:
        self._inverse_name, self._inverse, self.back_substitutions = inverse, None, 0
        blocks = self.blocks = functional.blocks
        self._firsts = [blocks.Y.ndof + int(first) for first in blocks.firsts[:-1]]
        patterns = [
            Placed(M.pattern(), f) for M, f in zip(functional.penalties, self._firsts, strict=True)
        ]
        self._sum = SparseSum(blocks.saddle.mat.local_mat, [*self._tichonov(), *patterns])
        self.use(functional)

    def _tichonov(self) -> list[Placed]:
        return [Placed(B, first) for B, first in zip(self.blocks.B, self._firsts, strict=True)]

    def use(self, functional: DualFunctional) -> None:
        """Switch to another regularisation on the same blocks."""
        self.functional = functional
        self._sum.entries[:] = 0.0
        self._sum.add(Placed(self.blocks.saddle.mat.local_mat))
        for B in self._tichonov():
            self._sum.add(B, 1 / functional.gamma_T)
        self._constant = self._sum.entries.copy()

    @property
    def has_factors(self) -> bool:
        """Whether there has been a factorisation, so that ``direction`` can be asked for."""
        return self._inverse is not None

    def factorise(self, v: BaseVector | None) -> None:
        """Assemble and factorise the Newton matrix at v; None leaves the nonsmooth terms out.

        Raises
        ------
        FactorisationError
            If the direct solver gives up.
        """
        self._sum.entries[:] = self._constant
        for i, (M, first) in enumerate(zip(self.functional.penalties, self._firsts, strict=True)):
            if v is not None:
                self._sum.add(Placed(M.hessian(self.blocks.part_of(v, i)), first))
        self._finish()
        try:
            self._invert()
        except SOLVER_ERRORS as error:
            raise FactorisationError(
                f"{self._inverse_name} could not factorise the Newton matrix: {error}"
            ) from error

    def _invert(self) -> None:
        if self._inverse is None:
            X = self.blocks.X
            free = X.FreeDofs(coupling=True)
            self._inverse = factors(self._sum.matrix, X, free, self._inverse_name)
        else:
            self._inverse.Update()

    def _finish(self) -> None:
        """A last change of the assembled matrix before it is factorised."""

    def step(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """Factorise at v and solve for the Newton step (delta y, delta v); r is the residual."""
        self.factorise(v)
        self.back_substitutions = 0
        return self.direction(v, r)

    def direction(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) at v, where the residual is r, with the last factors."""
        return self.solve((-r).Evaluate())

    def solve(self, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) of (7.1) for the right hand side (0, r), with the last factors."""
        return self._completed(self._back_substitution(self._right_hand_side(r)))

    def _right_hand_side(self, r: BaseVector) -> BaseVector:
        """(0, r) as one vector."""
        right = self._sum.matrix.CreateColVector()
        right[:] = 0.0
        right.Range(self.blocks.Y.ndof, self.blocks.X.ndof).data = r.local_vec
        return right

    def _back_substitution(self, right: BaseVector) -> BaseVector:
        """The solution (u, 0, v), without the plastic strains inside the elements."""
        self.back_substitutions += 1
        x = right.CreateVector()
        x.data = self._inverse * right
        return x

    def _completed(self, x: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) from the solution without plastic strains."""
        blocks, ny = self.blocks, self.blocks.Y.ndof
        x.data += blocks.saddle.harmonic_extension.local_mat * x
        dy, dv = blocks.Y_vector(), blocks.H_vector()
        dy.local_vec.data, dv.local_vec.data = x.Range(0, ny), x.Range(ny, blocks.X.ndof)
        return dy, dv
