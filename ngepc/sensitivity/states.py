"""The solutions that derivatives are taken at: of one time step, or of all steps of a history."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.sparse import diags
from scipy.sparse.linalg import spsolve

from ngepc.discretisation.loads import nodal
from ngepc.discretisation.points import Points
from ngepc.evolution.result import Evolution, EvolutionStep
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State

CLOSED = 1e-10
"""Part of the largest displacement up to which a row of a solution counts as closed."""

Solution = ExactResult | Evolution


def states_of(result: Solution) -> list[Callable[[], State]]:
    """For each time step what gives its solution: states of a history are rebuilt when needed.

    Raises
    ------
    TypeError, ValueError
        For results of other solvers, and with friction.
    SolverError
        If the run did not converge: what is no solution has no derivative.
    """
    if not isinstance(result, Solution):
        raise TypeError(
            f"result={result!r}: a result of semismooth_newton without gamma, or an Evolution, "
            "is needed"
        )
    result.raise_for_status()
    if isinstance(result, ExactResult):
        problems, states = [result.problem], [result.state.on_sphere]
    else:
        problems = [step.problem for step in result.steps]
        if any(step.problem.mesh != result.problem.mesh for step in result.steps):
            raise ValueError("result has steps on several meshes: one mesh is needed")
        points = result.memory.functions.points
        states = [partial(restored_state, step, points) for step in result.steps]
    if not states:
        raise ValueError("result has no finished step: at least one is needed")
    if any(problem.friction is not None for problem in problems):
        raise ValueError("friction is not None: there are no derivatives with friction yet")
    for problem in problems:
        if problem.contact_pairs or problem.rollers:
            raise ValueError(
                f"contact={problem.contact!r}, prescribed={problem.prescribed!r}: there are no "
                "derivatives with two bodies or a Roller yet, rigid obstacles and components are "
                "needed"
            )
    return states


def restored_state(step: EvolutionStep, points: Points) -> State:
    """The state of a finished step from its displacement: contact forces are what is missing."""
    discrete = DiscreteProblem(step.problem, points)
    u = nodal(step.fields.displacement.vec.FV().NumPy(), step.problem)
    state, rows = discrete.state(u.copy()), discrete.rows
    closed = np.flatnonzero(state.open_gap <= CLOSED * np.abs(u).max())
    multipliers = np.zeros(len(rows))
    if len(closed):
        free = diags(discrete.supports.free.ravel().astype(float))
        normal = (rows.normal[closed] @ free).tocsr()
        found = spsolve((normal @ normal.T).tocsc(), normal @ -state.imbalance.ravel())
        multipliers[closed] = np.maximum(found, 0.0)
    return discrete.state(u, contact=multipliers)
