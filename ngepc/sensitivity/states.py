"""The solutions that derivatives are taken at: of one time step, or of all steps of a history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from ngepc.discretisation.loads import nodal
from ngepc.discretisation.points import Points
from ngepc.evolution.result import Evolution, EvolutionStep
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.loading import require_linear
from ngepc.model.problem import Problem

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
    if any(step.contact is None for step in result.steps):
        raise ValueError("result has steps with gamma: steps of the exact methods are needed")
    names = ("initial_plastic_strain", "initial_hardening")
    problems[0] = replace(problems[0], **{name: getattr(result.problem, name) for name in names})
    points = result.memory.functions.points
    steps = zip(problems, result.steps, strict=True)
    return [partial(restored_state, problem, step, points) for problem, step in steps]


def restored_state(problem: Problem, step: EvolutionStep, points: Points) -> State:
    """The state of a finished step from its displacement and its forces of contact."""
    u = nodal(step.fields.displacement.vec.FV().NumPy(), problem).copy()
    return DiscreteProblem(problem, points).state(u, contact=step.contact)
