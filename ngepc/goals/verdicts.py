"""Verdicts: is a number of the continuous solution below or above a limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ngepc.bounds.outcome import why_infinite
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.goals.adaptive import run_to, tolerance_of
from ngepc.goals.clock import Clock
from ngepc.goals.confidence import SIDES
from ngepc.goals.ends import about_zero
from ngepc.goals.goal_interval import GoalBound
from ngepc.goals.refinement import BoundedResult, MeshRecord, Refinement
from ngepc.goals.variants import of_order_two, with_order_two
from ngepc.linalg.blas import one_blas_thread
from ngepc.model.problem import Problem
from ngepc.model.round import round_note

PASS = "PASS"
FAIL = "FAIL"
UNDECIDED = "UNDECIDED"

FINEST = 1e-6
"""The relative error that meshes aim at; the limit is usually decided before it is reached."""


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

    tolerance = tolerance_of(problem, None, goal, 100 * FINEST)
    hopeless = about_zero if limit == 0 else beside_zero
    problem = with_order_two(problem)
    run = run_to(problem, tolerance, options, decided, goal, hopeless)
    ending = clock.ending if clock.too_late else run.message
    found = verdict_of(run, limit, above, ending)
    sides = round_note(problem, SIDES)
    return replace(found, sentence=" ".join(filter(None, [found.sentence, sides])))


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
        why = why_infinite(run.result.state)
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
