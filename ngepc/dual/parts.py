"""The parts of the dual variable v = (z, q) by name.

A part is one component of v with the terms that it alone has in the saddle function of
functional.py: its row of <Lambda y, v>, of (psi, z), of b and its nonsmooth term M.
"""

from __future__ import annotations

from ngsolve import BND, CF, BilinearForm, FESpace, ds, dx
from ngsolve.la import BaseMatrix

from ngepc.discretisation.spaces import contact_space, plastic_dual_space
from ngepc.dual.penalty import ContactPenalty, PlasticPenalty
from ngepc.dual.spaces import DualSpaces, Weights
from ngepc.model.normals import outward_normal
from ngepc.model.problem import Problem

CONTACT, PLASTIC = "contact", "plastic"


class ContactPart:
    """z, the normal stress on Gamma_c: (u.n, z) - (psi, z) + M^1(z)."""

    def __init__(self, problem: Problem, choice: DualSpaces) -> None:
        self._problem, self._choice = problem, choice
        self._on_contact = ds("|".join(problem.contact_names))
        self.space = contact_space(problem, ends_fixed=choice.tichonov.fixed)

    def coupling(self, u: CF, p: CF, w: CF) -> CF:
        """(tau_n u, w) on Gamma_c."""
        return (u * outward_normal(self._problem.mesh)) * w * self._on_contact

    def offset(self, w: CF) -> CF | None:
        """(psi, w) on Gamma_c."""
        return self._problem.psi * w * self._on_contact

    def tichonov(self) -> BaseMatrix:
        """B_z; ValueError for (R2) where a piece of Gamma_c has no ends: it has a kernel."""
        tichonov = self._choice.tichonov
        if tichonov.fixed and closed_somewhere(self._problem, self.space):
            raise ValueError(
                f"contact={self._problem.contact!r} has a closed piece without ends: the gradient "
                "product (R2) has the constants in its kernel there; use tichonov=FullProduct()"
            )
        product = tichonov.contact(*self.space.TnT(), self._choice.units.length)
        return BilinearForm(product * self._on_contact).Assemble().mat

    def term(self, weights: Weights, points: int) -> ContactPenalty:
        """M^1."""
        return ContactPenalty(self._problem, weights.contact, self.space, points)


class PlasticPart:
    """q, which is dev H~ p - dev sigma by (3.8): (p, q) + M^2(q)."""

    def __init__(self, problem: Problem, choice: DualSpaces) -> None:
        self._problem, self._choice = problem, choice
        self.space = plastic_dual_space(problem, boundary_fixed=choice.tichonov.fixed)

    def coupling(self, u: CF, p: CF, w: CF) -> CF:
        """(p, w) in Omega."""
        return p * w * dx

    def offset(self, w: CF) -> CF | None:
        """Zero."""
        return None

    def tichonov(self) -> BaseMatrix:
        """B_q."""
        product = self._choice.tichonov.plastic(*self.space.TnT(), self._choice.units.length)
        return BilinearForm(product * dx).Assemble().mat

    def term(self, weights: Weights, points: int) -> PlasticPenalty:
        """M^2."""
        return PlasticPenalty(self._problem, weights.plastic, self.space, points)


def dual_parts(problem: Problem, choice: DualSpaces) -> dict[str, ContactPart | PlasticPart]:
    """Name -> part; without contact there is no such part."""
    contact = {CONTACT: ContactPart(problem, choice)} if problem.contact_names else {}
    return {**contact, PLASTIC: PlasticPart(problem, choice)}


def closed_somewhere(problem: Problem, Z: FESpace) -> bool:
    """Whether a connected piece of Gamma_c has no fixed degree of freedom of Z."""
    names, free = set(problem.contact_names), Z.FreeDofs()
    elements = [
        [dof for dof in Z.GetDofNrs(element) if dof >= 0]
        for element in problem.mesh.Elements(BND)
        if element.mat in names
    ]
    held = {dof for dof in range(Z.ndof) if not free[dof]}
    while elements:
        apart = [dofs for dofs in elements if held.isdisjoint(dofs)]
        if len(apart) == len(elements):
            return True
        held.update(dof for dofs in elements if not held.isdisjoint(dofs) for dof in dofs)
        elements = apart
    return False
