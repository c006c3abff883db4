"""The linear part of the saddle function: D, Lambda, l, psi and B, assembled once for a path."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from ngsolve import (
    BND,
    CF,
    BilinearForm,
    BitArray,
    FESpace,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    Trace,
    ds,
    dx,
)
from ngsolve.la import BaseVector

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.loads import work_of
from ngepc.discretisation.spaces import (
    contact_space,
    displacement_space,
    plastic_dual_space,
    plastic_space,
    prescribed_displacement,
)
from ngepc.dual.spaces import DualSpaces, SurfaceGradient
from ngepc.linalg.direct import symmetric_inverse
from ngepc.model.elements import outward_normal
from ngepc.model.limits import require_without
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.processes import require_whole

CONTACT, PLASTIC = "contact", "plastic"
"""The parts of v: z, the normal stress on Gamma_c, and q = dev H~ p - dev sigma, (3.8)."""

EPSILON = float(np.finfo(float).eps)


def elastic_terms(problem: Problem, h: Coefficient, u: CF, p: CF, v: CF, r: CF) -> list[CF]:
    """The integrand of <D (u, p), (v, r)>, C (eps(u) - p) : (eps(v) - r) + h p . r, in parts.

    Each part has one trial and one test function: that is several times cheaper to assemble.
    """
    m, kinematics = problem.material, problem.kinematics
    e, d, mu = kinematics.strain(u), kinematics.strain(v), as_scalar(m.lame_mu)
    return [
        m.lame_lambda * Trace(e) * Trace(d) + 2 * mu * InnerProduct(e, d),
        -2 * mu * (kinematics.coordinates(e) * r),
        -2 * mu * (kinematics.coordinates(d) * p),
        (2 * mu + h) * (p * r),
    ]


def load_terms(problem: Problem, v: CF, r: CF) -> list:
    """The integrals of -l(v, r) in (2.15) and (2.16): loads, back stress, initial strain."""
    m, kinematics = problem.material, problem.kinematics
    terms = work_of(problem, v)
    if problem.initial_hardening is not None:
        terms.append(-kinematics.coordinates(problem.alpha_0[1]) * r * dx)
    if problem.initial_plastic_strain is not None:
        e = kinematics.strain(v) - kinematics.tensor(r)
        terms.append(2 * as_scalar(m.lame_mu) * InnerProduct(e, problem.p_0) * dx)
    return terms


def primal_energy(problem: Problem, u: GridFunction, p: GridFunction) -> float:
    """J(u, p) of (2.14); p are the coordinates of the plastic strain gained in the step."""
    mesh, h = problem.mesh, problem.effective_hardening
    strain_energy = Integrate(sum(elastic_terms(problem, h, u, p, u, p)) / 2, mesh)
    dissipation = Integrate(as_scalar(problem.beta) * Norm(p), mesh)
    return strain_energy + dissipation - sum(Integrate(t, mesh) for t in load_terms(problem, u, p))


def require_papers_problem(problem: Problem) -> None:
    """Refuse, by a ValueError, what the paper's method is not for."""
    require_whole("gamma", problem.mesh)
    lacks = ("law", "strain", "friction", "pairs", "order", "revolution", "places", "corner")
    advice = "; leave gamma and regularisation out"
    require_without(problem, "the paper's regularised method", *lacks, advice=advice)


def contact_space_of(problem: Problem, product: SurfaceGradient) -> FESpace:
    """Z_h; ValueError for (R2) where a piece of Gamma_c has no ends: B has a kernel there."""
    Z = contact_space(problem, ends_fixed=product.fixed)
    if product.fixed and closed_somewhere(problem, Z):
        raise ValueError(
            f"contact={problem.contact!r} has a closed piece without ends: the gradient "
            "product (R2) has the constants in its kernel there; use tichonov=FullProduct()"
        )
    return Z


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


