"""Which plastic strains p the dual functional is the dual of: one per element, or all of L^2.

With p constant on the elements, as in section 7, F*(Lambda* v) sees q through its element means
Pi q alone.  Where the body does not yield, a q whose mean vanishes on every element, a
checkerboard, is then held by the Tichonov term only.  With p in L^2 the minimum of F over p is
taken at every point; on straight simplices, where eps(u) is constant,

    p = p_0 + (q - Pi q) / c,    c = 2 mu_2 + h_F,

with the constant p_0 of before, and F* gains the quadratic term s(q, q) / 2,

    s(q, r) = int (q - Pi q) . (r - Pi r) / c.

Nothing else changes: p_0 has the same equation, and no degree of freedom is added.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ngsolve import (
    ET,
    L2,
    CoefficientFunction,
    GridFunction,
    InnerProduct,
    IntegrationRule,
    VectorValued,
    dx,
)

from ngepc.checks.kinds import require_attributes
from ngepc.discretisation.spaces import has_straight_simplices
from ngepc.model.problem import Problem, as_scalar

MEANS = {shape: IntegrationRule(shape, 1) for shape in (ET.TRIG, ET.TET)}
"""Rules with one point: exact for affine functions, so that q at the point is Pi q."""


class PlasticStrain(Protocol):
    """What the dual functional asks of a choice of plastic strains."""

    def completion(
        self,
        problem: Problem,
        h_F: CoefficientFunction,
        q: CoefficientFunction,
        r: CoefficientFunction,
    ) -> list[CoefficientFunction]:
        """The integrals of s(q, r); none for zero."""
        ...

    def increment(
        self, problem: Problem, h_F: CoefficientFunction, p: GridFunction, q: GridFunction
    ) -> CoefficientFunction:
        """The p of F, from its element means and q."""
        ...


def require_plastic_strain(value: object) -> None:
    """Accept a choice of plastic strains.

    Raises
    ------
    TypeError
        If it is none.
    """
    needed = "ElementwisePlasticStrain() or PointwisePlasticStrain()"
    require_attributes("plastic_strain", value, ("completion", "increment"), needed)


@dataclass(frozen=True)
class ElementwisePlasticStrain:
    """p in the space Q_h of section 7: constant on simplices."""

    def completion(
        self,
        problem: Problem,
        h_F: CoefficientFunction,
        q: CoefficientFunction,
        r: CoefficientFunction,
    ) -> list[CoefficientFunction]:
        """No integrals: s is zero."""
        return []

    def increment(
        self, problem: Problem, h_F: CoefficientFunction, p: GridFunction, q: GridFunction
    ) -> GridFunction:
        """``p`` itself."""
        return p


@dataclass(frozen=True)
class PointwisePlasticStrain:
    """p in L^2, on straight triangles and tetrahedra.

    The block of q in (7.1) becomes a mass matrix where nothing yields, so that q has no
    checkerboard and multigrid inverts its block, whatever gamma_T.  Initial values enter by their
    element means, and so does c.
    """

    def completion(
        self,
        problem: Problem,
        h_F: CoefficientFunction,
        q: CoefficientFunction,
        r: CoefficientFunction,
    ) -> list[CoefficientFunction]:
        """The integrals of s(q, r): the mass matrix less that of the means.

        Raises
        ------
        ValueError
            If an element is no straight simplex.
        """
        if not has_straight_simplices(problem.mesh):
            raise ValueError(
                f"plastic_strain={self!r}: a mesh of straight triangles or tetrahedra is needed"
            )
        product = self._compliance(problem, h_F) * InnerProduct(q, r)
        return [product * dx, -product * dx(intrules=MEANS)]

    def increment(
        self, problem: Problem, h_F: CoefficientFunction, p: GridFunction, q: GridFunction
    ) -> CoefficientFunction:
        """p + (q - Pi q) / c."""
        means = GridFunction(VectorValued(L2(problem.mesh, order=0), q.dim))
        means.Set(q)
        return p + self._compliance(problem, h_F) * (q - means)

    def _compliance(self, problem: Problem, h_F: CoefficientFunction) -> GridFunction:
        """1 / c, constant on each element."""
        compliance = GridFunction(L2(problem.mesh, order=0))
        compliance.Set(1 / (2 * as_scalar(problem.material.lame_mu) + as_scalar(h_F)))
        return compliance
