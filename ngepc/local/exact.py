"""One exact solve, which may go from zero by way of displacements of order one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.local.iterative import Iterative
from ngepc.local.result import ExactResult
from ngepc.local.solver import (
    FEW_FORCES,
    RepeatedSolver,
    SymbolicForms,
    first_compliance,
)
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import History, Monitor, Status

SOFT = 0.02
"""Hardening over 2 mu_2 below which a cold solve with order two may go by way of order one."""

FAR = 0.5
"""It does if this part of the load is out of balance after the elastic step."""

ROUGH = 1e-2
"""Tolerance of the solution of order one."""

LARGE = 1.0
"""A solution of order one without hardening and with a larger |p| is no good start."""


@one_blas_thread
@crew()
def solve_exactly(
    problem: Problem,
    start: object | None,
    tolerance: float,
    max_iterations: int,
    inverse: str | Iterative | SymbolicForms | None,
    monitor: Monitor | None,
) -> ExactResult:
    """Minimise J(u, p) of (2.14) over the discrete displacements with N u <= gaps.

    The same arguments as ``semismooth_newton`` and ``NewtonOptions``.  Without a ``start`` soft
    plane bodies with displacements of order two start from the solution of order one.
    """
    limits = {"tolerance": tolerance, "max_iterations": max_iterations}
    options = NewtonOptions(**limits, inverse=inverse)
    solver = RepeatedSolver(options)
    discrete = solver.discretised(problem)
    state = starting_state(discrete, start)
    guess = discrete.compliance
    if discrete.contact.friction.d > 1:
        # friction in space: with a poor guess the small problems of the rows take most of the time
        guess = partial(first_compliance, discrete)
    compliance = cache(guess)
    order_one = None
    if start is None and gains_by_order_one(discrete):
        order_one = OrderOne(options)
    result = solver.solve_from(state, monitor, compliance, order_one)
    if order_one is not None:
        result = replace(result, order_one=order_one.history)
    learned = compliance.cache_info().currsize > 0
    if learned and len(discrete.contact) <= FEW_FORCES:
        result = replace(result, compliance=compliance())
    return result


def gains_by_order_one(discrete: DiscreteProblem) -> bool:
    """Whether a cold solve with order two may take less time by way of order one.

    It does for plane bodies that soften much when they yield.  A history starts from its last step
    instead, and with friction the start could decide which of several equilibria is found.
    """
    problem = discrete.problem
    law = discrete.law
    plane = problem.N == 2 and problem.order == 2 and problem.processes.size == 1
    history = (
        problem.initial_plastic_strain,
        problem.initial_hardening,
        problem.initial_accumulated,
        problem.initial_displacement,
    )
    virgin = all(value is None for value in history)
    soft = float((law.least_hardening / law.two_mu).min()) < SOFT
    return plane and virgin and soft and problem.friction is None


class OrderOne:
    """Replaces the elastic iterate by a rough solution with displacements of order one.

    About half of the steps from an elastic solution only find the size of the displacement and the
    plastic zone.  With order one they take a fifth of the time.  ``history`` has their records.
    """

    history: History | None = None

    def __init__(self, options: NewtonOptions) -> None:
        self._options = replace(options, tolerance=max(ROUGH, options.tolerance))

    def __call__(self, here: State) -> State:
        """The state to go on from; the same one if it is near or order one does not converge."""
        if here.residual_norm < FAR:
            return here
        solver = RepeatedSolver(self._options)
        first = solver(replace(here.discrete.problem, order=1)).or_interrupted()
        self.history = first.history
        if first.status is not Status.CONVERGED or first.state.flowing > LARGE:
            return here
        return starting_state(here.discrete, first)
