"""Guaranteed intervals of forces and displacements; their width is a product of two errors.

Let u_h be an admissible displacement and sigma^ a stress in equilibrium with the loads and a
contact pressure P^, as in the error bound; gap_h = psi - u_h . n >= 0, and s(.) the stress by the
strain of the step.  A goal Q is l(u) for a load (c = 0), or int c P (l = 0).  Let z be any
displacement that vanishes on supports, tau^ any stress in equilibrium with the load of the goal and
the pressure pi^, and lambda > 0 with

    c - z . n <= lambda gap_h   and   -pi^ <= lambda P^   on contact.

Then

    Q <= Q_0 + int S + lambda int P^ gap_h,
    Q_0 = l(u_h) + [f(z) - int s(eps_h) : eps(z)] + int pi^ gap_h,
    S = sup over e of  tau^ : e - eps(z) : (s(eps_h + e) - s(eps_h))
                       - lambda e : (s(eps_h + e) - sigma^).

The lower bound is the same with -z, -tau^, -pi^ and -c.  For two bodies u . n and z . n are the
jumps of these.  ``docs/goal_bound.md`` has the proof.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ngepc.bounds.bound import state_of
from ngepc.bounds.counterpart import on_simplices
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.data import BoundData
from ngepc.bounds.of_state import bound_and_search, bound_data_of
from ngepc.bounds.outcome import FLOWS, ErrorBound, why_infinite
from ngepc.bounds.rollers import in_components, result_by_nodes
from ngepc.bounds.thickness import is_of_thickness_one, of_thickness_one
from ngepc.bounds.transfer import on_matching
from ngepc.checks.kinds import require_instance
from ngepc.discretisation.factors import Factors
from ngepc.goals.adjoint import AdjointProblem, Start
from ngepc.goals.adjoint_conditions import EPS
from ngepc.goals.best_lambda import LARGEST, Candidate, LambdaSearch, size_of_energy
from ngepc.goals.goal_interval import GoalBound, interval_of_elements, thick_goal
from ngepc.goals.goal_terms import GoalTerms, check_goal, goal_of_result, terms_of
from ngepc.goals.integrand import BoundPart
from ngepc.goals.kinds import Goal, as_goal, over_elements_of
from ngepc.goals.resultant import largest_resultant
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.secants import Compliance
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.features import FEATURES, require_covered
from ngepc.model.problem import Problem

COVERS = BOUNDED - {"axisymmetric"}
"""Features that goal bounds cover."""
WITH_HILL = COVERS - {"isotropic hardening", "hardening law", "rate"}
"""Those that they cover together with Hill's criterion."""
INSTEAD = "; confidence(result) says how accurate its energy is"
"""What is advised where there is no interval."""

ROUNDING = 1e-12
"""Part of the works in an interval by which it is widened, for rounding errors."""
SUPREMA = 1e-14
"""The same for lambda times the strain energy, which the suprema are differences of."""
RESULTANT = 2.0
"""The resultant of the solution's pressure over that of P^ where no bound of it is known."""


@one_blas_thread
def goal_bound(result: object, goal: object) -> GoalBound:
    """A guaranteed interval of a force or a displacement of the continuous solution.

    Parameters
    ----------
    result
        A result of ``semismooth_newton`` without gamma, converged or not.
    goal
        "contact_force", "work" (of the loads), ``ContactForceOn``, ``MeanDisplacement``,
        ``LoadWork``, ``DisplacementAt`` (the mean over the element around the point) or
        ``Reaction``.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver, or ``goal`` is not a goal.
    ValueError
        For problems that goal bounds do not cover; the message names the argument: loads that
        vary inside elements, and everything that error bounds do not cover.
    RuntimeError
        As ``error_bound``, and where the error bound is infinite.
    """
    require_instance("result", result, ExactResult, "a result without gamma")
    check_goal(goal, in_components(result.problem))
    return GoalProblem(result).bound_of(goal)