class LinearBlocks:
    """Matrices and vectors of a problem that no Newton step and no gamma changes.

    Y, H and X are the spaces of y = (u, p), of v = (z, q) and of (y, v), ``spaces`` the parts of H
    by name, without contact the plastic one alone.  ``saddle`` is the condensed form of
    [[-D, Lambda*], [Lambda, 0]], D: Y -> Y* neither condensed nor factorised, Lambda: Y -> H,
    ``B_inverse`` does the Poisson solves.  ``load`` and ``psi`` are -l and [psi, 0] as functionals,
    ``residual_unit`` is that of ||Psi_gamma||_{H*}, length^(N/2 + 1) of the reference units.
    ValueError for a problem that the paper's method is not for.
    """

    def __init__(self, problem: Problem, choice: DualSpaces, inverse: str) -> None:
        require_papers_problem(problem)
        self.problem, self.choice, product = problem, choice, choice.tichonov
        self.residual_unit = choice.units.length ** (problem.N / 2 + 1)
        self.on_contact = ds("|".join(problem.contact_names))
        contact = {CONTACT: contact_space_of(problem, product)} if problem.contact_names else {}
        plastic = plastic_dual_space(problem, boundary_fixed=product.fixed)
        self.spaces = {**contact, PLASTIC: plastic}
        V, Q, v = displacement_space(problem), plastic_space(problem), self.spaces.values()
        self.Y, self.H, self.X = FESpace([V, Q]), FESpace([*v]), FESpace([V, Q, *v])
        lasts = np.cumsum([space.ndof for space in v]).tolist()
        self._ranges = self.by_name(zip([0, *lasts[:-1]], lasts, strict=True))
        self._assemble_saddle(inverse)
        self._assemble_primal()
        self._assemble_dual(inverse)

    def by_name(self, parts: Iterable) -> dict[str, Any]:
        """Parts of v by their names."""
        return dict(zip(self.spaces, parts, strict=True))

    def coupling(self, u: CF, p: CF, v: Sequence[CF]) -> CF:
        """<Lambda (u, p), v> = (tau_n u, z) on Gamma_c + (p, q)."""
        part = self.by_name(v)
        plastic = p * part[PLASTIC] * dx
        if CONTACT not in part:
            return plastic
        return (u * outward_normal(self.problem.mesh)) * part[CONTACT] * self.on_contact + plastic

    def product(self, v: Sequence[CF], w: Sequence[CF]) -> CF:
        """b(v, w)."""
        tichonov, length = self.choice.tichonov, self.choice.units.length
        v, w = self.by_name(v), self.by_name(w)
        plastic = tichonov.plastic(v[PLASTIC], w[PLASTIC], length) * dx
        if CONTACT not in v:
            return plastic
        return tichonov.contact(v[CONTACT], w[CONTACT], length) * self.on_contact + plastic

    def _assemble_saddle(self, inverse: str) -> None:
        (u, p, *v), (du, dp, *dv) = self.X.TnT()
        h = self.problem.effective_hardening
        self.saddle = BilinearForm(self.X, symmetric=True, symmetric_storage=True, condense=True)
        for term in elastic_terms(self.problem, h, u, p, du, dp):
            self.saddle += (-term).Compile() * dx
        self.saddle += self.coupling(u, p, dv) + self.coupling(du, dp, v)
        self.saddle.Assemble()
        displacements = BitArray(self.X.FreeDofs(coupling=True))
        displacements[self.Y.ndof :] = False
        self._minus_D_inverse = symmetric_inverse(self.saddle.mat, displacements, inverse)

    def _assemble_primal(self) -> None:
        (u, p), (du, dp) = self.Y.TnT()
        D = BilinearForm(self.Y, symmetric=True, symmetric_storage=True)
        for term in elastic_terms(self.problem, self.problem.effective_hardening, u, p, du, dp):
            D += term.Compile() * dx
        self.D = D.Assemble().mat
        load = LinearForm(self.Y)
        for term in load_terms(self.problem, du, dp):
            load += term
        self.load = load.Assemble().vec
        self.lift = GridFunction(self.Y)
        V = self.Y.components[0]
        self.lift.components[0].vec.data = prescribed_displacement(self.problem, V).vec
        self.D_lift = (self.D * self.lift.vec).Evaluate()

    def _assemble_dual(self, inverse: str) -> None:
        y, (v, w) = self.Y.TrialFunction(), self.H.TnT()
        coupling, psi = BilinearForm(trialspace=self.Y, testspace=self.H), LinearForm(self.H)
        coupling += self.coupling(*y, w)
        if CONTACT in self.spaces:
            psi += self.problem.psi * w[0] * self.on_contact
        self.Lambda, self.psi = coupling.Assemble().mat, psi.Assemble().vec
        self.B = BilinearForm(self.product(v, w)).Assemble().mat
        self.B_inverse = self.B.Inverse(self.H.FreeDofs(), inverse=inverse)

    def Y_vector(self) -> BaseVector:
        """Zero in Y."""
        return (0.0 * self.load).Evaluate()

    def H_vector(self) -> BaseVector:
        """Zero in H."""
        return (0.0 * self.psi).Evaluate()

    def part_of(self, v: BaseVector, name: str) -> BaseVector:
        """View of the part of a vector on H."""
        return v.Range(*self._ranges[name])

    def fields(self, y: BaseVector, v: BaseVector) -> dict[str, GridFunction]:
        """'displacement', 'plastic_strain' and the parts of v as functions on the mesh."""
        state = GridFunction(self.X)
        state.vec.Range(0, self.Y.ndof).data = y
        state.vec.Range(self.Y.ndof, self.X.ndof).data = v
        names = ("displacement", "plastic_strain", *self.spaces)
        return {"state": state, **dict(zip(names, state.components, strict=True))}

    def primal_of(self, v: BaseVector) -> BaseVector:
        """The y with D y = Lambda* v - l and the prescribed displacements.

        The factors of the condensed D find y, the residual formed with D itself corrects it once:
        where h is small beside the elastic moduli, condensation alone would lose digits.
        """
        right, y = (self.Lambda.T * v + self.load).Evaluate(), (1.0 * self.lift.vec).Evaluate()
        for _ in range(2):
            y += self.primal_response((right - self.D * y).Evaluate())
        return y

    def primal_response(self, r: BaseVector) -> BaseVector:
        """The y with D y = r, zero at the supports, by the factors of the condensed D."""
        right, x = (self.saddle.mat.CreateColVector() for _ in range(2))
        right[:] = 0.0
        right.Range(0, self.Y.ndof).data = -1 * r
        right.data += self.saddle.harmonic_extension_trans * right
        x.data = self._minus_D_inverse * right
        x.data += self.saddle.inner_solve * right
        x.data += self.saddle.harmonic_extension * x
        return (1.0 * x.Range(0, self.Y.ndof)).Evaluate()

    def rounding_of(self, y: BaseVector) -> BaseVector:
        """EPSILON |D| |y|: how uncertain each entry of D y is, in whatever way D is assembled."""
        D = self.D.CreateMatrix()
        sizes, rounding = D.CreateRowVector(), D.CreateColVector()
        D.AsVector().FV().NumPy()[:] = np.abs(self.D.AsVector().FV().NumPy())
        sizes.FV().NumPy()[:] = np.abs(y.FV().NumPy())
        rounding.data = EPSILON * (D * sizes)
        return rounding

    def conjugate(self, y: BaseVector, v: BaseVector) -> float:
        """F*(Lambda* v) = <Lambda* v - l, y> - 1/2 <D y, y>, where D y = Lambda* v - l."""
        r, y_0 = (self.Lambda.T * v + self.load).Evaluate(), (y - self.lift.vec).Evaluate()
        twice_energy = InnerProduct(r, y_0) + InnerProduct(self.D_lift, y)  # <D y, y>
        return InnerProduct(r, y) - twice_energy / 2
