"""The regularised dual functional J*_gamma with its derivatives, and iterates of Newton's method.

The saddle function S(y, v) that both come from is that of ``ngepc.dual.saddle``:
J*_gamma(v) = max_y S(y, v), attained where D y = Lambda* v - l, and there its derivative is

    J*_gamma'(v) = Lambda y - [psi, 0] + M(v) + B v / gamma_T = -Psi_gamma,

with Psi_gamma of (6.2) at the lambda that belongs to v (proof of Proposition 6.9).
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from ngsolve import (
    CF,
    BilinearForm,
    BitArray,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    ds,
    dx,
)
from ngsolve.la import BaseMatrix, BaseVector

from ngepc._deprecated import old_names
from ngepc.checks.arguments import is_number
from ngepc.discretisation.prolongation import prolongate
from ngepc.discretisation.quadrature import (
    KINKED,
    SMOOTH,
    SMOOTH_ORDER,
    boundary_rules,
    classify,
    fine_rules,
    rules_of,
    threshold_bounds,
)
from ngepc.dual import saddle
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.spaces import Coupled
from ngepc.model.elements import elements_by_shape

ROUNDING_SAMPLES = 2
EPSILON = float(np.finfo(float).eps)


class DualFunctional:
    """J*_gamma of (D_gamma) on the discrete spaces, with blocks that a path in gamma shares.

    ``gamma_tichonov`` is that of ``Coupled``.  Elements with a kink have this number of quadrature
    ``points``, others a few or none; the rule of the boundary has the order that gives this number
    on a cell.
    """

    def __init__(
        self,
        blocks: LinearBlocks,
        points: int,
        gamma: float,
        gamma_tichonov: float | None = None,
    ) -> None:
        self.blocks = blocks
        self.points = points
        fixed = blocks.choice
        self.regularisation = Coupled(
            gamma,
            gamma_tichonov=gamma_tichonov,
            tichonov=fixed.tichonov,
            units=fixed.units,
        )
        self.weights = self.regularisation.weights
        self._v = GridFunction(blocks.H)  # where the forms are evaluated
        self._gradient = LinearForm(blocks.H)
        self._hessian = BilinearForm(blocks.H, symmetric=True, symmetric_storage=True)
        z, q = self._v.components
        (dz, dq), (w, r) = blocks.H.TnT()
        parts = self._add_contact(z, dz, w, points), self._add_plastic(q, dq, r, points)
        self._penalties, self._active = zip(*parts, strict=True)

    def __reduce__(self) -> tuple:
        """NGSolve's forms are not pickled, but made again."""
        gammas = self.regularisation.gamma, self.regularisation.gamma_tichonov
        return DualFunctional, (self.blocks, self.points, *gammas)

    def _add_contact(self, z: CF, dz: CF, w: CF, points: int) -> tuple[CF, CF]:
        """M^1 and its derivatives; the integrals of the energy and of contact, z < 0."""
        rules = boundary_rules(self.blocks.problem.N, points)
        on_contact = ds(definedon=self.blocks.contact, intrules=rules)
        penalty = saddle.ContactPenalty(z, self.weights.contact)
        self._gradient += penalty.gradient * w * on_contact
        self._hessian += penalty.curvature * dz * w * on_contact
        return penalty.density * on_contact, penalty.pressed * on_contact

    def _add_plastic(self, q: CF, dq: CF, r: CF, points: int) -> tuple[CF, CF]:
        """M^2 and its derivatives; the integrals of the energy and, by a low order, of yielding."""
        mesh = self.blocks.problem.mesh
        beta = self.blocks.problem.beta
        beta = float(beta) if is_number(beta) else beta
        fine = fine_rules(mesh.dim, points)
        smooth = rules_of(mesh.dim, SMOOTH_ORDER)
        self._elements = elements_by_shape(mesh)
        self._bounds = np.array(threshold_bounds(mesh, beta, fine))
        self._of_kind = {SMOOTH: BitArray(mesh.ne), KINKED: BitArray(mesh.ne)}
        few = dx(definedonelements=self._of_kind[SMOOTH], intrules=smooth)
        low = dx(definedonelements=self._of_kind[KINKED], intrules=smooth)
        many = dx(definedonelements=self._of_kind[KINKED], intrules=fine)
        law = saddle.RadialLaw(q, beta)
        gamma = self.weights.plastic
        density, slope, curvature = (
            (gamma * f).Compile() for f in (law.density, law.gradient, law.curvature)
        )
        for measure in (few, many):
            self._gradient += InnerProduct(slope, r) * measure
            self._hessian += InnerProduct(curvature * dq, r) * measure
        return density * few + density * many, law.inside * few + law.inside * low

    def kinds(self, v: BaseVector) -> np.ndarray:
        """The kinds of the elements at v, ``ngepc.discretisation.quadrature``."""
        q = np.array(self.blocks.parts(v)[1].FV())
        kind = np.empty(self._bounds.shape[1], int)
        q = q.reshape(self.blocks.problem.kinematics.d, -1)
        for numbers, nodes in self._elements:
            kind[numbers] = classify(q, nodes, *self._bounds[:, numbers])
        return kind

    def _enter(self, v: BaseVector, kind: np.ndarray) -> None:
        """Make the forms those at v, for these kinds of the elements."""
        self._v.vec.data = v
        for number, elements in self._of_kind.items():
            elements.Clear()
            elements |= BitArray((kind == number).tolist())

    def at(self, v: BaseVector, y: BaseVector | None = None) -> DualIterate:
        """The iterate at v; y is solved for if it is not given."""
        return DualIterate(self, v, y)

    def penalties(self, v: BaseVector, kind: np.ndarray) -> tuple[float, ...]:
        """M^1(z) and M^2(q), for the kinds of the elements at v."""
        self._enter(v, kind)
        return self._integrals(self._penalties)

    def active(self, v: BaseVector, kind: np.ndarray) -> tuple[float, ...]:
        """The measures of the contact that z presses and of what yields, by a low order."""
        self._enter(v, kind)
        return self._integrals(self._active)

    def _integrals(self, parts: tuple[CF, CF]) -> tuple[float, ...]:
        return tuple(Integrate(part, self.blocks.problem.mesh) for part in parts)

    def multipliers(self, v: BaseVector, kind: np.ndarray) -> BaseVector:
        """M(v) as a functional on H."""
        self._enter(v, kind)
        return (1.0 * self._gradient.Assemble().vec).Evaluate()

    def curvature(self, v: BaseVector, kind: np.ndarray) -> BaseMatrix:
        """The Newton derivative of M at v, a new matrix."""
        self._enter(v, kind)
        return self._hessian.Assemble(reallocate=True).mat

    def tichonov(self, v: BaseVector, w: BaseVector) -> float:
        """b(v, w) / gamma_T."""
        return InnerProduct(self.tichonov_gradient(w), v)

    def tichonov_gradient(self, v: BaseVector) -> BaseVector:
        """B v / gamma_T as a functional on H."""
        return (1 / self.weights.tichonov * (self.blocks.B * v)).Evaluate()

    def linear_residual(self, y: BaseVector, v: BaseVector) -> BaseVector:
        """Lambda y - [psi, 0] + B v / gamma_T."""
        r = (self.blocks.Lambda * y - self.blocks.psi).Evaluate()
        r += self.tichonov_gradient(v)
        return r

    def residual_norms(self, r: BaseVector) -> np.ndarray:
        """<r, B^(-1) r>^(1/2) of the parts on Gamma_c and in Omega, (2,)."""
        parts = (
            self.blocks.parts((self.blocks.B_inverse * r).Evaluate()),
            self.blocks.parts(r),
        )
        return np.sqrt(
            [max(0.0, InnerProduct(*pair)) for pair in zip(*parts, strict=True)]
        )

    def rounding(self, y: BaseVector) -> np.ndarray:
        """The effect of rounding in D y = Lambda* v - l on the norms, for any solver of y.

        Each entry of D y is uncertain by EPSILON |D| |y|, in whatever way D is assembled, and
        D^(-1) may amplify that by lambda/h.  The norms of Lambda D^(-1) e are averaged over a few e
        of that size with random signs.
        """
        blocks = self.blocks
        size = y.CreateVector()
        signs = np.random.default_rng(0)
        D = blocks.D.CreateMatrix()
        e = y.CreateVector()
        squares = np.zeros(2)
        D.AsVector().FV().NumPy()[:] = np.abs(blocks.D.AsVector().FV().NumPy())
        e.FV().NumPy()[:] = np.abs(y.FV().NumPy())
        size.data = EPSILON * (D * e)
        for _ in range(ROUNDING_SAMPLES):
            e.FV().NumPy()[:] = size.FV().NumPy() * signs.choice((-1.0, 1.0), len(size))
            image = (blocks.Lambda * blocks.primal_response(e)).Evaluate()
            squares += self.residual_norms(image) ** 2 / ROUNDING_SAMPLES
        return np.sqrt(squares)

    def carried(self, old: DualFunctional, v: BaseVector) -> BaseVector:
        """The v in H_h with the nodal values of an earlier v, on this or another mesh."""
        w = self.blocks.H_vector()
        parts = old.blocks.parts(v), self.blocks.parts(w)
        spaces = old.blocks.H.components, self.blocks.H.components
        for values, to, source, target in zip(*parts, *spaces, strict=True):
            to.FV().NumPy()[:] = prolongate(source, values, target)
        return w


