"""The nonsmooth terms M^1 and M^2 of (D_gamma) and their derivatives, by NGSolve's forms."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import (
    BilinearForm,
    BitArray,
    CoefficientFunction,
    FESpace,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    OuterProduct,
    ds,
    dx,
)
from ngsolve.la import BaseMatrix, BaseVector

from ngepc.checks.arguments import is_number
from ngepc.discretisation.quadrature import (
    KINKED,
    SMOOTH,
    boundary_rules,
    classify,
    fine_rules,
    smooth_rules,
    threshold_bounds,
)
from ngepc.dual.parameters import Weights
from ngepc.dual.radial import RadialLaw
from ngepc.model.elements import element_numbers, element_vertices
from ngepc.model.problem import Problem, as_scalar


class AssembledTerm:
    """A nonsmooth term M by forms around the function at which they are assembled.

    Parameters
    ----------
    function
        The grid function in the forms.
    energy, active
        M and the measure of its active set as integrals.
    gradient, hessian
        M' and its Newton derivative.
    """

    def __init__(
        self,
        function: GridFunction,
        energy: CoefficientFunction,
        active: CoefficientFunction,
        gradient: LinearForm,
        hessian: BilinearForm,
    ) -> None:
        self.function, self.energy, self.active = function, energy, active
        self.gradient, self.hessian = gradient, hessian

    def at(self, v: BaseVector) -> AssembledState:
        """The term at v, with its active set."""
        return AssembledState(self, v)

    def sort(self, v: BaseVector) -> np.ndarray | None:
        """The active elements at v, where the forms ask for them."""
        return None

    def enter(self, v: BaseVector, kind: np.ndarray | None) -> None:
        """Make v and its active elements those of the forms."""
        self.function.vec.data = v

    def pattern(self) -> BaseMatrix:
        """A matrix with all entries that a Newton derivative may ever have."""
        return self.hessian.Assemble(reallocate=True).mat


class AssembledState:
    """A nonsmooth term at one v: its active set, and what follows from it.

    Parameters
    ----------
    term
        The term.
    v
        The function as coefficients.
    """

    def __init__(self, term: AssembledTerm, v: BaseVector) -> None:
        self._term, self._v = term, v.CreateVector()
        self._v.data = v
        self._kind = term.sort(v)

    def _forms(self) -> AssembledTerm:
        self._term.enter(self._v, self._kind)
        return self._term

    @cached_property
    def energy(self) -> float:
        """M(v)."""
        return Integrate(self._forms().energy, self._term.function.space.mesh)

    @cached_property
    def active(self) -> float:
        """Measure of the active set, by a low order: for records."""
        return Integrate(self._forms().active, self._term.function.space.mesh)

    @cached_property
    def gradient(self) -> BaseVector:
        """M'(v) as a functional."""
        assembled = self._forms().gradient.Assemble().vec
        gradient = assembled.CreateVector()
        gradient.data = assembled
        return gradient

    def hessian(self) -> BaseMatrix:
        """The Newton derivative of M' at v; the next one overwrites it."""
        return self._forms().hessian.Assemble(reallocate=True).mat


class ContactPenalty(AssembledTerm):
    """M^1(z) = 1/(2 gamma) |[mu^ + gamma z]^+|^2 on Gamma_c, with Lemma 6.2.

    M^1'(z) = [mu^ + gamma z]^+, its Newton derivative gamma chi on the set where that is positive;
    active is the contact, z + mu^/gamma < 0.

    Parameters
    ----------
    problem, weights
        The data.
    Z
        The space of z.
    quadrature_points
        As for the domain; the boundary rule has the same order.
    """

    def __init__(
        self, problem: Problem, weights: Weights, Z: FESpace, quadrature_points: int
    ) -> None:
        gamma, z = weights.contact, GridFunction(Z)
        on_contact = ds(
            "|".join(problem.contact_names),
            intrules=boundary_rules(problem.N, quadrature_points),
        )
        mu = as_scalar(weights.contact_shift) + gamma * z  # (OC2_gamma): mu = [mu^ + gamma z]^+
        dz, w = Z.TnT()
        gradient = LinearForm(Z)
        gradient += IfPos(mu, mu, 0) * w * on_contact
        hessian = BilinearForm(Z, symmetric=True, symmetric_storage=True)
        hessian += IfPos(mu, gamma, 0.0) * dz * w * on_contact
        energy = IfPos(mu, mu * mu, 0) / (2 * gamma) * on_contact
        super().__init__(z, energy, IfPos(-mu, 1.0, 0.0) * on_contact, gradient, hessian)


class PlasticPenalty(AssembledTerm):
    """M^2(q) = int 1/(2 gamma) ([nu^ + gamma (|q| - beta_gamma)]^+)^2, with Lemma 6.3.

    That is gamma times the ``RadialLaw`` with the threshold beta_gamma - nu^/gamma.

    Parameters
    ----------
    problem, weights
        The data.
    R
        The space of q.
    quadrature_points
        Points on elements that the kink crosses.
    """

    def __init__(
        self, problem: Problem, weights: Weights, R: FESpace, quadrature_points: int
    ) -> None:
        mesh, N, gamma = problem.mesh, problem.N, weights.plastic
        threshold = weights.threshold
        threshold = float(threshold) if is_number(threshold) else threshold
        fine, smooth = fine_rules(N, quadrature_points), smooth_rules(N)
        self._elements = list(zip(element_vertices(mesh), element_numbers(mesh), strict=True))
        self._low, self._high = threshold_bounds(mesh, threshold, fine)
        self._of_kind = {SMOOTH: BitArray(mesh.ne), KINKED: BitArray(mesh.ne)}
        measures, low = (
            [
                dx(definedonelements=self._of_kind[SMOOTH], intrules=smooth),
                dx(definedonelements=self._of_kind[KINKED], intrules=rules),
            ]
            for rules in (fine, smooth)
        )
        q, (dq, r) = GridFunction(R), R.TnT()
        law = RadialLaw(Norm(q), threshold)
        direction = q / law.size
        curvature = law.slope * Id(q.dim) + law.across * OuterProduct(direction, direction)
        density, slope, curvature = (
            (gamma * f).Compile() for f in (law.density, law.slope * q, curvature)
        )
        gradient = LinearForm(R)
        hessian = BilinearForm(R, symmetric=True, symmetric_storage=True)
        for m in measures:
            gradient += InnerProduct(slope, r) * m
            hessian += InnerProduct(curvature * dq, r) * m
        energy, active = sum(density * m for m in measures), sum(law.inside * m for m in low)
        super().__init__(q, energy, active, gradient, hessian)

    def sort(self, v: BaseVector) -> np.ndarray:
        """The kinds of the elements, ``ngepc.discretisation.quadrature``."""
        q, kind = np.array(v.FV()).reshape(self.function.dim, -1), np.empty(len(self._low), int)
        for nodes, numbers in self._elements:
            kind[numbers] = classify(q, nodes, self._low[numbers], self._high[numbers])
        return kind

    def enter(self, v: BaseVector, kind: np.ndarray) -> None:
        """Make v and the kinds of the elements those of the forms."""
        super().enter(v, kind)
        for number, elements in self._of_kind.items():
            elements.Clear()
            elements |= BitArray((kind == number).tolist())

    def pattern(self) -> BaseMatrix:
        """A matrix with all entries that a Newton derivative may ever have."""
        self.enter(self.function.vec, np.full(len(self._low), SMOOTH))
        return super().pattern()
