"""Verdicts: is a number below or above a limit, and how accurate is a result."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ngsolve import ET, CoefficientFunction, IfPos, Mesh

from ngepc.bounds.bound import error_bound, solved_problem
from ngepc.bounds.outcome import is_free_of_stress, strain_energy
from ngepc.bounds.transfer import check_carried
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import at_most_percent, in_percent
from ngepc.goals.adaptive import run_to, tolerance_of
from ngepc.goals.clock import Clock
from ngepc.goals.ends import FLOWS, NO_BOUND, about_zero
from ngepc.goals.goal_interval import GoalBound
from ngepc.goals.refinement import BoundedResult, MeshRecord, Refinement
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.exact import solve_exactly
from ngepc.model.data import DefaultOrder
from ngepc.model.problem import Problem
from ngepc.model.round import round_note

log = logging.getLogger(__name__)

PASS = "PASS"
FAIL = "FAIL"
UNDECIDED = "UNDECIDED"
FINEST = 1e-6
"""The relative error that meshes aim at; the limit is usually decided before it is reached."""
TOLERANCE = 1e-9
MOST_STEPS = 100

SIDES = 1e-3
"""A larger part that straight sides cut off a round body is said beside a bound, which lacks it."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether a number satisfies a limit.

    Parameters
    ----------
    outcome
        "PASS", "FAIL" or "UNDECIDED".
    goal
        The interval that decided, or was reached; None if the error bound is always infinite.
    run
        The meshes that were needed.
    sentence
        The interval and the limit, or why there is no decision.
    """

    outcome: str
    goal: GoalBound | None
    run: BoundedResult = field(repr=False)
    sentence: str

    @property
    def guaranteed(self) -> bool:
        """Whether the interval is proved, see ``GoalBound.guaranteed``."""
        return self.goal is not None and self.goal.guaranteed

    def __str__(self) -> str:
        return f"{self.outcome}: {self.sentence}"


@one_blas_thread
def verdict(
    problem: Problem,
    goal: object,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
    options: Refinement | None = None,
    seconds: float = 60.0,
) -> Verdict:
    """Whether a force or a displacement of the continuous solution satisfies a limit.

    The mesh is refined for the goal until its interval lies on one side of the limit.  A problem
    with the default order is solved with displacements of order two, whose intervals are narrower.

    Parameters
    ----------
    problem, goal
        As for ``solve_to``.
    at_most, at_least
        The limit: one of them.
    options
        Marking and limits of the meshes.
    seconds
        No mesh is started that is expected to end after so many seconds.

    Returns
    -------
    Verdict
        PASS if the whole interval satisfies the limit, FAIL if no part of it does, UNDECIDED if the
        limit lies inside the interval, or no mesh gave one.

    Raises
    ------
    TypeError, ValueError
        As ``solve_to``, and unless one limit is given.
    """
    require_instance("problem", problem, Problem, "a Problem")
    limit, above = limit_of(at_most, at_least)
    if goal is None:
        raise TypeError(
            "goal=None: a goal of goal_bound is needed, 'contact_force' for example"
        )
    require_number("seconds", seconds, 0, strict=True)
    clock = Clock(seconds)

    def decided(record: MeshRecord) -> None:
        """End the run at the first mesh whose interval decides, or where time runs out."""
        clock.after(record.nodes)
        known = outcome_of(record.lower, record.upper, limit, above) != UNDECIDED
        if known or clock.too_late:
            raise StopIteration

    tolerance = tolerance_of(problem, FINEST, goal, 100 * FINEST)
    hopeless = about_zero if limit == 0 else beside_zero
    problem = with_order_two(problem)
    run = run_to(problem, tolerance, options, decided, goal, hopeless)
    ending = clock.ending if clock.too_late else run.message
    found = verdict_of(run, limit, above, ending)
    sides = round_note(problem, SIDES)
    return replace(found, sentence=" ".join(filter(None, [found.sentence, sides])))


def with_order_two(problem: Problem) -> Problem:
    """The problem with displacements of order two, if its order is a default that may be two."""
    if problem.order == 1 and isinstance(problem.order, DefaultOrder):
        return of_order_two(problem) or problem
    return problem


def of_order_two(problem: Problem) -> Problem | None:
    """The problem with displacements of order two; None if bounds do not cover it then."""
    other = _with_history(problem, order=2)
    try:
        check_carried(other)
    except ValueError:
        return None
    return other


def limit_of(at_most: float | None, at_least: float | None) -> tuple[float, bool]:
    """The limit that is given, and whether it is one from above."""
    if (at_most is None) == (at_least is None):
        raise ValueError(
            f"at_most={at_most!r}, at_least={at_least!r}: one of them is needed"
        )
    if at_least is None:
        return require_number("at_most", at_most), True
    return require_number("at_least", at_least), False


def verdict_of(run: BoundedResult, limit: float, above: bool, ending: str) -> Verdict:
    """What the last interval of a run says of a limit; ``ending`` is why there is no finer mesh."""
    required = f"required: at {'most' if above else 'least'} {limit:g}."
    found = run.goal
    if found is None:
        why = FLOWS if run.message == FLOWS else NO_BOUND
        said = (f"{narrowest(run.records)}, {required}", why, run.result.ending)
        return Verdict(UNDECIDED, None, run, " ".join(filter(None, said)))
    outcome = outcome_of(found.lower, found.upper, limit, above)
    why = ""
    if outcome == UNDECIDED:
        why = " ".join(filter(None, (ending, narrower_with(run.result.problem))))
    said = (f"{found}, {required}", why, found.message)
    return Verdict(outcome, found, run, " ".join(filter(None, said)))


def narrower_with(problem: Problem) -> str:
    """Advice to take displacements of order two; empty where bounds do not cover them."""
    if problem.order > 1 or of_order_two(problem) is None:
        return ""
    return "Displacements of order two (order=2) give narrower intervals."


def narrowest(records: Sequence[MeshRecord]) -> str:
    """The narrowest interval of meshes without one on the last of them, in words."""
    best = min(records, key=lambda record: record.upper - record.lower)
    if not math.isfinite(best.upper - best.lower):
        return "no interval"
    ends = f"{best.lower:.6g} to {best.upper:.6g}"
    return f"no interval on the last mesh ({ends} on {best.nodes} nodes)"


def beside_zero(before: GoalBound | None, now: GoalBound | None) -> str:
    """Intervals around zero become narrower than the distance of a limit to it."""
    return ""


def outcome_of(lower: float, upper: float, limit: float, above: bool) -> str:
    """What an interval says of a limit from ``above`` or from below, which satisfies itself."""
    satisfied = upper <= limit if above else lower >= limit
    violated = lower > limit if above else upper < limit
    if satisfied:
        return PASS
    return FAIL if violated else UNDECIDED


@one_blas_thread
def confidence(result: object) -> str:
    """One line about the distance of the energy of a result from that of the continuous problem.

    The percentage is that of the strain energy, ``ErrorBound.strain_energy``.

    Of a round body with straight sides it is that of the body which the mesh fills; what these cut
    off is said if it is more than 0.1 percent.

    A guaranteed bound if the problem has one; otherwise an estimate by another order or by one
    refinement of the mesh, which costs one more solve.  For a history: the distance of its steps
    from those of the continuous problem, or the line of its last step if that has no bound.

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
    ways = {
        "another order": _other_order,
        "one refinement": _refined,
        "elements of order one, usually much too large": _lower_order,
    }
    failures = []
    for name, made in ways.items():
        try:
            other = made(problem)
            if other is None:
                continue
            log.info("no bound; solved for an estimate by %s", name)
            given = other, None, TOLERANCE, MOST_STEPS, "sparsecholesky", None
            solved = solve_exactly(*given).or_interrupted()
        except (ValueError, RuntimeError) as error:
            failures.append(str(error))
            continue
        if not solved.status.is_success:
            failures.append(solved.status.value)
            continue
        # J itself contains the work of the loads on a rigid travel, which says nothing
        size = strain_energy(solved.state)
        change = abs(result.primal_energy - solved.primal_energy)
        part = change / size if size > 0 else float(change > 0)
        found = f"the energy changes by {in_percent(part)} of the strain energy"
        if is_free_of_stress(solved.state, change):
            found = "the body is free of stress, up to rounding errors"
        return (
            f"Estimate by {name}, not guaranteed: {found}. No bound: {sentence(reason)}"
        )
    different = dict.fromkeys(failure.rstrip(".") for failure in failures)
    failed = sentence("; ".join(different) or "the mesh cannot be refined")
    return f"No estimate: {failed} No bound: {sentence(reason)}"


