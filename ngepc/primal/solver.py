"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy under the contact conditions N u <= gaps.  Each step minimises Newton's model
of it over the *feasible* set: one factorisation, and a complementarity problem on the contact rows
that is solved exactly.  All iterates are feasible and every step goes downhill.

Everything is assembled from symbolic forms of NGSolve: it is the independent witness of
``ngepc.local``, with which it shares supports, loads, integration rules and contact rows only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.kinds import require_function, require_instance
from ngepc.discretisation.balance import EPSILON
from ngepc.discretisation.contact_step import ROUNDING, ContactWork, rival, with_contact
from ngepc.discretisation.prolongation import nodal_values
from ngepc.linalg.direct import SOLVER_ERRORS, FactorisationError, require_solver
from ngepc.linalg.linesearch import nearly_flat
from ngepc.model.problem import Problem
from ngepc.primal.energy import ReducedEnergy
from ngepc.primal.result import PrimalResult, PrimalState
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor

SLOPE_ROUNDING = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""


@dataclass(frozen=True, kw_only=True)
class PrimalOptions(Declared):
    """How far ``primal_newton`` iterates.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the nodal forces out of balance and of
        what contact leaves, relative to the larger of the norms of applied and internal forces,
        or to the smaller of beta/h and 4e-6 |K| |u|, where strains cancel; in [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.
    inverse
        NGSolve's name of a direct solver, or, for large bodies, ``PETSc()`` or ``PyAMG()``.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: Annotated[float, Check(require_number, least=1e-13, below=1)] = 1e-10
    max_iterations: Count = 100
    inverse: Annotated[str | object, Check(require_solver)] = "sparsecholesky"


class PrimalStep:
    """A step in u alone, see ``NewtonStep``; what the rows answer is learned from step to step."""

    result = PrimalResult

    def __init__(self, reduced: ReducedEnergy) -> None:
        self.reduced, self.contact = reduced, reduced.contact
        self.compliance = reduced.compliance()

    def __call__(self, here: PrimalState) -> tuple[PrimalState, float, int] | None:
        """The next state, the step length and its trials; None if no length lowers J."""
        change, contact = self._target(here)
        length, trials = 1.0, 0  # a step from an infeasible u makes it feasible
        if here.penetration <= here.touching_distance:
            found = nearly_flat(*self._slope(here, change, contact))
            if found is None:
                return None
            length, trials = found
        if length < 1:
            contact = here.contact + length * (contact - here.contact)
        return PrimalState(self.reduced, here.u + length * change, contact), length, trials

    def rival(self, state: PrimalState) -> tuple[bool, str]:
        """Whether friction allows other equilibria beside a solution, see ``NewtonStep``."""
        if not self.contact.friction.d:
            return False, ""
        self.reduced.factorise(state.u)
        return rival(state, self.reduced.solve, self.reduced.examined)

    def numbers(self, state: PrimalState) -> dict[str, float]:
        """What yields."""
        return {"plastic_active": self.reduced.plastic_measure(state.u)}

    def _target(self, here: PrimalState) -> tuple[np.ndarray, np.ndarray]:
        """The step to the solution of Newton's model with contact, and the contact forces there."""
        reduced = self.reduced
        try:
            reduced.factorise(here.u)
        except SOLVER_ERRORS as error:
            raise FactorisationError(f"the factorisation failed: {error}") from error
        free = reduced.solve(-here.imbalance)
        if not np.isfinite(free).all():
            raise FactorisationError("the tangent stiffness is singular")
        found = with_contact(here, reduced.solve, free, here.contact, self.compliance)
        if found is None:
            raise FactorisationError(self.contact.unsolvable)
        return found

    def _slope(
        self, here: PrimalState, change: np.ndarray, following: np.ndarray
    ) -> tuple[Callable[[float], float], float]:
        """d/dt of J(u + t du) with the work of friction, and what rounding leaves of it."""
        reduced, work = self.reduced, ContactWork(here, change, following)
        rest = np.where(reduced.free, work.held - reduced.load, 0.0)

        def slope(t: float) -> float:
            forces = reduced.internal_forces(here.u + t * change) + rest
            return float(np.vdot(forces, change)) + work.slope(t)

        terms = SLOPE_ROUNDING * np.abs(change) + 2 * EPSILON * np.abs(here.u)
        answers = np.abs(following) / self.reduced.row_stiffness
        held = ROUNDING * np.abs(following).sum() * answers.max(initial=0.0)
        return slope, float(np.vdot(np.abs(here.internal_forces), terms) + held)


def primal_newton(
    problem: Problem,
    start: GridFunction | object | None = None,
    options: PrimalOptions | None = None,
    monitor: Monitor | None = None,
) -> PrimalResult:
    """Minimise J(u, p) of (2.14) over continuous displacements and pointwise plastic strains.

    The points are those of ``discretisation.rules``, for all kinematics and both orders.

    Parameters
    ----------
    problem
        Data of the time step.
    start
        A displacement to start from: a GridFunction or any result with ``displacement``, on this
        or on another mesh of the body (it is evaluated at the vertices).  None starts from zero.
    options
        Tolerance and limits; None for the defaults.
    monitor
        Called with the record of every iterate; raising StopIteration ends the run.

    Returns
    -------
    PrimalResult
        ``status`` is CONVERGED only if the residual of the returned state meets the tolerance.

    Raises
    ------
    TypeError
        If ``problem``, ``start`` or ``options`` is of the wrong kind.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_function("monitor", monitor, "a record", optional=True)
    options = PrimalOptions() if options is None else options
    require_instance("options", options, PrimalOptions, "PrimalOptions(...)")
    given = None if start is None else nodal_values(start, problem)
    reduced = ReducedEnergy(problem, options.inverse)
    u = reduced.supports.values
    if given is not None:
        u = np.where(reduced.free, given, u)
    u = reduced.contact.on_rollers(u, reduced.free)
    state = PrimalState(reduced, u, np.zeros(len(reduced.contact)))
    step, tolerance = PrimalStep(reduced), options.tolerance
    return newton_iteration(state, step, tolerance, options.max_iterations, monitor)
