"""What a run of Algorithm 7.1 has shown, and the result that it ends with: what to try."""

from __future__ import annotations

import logging
from dataclasses import replace

from ngepc.dual.iterates import Iterate
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import ResidualBelow
from ngepc.linalg.linesearch import ROUNDING
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

logger = logging.getLogger(__name__)

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


class RunLog:
    """What a run has shown.

    Attributes
    ----------
    history
        The records of its iterates.
    drowned
        How many of the last steps in a row have changed the energy by rounding only.
    """

    def __init__(self, rule: ResidualBelow, monitor: Monitor | None) -> None:
        self.rule, self._monitor = rule, monitor
        self.history, self.drowned = History(), 0

    def note(self, here: Iterate) -> IterationRecord:
        """Record an iterate, log it and show it to the monitor."""
        record, records = here.record(), self.history.records
        if records:
            unmoved = abs(record.energy - records[-1].energy) <= ROUNDING * here.magnitude
            self.drowned = self.drowned + 1 if unmoved else 0
        self.history.append(record)
        logger.info(
            "it:%4d residual:%.3e energy:%.12e step:%.4g",
            *(record.iteration, record.residual_norm, record.energy, record.step_length),
        )
        if self._monitor is not None:
            self._monitor(replace(record, snapshot=lambda: self._snapshot(here)))
        return record

    def _snapshot(self, here: Iterate) -> DualResult:
        """The result of a run that had stopped at an iterate."""
        seen = History(self.history.records[: here.number + 1])
        return DualResult(here.functional, here.y, here.v, Status.STOPPED, "", seen)

    def result(self, here: Iterate, status: Status, cause: str = "") -> DualResult:
        """The result of a run that ends at an iterate."""
        records = self.history.records
        last = records[-1] if records else None
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
        if not steps:
            return ""
        shortest = min(steps, key=lambda record: record.step_length)
        if shortest.step_length >= 1:
            return f"None of the last {len(steps)} steps was damped."
        return (
            f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}, the shortest of "
            f"the last {len(steps)}."
        )
