"""When the loop of Algorithm 7.1 ends, whether an iterate that seems right is, and what is said.

The residual of the iteration is updated with each step, by factors of the condensed (7.1) whose
errors it cannot see.  Here y is solved for again and corrected with D itself, and what rounding
leaves in that is estimated.  CONVERGED is said only where the residual *and* its rounding together
meet the rule: any other way of computing it in the same precision then finds the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve.la import BaseVector

from ngepc.dual.functional import Iterate, total
from ngepc.dual.result import DualResult
from ngepc.linalg.linesearch import ROUNDING
from ngepc.results.outcome import History, Status

CORRECTIONS = 3
"""Most steps with the last factors."""

ROUNDING_STEPS = 8
"""Steps in a row that change the energy by no more than rounding end a run."""

WINDOW = 5
"""Steps that are looked at for damping."""

ADVICE = {
    Status.ITERATION_LIMIT: (
        "Start from the solution for a smaller gamma or a smaller load step, raise max_iterations, "
        "or leave gamma out."
    ),
    Status.LINESEARCH_FAILED: "Start from the solution for a smaller gamma or a smaller load step.",
    Status.STAGNATED: "Energies only change by rounding: ask for a tolerance above this residual.",
    Status.NONFINITE: (
        "Check loads and coefficients for NaN and for values that changed during the run, or "
        "start from the solution for a smaller gamma."
    ),
}

Ending = tuple[Iterate, Status | None, str]
"""The iterate to go on from or to end with, how the run has ended if it has, and the cause."""


@dataclass(frozen=True)
class Tolerances:
    """||Psi_gamma||_{H*} < tolerance, as in Algorithm 7.1; its text stands in messages.

    With ``bounds`` of the parts on Gamma_c and in Omega those count after a step at least, step
    (iv)(a) of Algorithm 7.2.
    """

    tolerance: float
    bounds: tuple[float, float] | None = None

    def met(self, norms: np.ndarray, steps: int) -> bool:
        """Whether an iterate with these norms will do after so many steps."""
        if self.bounds is None or steps == 0:
            return total(norms) < self.tolerance
        return bool((norms < self.bounds).all())

    def __str__(self) -> str:
        if self.bounds is None:
            return f"the tolerance {self.tolerance:.3g}"
        return "the tolerances {:.3g} (contact) and {:.3g} (plastic)".format(*self.bounds)


def judged(
    here: Iterate,
    before: Iterate,
    history: History,
    rule: Tolerances,
    max_iterations: int,
    solve: Callable[[BaseVector], tuple[BaseVector, BaseVector]],
) -> Ending:
    """Test by test, whether the iteration is over; ``solve`` uses the last factors."""
    steps, status, cause = len(history.records) - 1, None, ""
    if not math.isfinite(here.residual_norm + here.energy):
        return before, Status.NONFINITE, ""
    if rule.met(here.norms, steps):
        here, status, cause = final_check(here, rule, steps, solve)
    if status is None and steps == max_iterations:
        return here, Status.ITERATION_LIMIT, ""
    changes = np.abs(np.diff(history.energies[-ROUNDING_STEPS - 1 :]))
    drowned = len(changes) == ROUNDING_STEPS and changes.max() <= ROUNDING * here.magnitude
    if status is None and drowned:
        return here, Status.STAGNATED, ""
    return here, status, cause


def final_check(
    here: Iterate,
    rule: Tolerances,
    steps: int,
    solve: Callable[[BaseVector], tuple[BaseVector, BaseVector]],
) -> Ending:
    """Judge an iterate whose updated residual meets the rule: y and residual afresh, corrected.

    Near a solution the active sets stay, so that a correction needs no new factors.  The status is
    CONVERGED or STAGNATED, None where further Newton steps may help.
    """
    here = Iterate(here.functional, here.v)
    rounding = here.functional.rounding(here.y)
    for _ in range(CORRECTIONS):
        if rule.met(here.norms + rounding, steps) or steps == 0:
            break
        dv = solve((-here.residual).Evaluate())[1]
        better = Iterate(here.functional, (here.v + dv).Evaluate())
        if not better.residual_norm <= here.residual_norm / 2:
            break
        here = better
    if rule.met(here.norms + rounding, steps):
        return here, Status.CONVERGED, ""
    if rule.met(rounding, steps):
        return here, None, ""
    left = total(rounding)
    reach = 1.1 * (here.residual_norm + left) / here.functional.blocks.residual_unit
    cause = (
        f"Rounding alone leaves about {left:.2g} of the residual, in whatever way it is computed: "
        "the hardening is small beside the elastic moduli, or the loads are large, for "
        f"{rule}. A tolerance above {reach:.2g} is within reach."
    )
    return here, Status.STAGNATED, cause


def ended(
    here: Iterate, status: Status, cause: str, history: History, rule: Tolerances
) -> DualResult:
    """The result of a run that ends with an iterate, and a message unless it has converged."""
    message = cause
    if status not in (Status.CONVERGED, Status.STOPPED):
        if status is not Status.NONFINITE:
            here = Iterate(here.functional, here.v)
        last, (contact, plastic) = history.records[-1], here.norms
        seen = (
            f"After {last.iteration} steps the residual is {here.residual_norm:.3g} (contact "
            f"{contact:.3g}, plastic {plastic:.3g}), {rule}; last step length "
            f"{last.step_length:.3g}."
        )
        message = " ".join(filter(None, (cause, seen, damping(history), ADVICE[status])))
    return DualResult(here.functional, here.y, here.v, status, message, history)


def damping(history: History) -> str:
    """The shortest of the last steps, if it was damped."""
    steps = history.records[1:][-WINDOW:]
    shortest = min(steps, key=lambda record: record.step_length, default=None)
    if shortest is None or shortest.step_length >= 1:
        return f"None of the last {len(steps)} steps was damped." if steps else ""
    return (
        f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}, the shortest of "
        f"the last {len(steps)}."
    )
