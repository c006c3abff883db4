"""The linear part of the saddle function: D, Lambda, l, psi and B on the spaces of section 7.

Nothing here changes during Newton steps or along a path in gamma, so it is assembled once.
"""

from __future__ import annotations

import numpy as np
from ngsolve import (
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    Trace,
    dx,
)
from ngsolve.la import PARALLEL_STATUS, BaseVector, SparseMatrixd

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.spaces import displacement_space, plastic_space, prescribed_displacement
from ngepc.dual.friction import friction_energy
from ngepc.dual.parts import dual_parts
from ngepc.dual.regularisation import Regularisation
from ngepc.linalg.assembly import diagonal_block
from ngepc.linalg.direct import LinearSolver, linear_solver
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.tensors import coordinates, strain, tensor
from ngepc.parallel import integral, total
from ngepc.results.equilibrium import external_work

REFINEMENTS = 1
"""Corrections of y by the residual of D y = Lambda* v - l; a second one is rounding."""

EPSILON = float(np.finfo(float).eps)


def elastic_terms(
    problem: Problem,
    h: Coefficient,
    u: CoefficientFunction,
    p: CoefficientFunction,
    v: CoefficientFunction,
    r: CoefficientFunction,
) -> list[CoefficientFunction]:
    """The integrand of <D (u, p), (v, r)>, C (eps(u) - p) : (eps(v) - r) + h p . r, in parts.

    Each part has one trial and one test function: that is several times cheaper to assemble.
    """
    m, N = problem.material, problem.N
    e, d, mu = strain(u), strain(v), as_scalar(m.lame_mu)
    return [
        m.lame_lambda * Trace(e) * Trace(d) + 2 * mu * InnerProduct(e, d),
        -2 * mu * (coordinates(e, N) * r),
        -2 * mu * (coordinates(d, N) * p),
        (2 * mu + h) * (p * r),
    ]


def load_terms(problem: Problem, v: CoefficientFunction, r: CoefficientFunction) -> list:
    """The integrals of -l(v, r) in (2.15) and (2.16): loads, back stress, initial strain."""
    m, N = problem.material, problem.N
    terms = external_work(problem, v)
    if problem.initial_hardening is not None:
        terms.append(-coordinates(problem.alpha_0[1], N) * r * dx)
    if problem.initial_plastic_strain is not None:
        e = strain(v) - tensor(r, N)
        terms.append(2 * as_scalar(m.lame_mu) * InnerProduct(e, problem.p_0) * dx)
    return terms


def primal_energy(problem: Problem, u: GridFunction, p: GridFunction) -> float:
    """J(u, p) of (2.14), with int F |u_t| where there is friction.

    Parameters
    ----------
    problem
        The data.
    u, p
        The displacement and the coordinates of the plastic strain gained in the step.
    """
    mesh, h = problem.mesh, problem.effective_hardening
    strain_energy = Integrate(sum(elastic_terms(problem, h, u, p, u, p)) / 2, mesh)
    dissipation = Integrate(as_scalar(problem.beta) * Norm(p), mesh)
    dissipation += friction_energy(problem, u)
    return strain_energy + dissipation - sum(integral(t, mesh) for t in load_terms(problem, u, p))


