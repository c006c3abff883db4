"""Termination of Algorithm 7.1: tests, a final check of the residual, and messages.

The residual of the iteration is updated with each step, by factors of the condensed (7.1), whose
errors it does not contain.  Here y is solved for again and corrected with D itself, and what
rounding leaves in that is estimated.  The status is CONVERGED only if the residual *and* its
rounding together meet the tolerances: any other way of computing it in the same precision then
finds the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve.la import BaseVector

from ngepc.checks.sentences import counted
from ngepc.dual.functional import DualIterate, total
from ngepc.dual.result import DualResult, with_remarks
from ngepc.linalg.linesearch import ROUNDING
from ngepc.results.outcome import History, Status

CORRECTIONS = 3  # largest number of steps with the last factors
ROUNDING_STEPS = 8  # in a row, that change the energy by rounding only, end a run
WINDOW = 5  # number of last steps in the test for damping

NEARER = "Start from the solution for a smaller gamma or a smaller load step"
ADVICE = {
    Status.ITERATION_LIMIT: f"{NEARER}, raise max_iterations, or leave gamma out.",
    Status.LINESEARCH_FAILED: f"{NEARER}.",
    Status.STAGNATED: "Rounding errors hide further progress. A tolerance above {} can be met.",
    Status.NONFINITE: "Check loads and coefficients for NaN and for values that changed during "
    f"the run. {NEARER}.",
}

Solve = Callable[[BaseVector], tuple[BaseVector, BaseVector]]
"""The right hand side of (7.1) -> dy, dv, with the last factors."""

Judgement = tuple[DualIterate, Status | None, str]
"""The iterate to go on from or to end with, how the run has ended if it has, and the cause."""


@dataclass(frozen=True)
class Tolerances:
    """||Psi_gamma||_{H*} < tolerance, as in Algorithm 7.1; messages contain its text.

    With ``bounds`` of the parts on Gamma_c and in Omega those count after a step at least, step
    (iv)(a) of Algorithm 7.2.
    """

    tolerance: float
    bounds: tuple[float, float] | None = None

    def met(self, norms: np.ndarray, steps: int) -> bool:
        """Whether an iterate with these norms is accepted after this number of steps."""
        if self.bounds is None or steps == 0:
            return total(norms) < self.tolerance
        return bool((norms < self.bounds).all())

    def __str__(self) -> str:
        if self.bounds is None:
            return f"the tolerance {self.tolerance:.3g}"
        return "the tolerances {:.3g} (contact) and {:.3g} (plastic)".format(
            *self.bounds
        )


def judged(
    here: DualIterate,
    before: DualIterate,
    history: History,
    aim: Tolerances,
    most: int,
    solve: Solve,
) -> Judgement:
    """The tests for termination, at the latest after ``most`` steps."""
    steps = len(history.records) - 1
    if not math.isfinite(here.residual_norm + here.energy):
        return before, Status.NONFINITE, ""
    if aim.met(here.norms, steps):
        here, status, cause = final_check(here, aim, steps, solve)
        if status is not None:
            return here, status, cause
    if steps == most:
        return here, Status.ITERATION_LIMIT, ""
    changes = np.abs(np.diff(history.energies[-ROUNDING_STEPS - 1 :]))
    limited_by_rounding = (
        len(changes) == ROUNDING_STEPS and changes.max() <= ROUNDING * here.magnitude
    )
    return here, Status.STAGNATED if limited_by_rounding else None, ""


def final_check(
    here: DualIterate, aim: Tolerances, steps: int, solve: Solve
) -> Judgement:
    """Check an iterate whose updated residual meets the aim, with y and residual computed anew.

    Near a solution the active sets do not change, so that a correction needs no new factors.  The
    status is CONVERGED or STAGNATED, or None if further Newton steps may help.
    """
    here = DualIterate(here.functional, here.v)
    rounding = here.functional.rounding(here.y)
    for _ in range(CORRECTIONS):
        if aim.met(here.norms + rounding, steps) or steps == 0:
            break
        dv = solve((-here.residual).Evaluate())[1]
        better = DualIterate(here.functional, (here.v + dv).Evaluate())
        if not better.residual_norm <= here.residual_norm / 2:
            break
        here = better
    if aim.met(here.norms + rounding, steps):
        return here, Status.CONVERGED, ""
    if aim.met(rounding, steps):
        return here, None, ""
    cause = (
        f"Rounding errors leave a residual of about {total(rounding):.2g}, which this computation "
        "of it may hide: the hardening is small compared with the elastic moduli, or the loads "
        f"are large, for {aim}."
    )
    return here, Status.STAGNATED, cause


def reachable(here: DualIterate) -> float:
    """A tolerance that an iterate meets, with the rounding errors of its residual."""
    rounding = total(here.functional.rounding(here.y))
    return 1.1 * (here.residual_norm + rounding) / here.functional.blocks.residual_unit


def ended(
    here: DualIterate, status: Status, cause: str, history: History, aim: Tolerances
) -> DualResult:
    """The result of a run that ends with an iterate, with a message on how, and on what it is."""
    if status not in (Status.CONVERGED, Status.STOPPED):
        if status is not Status.NONFINITE:
            here = DualIterate(here.functional, here.v)
        last = history.records[-1]
        contact, plastic = here.norms
        seen = (
            f"After {counted(last.iteration, 'step')} the residual is {here.residual_norm:.3g} "
            f"(contact {contact:.3g}, plastic {plastic:.3g}), {aim}; last step length "
            f"{last.step_length:.3g}."
        )
        recent = history.records[1:][-WINDOW:]
        damped = f"Steps damped among the last {len(recent)}: none." if recent else ""
        shortest = min(recent, key=lambda record: record.step_length, default=last)
        if shortest.step_length < 1:
            damped = (
                f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}, the shortest "
                f"of the last {len(recent)}."
            )
        advice = ADVICE[status]
        if status is Status.STAGNATED:
            advice = advice.format(f"{reachable(here):.2g}")
        cause = " ".join(filter(None, (cause, seen, damped, advice)))
    message = " ".join(filter(None, (cause, here.functional.blocks.note)))
    found = DualResult(here.functional, here.y, here.v, status, message, history)
    return with_remarks(found)
