"""The solutions that derivatives are taken at: of one time step, or of all steps of a history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from ngsolve import GridFunction
from scipy.sparse import diags
from scipy.sparse.linalg import lsmr

from ngepc.discretisation.loads import nodal
from ngepc.discretisation.points import Points
from ngepc.evolution.result import Evolution
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.loading import require_linear
from ngepc.model.problem import Problem

CLOSED = 1e-10
"""Part of the largest displacement up to which a row of a solution counts as closed."""

EXACT = 1e-15
"""Relative accuracy asked of the contact forces that balance leaves."""

Solution = ExactResult | Evolution


def states_of(result: Solution) -> list[Callable[[], State]]:
    """For each time step what gives its solution: states of a history are rebuilt when needed.

    TypeError, ValueError for results of other solvers. SolverError if the run did not converge:
    what is no solution has no derivative.
    """
    if not isinstance(result, Solution):
        raise TypeError(
            f"result={result!r}: a result of semismooth_newton without gamma, or an Evolution, "
            "is needed"
        )
    result.raise_for_status()
    require_linear(result.problem, "derivatives need")
    if isinstance(result, ExactResult):
        return [lambda: result.state]
    problems = [step.problem for step in result.steps]
    if not problems:
        raise ValueError("result has no finished step: at least one is needed")
    if any(problem.mesh != result.problem.mesh for problem in problems):
        raise ValueError("result has steps on several meshes: one mesh is needed")
    names = ("initial_plastic_strain", "initial_hardening")
    problems[0] = replace(problems[0], **{name: getattr(result.problem, name) for name in names})
    points = result.memory.functions.points
    return [
        partial(restored_state, problem, step.fields.displacement, points)
        for problem, step in zip(problems, result.steps, strict=True)
    ]


def restored_state(problem: Problem, displacement: GridFunction, points: Points) -> State:
    """The state of a finished step from its displacement: contact forces are what is missing."""
    discrete = DiscreteProblem(problem, points)
    u = nodal(displacement.vec.FV().NumPy(), problem).copy()
    state, conditions = discrete.state(u), discrete.contact
    closed = (state.open_gap <= CLOSED * np.abs(u).max()) | discrete.rows.tied
    x = np.zeros(len(conditions))
    if closed.any():
        d = (len(x) - len(closed)) // len(closed)
        pressed = np.flatnonzero(np.concatenate([closed, np.repeat(closed, d)]))
        pushes = conditions.matrix[pressed] @ diags(discrete.free.ravel().astype(float))
        x[pressed] = lsmr(pushes.T, -state.imbalance.ravel(), atol=EXACT, btol=EXACT)[0]
        admissible = np.maximum(conditions.normal(x), 0.0)
        x[: len(closed)] = np.where(discrete.rows.tied, conditions.normal(x), admissible)
    return discrete.state(u, contact=x)
