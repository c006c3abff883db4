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
    IntegrationRule,
    LinearForm,
    Norm,
    OuterProduct,
    ds,
    dx,
)
from ngsolve.la import BaseMatrix, BaseVector

from ngepc.checks.arguments import ELEMENT_TYPES, is_number
from ngepc.discretisation.elements import element_numbers, element_vertices
from ngepc.discretisation.quadrature import (
    IDLE,
    boundary_rules,
    fine_rules,
    ranks,
    smooth_orders,
    threshold_bounds,
)
from ngepc.dual.parameters import Weights
from ngepc.dual.radial import RadialLaw
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

    def enter(self, v: BaseVector, rank: np.ndarray | None) -> None:
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
        self._rank = term.sort(v)

    def _forms(self) -> AssembledTerm:
        self._term.enter(self._v, self._rank)
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
        fine, smooth = fine_rules(N, quadrature_points), smooth_orders(N, quadrature_points)
        rules = [_rules(N, order) for _, order in smooth]
        self._variations = [variation for variation, _ in smooth]
        self._elements = list(zip(element_vertices(mesh), element_numbers(mesh), strict=True))
        self._low, self._high = threshold_bounds(mesh, threshold, fine)
        self._ranked = [BitArray(mesh.ne) for _ in (*rules, fine)]
        measures, low = (
            [
                dx(definedonelements=of_rank, intrules=rule)
                for of_rank, rule in zip(self._ranked, chosen, strict=True)
            ]
            for chosen in ((*rules, fine), (rules[0],) * len(self._ranked))
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
        inside = IfPos(law.excess, 1.0, 0.0)
        energy, active = sum(density * m for m in measures), sum(inside * m for m in low)
        super().__init__(q, energy, active, gradient, hessian)

    def sort(self, v: BaseVector) -> np.ndarray:
        """The ranks of the elements, ``ngepc.discretisation.quadrature``."""
        q, rank = np.array(v.FV()).reshape(self.function.dim, -1), np.empty(len(self._low), int)
        for nodes, numbers in self._elements:
            low, high = self._low[numbers], self._high[numbers]
            rank[numbers] = ranks(q, nodes, low, high, self._variations)
        return rank

    def enter(self, v: BaseVector, rank: np.ndarray) -> None:
        """Make v and the ranks of the elements those of the forms."""
        super().enter(v, rank)
        for number, elements in enumerate(self._ranked):
            elements.Clear()
            elements |= BitArray((rank == number).tolist())

    def pattern(self) -> BaseMatrix:
        """A matrix with all entries that a Newton derivative may ever have."""
        self.enter(self.function.vec, np.full(len(self._low), IDLE + 1))
        return super().pattern()


def _rules(dim: int, order: int) -> dict:
    return {shape: IntegrationRule(shape, order) for shape in ELEMENT_TYPES[dim]}
