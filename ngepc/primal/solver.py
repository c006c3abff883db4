"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy under the contact conditions N u <= gaps.  All iterates but the start are
feasible and every step goes downhill.

Everything is assembled from symbolic forms of NGSolve: it is the independent witness of
``ngepc.local``, with which it shares supports, loads, integration rules and contact rows, and how a
step ends at contact and where the energy falls (``results.step``); energy, tangent and plastic
strain are its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.kinds import require_function, require_instance
from ngepc.discretisation.prolongation import nodal_values
from ngepc.linalg.direct import require_solver
from ngepc.model.problem import Problem
from ngepc.primal.energy import ReducedEnergy
from ngepc.primal.result import PrimalResult, PrimalState
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor
from ngepc.results.step import ContactStep, ExactTarget, Line


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


class PrimalLine(Line):
    """States and work along a step in u alone."""

    def internal_work(self, t: float) -> float:
        """The internal forces at u + t du times du."""
        du = self.target.change
        return float(np.vdot(self.here.reduced.internal_forces(self.here.u + t * du), du))

    def state(self, t: float) -> PrimalState:
        """The state at u + t du."""
        u = self.here.u + t * self.target.change
        return PrimalState(self.here.reduced, u, self.forces(t))


class PrimalStep(ContactStep):
    """A step in u alone."""

    line, result = PrimalLine, PrimalResult

    def numbers(self, state: PrimalState) -> dict[str, float]:
        """What yields."""
        return {"plastic_active": state.reduced.plastic_measure(state.u)}


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
    step, tolerance = PrimalStep(reduced, ExactTarget(reduced)), options.tolerance
    return newton_iteration(state, step, tolerance, options.max_iterations, monitor)