class LinearBlocks:
    """Matrices and vectors of a problem that no Newton step changes.

    Parameters
    ----------
    problem
        The data.
    regularisation
        Its Tichonov choice, its hardening share and its reference length enter here.
    inverse
        The solver for D and B: a ``LinearSolver`` or NGSolve's name of a direct one.

    Attributes
    ----------
    Y, H, X
        The spaces of y = (u, p), of v, and of (y, v).
    firsts
        First degree of freedom of each dual part within H, and their total number.
    saddle
        Condensed form of [[-D, Lambda*], [Lambda, 0]].
    D
        D: Y -> Y* as a matrix, neither condensed nor factorised.
    u_inverse
        The inverse of D condensed to u.
    Lambda, load, psi
        Lambda: Y -> H as a matrix; -l and [psi, 0] as functionals.
    completion
        The matrix of s on R_h, ``ngepc.dual.plastic_strain``; None for zero.
    B, B_inverse
        Blocks of B for each part, and their inverses (the Poisson solves).
    """

    def __init__(
        self, problem: Problem, regularisation: Regularisation, inverse: str | LinearSolver
    ) -> None:
        self.problem, self.solver = problem, linear_solver(inverse)
        regularisation = regularisation.resolved(problem)
        self.parts = dual_parts(problem, regularisation)
        self._plastic_strain = regularisation.plastic_strain
        self.h_F = problem.effective_hardening * regularisation.hardening_share
        self.spaces = [part.space(problem, regularisation) for part in self.parts]
        V, Q = displacement_space(problem), plastic_space(problem)
        self.Y, self.H = FESpace([V, Q]), FESpace(self.spaces)
        self.X = FESpace([V, Q, *self.spaces])
        self.firsts = np.cumsum([0, *(s.ndof for s in self.spaces)])
        self._assemble_saddle()
        self._assemble_primal()
        self._assemble_coupling()
        self.completion = self._assemble_completion()
        self.B = [
            part.tichonov(problem, regularisation, space)
            for part, space in zip(self.parts, self.spaces, strict=True)
        ]
        self.B_inverse = [
            self.solver.product_inverse(B, space)
            for B, space in zip(self.B, self.spaces, strict=True)
        ]

    def _couplings(self, u, p, v) -> list:
        return [part.coupling(self.problem, u, p, w) for part, w in zip(self.parts, v, strict=True)]

    def _assemble_saddle(self) -> None:
        (u, p, *v), (du, dp, *dv) = self.X.TnT()
        self.saddle = BilinearForm(self.X, symmetric=True, symmetric_storage=True, condense=True)
        for term in elastic_terms(self.problem, self.h_F, u, p, du, dp):
            self.saddle += (-term).Compile() * dx
        for term in (*self._couplings(u, p, dv), *self._couplings(du, dp, v)):
            self.saddle += term
        for term in self._completion(v[-1], dv[-1]):
            self.saddle += term
        self.saddle.Assemble()

    def _completion(self, q, r) -> list:
        return self._plastic_strain.completion(self.problem, self.h_F, q, r)

    def _assemble_completion(self) -> SparseMatrixd | None:
        R = self.spaces[-1]
        terms = self._completion(*R.TnT())
        if not terms:
            return None
        form = BilinearForm(R, symmetric=True, symmetric_storage=True)
        for term in terms:
            form += term
        return form.Assemble().mat.local_mat

    def _assemble_primal(self) -> None:
        (u, p), (du, dp) = self.Y.TnT()
        D = BilinearForm(self.Y, symmetric=True, symmetric_storage=True)
        for term in elastic_terms(self.problem, self.h_F, u, p, du, dp):
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
        self._condense(V)

    def _condense(self, V: FESpace) -> None:
        """Factors of D without p, which lives inside the elements, and of its block for p."""
        self._displacements, self._strains = (0, V.ndof), (V.ndof, self.Y.ndof)
        block = diagonal_block(self.D.local_mat, *self._strains)
        self._p_inverse = block.Inverse(inverse="sparsecholesky")
        saddle = self.saddle.mat.local_mat
        condensed = diagonal_block(saddle, *self._displacements, factor=-1.0)
        self.u_inverse = self.solver.primal_inverse(condensed, V)

    def _assemble_coupling(self) -> None:
        u, p = self.Y.TrialFunction()
        w = self.H.TestFunction()
        coupling = BilinearForm(trialspace=self.Y, testspace=self.H)
        for term in self._couplings(u, p, w):
            coupling += term
        self.Lambda = coupling.Assemble().mat
        psi = LinearForm(self.H)
        for part, component in zip(self.parts, w, strict=True):
            offset = part.offset(self.problem, component)
            if offset is not None:
                psi += offset
        self.psi = psi.Assemble().vec

    def Y_vector(self) -> BaseVector:
        """Zero in Y."""
        y = self.load.CreateVector()
        y[:] = 0.0
        return y

    def H_vector(self) -> BaseVector:
        """Zero in H."""
        v = self.psi.CreateVector()
        v[:] = 0.0
        return v

    def H_functional(self) -> BaseVector:
        """Zero as a functional on H."""
        f = self.psi.CreateVector()
        f[:] = 0.0
        f.SetParallelStatus(PARALLEL_STATUS.DISTRIBUTED)
        return f

    def part_of(self, v: BaseVector, number: int) -> BaseVector:
        """View of the component ``number`` of a vector on H, what this process has of it.

        ``v`` has to outlive the view.
        """
        return v.local_vec.Range(int(self.firsts[number]), int(self.firsts[number + 1]))

    def primal_of(self, v: BaseVector, y: BaseVector, refinements: int = REFINEMENTS) -> None:
        """Solve D y = Lambda* v - l with the prescribed displacements; overwrites ``y``.

        The factors of the condensed D find y, the residual formed with D itself corrects it: where
        h is small beside the elastic moduli, condensation alone would lose digits.
        """
        right, r = y.CreateVector(), y.CreateVector()
        right.data = self.Lambda.T * v + self.load
        y.data = self.lift.vec
        for _ in range(1 + refinements):
            r.data = right - self.D * y
            y += self.primal_response(r)

    def primal_response(self, r: BaseVector) -> BaseVector:
        """The y with D y = r, zero at the supports, by the factors of the condensed D."""
        rest, y = r.CreateVector(), self.Y_vector()
        u, p = (y.local_vec.Range(*part) for part in (self._displacements, self._strains))
        p.data = self._p_inverse * r.local_vec.Range(*self._strains)
        rest.data = r - self.D * y
        y[:] = 0.0
        u.data = self.u_inverse * rest.local_vec.Range(*self._displacements)
        rest.data = r - self.D * y
        p.data = self._p_inverse * rest.local_vec.Range(*self._strains)
        return y

    def primal_change(self, dv: BaseVector, du: BaseVector) -> BaseVector:
        """dy with D dy = Lambda* dv, from the guess ``du`` of its displacements."""
        right, r, dy = self.load.CreateVector(), self.load.CreateVector(), self.Y_vector()
        right.data = self.Lambda.T * dv
        dy.local_vec.Range(*self._displacements).data = du
        for _ in range(1 + REFINEMENTS):
            r.data = right - self.D * dy
            dy += self.primal_response(r)
        return dy

    def rounding_of(self, y: BaseVector) -> BaseVector:
        """EPSILON |D| |y|: how uncertain each entry of D y is, in whatever way D is assembled.

        On a distributed mesh it is what this process contributes, a vector of its own.
        """
        D = self.D.local_mat.CreateMatrix()
        sizes, rounding = D.CreateRowVector(), D.CreateColVector()
        D.AsVector().FV().NumPy()[:] = np.abs(self.D.local_mat.AsVector().FV().NumPy())
        sizes.FV().NumPy()[:] = np.abs(y.FV().NumPy())
        rounding.data = EPSILON * (D * sizes)
        return rounding

    def conjugate(self, y: BaseVector, v: BaseVector) -> float:
        """F*(Lambda* v) = <Lambda* v - l, y> - 1/2 <D y, y> + s(q, q) / 2.

        There D y = Lambda* v - l.
        """
        r, y_0 = y.CreateVector(), y.CreateVector()
        r.data = self.Lambda.T * v + self.load
        y_0.data = y - self.lift.vec
        twice_energy = InnerProduct(r, y_0) + InnerProduct(self.D_lift, y)  # <D y, y>
        return InnerProduct(r, y) - twice_energy / 2 + self._completed(v) / 2

    def conjugate_gradient(self, y: BaseVector, v: BaseVector) -> BaseVector:
        """Lambda y + s(q, .), the derivative of F*(Lambda* v) where D y = Lambda* v - l."""
        g = self.psi.CreateVector()
        g.data = self.Lambda * y
        if self.completion is not None:
            last = len(self.parts) - 1
            self.part_of(g, last).data += self.completion * self.part_of(v, last)
        return g

    def _completed(self, v: BaseVector) -> float:
        """s(q, q)."""
        if self.completion is None:
            return 0.0
        q = self.part_of(v, len(self.parts) - 1)
        return total(InnerProduct((self.completion * q).Evaluate(), q), self.problem.mesh)