def sentence(text: str) -> str:
    """The text with a full stop at its end."""
    return text.rstrip(".") + "."


def _other_order(problem: Problem) -> Problem | None:
    """The problem with order two; None where it has that."""
    return _with_history(problem, order=2) if problem.order == 1 else None


def _with_history(problem: Problem, **changes: object) -> Problem:
    """A changed problem with the same hardening and PEEQ, which may fall below zero between points.

    They are polynomials with values at the points of the step before, and have new points here.
    """
    changes["initial_accumulated"] = _not_negative(problem.initial_accumulated)
    changes["initial_hardening"] = _not_negative(problem.initial_hardening)
    return replace(problem, **changes)


def _not_negative(value: Any) -> Any:
    """A scalar coefficient, or the first of a pair, with zero where it is negative."""
    if isinstance(value, Sequence) and len(value) == 2:
        return _not_negative(value[0]), value[1]
    if isinstance(value, CoefficientFunction) and value.dim == 1:
        return IfPos(value, value, 0.0)
    return value


def _lower_order(problem: Problem) -> Problem | None:
    """The problem with order one; None where it has that."""
    return _with_history(problem, order=1) if problem.order > 1 else None


def _refined(problem: Problem) -> Problem | None:
    """The problem on a mesh that is refined once; None for cells that Netgen cannot divide."""
    shapes = {element.type for element in problem.mesh.Elements()}
    if problem.N == 3 and shapes != {ET.TET}:
        return None
    finer = Mesh(problem.mesh.ngmesh.Copy())
    finer.Refine()
    finer.Curve(problem.mesh.GetCurveOrder())  # copies are straight
    return _with_history(problem, mesh=finer)
