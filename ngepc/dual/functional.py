"""The regularised dual functional J*_gamma and its residual.

With y = (u, p) and v = (z, q) everything comes from the saddle function

    S(y, v) = -1/2 <D y, y> - l(y) + <Lambda y - [psi, 0], v> + M^1(z) + M^2(q) + T(v),

    M^1(z) = gamma_z/2 |[z]^+|^2,   M^2(q) = gamma_q/2 |[|q| - beta]^+|^2,
    T(v) = b(v, v) / (2 gamma_T),

concave in y, convex in v:  J*_gamma(v) = max_y S(y, v), attained where D y = Lambda* v - l, and
Psi_gamma = Lambda y - [psi, 0] + M(v) + B v / gamma_T there.  The paper takes one gamma.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from ngsolve import H1, GridFunction, InnerProduct
from ngsolve.la import BaseVector

from ngepc.discretisation.prolongation import prolongate
from ngepc.dual.blocks import CONTACT, PLASTIC, LinearBlocks
from ngepc.dual.penalty import ActiveTerms, Penalty
from ngepc.dual.spaces import Coupled
from ngepc.model.problem import as_scalar

ROUNDING_SAMPLES = 2


class ResidualNorms(dict[str, float]):
    """||Psi_gamma||_{H*} of the parts of v by name, 'contact' and 'plastic'."""

    @property
    def total(self) -> float:
        """Norm of the whole residual."""
        return math.sqrt(sum(norm**2 for norm in self.values()))

    def plus(self, more: ResidualNorms) -> ResidualNorms:
        """The sums, part by part."""
        return ResidualNorms({name: norm + more[name] for name, norm in self.items()})


class DualFunctional:
    """J*_gamma of (D_gamma) on the discrete spaces.

    The blocks can be shared along a path in gamma; ValueError if they were assembled for another
    product or other units.  ``quadrature_points`` are those of elements that a kink crosses.
    """

    def __init__(
        self, blocks: LinearBlocks, regularisation: Coupled, quadrature_points: int
    ) -> None:
        if regularisation.spaces != blocks.choice:
            raise ValueError(
                f"regularisation={regularisation!r}: tichonov and units of the blocks are needed, "
                f"{blocks.choice!r}"
            )
        self.blocks, self.regularisation = blocks, regularisation
        self.weights = regularisation.weights
        self.penalty = Penalty(blocks, self.weights, quadrature_points)

    def terms(self, v: BaseVector) -> ActiveTerms:
        """M^1 and M^2 at v."""
        return ActiveTerms(self.penalty, v)

    def tichonov(self, v: BaseVector, w: BaseVector) -> float:
        """b(v, w) / gamma_T."""
        return InnerProduct(self.tichonov_gradient(w), v)

    def tichonov_gradient(self, v: BaseVector) -> BaseVector:
        """B v / gamma_T as a functional on H."""
        return (1 / self.weights.tichonov * (self.blocks.B * v)).Evaluate()

    def smooth_energy(self, y: BaseVector, v: BaseVector) -> float:
        """F*(Lambda* v) - (psi, z) + T(v), with y the solution of D y = Lambda* v - l."""
        conjugate = self.blocks.conjugate(y, v) - InnerProduct(self.blocks.psi, v)
        return conjugate + self.tichonov(v, v) / 2

    def linear_residual(self, y: BaseVector, v: BaseVector) -> BaseVector:
        """Lambda y - [psi, 0] + B v / gamma_T."""
        r = (self.blocks.Lambda * y - self.blocks.psi).Evaluate()
        r += self.tichonov_gradient(v)
        return r

    def residual_norms(self, r: BaseVector) -> ResidualNorms:
        """<r, B^(-1) r>^(1/2) of each part."""
        riesz, part_of = (self.blocks.B_inverse * r).Evaluate(), self.blocks.part_of
        squares = {n: InnerProduct(part_of(riesz, n), part_of(r, n)) for n in self.blocks.spaces}
        return ResidualNorms({name: math.sqrt(max(0.0, s)) for name, s in squares.items()})

    def rounding(self, y: BaseVector) -> ResidualNorms:
        """What rounding in D y = Lambda* v - l leaves of the residual, whatever solver finds y.

        Each entry of D y is uncertain by EPSILON |D| |y|, and D^(-1) may amplify that by lambda/h.
        The norms of Lambda D^(-1) e are averaged over a few e of that size with random signs.
        """
        sizes, signs = self.blocks.rounding_of(y), np.random.default_rng(0)
        e, squares = self.blocks.Y_vector(), Counter()
        for _ in range(ROUNDING_SAMPLES):
            e.FV().NumPy()[:] = sizes.FV().NumPy() * signs.choice((-1.0, 1.0), len(sizes))
            image = (self.blocks.Lambda * self.blocks.primal_response(e)).Evaluate()
            norms = self.residual_norms(image)
            squares.update({name: norm**2 / ROUNDING_SAMPLES for name, norm in norms.items()})
        return ResidualNorms({name: math.sqrt(square) for name, square in squares.items()})

    def carried(self, old: DualFunctional, v: BaseVector) -> BaseVector:
        """The v in H_h that belongs to v of an earlier problem, on this or another mesh.

        P1 interpolation of nodal values.  What belongs together in two regularisations are equal
        multipliers, |p| = gamma_q [|q| - beta]^+ and mu = gamma_z [z]^+: the excess of |q| and of z
        is scaled by the quotient of the gammas.
        """
        blocks, w = self.blocks, self.blocks.H_vector()
        same_mesh = old.blocks.problem.mesh is blocks.problem.mesh
        for name, target in blocks.spaces.items():
            values, source = old.blocks.part_of(v, name), old.blocks.spaces[name]
            if same_mesh and source.ndof == target.ndof:
                carried = values.FV().NumPy() * np.array(target.FreeDofs(), dtype=float)
            else:
                carried = prolongate(source, values, target)
            blocks.part_of(w, name).FV().NumPy()[:] = carried
        self._keep_multipliers(old, w)
        return w

    def _keep_multipliers(self, old: DualFunctional, v: BaseVector) -> None:
        """Scale the excess of z and |q| by the quotients of the gammas, in place."""
        problem, before, after = self.blocks.problem, old.weights, self.weights
        if before.plastic != after.plastic:
            beta = GridFunction(H1(problem.mesh, order=1))  # where it jumps, the mean
            beta.Set(as_scalar(problem.beta))
            q = self.blocks.part_of(v, PLASTIC).FV().NumPy().reshape(problem.kinematics.d, -1)
            q[:] = scaled_excess(q, beta.vec.FV().NumPy(), before.plastic / after.plastic)
        if CONTACT in self.blocks.spaces:
            z = self.blocks.part_of(v, CONTACT).FV().NumPy()
            z[z > 0] *= before.contact / after.contact


def scaled_excess(q: np.ndarray, threshold: np.ndarray | float, ratio: float) -> np.ndarray:
    """Nodal values q, shape (d, nodes), with |q| - threshold times ``ratio`` where positive."""
    size = np.sqrt((q * q).sum(axis=0))
    excess = np.maximum(size - threshold, 0.0)
    return q * (1 + (ratio - 1) * excess / np.where(size > 0, size, 1.0))