def check_goals(problem: Problem) -> None:
    """Refuse problems without goal bounds by name; what error bounds refuse is left to them."""
    bounded = FEATURES.keys() - BOUNDED
    require_covered(problem, "a goal bound", COVERS | bounded, INSTEAD)
    if FEATURES["anisotropic yield"].found(problem):
        what = "a goal bound with Hill's criterion"
        advice = "; displacement_bracket(result, ...) covers it"
        require_covered(problem, what, WITH_HILL | bounded, advice)


def require_finite(bound: ErrorBound) -> None:
    """Refuse an infinite bound with a RuntimeError."""
    if not math.isfinite(bound.total):
        why = why_infinite(bound.state)
        advice = "" if why == FLOWS else " So may a finer mesh."
        raise RuntimeError(why + advice)


class GoalProblem:
    """A result with its error bound, for several goals, which share factors and stresses."""

    def __init__(self, result: ExactResult) -> None:
        check_goals(result.problem)
        thick = result.problem
        one = result_by_nodes(of_thickness_one(result))
        given = on_simplices(one)
        result, parents = on_matching(given)
        bound_data = bound_data_of(result.discrete)
        tangent = Factors(bound_data.discrete, "sparsecholesky")
        state = state_of(bound_data.discrete, result)
        bound, search = bound_and_search(bound_data, state, tangent)
        self._take(bound_data, bound, tangent, search, result.compliance)
        self._mesh = one.problem.mesh
        self._given = one.state
        if parents is not None:
            self._copied = given.problem, parents
        if given is not one:
            self._cut = one
        if not is_of_thickness_one(thick):
            self._thick = thick

    @classmethod
    def of_bound(
        cls,
        bound_data: BoundData,
        bound: ErrorBound,
        tangent: Factors,
        search: Any,
        compliance: Compliance | None = None,
        given: State | None = None,
    ) -> GoalProblem:
        """The same from the results of ``bound_and_search`` and the factors that it used.

        ``compliance`` is a guess of that of the contact rows, from Newton's method for example;
        ``given`` is the state before it was cleared of the obstacle, None if it was clear.
        """
        made = cls.__new__(cls)
        check_goals(bound_data.problem)
        made._take(bound_data, bound, tangent, search, compliance)
        made._given = bound.state if given is None else given
        return made

    def _take(
        self,
        bound_data: BoundData,
        bound: ErrorBound,
        tangent: Factors,
        search: Any,
        compliance: Compliance | None = None,
    ) -> None:
        if bound_data.carried.left.any():
            names = " and ".join(
                name
                for name in ("body_force", "traction", "pressure")
                if getattr(bound_data.problem, name) is not None
            )
            raise ValueError(
                f"{names}: a goal bound needs a body force that is constant on elements and "
                "tractions that are affine; displacement_bracket(result, ...) takes any load"
            )
        self._copied: tuple[Problem, np.ndarray] | None = None
        self._cut: ExactResult | None = None
        self._thick: Problem | None = None
        self._mesh = bound_data.problem.mesh
        self.bound_data = bound_data
        self.bound = bound
        if compliance is not None:
            compliance = compliance.copy()  # it learns
        self._adjoints = AdjointProblem(
            bound_data,
            bound.state,
            bound.pressure,
            min(bound.relative, 1.0),
            tangent,
            search,
            compliance,
        )
        require_finite(bound)
        self._of_bound = BoundPart(bound_data, bound)
        self._lambdas = LambdaSearch(bound, self._adjoints, self._of_bound)

    def bound_of(self, goal: object, near: float | None = None) -> GoalBound:
        """The interval of a goal; ``near`` is a guess of lambda, such as that of the last mesh."""
        bound_data = self.bound_data
        goal = over_elements_of(self._mesh, as_goal(goal))
        terms = terms_of(goal, bound_data)
        discrete = terms.value(bound_data, self.bound.state)
        start = self._adjoints.start(terms)
        if size_of_energy(self.bound) > 0:
            best = self._lambdas.best(start, near)
            found = self._interval(start, best.finite(), discrete)
        else:
            found = self._at_rest(start, discrete)
        found = replace(found, discrete=self._goal_of_given(goal, terms))
        if self._copied is not None:
            found = interval_of_elements(found, *self._copied)
        return found if self._thick is None else thick_goal(found, self._thick)

    def _goal_of_given(self, goal: Goal, terms: GoalTerms) -> float:
        """The goal of the result, not of the displacement that clears the obstacle for the bound.

        That is one on another mesh where two bodies meet; both have the same contact forces.
        """
        if self._cut is not None:
            return goal_of_result(goal, self._cut)
        force = terms.contact_force(self.bound_data, self.bound.state)
        return force + goal.form(self._given.discrete.problem).work(self._given)

    def _at_rest(self, start: Start, discrete: float) -> GoalBound:
        """The goal of a solution without strain and error: known exactly.

        The error bound is zero, so that the width of the interval falls as 1/lambda.
        """
        size = np.ptp(self.bound_data.cells.points, axis=0).max()
        moved = np.abs(start.base.z + start.lift).max()
        chosen = self._lambdas.candidate(start, float(LARGEST * moved / size) or 1.0)
        none = np.zeros(len(self.bound_data.cells.nodes))
        adjoint = chosen.adjoint
        numbers = (adjoint.energy, chosen.factor, none, adjoint, start.goal)
        ends = (start.goal.name, discrete, discrete, discrete)
        return GoalBound(*ends, self.bound, *numbers, start.goal.note)

    def _interval(self, start: Start, chosen: Candidate, discrete: float) -> GoalBound:
        """The interval that an adjoint and its lambda give."""
        terms = start.goal
        contact = self.bound_data.contact
        state = self.bound.state
        adjoint = chosen.adjoint
        opened = chosen.factor * contact.opening(state.u, self.bound.pressure)
        centre = float(np.vdot(start.load, state.u))
        centre += float(np.vdot(self.bound_data.discrete.load, adjoint.z))
        centre += chosen.integrand.residual
        centre -= float(
            np.vdot(self.bound_data.discrete.supports.pull(state.u), adjoint.z)
        )
        centre += float(contact.opening(state.u, adjoint.pressure).sum())
        rounding = self._rounding(terms, chosen, discrete)
        above, below = chosen.suprema
        per_cell = (above + below) / 2
        per_cell += np.bincount(contact.owner, opened, minlength=len(per_cell))
        proved = centre - float(below.sum() + opened.sum()) - rounding
        lower = max(proved, 0.0) if terms.is_contact_force else proved
        return GoalBound(
            terms.name,
            lower,
            centre + float(above.sum() + opened.sum()) + rounding,
            discrete,
            self.bound,
            adjoint.energy,
            chosen.factor,
            per_cell,
            adjoint,
            terms,
            terms.note,
            lower - proved,
        )

    @cached_property
    def _resultant(self) -> float:
        """No less than the contact force of the solution, for all goals."""
        return largest_resultant(self.bound_data, self.bound)

    def _rounding(self, terms: GoalTerms, chosen: Candidate, discrete: float) -> float:
        """By how much rounding errors widen the interval at each end.

        Conditions that are violated by v change the proof by at most v times the resultant of the
        pressure of the solution, see ``largest_resultant``.
        """
        state = self.bound.state
        factor = chosen.factor
        z = np.abs(chosen.adjoint.z)
        works = np.vdot(np.abs(self.bound_data.discrete.load), z)
        works += np.vdot(np.abs(state.internal_forces), z) + abs(discrete)
        missed = self._adjoints.violation(terms, chosen.adjoint.z, factor)
        missed += factor * self._adjoints.penetration
        sizes = self._adjoints.scale(terms, z) + factor * np.abs(state.u).max()
        missed += EPS * sizes
        P = self.bound.pressure[:, :, None]
        force = self.bound_data.contact.moments(P)[:, : P.shape[1]].sum()
        suprema = SUPREMA * factor * self.bound.strain_energy
        largest = self._resultant
        force = max(RESULTANT * force, largest if math.isfinite(largest) else 0.0)
        return float(ROUNDING * works + suprema + force * missed)
