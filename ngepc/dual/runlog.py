"""What a run of Algorithm 7.1 has shown: its history, and the result that it ends with."""

from __future__ import annotations

import logging
from dataclasses import replace

from ngepc.dual.diagnosis import RecentDuals, describe
from ngepc.dual.functional import DualFunctional
from ngepc.dual.iterates import Iterate
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import End, StoppingRule
from ngepc.linalg.linesearch import ROUNDING
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

logger = logging.getLogger(__name__)

TRUE_RESIDUAL = (Status.ITERATION_LIMIT, Status.LINESEARCH_FAILED, Status.STAGNATED)
"""Statuses whose message quotes the residual computed afresh."""


class RunLog:
    """What a run has shown: its history, its last iterates, and the result it ends with.

    Parameters
    ----------
    functional, rule, monitor
        As for ``run``.

    Attributes
    ----------
    drowned
        How many of the last steps in a row have changed the energy by rounding only.
    """

    def __init__(
        self, functional: DualFunctional, rule: StoppingRule, monitor: Monitor | None
    ) -> None:
        self.functional, self.rule, self._monitor = functional, rule, monitor
        self.history, self.drowned = History(), 0
        self._recent = RecentDuals(functional)

    @property
    def last(self) -> IterationRecord:
        """The record of the last iterate."""
        return self.history.records[-1]

    def note(self, here: Iterate) -> None:
        """Record an iterate, log it and show it to the monitor."""
        record = here.record(self.functional)
        if self.history.records:
            unmoved = abs(record.energy - self.last.energy) <= ROUNDING * here.magnitude
            self.drowned = self.drowned + 1 if unmoved else 0
        self.history.append(record)
        self._recent.append(here.v)
        logger.info(
            "it:%4d residual:%.3e energy:%.12e step:%.4g",
            *(record.iteration, record.residual_norm, record.energy, record.step_length),
        )
        if self._monitor is not None:
            self._monitor(replace(record, snapshot=lambda: self._snapshot(here)))

    def _snapshot(self, here: Iterate) -> DualResult:
        """The result of a run that had stopped at an iterate."""
        seen = History(self.history.records[: here.number + 1])
        return DualResult(self.functional, here.y, here.v, Status.STOPPED, "", seen)

    def result(self, here: Iterate, end: End) -> DualResult:
        """The result of a run that ends at an iterate."""
        last = self.history.records[-1] if self.history.records else None
        if end.status in TRUE_RESIDUAL:
            here.refresh(self.functional)
            last = here.record(self.functional)
        message = describe(end.status, self.history, last, self.rule, self._recent, end.cause)
        return DualResult(self.functional, here.y, here.v, end.status, message, self.history)
