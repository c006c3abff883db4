"""Solutions with a first-order prediction, for the live laboratory.

The factors of the last tangent are kept when the data change, and what is known of the compliance
of the contact rows.  One linear solve with contact
then gives the next solution to first order, and Newton's method starts from it.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.discretisation.contact_step import with_contact
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.secants import Compliance
from ngepc.local.choice import DIRECT, fastest_solver, few_for_factors
from ngepc.local.iterative import Iterative
from ngepc.local.result import ExactResult
from ngepc.local.solver import RepeatedSolver
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status

REMEMBERED = 2000
"""Largest number of contact forces for which the compliance matrix is kept."""

LONGER = 2.0
"""Factors are used up to this many times the number of unknowns up to which they are faster."""


class WarmSolver(RepeatedSolver):
    """Solves similar problems in sequence, each from the last solution, see ``RepeatedSolver``."""

    last: ExactResult | None = None  # the last solution
    _next: tuple[Problem, State] | None = None
    _learned: tuple[csr_matrix, Compliance] | None = None

    def _fastest(self, discrete: DiscreteProblem) -> str | Iterative:
        """Factors for larger bodies than elsewhere, since they give a prediction."""
        small = few_for_factors(discrete, LONGER)
        return DIRECT if small else fastest_solver(discrete)

    def _compliance(self, discrete: DiscreteProblem) -> Compliance:
        """The approximate compliance of the contact rows, from this and earlier solves."""
        rows = discrete.contact.matrix
        known = self._learned
        if known is None or known[0] is not rows or len(discrete.contact) > REMEMBERED:
            self._learned = known = rows, discrete.compliance()
        return known[1]

    def predict(self, problem: Problem) -> ExactResult | None:
        """The first-order prediction from the last solution; None if the tangent does not fit.

        It needs the same mesh, supports, prescribed displacements, contact boundary and friction.
        The status is STOPPED, as it is not a solution; see its residual.
        """
        self._next = None
        if self.last is None or self._tangent is None or self._tangent.moduli is None:
            return None
        discrete = self.discretised(problem)
        if discrete.stiffness is not self._discrete.stiffness:
            return None
        held = self._discrete.supports.values
        if not np.array_equal(discrete.supports.values, held):
            return None
        before = self.last.state
        here = discrete.state(before.u, contact=before.contact)
        try:
            compliance = self._compliance(discrete)
            change, contact = with_contact(here, self._tangent.solve, compliance)
        except FactorisationError:
            return None
        _, moved = here.along(change)
        state = moved(1.0, contact)
        self._next = problem, state
        return ExactResult(state, Status.STOPPED, "Predicted.", History())

    def solve(self, problem: Problem) -> ExactResult:
        """The solution, from the prediction where there is one."""
        if self._next is None or self._next[0] is not problem:
            self.predict(problem)
        near = self._next
        self._next = None
        if near is None:
            result = self(problem, self.last)
        else:
            state = near[1]
            compliance = partial(self._compliance, state.discrete)
            result = self.solve_from(state, compliance=compliance)
        self.last = result if result.status.is_success else None
        if self.last is None:
            self._learned = None
        return result
