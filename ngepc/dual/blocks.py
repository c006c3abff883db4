"""The linear part of the saddle function: D, Lambda, l, psi and B, assembled once for a path."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    BilinearForm,
    BitArray,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    ds,
    dx,
)
from ngsolve.la import BaseVector
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ngepc._deprecated import old_names
from ngepc.checks.sentences import in_words
from ngepc.discretisation.sampled import LOADS, what_is_unseen
from ngepc.discretisation.supports import prescribed_displacement
from ngepc.dual import saddle
from ngepc.dual.spaces import DualSpaces
from ngepc.linalg.direct import symmetric_inverse
from ngepc.model.data import as_scalar, of_order_one, order_note
from ngepc.model.features import BASIC_FEATURES, HISTORY_FEATURES, require_covered
from ngepc.model.problem import Problem

COVERS = BASIC_FEATURES | HISTORY_FEATURES | {"quadrilaterals", "hexahedra", "prisms"}
"""Features that the paper's regularised method covers."""


def primal_energy(problem: Problem, u: GridFunction, p: GridFunction) -> float:
    """J(u, p) of (2.14); p are the coordinates of the plastic strain gained in the step."""
    mesh = problem.mesh
    strain_energy = Integrate(sum(saddle.elastic_terms(problem, u, p, u, p)) / 2, mesh)
    dissipation = Integrate(as_scalar(problem.beta) * Norm(p), mesh)
    return (
        strain_energy
        + dissipation
        - sum(Integrate(t, mesh) for t in saddle.load_terms(problem, u, p))
    )


class LinearBlocks:
    """Matrices and vectors of a problem that do not depend on the iterate and on gamma.

    Y, H and X are the spaces of y = (u, p), of v = (z, q) and of (y, v); without contact z is
    empty.  ``saddle`` is the condensed form of [[-D, Lambda*], [Lambda, 0]], D: Y -> Y* neither
    condensed nor factorised, Lambda: Y -> H, ``B_inverse`` does the Poisson solves.  ``load`` and
    ``psi`` are -l and [psi, 0] as functionals, ``residual_unit`` is that of ||Psi_gamma||_{H*},
    length^(N/2 + 1) of the reference units; ``note`` is a message for the user.  ValueError for a
    problem that the paper's method does not cover.
    """

    def __init__(self, problem: Problem, choice: DualSpaces, inverse: str) -> None:
        problem = of_order_one(problem)
        advice = "; leave gamma and regularisation out"
        require_covered(problem, "the paper's regularised method", COVERS, advice)
        self.problem = problem
        order = order_note(problem, ", as the regularised method needs them")
        self.note = " ".join(filter(None, (order, what_is_unseen(problem, LOADS))))
        self.choice = choice
        self.inverse = inverse
        fixed = choice.tichonov.fixed
        self.residual_unit = choice.units.length ** (problem.N / 2 + 1)
        self.contact = problem.mesh.Boundaries("|".join(problem.contact_names))
        spaces = saddle.SaddleSpaces(problem, ends_fixed=fixed)
        self.Y = spaces.Y
        self.H = spaces.H
        self.X = spaces.X
        self._assemble_dual(inverse)
        self._assemble_saddle(inverse)
        self._assemble_primal()

    def __reduce__(self) -> tuple:
        """NGSolve's matrices are not pickled, but assembled again."""
        return LinearBlocks, (self.problem, self.choice, self.inverse)

    def _assemble_dual(self, inverse: str) -> None:
        y = self.Y.TrialFunction()
        v, w = self.H.TnT()
        product = self.choice.tichonov
        length = self.choice.units.length
        on_contact = ds(definedon=self.contact)
        B = BilinearForm(self.H)
        psi = LinearForm(self.H)
        psi += self.problem.psi * w[0] * on_contact
        B += product.contact(v[0], w[0], length) * on_contact
        B += product.plastic(v[1], w[1], length) * dx
        self.B = B.Assemble().mat
        self.psi = psi.Assemble().vec
        if product.fixed:
            self._require_ends()
        self.B_inverse = self.B.Inverse(self.H.FreeDofs(), inverse=inverse)
        coupling = BilinearForm(trialspace=self.Y, testspace=self.H)
        coupling += saddle.coupling(self.problem, y, w)
        self.Lambda = coupling.Assemble().mat

    def _require_ends(self) -> None:
        """ValueError where a piece of Gamma_c has no ends: B has a kernel there."""
        ends = self.H.Range(0).stop
        Z = csr_matrix(tuple(np.asarray(a) for a in self.B.CSR()))[:ends, :ends]
        number, piece = connected_components(Z)
        if len(set(piece[~np.array(self.H.FreeDofs())[:ends]])) < number:
            raise ValueError(
                f"contact={in_words(self.problem.contact)} has a closed piece without "
                "ends: the gradient "
                "product (R2) has the constants in its kernel there; use tichonov=FullProduct()"
            )

    def _assemble_saddle(self, inverse: str) -> None:
        (u, p, *v), (du, dp, *dv) = self.X.TnT()
        self.saddle = BilinearForm(
            self.X, symmetric=True, symmetric_storage=True, condense=True
        )
        for term in saddle.elastic_terms(self.problem, u, p, du, dp):
            self.saddle += (-term).Compile() * dx
        self.saddle += saddle.coupling(self.problem, (u, p), dv)
        self.saddle += saddle.coupling(self.problem, (du, dp), v)
        self.saddle.Assemble()
        displacements = BitArray(self.X.FreeDofs(coupling=True))
        displacements[self.Y.ndof :] = False
        self._minus_D_inverse = symmetric_inverse(
            self.saddle.mat, displacements, inverse
        )

    def _assemble_primal(self) -> None:
        (u, p), (du, dp) = self.Y.TnT()
        D = BilinearForm(self.Y, symmetric=True, symmetric_storage=True)
        load = LinearForm(self.Y)
        for term in saddle.elastic_terms(self.problem, u, p, du, dp):
            D += term.Compile() * dx
        for term in saddle.load_terms(self.problem, du, dp):
            load += term
        self.D = D.Assemble().mat
        self.load = load.Assemble().vec
        self.lift = GridFunction(self.Y)
        given = prescribed_displacement(self.problem, self.Y.components[0])
        self.lift.components[0].vec.data = given.vec
        self.D_lift = (self.D * self.lift.vec).Evaluate()

    def H_vector(self) -> BaseVector:
        """Zero in H."""
        return (0.0 * self.psi).Evaluate()

    def parts(self, v: BaseVector) -> tuple[BaseVector, BaseVector]:
        """Views of z and q in a vector on H."""
        return v[self.H.Range(0)], v[self.H.Range(1)]

    def primal_of(self, v: BaseVector) -> BaseVector:
        """The y with D y = Lambda* v - l and the prescribed displacements.

        The factors of the condensed D find y, the residual formed with D itself corrects it once:
        where h is small beside the elastic moduli, condensation alone would lose digits.
        """
        right = (self.Lambda.T * v + self.load).Evaluate()
        y = (1.0 * self.lift.vec).Evaluate()
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

    def conjugate(self, y: BaseVector, v: BaseVector) -> float:
        """F*(Lambda* v) = <Lambda* v - l, y> - 1/2 <D y, y>, where D y = Lambda* v - l."""
        r = (self.Lambda.T * v + self.load).Evaluate()
        y_0 = (y - self.lift.vec).Evaluate()
        twice_energy = InnerProduct(r, y_0) + InnerProduct(self.D_lift, y)  # <D y, y>
        return InnerProduct(r, y) - twice_energy / 2


__getattr__ = old_names(__name__)
