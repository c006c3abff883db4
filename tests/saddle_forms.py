"""The Newton system as forms of NGSolve, in all three unknowns: a witness of the tangent.

The unknowns du, dp, dq solve at each state (u, q), w = -q, with c = 2 mu_2 + h and, where the trial
stress s of the paper's (3.8) exceeds the yield bound,  |s| w = beta s  linearised:

    int sigma(du, dp) : eps(v) = r(v),     sigma = mu_1 tr eps(du) I + 2 mu_2 (eps(du) - dp),
    c dp - 2 mu_2 dev eps(du) = dq,        the first rows of D y = (l, q) in (4.1),
    c B dp + (I - B) dq = 0,               dw = B ds with ds = dw + c dp,

    B = beta/|s| (I - d d') + (beta - w.d)/|s| d d',  d = s/|s|,   and B = I where s is elastic.

p and q live at the integration points, so that NGSolve condenses them element by element
(``condense=True``).  ``Stiffness`` assembles the same matrix of u directly, in 9 ms where this
takes 0.26 s (Example (a), 6273 nodes); this is what it is compared with.
"""

from __future__ import annotations

import numpy as np
from ngsolve import (
    COUPLING_TYPE,
    L2,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    GridFunction,
    IfPos,
    InnerProduct,
    Norm,
    Trace,
    VectorValued,
    dx,
)
from ngsolve.fem import CacheCF
from ngsolve.la import BaseMatrix

from ngepc.discretisation.law import ROUNDING
from ngepc.discretisation.points import PointFunctions
from ngepc.discretisation.spaces import nodal
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.data import as_scalar
from ngepc.model.elements import plastic_order


class SaddleForms:
    """The tangent of a Newton step, u x p x q condensed to u.

    Parameters
    ----------
    discrete
        The discrete problem.
    inverse
        NGSolve's name of a direct solver.

    Attributes
    ----------
    form
        The bilinear form on u x p x q; ``form.mat`` is condensed.
    back_substitutions, linear_iterations
        As for ``Factors``.
    """

    linear_iterations, examined, stiffened = 0, 600, None

    def __init__(self, discrete: DiscreteProblem, inverse: str) -> None:
        self.discrete, self._name, self._inverse = discrete, inverse, None
        self.back_substitutions = 0
        assert not discrete.added.nnz, (
            "springs, rollers and floating parts are not in the forms"
        )
        problem, V = discrete.problem, discrete.supports.space
        assert not {"hardening law", "initial strain"} & set(problem.features)
        local = L2(problem.mesh, order=plastic_order(problem.mesh, problem.order))
        Q = VectorValued(local, problem.kinematics.d)
        self.space = V * Q * Q
        self.space.SetCouplingType(self.space.Range(0), COUPLING_TYPE.WIREBASKET_DOF)
        self.displacement, self.dual = GridFunction(V), GridFunction(Q)
        self._functions = PointFunctions(discrete.points)
        self.form = BilinearForm(self.space, condense=True)
        self.form += (
            problem.kinematics.weight
            * self._saddle(*self.space.TrialFunction(), *self.space.TestFunction())
            * dx(intrules=discrete.points.rules)
        )
        self._free = BitArray(self.space.ndof)
        self._free.Clear()
        for number in np.flatnonzero(discrete.supports.free.T.ravel()).tolist():
            self._free.Set(number)

    def _saddle(self, u, p, q, v, r, t) -> CoefficientFunction:
        """The three rows above, tested with v, r and t."""
        problem, kinematics = self.discrete.problem, self.discrete.problem.kinematics
        mu_1, two_mu = (
            as_scalar(problem.material.lame_lambda),
            2 * as_scalar(problem.material.lame_mu),
        )
        c = two_mu + problem.effective_hardening
        e, d = kinematics.strain(u), kinematics.strain(v)
        stress_power = mu_1 * Trace(e) * Trace(d) + two_mu * InnerProduct(e, d)
        balance = stress_power - two_mu * InnerProduct(p, kinematics.coordinates(d))
        definition = c * p - two_mu * kinematics.coordinates(e) - q
        return (
            balance
            + InnerProduct(definition, r)
            + InnerProduct(self._flow(c * p, q), t)
        )

    def _flow(
        self, cp: CoefficientFunction, q: CoefficientFunction
    ) -> CoefficientFunction:
        """B c dp + (I - B) dq = dq + B (c dp - dq)."""
        problem, kinematics = self.discrete.problem, self.discrete.problem.kinematics
        two_mu, beta = 2 * as_scalar(problem.material.lame_mu), as_scalar(problem.beta)
        e = kinematics.strain(self.displacement) - problem.p_0 - problem.eps_0
        s = kinematics.coordinates(two_mu * e - problem.alpha_0[1])
        size = IfPos(Norm(s) - beta, Norm(s), beta)  # max(|s|, beta) > 0
        d, ds = s / size, cp - q
        along = InnerProduct(-self.dual, d)
        part = IfPos(
            along, IfPos(beta - along, along, beta), 0.0
        )  # of w along s, in [0, beta]
        yields = Norm(s) - (1 + ROUNDING) * beta
        across = CacheCF(IfPos(yields, beta / size, 1.0).Compile())
        extra = CacheCF(IfPos(yields, part / size, 0.0).Compile())
        d = CacheCF(d.Compile())
        return q + across * ds - extra * InnerProduct(d, ds) * d

    def linearise(self, here: State) -> None:
        """Assemble and factorise the tangent at a state."""
        self.back_substitutions = 0
        self.displacement.vec.FV().NumPy()[:] = here.u.T.ravel()
        self.dual.vec.data = self._functions.function(-here.yielding).vec
        matrix = self.form.Assemble().mat
        if self._inverse is None:
            self._inverse = matrix.Inverse(self._free, inverse=self._name)
        else:
            self._inverse.Update()

    @property
    def matrix(self) -> BaseMatrix:
        """The condensed matrix, rows of p and q empty."""
        return self.form.mat

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements, zero where held, that answer nodal forces; both (nodes, N)."""
        self.back_substitutions += 1
        right, left = self.form.mat.CreateColVector(), self.form.mat.CreateRowVector()
        right[:] = 0.0
        count = forces.size
        right.FV().NumPy()[:count] = forces.T.ravel()
        left.data = self._inverse * right
        u = nodal(left.FV().NumPy()[:count], self.discrete.problem)
        return np.where(self.discrete.supports.free, u, 0.0)
