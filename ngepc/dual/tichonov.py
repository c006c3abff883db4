"""Choices of the Hilbert space H and the product b of the Tichonov regularisation (section 7).

    b([z, q], [w, r]) = <B_z z, w> + <B_q q, r>

A choice pairs a product on Gamma_c with one in Omega.  Each product says which boundary
conditions it needs and gives its matrix, which also measures the residual: the inverse of B is
the solution of the Poisson problems of Algorithm 7.1.  All products have one unit, stress^2
length^(N-2), so that a sum of them makes sense: that of the gradients in Omega, and of the
Slobodeckij integral.  The others carry powers of a reference length L (``Units.length``, 1 as in
the paper).  In an L2 term it matters: L is the length beyond which such a term outweighs the
gradient, so a body of another size needs L = its size to give the scaled result.
"""

from dataclasses import dataclass
from typing import Protocol

from ngsolve import (
    BND,
    BilinearForm,
    CoefficientFunction,
    FESpace,
    InnerProduct,
    ds,
    dx,
    grad,
)
from ngsolve.comp import DifferentialSymbol, ProxyFunction
from ngsolve.la import SparseMatrixd

from ngepc.checks.kinds import require_attributes
from ngepc.dual.fractional import contact_seminorm, from_dense, to_dense
from ngepc.model.problem import Problem


class ContactProduct(Protocol):
    """A Hilbert space H_1 of functions on Gamma_c with its product."""

    ends_fixed: bool

    def matrix(self, problem: Problem, Z: FESpace, length: float) -> SparseMatrixd:
        """B_z on a scalar space, symmetric positive definite on its free dofs."""
        ...


class PlasticProduct(Protocol):
    """A Hilbert space H_2 of functions in Omega with its product."""

    boundary_fixed: bool

    def matrix(self, problem: Problem, R: FESpace, length: float) -> SparseMatrixd:
        """B_q, symmetric positive definite on the free dofs of R."""
        ...


@dataclass(frozen=True)
class Tichonov:
    """A product on Gamma_c and one in Omega.

    Parameters
    ----------
    contact
        ``ContactGradient()``, ``ContactSobolev()`` or ``ContactSlobodeckij()``.
    plastic
        ``PlasticGradient()`` or ``PlasticSobolev()``.

    Raises
    ------
    TypeError
        If one is no product.
    """

    contact: ContactProduct
    plastic: PlasticProduct

    def __post_init__(self) -> None:
        on_contact, inside = ("matrix", "ends_fixed"), ("matrix", "boundary_fixed")
        require_attributes(
            "contact", self.contact, on_contact, "a product such as ContactGradient()"
        )
        require_attributes("plastic", self.plastic, inside, "a product such as PlasticGradient()")


@dataclass(frozen=True)
class ContactGradient:
    """H^1_0(Gamma_c): L (grad z, grad w) with tangential gradients; z = 0 at the ends."""

    ends_fixed = True

    def matrix(self, problem: Problem, Z: FESpace, length: float) -> SparseMatrixd:
        """B_z.

        Raises
        ------
        ValueError
            If a piece of Gamma_c has no ends: its constants would be in the kernel.
        """
        if closed_somewhere(problem, Z):
            raise ValueError(
                f"contact={problem.contact!r} has a closed piece without ends: the gradient "
                "product (R2) has the constants in its kernel there; use tichonov=Fractional() "
                "(R1) or tichonov=FullProduct()"
            )
        z, w = Z.TnT()
        product = length * _gradients(z, w)
        return BilinearForm(product * _on_contact(problem)).Assemble().mat


@dataclass(frozen=True)
class ContactSobolev:
    """H^1(Gamma_c): L (grad z, grad w) + (z, w) / L, free at the ends."""

    ends_fixed = False

    def matrix(self, problem: Problem, Z: FESpace, length: float) -> SparseMatrixd:
        """B_z."""
        z, w = Z.TnT()
        product = length * _gradients(z, w) + z * w / length
        return BilinearForm(product * _on_contact(problem)).Assemble().mat


@dataclass(frozen=True)
class ContactSlobodeckij:
    """H^(1/2)(Gamma_c): double integral of section 5 with s = 1/2 plus (z, w) / L; free ends.

    The matrix is dense, but on the degrees of freedom of Gamma_c only.
    """

    ends_fixed = False

    def matrix(self, problem: Problem, Z: FESpace, length: float) -> SparseMatrixd:
        """B_z.

        Raises
        ------
        ValueError
            In three dimensions, or if Gamma_c touches itself.
        """
        z, w = Z.TnT()
        mass = BilinearForm(z * w / length * _on_contact(problem)).Assemble().mat
        return from_dense(contact_seminorm(problem, Z) + to_dense(mass))


@dataclass(frozen=True)
class PlasticGradient:
    """H^1_0(Omega)^d: sum_i (grad q_i, grad r_i); q = 0 on the boundary of the body."""

    boundary_fixed = True

    def matrix(self, problem: Problem, R: FESpace, length: float) -> SparseMatrixd:
        """B_q."""
        q, r = R.TnT()
        return BilinearForm(InnerProduct(grad(q), grad(r)) * dx).Assemble().mat


@dataclass(frozen=True)
class PlasticSobolev:
    """H^1(Omega)^d: sum_i (grad q_i, grad r_i) + (q_i, r_i) / L^2, no boundary condition on q."""

    boundary_fixed = False

    def matrix(self, problem: Problem, R: FESpace, length: float) -> SparseMatrixd:
        """B_q."""
        q, r = R.TnT()
        product = InnerProduct(grad(q), grad(r)) + InnerProduct(q, r) / length**2
        return BilinearForm(product * dx).Assemble().mat


@dataclass(frozen=True)
class SurfaceGradient(Tichonov):
    """(R2): H = H^1_0(Gamma_c) x H^1_0(Omega)^d with the products of the gradients."""

    contact: ContactProduct = ContactGradient()
    plastic: PlasticProduct = PlasticGradient()


@dataclass(frozen=True)
class Fractional(Tichonov):
    """(R1): H = H^(1/2)(Gamma_c) x H^1_0(Omega)^d, two dimensions.

    ``Fractional(plastic=PlasticSobolev())`` frees q on the boundary too.
    """

    contact: ContactProduct = ContactSlobodeckij()
    plastic: PlasticProduct = PlasticGradient()


@dataclass(frozen=True)
class FullProduct(Tichonov):
    """H = H^1(Gamma_c) x H^1(Omega)^d with the full products: no boundary condition at all.

    The alternative named in section 7 for q; ``FullProduct(contact=ContactGradient())`` keeps
    z = 0 at the ends of Gamma_c.
    """

    contact: ContactProduct = ContactSobolev()
    plastic: PlasticProduct = PlasticSobolev()


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


def _gradients(z: ProxyFunction, w: ProxyFunction) -> CoefficientFunction:
    return grad(z).Trace() * grad(w).Trace()


def _on_contact(problem: Problem) -> DifferentialSymbol:
    return ds("|".join(problem.contact_names))
