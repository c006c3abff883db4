"""When the loop of Algorithm 7.1 ends, whether an iterate that seems right is, and what is said.

The residual of the iteration is updated with each step, by factors of the condensed (7.1) whose
errors it cannot see.  Here y is solved for again and corrected with D itself, and what rounding
leaves in that is estimated.  CONVERGED is said only where the residual *and* its rounding together
meet the rule: any other way of computing it in the same precision then finds the same.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

from ngepc.dual.functional import ResidualNorms
from ngepc.dual.iterates import Iterate
from ngepc.dual.result import DualResult
from ngepc.dual.system import NewtonSystem
from ngepc.linalg.linesearch import ROUNDING
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

logger = logging.getLogger(__name__)

CORRECTIONS = 3
"""Most steps with the last factors."""

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

TRUE_RESIDUAL = (Status.ITERATION_LIMIT, Status.LINESEARCH_FAILED, Status.STAGNATED)
"""Statuses whose message quotes the residual computed afresh."""


@dataclass(frozen=True)
class ResidualBelow:
    """||Psi_gamma||_{H*} < tolerance, the rule of Algorithm 7.1; its text stands in messages."""

    tolerance: float

    def met(self, norms: ResidualNorms, steps: int) -> bool:
        """Whether an iterate with these norms will do after so many steps."""
        return norms.total < self.tolerance

    def __str__(self) -> str:
        return f"the tolerance {self.tolerance:.3g}"


class End(Exception):
    """Why a run ends: a status, the iterate it ends with, a sentence where something went wrong."""

    def __init__(self, status: Status, here: Iterate, cause: str = "") -> None:
        super().__init__(status)
        self.status, self.here, self.cause = status, here, cause


def final_check(system: NewtonSystem, here: Iterate, rule: ResidualBelow) -> Iterate:
    """Judge an iterate whose updated residual meets the rule: y and residual afresh, corrected.

    Near a solution the active sets stay, so that a correction needs no new factors.  Returns where
    to go on from, if further Newton steps may help; ``End`` otherwise, CONVERGED or STAGNATED.
    """
    here = here.afresh()
    rounding = here.functional.rounding(here.y)
    for _ in range(CORRECTIONS):
        if rule.met(here.norms.plus(rounding), here.number) or here.number == 0:
            break
        better = here.afresh(system.solve((-here.residual).Evaluate())[1])
        if not better.norms.total <= here.norms.total / 2:
            break
        here = better
    if rule.met(here.norms.plus(rounding), here.number):
        raise End(Status.CONVERGED, here)
    if rule.met(rounding, here.number):
        return here
    reach = 1.1 * (here.norms.total + rounding.total) / here.functional.blocks.residual_unit
    raise End(
        Status.STAGNATED,
        here,
        f"Rounding alone leaves about {rounding.total:.2g} of the residual, in whatever way it is "
        "computed: the hardening is small beside the elastic moduli, or the loads are large, for "
        f"{rule}. A tolerance above {reach:.2g} is within reach.",
    )


class RunLog:
    """What a run has shown: its ``history``, and how many steps have ``drowned``.

    These, the last ones in a row, have changed the energy by rounding only.
    """

    def __init__(self, rule: ResidualBelow, monitor: Monitor | None) -> None:
        self.rule, self._monitor = rule, monitor
        self.history, self.drowned = History(), 0

    def note(self, here: Iterate) -> None:
        """Record an iterate, log it and show it to the monitor."""
        record, records = here.record(), self.history.records
        if records:
            unmoved = abs(record.energy - records[-1].energy) <= ROUNDING * here.magnitude
            self.drowned = self.drowned + 1 if unmoved else 0
        self.history.records.append(record)
        logger.info(
            "it:%4d residual:%.3e energy:%.12e step:%.4g",
            *(record.iteration, record.residual_norm, record.energy, record.step_length),
        )
        if self._monitor is not None:
            self._monitor(replace(record, snapshot=lambda: self._snapshot(here)))

    def _snapshot(self, here: Iterate) -> DualResult:
        """The result of a run that had stopped at an iterate."""
        seen = History(self.history.records[: here.number + 1])
        return DualResult(here.functional, here.y, here.v, Status.STOPPED, "", seen)

    def result(self, here: Iterate, status: Status, cause: str = "") -> DualResult:
        """The result of a run that ends at an iterate."""
        last = self.history.records[-1] if self.history.records else None
        if status in TRUE_RESIDUAL:
            here = here.afresh()
            last = here.record()
        message = self._message(status, cause, last)
        return DualResult(here.functional, here.y, here.v, status, message, self.history)

    def _message(self, status: Status, cause: str, last: IterationRecord | None) -> str:
        """What was seen and what to try, empty for a run that converged."""
        if status is Status.CONVERGED or last is None:
            return cause
        seen = (
            f"After {last.iteration} steps the residual is {last.residual_norm:.3g} (contact "
            f"{last.contact_residual_norm:.3g}, plastic {last.plastic_residual_norm:.3g}), "
            f"{self.rule}; last step length {last.step_length:.3g}."
        )
        damped = "" if status is Status.STOPPED else self._damped()
        return " ".join(filter(None, (cause, seen, damped, ADVICE.get(status))))

    def _damped(self) -> str:
        """The shortest of the last steps, if it was damped."""
        steps = self.history.records[1:][-WINDOW:]
        shortest = min(steps, key=lambda record: record.step_length, default=None)
        if shortest is None or shortest.step_length >= 1:
            return f"None of the last {len(steps)} steps was damped." if steps else ""
        return (
            f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}, the shortest of "
            f"the last {len(steps)}."
        )
