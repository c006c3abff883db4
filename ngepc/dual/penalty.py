"""The nonsmooth terms M^1 and M^2 of (D_gamma) and their derivatives, by NGSolve's forms."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import (
    CF,
    BilinearForm,
    BitArray,
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
from ngepc.model.elements import element_numbers, element_vertices
from ngepc.model.problem import Problem

TINY = 1e-290
"""What is added to |q|: q / |q| is zero at q = 0."""


class RadialLaw:
    """([s]^+)^2 / 2 with s = |q| - t, t > 0, and its derivatives (6.1); NaN where the data are NaN.

    ``density``, ``gradient`` and ``curvature`` are s^2 / 2, rho q and rho Id + (1 - rho) d d^T
    where s > 0, with rho = s / |q|, d = q / |q|; ``inside`` is 1 there.
    """

    def __init__(self, q: CF, threshold: CF | float) -> None:
        norm = Norm(q)
        size, excess = norm + TINY, norm - threshold
        self.inside = IfPos(excess, 1.0, 0.0)
        rho, direction = self.inside * excess / size, q / size
        across = self.inside * threshold / size
        self.density, self.gradient = self.inside * excess * excess / 2, rho * q
        self.curvature = rho * Id(q.dim) + across * OuterProduct(direction, direction)


class AssembledTerm:
    """A nonsmooth term M by forms around the function at which they are assembled.

    ``energy`` and ``active`` are M and the measure of its active set as integrals, ``gradient`` and
    ``hessian`` those of M' and of its Newton derivative.
    """

    def __init__(
        self, function: GridFunction, energy: CF, active: CF, gradient: CF, hessian: CF
    ) -> None:
        self.function, self.energy, self.active = function, energy, active
        self.gradient = LinearForm(gradient)
        self.hessian = BilinearForm(function.space, symmetric=True, symmetric_storage=True)
        self.hessian += hessian

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
    """A nonsmooth term at one v: its active set, and what follows from it."""

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
        return (1.0 * self._forms().gradient.Assemble().vec).Evaluate()

    def hessian(self) -> BaseMatrix:
        """The Newton derivative of M' at v; the next one overwrites it."""
        return self._forms().hessian.Assemble(reallocate=True).mat


class ContactPenalty(AssembledTerm):
    """M^1(z) = gamma/2 |[z]^+|^2 on Gamma_c, with Lemma 6.2.

    M^1'(z) = gamma [z]^+, its Newton derivative gamma chi where z > 0; active is the contact,
    z < 0.  The boundary rule has the order that gives so many points on a cell.
    """

    def __init__(self, problem: Problem, gamma: float, Z: FESpace, quadrature_points: int) -> None:
        rules = boundary_rules(problem.N, quadrature_points)
        on_contact = ds("|".join(problem.contact_names), intrules=rules)
        z, (dz, w) = GridFunction(Z), Z.TnT()
        mu = gamma * z  # (OC2_gamma): mu = [gamma z]^+
        super().__init__(
            z,
            energy=IfPos(mu, mu * mu, 0) / (2 * gamma) * on_contact,
            active=IfPos(-mu, 1.0, 0.0) * on_contact,
            gradient=IfPos(mu, mu, 0) * w * on_contact,
            hessian=IfPos(mu, gamma, 0.0) * dz * w * on_contact,
        )


class PlasticPenalty(AssembledTerm):
    """M^2(q) = gamma/2 int ([|q| - beta]^+)^2, gamma times ``RadialLaw``, with Lemma 6.3.

    Elements that the kink crosses have ``quadrature_points``, others a few or none.
    """

    def __init__(self, problem: Problem, gamma: float, R: FESpace, quadrature_points: int) -> None:
        mesh, N = problem.mesh, problem.N
        beta = float(problem.beta) if is_number(problem.beta) else problem.beta
        fine, smooth = fine_rules(N, quadrature_points), smooth_rules(N)
        self._elements = list(zip(element_vertices(mesh), element_numbers(mesh), strict=True))
        self._low, self._high = threshold_bounds(mesh, beta, fine)
        self._of_kind = {SMOOTH: BitArray(mesh.ne), KINKED: BitArray(mesh.ne)}
        few = dx(definedonelements=self._of_kind[SMOOTH], intrules=smooth)
        crossed = self._of_kind[KINKED]
        measures = [few, dx(definedonelements=crossed, intrules=fine)]
        low = [few, dx(definedonelements=crossed, intrules=smooth)]
        q, (dq, r) = GridFunction(R), R.TnT()
        law = RadialLaw(q, beta)
        density, slope, curvature = (
            (gamma * f).Compile() for f in (law.density, law.gradient, law.curvature)
        )
        super().__init__(
            q,
            energy=sum(density * m for m in measures),
            active=sum(law.inside * m for m in low),
            gradient=sum(InnerProduct(slope, r) * m for m in measures),
            hessian=sum(InnerProduct(curvature * dq, r) * m for m in measures),
        )

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
