"""How accurate a result is, in a sentence: a guaranteed bound, or an estimate without one."""

from __future__ import annotations

import logging
import math
from typing import Any

from ngepc.bounds.bound import error_bound, solved_problem, with_state
from ngepc.bounds.outcome import is_free_of_stress, strain_energy
from ngepc.checks.sentences import at_most_percent, in_percent
from ngepc.goals.variants import lower_order, other_order, refined_once
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.exact import solve_exactly
from ngepc.local.indicators import COVERS as INDICATED
from ngepc.local.indicators import indicators_of
from ngepc.local.system import State
from ngepc.model.elements import has_more_corners
from ngepc.model.features import is_covered
from ngepc.model.problem import Problem
from ngepc.model.round import round_note

log = logging.getLogger(__name__)

TOLERANCE = 1e-9
MOST_STEPS = 100
"""Of the solve for an estimate."""

LARGEST = 1500
"""Tetrahedra of order two up to which another solve for an estimate takes seconds."""

SIDES = 1e-3
"""A larger part that straight sides cut off a round body is said beside a bound, which lacks it."""


@one_blas_thread
def confidence(result: object) -> str:
    """One line about the distance of the energy of a result from that of the continuous problem.

    The percentage is that of the strain energy, ``ErrorBound.strain_energy``.

    Of a round body with straight sides it is that of the body which the mesh fills; what these cut
    off is said if it is more than 0.1 percent.

    A guaranteed bound if the problem has one; otherwise an estimate by another order or by one
    refinement of the mesh, which costs one more solve.  On more than 1,500 tetrahedra of order two
    that would take minutes: there the stresses recovered for ``error_indicators`` give it.

    For a history: the distance of its steps from those of the continuous problem, or the line of
    its last step if that has no bound.

    Parameters
    ----------
    result
        The result of a solver of a ``Problem``, or of ``evolve``.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver.
    ValueError
        For a history without a finished step.
    """
    if hasattr(type(result), "distance_bound"):
        return _of_history(result)
    problem = solved_problem(result)
    sides = round_note(problem, SIDES)
    return " ".join(filter(None, [_of_result(result, problem), sides]))


def _of_result(result: object, problem: Problem) -> str:
    """The bound or the estimate."""
    try:
        bound = error_bound(result)
    except (ValueError, RuntimeError) as error:
        return _estimated(result, problem, str(error))
    if not math.isfinite(bound.total):
        return _estimated(result, problem, "the error bound is infinite")
    size = at_most_percent(bound.relative)
    if bound.guaranteed and is_free_of_stress(bound.state, bound.total):
        return "Guaranteed: the body is free of stress, up to rounding errors."
    if bound.guaranteed:
        return f"Guaranteed: the energy error is at most {size}."
    return (
        f"Bound from samples of the data: the energy error is at most {size}. "
        f"{bound.message}"
    )


def _of_history(history: Any) -> str:
    """The line of a history."""
    if not history.steps:
        raise ValueError("result: a history with a finished step is needed")
    last = history.steps[-1].solution
    try:
        distance = history.distance_bound
    except (ValueError, RuntimeError):
        return f"The last step, from the state where it starts: {confidence(last)}"
    size = math.sqrt(2 * strain_energy(last.state))
    part = distance.value / size if size > 0 else math.inf
    start = (
        "Guaranteed: the" if distance.guaranteed else "Estimate, not guaranteed: the"
    )
    text = (
        f"{start} stress after the last step is off by {at_most_percent(part)} at most, in the "
        "energy norm, from that of the continuous problem with the same increments."
    )
    return " ".join(filter(None, [text, distance.message]))


def _estimated(result: object, problem: Problem, reason: str) -> str:
    """The estimate, and why there is no bound."""
    if refinement_takes_long(problem) and is_covered(problem, INDICATED):
        state = with_state(result).state
        error = problem.processes.total(float(indicators_of(state).sum()))
        part = of_strain_energy(error, state)
        found = f"the energy error is about {part}, perhaps twice or half of that"
        return said("recovered stresses", found, state, error, reason)
    ways = {
        "another order": other_order,
        "one refinement": refined_once,
        "elements of order one, usually much too large": lower_order,
    }
    failures = []
    for name, made in ways.items():
        try:
            other = made(problem)
            if other is None:
                continue
            size = other.mesh.ne, other.order
            log.info(
                "solving for an estimate by %s: %d elements of order %d", name, *size
            )
            given = other, None, TOLERANCE, MOST_STEPS, None, None
            solved = solve_exactly(*given).or_interrupted()
        except (ValueError, RuntimeError) as error:
            failures.append(str(error))
            continue
        if not solved.status.is_success:
            failures.append(solved.status.value)
            continue
        # J itself contains the work of the loads on a rigid travel, which says nothing
        change = abs(result.primal_energy - solved.primal_energy)
        found = f"the energy changes by {of_strain_energy(change, solved.state)}"
        return said(name, found, solved.state, change, reason)
    different = dict.fromkeys(failure.rstrip(".") for failure in failures)
    failed = sentence("; ".join(different) or "the mesh cannot be refined")
    return f"No estimate: {failed} No bound: {sentence(reason)}"


def refinement_takes_long(problem: Problem) -> bool:
    """Whether a solve on the refined mesh takes minutes; only tetrahedra are refined."""
    mesh = problem.mesh
    large = problem.N == 3 and problem.order == 2 and mesh.ne > LARGEST
    return large and not has_more_corners(mesh)


def of_strain_energy(energy: float, state: State) -> str:
    """An energy as a part of the strain energy of a state."""
    size = strain_energy(state)
    part = energy / size if size > 0 else float(energy > 0)
    return f"{in_percent(part)} of the strain energy"


def said(name: str, found: str, state: State, change: float, reason: str) -> str:
    """The line of an estimate by ``name``, and why there is no bound."""
    if is_free_of_stress(state, change):
        found = "the body is free of stress, up to rounding errors"
    return f"Estimate by {name}, not guaranteed: {found}. No bound: {sentence(reason)}"


def sentence(text: str) -> str:
    """The text with a full stop at its end."""
    return text.rstrip(".") + "."
