"""The parts of the dual variable v = (z, q) by name: spaces, couplings and nonsmooth terms.

A part is one component of v together with the terms that only it has in the saddle function
S(y, v) of functional.py: its row of <Lambda y, v>, of (psi, z), of the Tichonov form b and its
nonsmooth term M.  The functional is the sum over the parts.
"""

from __future__ import annotations

from ngsolve import CoefficientFunction, FESpace, ds, dx
from ngsolve.la import BaseMatrix

from ngepc.discretisation.spaces import contact_space, plastic_dual_space
from ngepc.dual.parameters import Weights
from ngepc.dual.penalty import ContactPenalty, PlasticPenalty
from ngepc.dual.spaces import DualSpaces
from ngepc.model.normals import outward_normal
from ngepc.model.problem import Problem

CONTACT, PLASTIC = "contact", "plastic"

Integrals = CoefficientFunction
"""What forms are added up from."""


class ContactPart:
    """z, the normal stress on Gamma_c: (u.n, z) - (psi, z) + M^1(z).

    Parameters
    ----------
    problem, choice
        The data.
    """

    def __init__(self, problem: Problem, choice: DualSpaces) -> None:
        self._problem, self._product = problem, choice.tichonov.contact
        self._length, self._on_contact = choice.units.length, ds("|".join(problem.contact_names))
        self.space: FESpace = contact_space(problem, ends_fixed=self._product.ends_fixed)

    def coupling(
        self, u: CoefficientFunction, p: CoefficientFunction, w: CoefficientFunction
    ) -> Integrals:
        """(tau_n u, w) on Gamma_c."""
        return (u * outward_normal(self._problem.mesh)) * w * self._on_contact

    def offset(self, w: CoefficientFunction) -> Integrals:
        """(psi, w) on Gamma_c."""
        return self._problem.psi * w * self._on_contact

    def tichonov(self) -> BaseMatrix:
        """B_z."""
        return self._product.matrix(self._problem, self.space, self._length)

    def term(self, weights: Weights, points: int) -> ContactPenalty:
        """M^1."""
        return ContactPenalty(self._problem, weights, self.space, points)


class PlasticPart:
    """q, which is dev H~ p - dev sigma by (3.8): (p, q) + M^2(q).

    Parameters
    ----------
    problem, choice
        The data.
    """

    def __init__(self, problem: Problem, choice: DualSpaces) -> None:
        self._problem, self._product = problem, choice.tichonov.plastic
        self._length = choice.units.length
        fixed = self._product.boundary_fixed
        self.space: FESpace = plastic_dual_space(problem, boundary_fixed=fixed)

    def coupling(
        self, u: CoefficientFunction, p: CoefficientFunction, w: CoefficientFunction
    ) -> Integrals:
        """(p, w) in Omega."""
        return p * w * dx

    def offset(self, w: CoefficientFunction) -> None:
        """Zero."""
        return None

    def tichonov(self) -> BaseMatrix:
        """B_q."""
        return self._product.matrix(self._problem, self.space, self._length)

    def term(self, weights: Weights, points: int) -> PlasticPenalty:
        """M^2."""
        return PlasticPenalty(self._problem, weights, self.space, points)


def dual_parts(problem: Problem, choice: DualSpaces) -> dict[str, ContactPart | PlasticPart]:
    """Name -> part; without contact there is no such part."""
    contact = {CONTACT: ContactPart(problem, choice)} if problem.contact_names else {}
    return {**contact, PLASTIC: PlasticPart(problem, choice)}
