"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy under the contact conditions N u <= gaps.  Each step minimises Newton's model
of it over the *feasible* set: one factorisation, and a complementarity problem on the contact rows
that is solved exactly.  All iterates are feasible and every step goes downhill.

Everything is assembled from symbolic forms of NGSolve: it is the independent witness of
``ngepc.local``, with which it shares supports, loads, integration rules and contact rows only.
"""

from __future__ import annotations

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.kinds import require_function, require_instance
from ngepc.discretisation.prolongation import nodal_values
from ngepc.model.problem import Problem
from ngepc.primal.energy import ReducedEnergy
from ngepc.primal.result import PrimalResult
from ngepc.primal.state import PrimalState
from ngepc.primal.step import PrimalOptions, PrimalStep
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor


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
