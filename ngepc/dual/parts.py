"""The parts of the dual variable v = (z, q): spaces, couplings and penalties.

A part is one component of v together with the terms that only it has in the saddle function
S(y, v) of functional.py: its row of <Lambda y, v>, of (psi, z), of the Tichonov form b and its
nonsmooth term M.  The functional is the sum over the parts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ngsolve import CoefficientFunction, FESpace, ds, dx
from ngsolve.comp import DifferentialSymbol
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.discretisation.quadrature import vertex_rules
from ngepc.discretisation.spaces import contact_space, has_straight_simplices, plastic_dual_space
from ngepc.dual.contact import ContactConstraint
from ngepc.dual.friction import FrictionPart
from ngepc.dual.penalty import ContactPenalty, PlasticPenalty
from ngepc.dual.regularisation import Regularisation
from ngepc.dual.simplex_penalty import SimplexPenalty, constants
from ngepc.model.normals import outward_normal
from ngepc.model.problem import Problem


class Penalty(Protocol):
    """A nonsmooth convex term M with its Newton derivative."""

    def energy(self, v: BaseVector) -> float:
        """M(v)."""
        ...

    def active(self, v: BaseVector) -> float:
        """Measure of the active set: contact, yielding, slip."""
        ...

    def gradient(self, v: BaseVector) -> BaseVector:
        """M'(v) as a functional."""
        ...

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        ...

    def hessian(self, v: BaseVector) -> SparseMatrixd:
        """A Newton derivative of M' at v, symmetric and positive semidefinite."""
        ...


class DualPart(Protocol):
    """One component of the dual variable."""

    name: str

    def space(self, problem: Problem, regularisation: Regularisation) -> FESpace:
        """Its finite element space."""
        ...

    def coupling(
        self,
        problem: Problem,
        u: CoefficientFunction,
        p: CoefficientFunction,
        w: CoefficientFunction,
    ) -> CoefficientFunction:
        """Its row of <Lambda (u, p), w> as an integral."""
        ...

    def offset(self, problem: Problem, w: CoefficientFunction) -> CoefficientFunction | None:
        """Its row of ([psi, 0], w) as an integral, None for zero."""
        ...

    def tichonov(
        self, problem: Problem, regularisation: Regularisation, space: FESpace
    ) -> SparseMatrixd:
        """Its block of B."""
        ...

    def penalty(
        self, problem: Problem, regularisation: Regularisation, space: FESpace, points: int
    ) -> Penalty:
        """Its nonsmooth term."""
        ...


@dataclass(frozen=True)
class ContactPart:
    """z, the normal stress on Gamma_c: (u.n, z) - (psi, z) + M^1(z).

    Parameters
    ----------
    at_nodes
        Whether (u.n - psi, z) is integrated with the vertices as points.
    """

    at_nodes: bool = False
    name: str = "contact"

    def _measure(self, problem: Problem) -> DifferentialSymbol:
        rules = {"intrules": vertex_rules(problem.N)} if self.at_nodes else {}
        return ds("|".join(problem.contact_names), **rules)

    def space(self, problem: Problem, regularisation: Regularisation) -> FESpace:
        """Z_h."""
        return contact_space(problem, ends_fixed=regularisation.tichonov.contact.ends_fixed)

    def coupling(
        self,
        problem: Problem,
        u: CoefficientFunction,
        p: CoefficientFunction,
        w: CoefficientFunction,
    ) -> CoefficientFunction:
        """(tau_n u, w) on Gamma_c."""
        n = outward_normal(problem.mesh)
        return (u * n) * w * self._measure(problem)

    def offset(self, problem: Problem, w: CoefficientFunction) -> CoefficientFunction:
        """(psi, w) on Gamma_c."""
        return problem.psi * w * self._measure(problem)

    def tichonov(
        self, problem: Problem, regularisation: Regularisation, space: FESpace
    ) -> SparseMatrixd:
        """B_z."""
        return regularisation.tichonov.contact.matrix(problem, space, regularisation.units.length)

    def penalty(
        self, problem: Problem, regularisation: Regularisation, space: FESpace, points: int
    ) -> Penalty:
        """M^1, or the constraint that it stands for."""
        if regularisation.exact_contact:
            return ContactConstraint(problem, space)
        return ContactPenalty(problem, regularisation, space, points)


@dataclass(frozen=True)
class PlasticPart:
    """q, which is dev H~ p - dev sigma by (3.8): (p, q) + M^2(q)."""

    name: str = "plastic"

    def space(self, problem: Problem, regularisation: Regularisation) -> FESpace:
        """R_h."""
        fixed = regularisation.tichonov.plastic.boundary_fixed
        return plastic_dual_space(problem, boundary_fixed=fixed)

    def coupling(
        self,
        problem: Problem,
        u: CoefficientFunction,
        p: CoefficientFunction,
        w: CoefficientFunction,
    ) -> CoefficientFunction:
        """(p, w) in Omega."""
        return p * w * dx

    def offset(self, problem: Problem, w: CoefficientFunction) -> None:
        """Zero."""
        return None

    def tichonov(
        self, problem: Problem, regularisation: Regularisation, space: FESpace
    ) -> SparseMatrixd:
        """B_q."""
        return regularisation.tichonov.plastic.matrix(problem, space, regularisation.units.length)

    def penalty(
        self, problem: Problem, regularisation: Regularisation, space: FESpace, points: int
    ) -> Penalty:
        """M^2."""
        straight = has_straight_simplices(problem.mesh)
        vectorised = straight and constants(problem, regularisation) is not None
        kind = SimplexPenalty if vectorised else PlasticPenalty
        return kind(problem, regularisation, space, points)


def dual_parts(problem: Problem, regularisation: Regularisation) -> list[DualPart]:
    """The parts that a problem has: contact and friction where it names them, plasticity last."""
    contact = [ContactPart(regularisation.nodal_contact)] if problem.contact_names else []
    friction = [] if problem.friction is None else [FrictionPart()]
    return [*contact, *friction, PlasticPart()]