class DualIterate:
    """J*_gamma at one v: the y with D y = Lambda* v - l, energy, residual, Newton derivative.

    Each is computed when it is first asked for, and does not depend on what was computed elsewhere
    in between.  ``y`` is solved for if it is not given.
    """

    def __init__(
        self, functional: DualFunctional, v: BaseVector, y: BaseVector | None = None
    ) -> None:
        self.functional = functional
        self.v = (1.0 * v).Evaluate()
        self._kind = functional.kinds(v)
        if y is not None:
            self.y = y

    @cached_property
    def y(self) -> BaseVector:
        """D y = Lambda* v - l."""
        return self.functional.blocks.primal_of(self.v)

    @cached_property
    def penalties(self) -> tuple[float, ...]:
        """M^1(z) and M^2(q)."""
        return self.functional.penalties(self.v, self._kind)

    @cached_property
    def active(self) -> tuple[float, ...]:
        """The measures of the contact that z presses and of what yields, by a low order."""
        return self.functional.active(self.v, self._kind)

    @cached_property
    def multipliers(self) -> BaseVector:
        """M(v) = (mu, nu) as a functional on H."""
        return self.functional.multipliers(self.v, self._kind)

    def hessian(self) -> BaseMatrix:
        """The Newton derivative of M at v, assembled at each call."""
        return self.functional.curvature(self.v, self._kind)

    @cached_property
    def residual(self) -> BaseVector:
        """J*_gamma'(v) = -Psi_gamma as a functional on H."""
        return (
            self.functional.linear_residual(self.y, self.v) + self.multipliers
        ).Evaluate()

    @cached_property
    def norms(self) -> np.ndarray:
        """||Psi_gamma||_{H*} of the parts on Gamma_c and in Omega, (2,)."""
        return self.functional.residual_norms(self.residual)

    @property
    def residual_norm(self) -> float:
        """||Psi_gamma||_{H*}."""
        return total(self.norms)

    @cached_property
    def smooth_energy(self) -> float:
        """The quadratic part of J*_gamma, F*(Lambda* v) - (psi, z) + T(v)."""
        f = self.functional
        v = self.v
        conjugate = f.blocks.conjugate(self.y, v) - InnerProduct(f.blocks.psi, v)
        return conjugate + f.tichonov(v, v) / 2

    @property
    def energy(self) -> float:
        """J*_gamma(v)."""
        return self.smooth_energy + sum(self.penalties)

    @property
    def magnitude(self) -> float:
        """Size of the terms that the energy is summed from."""
        return abs(self.smooth_energy) + abs(sum(self.penalties))


def total(norms: np.ndarray) -> float:
    """||Psi_gamma||_{H*} from its norms on Gamma_c and in Omega."""
    return math.sqrt((norms**2).sum())


__getattr__ = old_names(__name__)
