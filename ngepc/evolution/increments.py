"""Increments by accuracy: a second run with doubled steps estimates the time error.

Implicit Euler steps are of first order in time.  Two runs compute the history side by side: where
the coarse run has one step, the fine run has two.  Their difference at the end of a step estimates
the error of the fine run, because the error is proportional to the length of the steps.  This is an
estimate, not a bound.

Both runs start from the same state and then keep their own states.  Errors that decay during the
history, as in plasticity, therefore do not accumulate in the estimate.

A step from an elastic state has the same end as any shorter one from an elastic state.  Two runs
that both begin to yield in their last step would not differ, however long that step is; therefore
the fine run divides a step where energy is already dissipated, in the middle or later.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ngepc.checks.sentences import counted
from ngepc.discretisation.points import Points
from ngepc.evolution.result import EvolutionStep, elastic_energy, strain_at
from ngepc.evolution.run import Run, say_ending, stop
from ngepc.results.outcome import Status

log = logging.getLogger(__name__)

FEW = 8
"""A history of fewer listed steps is always halved once, because comparing one step with two
misses kinks."""


SHARE = 0.05
"""The least part of the dissipation of a step that its first piece must have."""

LATER = 6
"""How often the rest of a step is halved for that."""


class Difference:
    """The difference of two histories, relative to the largest values so far."""

    def __init__(self, points: Points) -> None:
        self._points = points
        self._stress = 0.0
        self._force = 0.0

    def see(self, step: EvolutionStep) -> None:
        """Update the largest stress and contact force."""
        strain = strain_at(self._points, step.fields.elastic_strain)
        force = float(np.linalg.norm(contact_forces(step)))
        self._stress = max(self._stress, self._norm(step, strain))
        self._force = max(self._force, force)

    def __call__(self, fine: EvolutionStep, coarse: EvolutionStep) -> float:
        """The larger relative difference of the stress and of the force of contact."""
        self.see(fine)
        strain = strain_at(self._points, fine.fields.elastic_strain)
        other_strain = strain_at(self._points, coarse.fields.elastic_strain)
        of_stress = self._norm(fine, strain - other_strain)

        of_force = np.linalg.norm(contact_forces(fine) - contact_forces(coarse))
        return max(
            relative(of_stress, self._stress), relative(float(of_force), self._force)
        )

    def _norm(self, step: EvolutionStep, elastic: np.ndarray) -> float:
        """(int C e : e)^(1/2), a norm of the stress C e."""
        energy = elastic_energy(self._points, step.problem.material, elastic)
        return math.sqrt(2 * energy)


def contact_forces(step: EvolutionStep) -> np.ndarray:
    """The integral of the pressure and the resultant with friction (force), shape (1 + N,).

    Between two bodies, and between obstacles on both sides of one, the resultant alone is zero but
    for rounding.
    """
    record = step.record
    return np.array([record.contact_force, *record.contact_resultant])


def relative(size: float, largest: float) -> float:
    """A size over the largest one; 0 if both are zero."""
    return size / largest if largest > 0 else 0.0


@dataclass(eq=False)
class Increments:
    """Two runs side by side: two steps of ``fine`` for each of ``coarse``.

    A step may add its share of time, times ``accuracy``, to the difference of the histories; where
    it adds more it is halved, ``most_halvings`` times at most.  The estimate stands in the records
    and the message of ``fine``.
    """

    fine: Run
    coarse: Run
    begin: float
    accuracy: float
    most_halvings: int
    monitor: Callable[[EvolutionStep], None] | None = None

    def __post_init__(self) -> None:
        self.difference = Difference(self.fine.evolution.memory.functions.points)
        self.apart = 0.0
        self.too_coarse = 0.0

    def advance(self, ends: list[float]) -> None:
        """Go through the listed ends of steps."""
        evolution = self.fine.evolution
        try:
            preview(self.coarse, ends, self.difference)
            self._through(ends)
        except (StopIteration, KeyboardInterrupt) as error:
            stop(evolution, error)
            return
        if self.too_coarse > self.accuracy:
            reason = f"the time error is still about {self.too_coarse:.2g}"
            evolution.status = Status.STEP_LIMIT
            evolution.message = (
                f"After {counted(self.most_halvings, 'halving')} of a step {reason}, "
                f"accuracy={self.accuracy:g} was asked for."
            )

    def _through(self, ends: list[float]) -> None:
        """All steps, halved where they have to be; a step that fails at last ends the run."""
        evolution = self.fine.evolution
        duration = ends[-1] - self.begin
        pending = listed(ends, self.begin, halve=len(ends) < FEW)
        now = self.begin
        while pending:
            end, level = pending.pop()
            states = self.fine.state, self.coarse.state
            status, message, where = self._both(now, end, level)
            apart = math.inf
            if status.is_success:
                apart = self.difference(
                    evolution.steps[-1], self.coarse.evolution.steps[-1]
                )
            allowed = self.apart + self.accuracy * (end - now) / duration
            if apart > allowed and level < self.most_halvings:
                self.fine.restore(states[0])
                self.coarse.restore(states[1])
                log.info("step to time %g: difference %.2g, halved", end, apart)
                pending += [(end, level + 1), (0.5 * (now + end), level + 1)]
                continue
            say_ending(evolution, where, status, message)
            if not status.is_success:
                return
            if apart > allowed:
                self.too_coarse = max(self.too_coarse, apart)
            self._record(apart)
            now = end

    def _record(self, apart: float) -> None:
        """Record the estimate at the end of two fine steps, and call the monitor with them."""
        steps = self.fine.evolution.steps
        record = replace(steps[-1].record, time_error=apart)
        steps[-1] = replace(steps[-1], record=record)
        self.apart = apart
        log.info("step to time %g: time error about %.2g", record.time, apart)
        if self.monitor is not None:
            for step in steps[-2:]:
                self.monitor(step)

    def _both(self, now: float, end: float, level: int) -> tuple[Status, str, float]:
        """One coarse step and two fine ones: how they ended, why, and where."""
        steps = (
            lambda: (*self.coarse.solve_step(end, level), end),
            lambda: self._to_a_middle(now, end, level),
            lambda: (*self.fine.solve_step(end, level), end),
        )
        worst = Status.CONVERGED, "", end
        for step in steps:
            ended = step()
            if ended[0] is not Status.CONVERGED:
                worst = ended
            if not ended[0].is_success:
                break
        return worst

    def _to_a_middle(
        self, now: float, end: float, level: int
    ) -> tuple[Status, str, float]:
        """The first fine step, to the middle or beyond: to where energy is dissipated.

        Where the body yields only at the end of a step, one step and two are the same.
        """
        state = self.fine.state
        whole = self.coarse.evolution.steps[-1].record.dissipation
        time = 0.5 * (now + end)
        for tries in range(LATER + 1):
            status, message = self.fine.solve_step(time, level)
            if not status.is_success or tries == LATER:
                break
            if self.fine.evolution.steps[-1].record.dissipation >= SHARE * whole:
                break
            self.fine.restore(state)
            time = 0.5 * (time + end)
        return status, message, time


def preview(run: Run, ends: list[float], difference: Difference) -> None:
    """Run the listed steps once, as far as they converge, for the size of stress and force."""
    state = run.state
    for end in ends:
        status, _ = run.solve_step(end, 0)
        if status is Status.STOPPED:
            raise StopIteration
        if not status.is_success:
            break
        difference.see(run.evolution.steps[-1])
        log.info(
            "step to time %g: solved for the sizes that errors are relative to", end
        )
    run.restore(state)


def listed(ends: list[float], begin: float, halve: bool) -> list[tuple[float, int]]:
    """Ends of the coarse steps with their halvings, the last one first."""
    starts = [begin, *ends[:-1]]
    if not halve:
        return [(end, 0) for end in reversed(ends)]
    steps = []
    for start, end in zip(starts, ends, strict=True):
        steps += [(0.5 * (start + end), 1), (end, 1)]
    return steps[::-1]
