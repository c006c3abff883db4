"""The nonsmooth terms M^1 and M^2 of (D_gamma) and their derivatives, by NGSolve's forms."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import (
    CF,
    BilinearForm,
    BitArray,
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
    SMOOTH_ORDER,
    boundary_rules,
    classify,
    fine_rules,
    rules_of,
    threshold_bounds,
)
from ngepc.dual.blocks import CONTACT, PLASTIC, LinearBlocks
from ngepc.dual.spaces import Weights
from ngepc.model.elements import element_numbers, element_vertices

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


class Penalty:
    """M^1(z) = gamma_z/2 |[z]^+|^2 and M^2(q) = gamma_q/2 |[|q| - beta]^+|^2, Lemmas 6.2 and 6.3.

    Forms around a function of H: ``energies`` and ``active`` are integrals by part, the latter the
    measures of contact, z < 0, and of what yields; ``gradient`` and ``hessian`` are M' and its
    Newton derivative.  Elements that a kink crosses have ``quadrature_points``, others a few or
    none; the rule of the boundary has the order that gives so many points on a cell.
    """

    def __init__(self, blocks: LinearBlocks, weights: Weights, quadrature_points: int) -> None:
        self.blocks, problem, H = blocks, blocks.problem, blocks.H
        self.v = GridFunction(H)
        self.energies, self.active = {}, {}
        self.gradient = LinearForm(H)
        self.hessian = BilinearForm(H, symmetric=True, symmetric_storage=True)
        parts = [blocks.by_name(v) for v in (self.v.components, *H.TnT())]
        if CONTACT in blocks.spaces:
            rules = boundary_rules(problem.N, quadrature_points)
            on_contact = ds("|".join(problem.contact_names), intrules=rules)
            self._add_contact(*(v[CONTACT] for v in parts), weights.contact, on_contact)
        self._add_plastic(*(v[PLASTIC] for v in parts), weights.plastic, quadrature_points)

    def _add_contact(self, z: CF, dz: CF, w: CF, gamma: float, on_contact: Any) -> None:
        mu = gamma * z  # (OC2_gamma): mu = [gamma z]^+
        self.energies[CONTACT] = IfPos(mu, mu * mu, 0) / (2 * gamma) * on_contact
        self.active[CONTACT] = IfPos(-mu, 1.0, 0.0) * on_contact
        self.gradient += IfPos(mu, mu, 0) * w * on_contact
        self.hessian += IfPos(mu, gamma, 0.0) * dz * w * on_contact

    def _add_plastic(self, q: CF, dq: CF, r: CF, gamma: float, points: int) -> None:
        problem = self.blocks.problem
        mesh, N = problem.mesh, problem.N
        beta = float(problem.beta) if is_number(problem.beta) else problem.beta
        fine, smooth = fine_rules(N, points), rules_of(N, SMOOTH_ORDER)
        self._elements = list(zip(element_vertices(mesh), element_numbers(mesh), strict=True))
        self._low, self._high = threshold_bounds(mesh, beta, fine)
        self._of_kind = {SMOOTH: BitArray(mesh.ne), KINKED: BitArray(mesh.ne)}
        few = dx(definedonelements=self._of_kind[SMOOTH], intrules=smooth)
        crossed = self._of_kind[KINKED]
        low = dx(definedonelements=crossed, intrules=smooth)
        law = RadialLaw(q, beta)
        density, slope, curvature = (
            (gamma * f).Compile() for f in (law.density, law.gradient, law.curvature)
        )
        measures = few, dx(definedonelements=crossed, intrules=fine)
        self.energies[PLASTIC] = sum(density * m for m in measures)
        self.active[PLASTIC] = law.inside * few + law.inside * low
        for measure in measures:
            self.gradient += InnerProduct(slope, r) * measure
            self.hessian += InnerProduct(curvature * dq, r) * measure

    def sort(self, v: BaseVector) -> np.ndarray:
        """The kinds of the elements, ``ngepc.discretisation.quadrature``."""
        q = np.array(self.blocks.part_of(v, PLASTIC).FV())
        q, kind = q.reshape(self.blocks.problem.kinematics.d, -1), np.empty(len(self._low), int)
        for nodes, numbers in self._elements:
            kind[numbers] = classify(q, nodes, self._low[numbers], self._high[numbers])
        return kind

    def enter(self, v: BaseVector, kind: np.ndarray) -> None:
        """Make v and the kinds of the elements those of the forms."""
        self.v.vec.data = v
        for number, elements in self._of_kind.items():
            elements.Clear()
            elements |= BitArray((kind == number).tolist())

    def pattern(self) -> BaseMatrix:
        """A matrix with all entries that a Newton derivative may ever have."""
        self.enter(self.v.vec, np.full(len(self._low), SMOOTH))
        return self.hessian.Assemble(reallocate=True).mat


class ActiveTerms:
    """M^1 and M^2 at one v: the active sets, and what follows from them."""

    def __init__(self, penalty: Penalty, v: BaseVector) -> None:
        self._penalty, self._v, self._kind = penalty, (1.0 * v).Evaluate(), penalty.sort(v)

    def _forms(self) -> Penalty:
        self._penalty.enter(self._v, self._kind)
        return self._penalty

    def _integrals(self, by_part: dict[str, CF]) -> dict[str, float]:
        mesh = self._forms().blocks.problem.mesh
        return {name: Integrate(integral, mesh) for name, integral in by_part.items()}

    @cached_property
    def energies(self) -> dict[str, float]:
        """M^1(z) and M^2(q) by part."""
        return self._integrals(self._penalty.energies)

    @property
    def energy(self) -> float:
        """M^1(z) + M^2(q)."""
        return sum(self.energies.values())

    @cached_property
    def measures(self) -> dict[str, float]:
        """Part name -> measure of its active set, by a low order: contact, yielding."""
        return self._integrals(self._penalty.active)

    @cached_property
    def gradient(self) -> BaseVector:
        """M(v) as a functional on H."""
        return (1.0 * self._forms().gradient.Assemble().vec).Evaluate()

    def hessian(self) -> BaseMatrix:
        """The Newton derivative of M at v; the next one overwrites it."""
        return self._forms().hessian.Assemble(reallocate=True).mat
