"""``semismooth_newton``: the exact method without gamma, the paper's regularised one with it."""

from __future__ import annotations

from typing import overload

from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.result import DualResult
from ngepc.dual.solver import solve_regularised
from ngepc.dual.spaces import Coupled
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.local.exact import solve_exactly
from ngepc.local.result import ExactResult
from ngepc.model.own import own_copy
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import Monitor


@overload
def semismooth_newton(
    problem: Problem,
    gamma: None = None,
    start: object | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: None = None,
) -> ExactResult: ...


@overload
def semismooth_newton(
    problem: Problem,
    gamma: float | None = None,
    start: DualResult | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: Coupled | None = None,
) -> DualResult: ...


@one_blas_thread
@crew()
def semismooth_newton(
    problem: Problem,
    gamma: float | None = None,
    start: object | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: Coupled | None = None,
) -> ExactResult | DualResult:
    """Solve one time step: the discrete problem itself, or its regularisation (D_gamma).

    With neither ``gamma`` nor ``regularisation`` nothing is regularised: J(u, p) of (2.14) is
    minimised over the discrete displacements with N u <= gaps by a primal-dual Newton method,
    ``ngepc.local``.  With one of them Algorithm 7.1 solves the paper's (D_gamma).

    Parameters
    ----------
    problem
        The data.
    gamma
        Short for ``regularisation=Coupled(gamma)``.
    start
        An earlier result (exact: or a displacement) on this or another mesh of the body; None
        starts from zero.  The exact method may then solve a soft plane problem of order two with
        order one before; the records of that are ``order_one`` of the result.
    options
        Tolerance, limits and solver; None for the defaults.
    monitor
        Called with the record of each iterate, start included; raising StopIteration stops.
    regularisation
        The regularisation; give this or ``gamma``.

    Returns
    -------
    ExactResult or DualResult
        Status, history and fields; the state reached is always there.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("problem", problem, Problem, "a Problem")
    options = NewtonOptions() if options is None else options
    require_instance("options", options, NewtonOptions, "NewtonOptions(...)")
    require_function("monitor", monitor, "a record", optional=True)
    if gamma is not None and regularisation is not None:
        raise ValueError(f"gamma={gamma!r}: give either gamma or regularisation")
    if gamma is None and regularisation is None:
        tolerance = options.tolerance
        limit = options.max_iterations
        return solve_exactly(problem, start, tolerance, limit, options.inverse, monitor)
    regularisation = Coupled(gamma) if regularisation is None else regularisation
    require_instance("regularisation", regularisation, Coupled, "Coupled(...)")
    return solve_regularised(own_copy(problem), regularisation, start, options, monitor)
