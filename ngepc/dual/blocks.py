"""The linear part of the saddle function: D, Lambda, l, psi and B, assembled once for a path."""

from __future__ import annotations

import numpy as np
from ngsolve import (
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
    dx,
)
from ngsolve.la import BaseVector

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.loads import work_of
from ngepc.discretisation.spaces import displacement_space, plastic_space, prescribed_displacement
from ngepc.dual.parts import dual_parts
from ngepc.dual.spaces import DualSpaces
from ngepc.linalg.direct import symmetric_inverse
from ngepc.model.limits import require_without
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.processes import require_whole

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


class LinearBlocks:
    """Matrices and vectors of a problem that no Newton step and no gamma changes.

    ``parts`` are those of v by name; Y, H and X the spaces of y = (u, p), of v and of (y, v);
    ``saddle`` the condensed form of [[-D, Lambda*], [Lambda, 0]].  D: Y -> Y* is neither condensed
    nor factorised, Lambda: Y -> H; ``B`` and ``B_inverse`` are by name (the Poisson solves).
    ``load`` and ``psi`` are -l and [psi, 0] as functionals, ``residual_unit`` is that of
    ||Psi_gamma||_{H*}, length^(N/2 + 1) of the reference units.  ValueError for a problem that the
    paper's method is not for.
    """

    def __init__(self, problem: Problem, choice: DualSpaces, inverse: str) -> None:
        require_papers_problem(problem)
        self.problem, self.choice = problem, choice
        self.residual_unit = choice.units.length ** (problem.N / 2 + 1)
        self.parts = dual_parts(problem, choice)
        spaces = [part.space for part in self.parts.values()]
        V, Q = displacement_space(problem), plastic_space(problem)
        self.Y, self.H, self.X = FESpace([V, Q]), FESpace(spaces), FESpace([V, Q, *spaces])
        lasts = np.cumsum([space.ndof for space in spaces]).tolist()
        ranges = zip([0, *lasts], lasts, strict=False)
        self._ranges = dict(zip(self.parts, ranges, strict=True))
        self._assemble_saddle(inverse)
        self._assemble_primal()
        self._assemble_coupling()
        self.B = {name: part.tichonov() for name, part in self.parts.items()}
        self.B_inverse = {
            name: B.Inverse(self.parts[name].space.FreeDofs(), inverse=inverse)
            for name, B in self.B.items()
        }

    def _couplings(self, u, p, v) -> list:
        return [part.coupling(u, p, w) for part, w in zip(self.parts.values(), v, strict=True)]

    def _assemble_saddle(self, inverse: str) -> None:
        (u, p, *v), (du, dp, *dv) = self.X.TnT()
        h = self.problem.effective_hardening
        self.saddle = BilinearForm(self.X, symmetric=True, symmetric_storage=True, condense=True)
        for term in elastic_terms(self.problem, h, u, p, du, dp):
            self.saddle += (-term).Compile() * dx
        for term in (*self._couplings(u, p, dv), *self._couplings(du, dp, v)):
            self.saddle += term
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

    def _assemble_coupling(self) -> None:
        (u, p), v = self.Y.TrialFunction(), self.H.TestFunction()
        coupling, psi = BilinearForm(trialspace=self.Y, testspace=self.H), LinearForm(self.H)
        for term in self._couplings(u, p, v):
            coupling += term
        for part, w in zip(self.parts.values(), v, strict=True):
            offset = part.offset(w)
            if offset is not None:
                psi += offset
        self.Lambda, self.psi = coupling.Assemble().mat, psi.Assemble().vec

    def Y_vector(self) -> BaseVector:
        """Zero in Y."""
        return (0.0 * self.load).Evaluate()

    def H_vector(self) -> BaseVector:
        """Zero in H."""
        return (0.0 * self.psi).Evaluate()

    def part_of(self, v: BaseVector, name: str) -> BaseVector:
        """View of the part of a vector on H."""
        return v.Range(*self._ranges[name])

    def first_of(self, name: str) -> int:
        """First degree of freedom of a part within X."""
        return self.Y.ndof + self._ranges[name][0]

    def fields(self, y: BaseVector, v: BaseVector) -> dict[str, GridFunction]:
        """'displacement', 'plastic_strain' and the parts of v as functions on the mesh."""
        state = GridFunction(self.X)
        state.vec.Range(0, self.Y.ndof).data = y
        state.vec.Range(self.Y.ndof, self.X.ndof).data = v
        names = ("displacement", "plastic_strain", *self.parts)
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
