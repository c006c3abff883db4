"""Choices of the Hilbert space H and the product b of the Tichonov regularisation (section 7).

Each object says which boundary conditions the dual variables z and q carry and gives the matrix
B = diag(B_z, B_q) of b on the discrete spaces.  B also measures the residual: its inverse is the
solution of the Poisson problems of Algorithm 7.1.
"""

from dataclasses import dataclass
from typing import Protocol

from ngsolve import BilinearForm, FESpace, InnerProduct, ds, dx, grad
from ngsolve.la import SparseMatrixd

from ngepc.problem import Problem


class Tichonov(Protocol):
    """What a Tichonov choice provides."""

    contact_ends_fixed: bool
    plastic_boundary_fixed: bool

    def contact_matrix(self, problem: Problem, Z: FESpace) -> SparseMatrixd:
        """B_z, symmetric positive definite on the free dofs of Z."""
        ...

    def plastic_matrix(self, problem: Problem, R: FESpace) -> SparseMatrixd:
        """B_q, symmetric positive definite on the free dofs of R."""
        ...


def _contact_ds(problem: Problem):
    return ds("|".join(problem.contact_names))


@dataclass(frozen=True)
class SurfaceGradient:
    """(R2): H = H^1_0(Gamma_c) x H^1_0(Omega)^d with the products of the gradients."""

    contact_ends_fixed: bool = True
    plastic_boundary_fixed: bool = True

    def contact_matrix(self, problem: Problem, Z: FESpace) -> SparseMatrixd:
        """(grad z_1, grad z_2) on Gamma_c, tangential gradients.

        Raises
        ------
        ValueError
            If Gamma_c has no ends: constants would be in the kernel.
        """
        if all(Z.FreeDofs()):
            raise ValueError(
                f"contact={problem.contact!r} is a closed boundary without ends: the gradient "
                "product (R2) has the constants in its kernel there; use tichonov=Fractional() "
                "(R1) or tichonov=FullProduct()"
            )
        z, w = Z.TnT()
        return BilinearForm(grad(z).Trace() * grad(w).Trace() * _contact_ds(problem)).Assemble().mat

    def plastic_matrix(self, problem: Problem, R: FESpace) -> SparseMatrixd:
        """sum_i (grad q_1i, grad q_2i) in Omega."""
        q, r = R.TnT()
        return BilinearForm(InnerProduct(grad(q), grad(r)) * dx).Assemble().mat
