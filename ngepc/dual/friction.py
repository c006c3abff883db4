"""Tresca friction, the outlook of the paper: a weighted L1(Gamma_c) term and its dual variable.

The primal energy gains int_Gc F |u_t| with a given bound F >= 0 (stress) on the tangential
traction.  Its conjugate is the constraint |t| <= F on a third dual variable t, which is the
tangential stress; Lambda gains the row u_t (u_t - u_0,t in a later time step).  The constraint
is regularised like |q| <= beta,

    M^3(t) = 1/(2 gamma) |[gamma (|t| - F)]^+|^2 on Gamma_c,

and t gets the Tichonov product of z.  See docs/friction.md.

In two dimensions t is a scalar along the tangent (-n_y, n_x).  In three it is a vector with 3
components of which only the tangential part acts; the normal one tends to zero with 1/gamma.
F is given: it acts on all of Gamma_c, also where there is no contact.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import (
    CF,
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    LinearForm,
    Mesh,
    Norm,
    OuterProduct,
    VectorValued,
    ds,
    sqrt,
)
from ngsolve.comp import DifferentialSymbol
from ngsolve.la import SparseMatrixd

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.quadrature import boundary_rules
from ngepc.discretisation.spaces import contact_space
from ngepc.dual.penalty import TINY, AssembledPenalty
from ngepc.dual.regularisation import Regularisation
from ngepc.linalg.assembly import repeated
from ngepc.model.material import Material
from ngepc.model.normals import outward_normal
from ngepc.model.problem import Problem, as_scalar
from ngepc.parallel import integral

ENERGY_POINTS = 400


def tangent(problem: Problem) -> CoefficientFunction:
    """The unit tangent (-n_y, n_x) on the boundary of a body in two dimensions."""
    n = outward_normal(problem.mesh)
    return CF((-n[1], n[0]))


def slip(problem: Problem, u: CoefficientFunction) -> CoefficientFunction:
    """u_t on the boundary (length): the scalar u . (-n_y, n_x), or the vector u - (u . n) n."""
    if problem.N == 2:
        return InnerProduct(u, tangent(problem))
    n = outward_normal(problem.mesh)
    return u - InnerProduct(u, n) * n


def friction_energy(problem: Problem, u: CoefficientFunction) -> float:
    """int_Gc F |u_t - u_0,t| (force times length), zero without friction."""
    if problem.friction is None:
        return 0.0
    gained = u if problem.u_0 is None else u - problem.u_0
    density = as_scalar(problem.friction) * _size(slip(problem, gained))
    return integral(density * _on_contact(problem, ENERGY_POINTS), problem.mesh)


def _size(t: CoefficientFunction) -> CoefficientFunction:
    return Norm(t) if t.dims else sqrt(t * t)


def _on_contact(problem: Problem, points: int) -> DifferentialSymbol:
    return ds("|".join(problem.contact_names), intrules=boundary_rules(problem.N, points))


@dataclass(frozen=True)
class FrictionPart:
    """t, the tangential stress on Gamma_c: (u_t, t) + M^3(t)."""

    name: str = "friction"

    def space(self, problem: Problem, regularisation: Regularisation) -> FESpace:
        """P1 on Gamma_c, with the conditions of z at the ends."""
        Z = contact_space(problem, ends_fixed=regularisation.tichonov.contact.ends_fixed)
        return Z if problem.N == 2 else VectorValued(Z, problem.N)

    def coupling(
        self,
        problem: Problem,
        u: CoefficientFunction,
        p: CoefficientFunction,
        w: CoefficientFunction,
    ) -> CoefficientFunction:
        """(u_t, w) on Gamma_c."""
        return InnerProduct(slip(problem, u), w) * ds("|".join(problem.contact_names))

    def offset(self, problem: Problem, w: CoefficientFunction) -> CoefficientFunction | None:
        """(u_0,t, w) on Gamma_c."""
        return None if problem.u_0 is None else self.coupling(problem, problem.u_0, None, w)

    def tichonov(
        self, problem: Problem, regularisation: Regularisation, space: FESpace
    ) -> SparseMatrixd:
        """B_z for each component."""
        scalar = space if problem.N == 2 else space.components[0]
        length = regularisation.units.length
        B = regularisation.tichonov.contact.matrix(problem, scalar, length)
        return B if problem.N == 2 else repeated(B, problem.N)

    def penalty(
        self, problem: Problem, regularisation: Regularisation, space: FESpace, points: int
    ) -> FrictionPenalty:
        """M^3."""
        return FrictionPenalty(problem, regularisation, space, points)


class FrictionPenalty(AssembledPenalty):
    """M^3(t) = gamma/2 int_Gc ([|t| - F]^+)^2 with the gamma of the contact term, Lemma 6.3.

    Gradient [gamma (|t| - F)]^+ t/|t|, Newton derivative gamma chi M(t) where |t| > F, the part of
    Gamma_c that slips, with M(t) of (6.1).  F = 0 is allowed: then M^3 is gamma/2 |t|^2.

    Parameters
    ----------
    problem, regularisation
        The data.
    space
        The space of t.
    quadrature_points
        As for the domain; the boundary rule has the same order.
    """

    def __init__(
        self,
        problem: Problem,
        regularisation: Regularisation,
        space: FESpace,
        quadrature_points: int,
    ) -> None:
        gamma = regularisation.gamma_contact
        t = GridFunction(space)
        on_contact = _on_contact(problem, quadrature_points)
        size = _size(t) + TINY
        s = size - as_scalar(problem.friction)
        rho, unit = s / size, t / size
        M = rho * Id(t.dim) + (1 - rho) * OuterProduct(unit, unit) if t.dims else CF(1.0)  # (6.1)
        dt, w = space.TnT()
        gradient = LinearForm(space)
        gradient += InnerProduct(IfPos(s, gamma * s, 0) * unit, w) * on_contact
        hessian = BilinearForm(space, symmetric=True, symmetric_storage=True)
        hessian += InnerProduct(IfPos(s, gamma, 0) * M * dt, w) * on_contact
        energy = IfPos(s, gamma / 2 * s * s, 0) * on_contact
        super().__init__(t, energy, IfPos(s, 1.0, 0.0) * on_contact, gradient, hessian)


def pressed_block_problem(mesh: Mesh, friction: Coefficient | None = 5.0) -> Problem:
    """The example of docs/friction.md: a block on its base, pressed down by 0.02 from above.

    The block bulges sideways against the friction of the press: it sticks in the middle of the
    top and slips towards the edges.

    Parameters
    ----------
    mesh
        A mesh of ``ngepc.geometries.block`` with height 1.
    friction
        Tresca's bound (stress, the unit of lame_mu = 1e3); None for a smooth press.
    """
    material = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=15.0, hardening=100.0)
    return Problem(mesh, material, contact="contact", gap=-0.02, friction=friction)
