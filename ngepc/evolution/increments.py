"""Increments by accuracy: the same history with steps twice as long says how far it is off.

Implicit Euler steps are of first order in time.  Two runs go through the history side by side, the
coarse one with one step where the fine one has two.  What they differ by at the end of a step
estimates the error of the fine run there: with an error proportional to the length of the steps,
coarse minus fine is the error of the fine run.  This is an estimate, no bound.

Both runs start from the same state at the begin of the history and keep their own: errors that a
history forgets, as plasticity does, count only as long as they are there.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from ngepc.discretisation.points import Points
from ngepc.evolution.result import Evolution, EvolutionStep, elastic_energy, tensors
from ngepc.results.outcome import Status

log = logging.getLogger(__name__)

FEW = 8
"""A history of fewer listed steps is halved once in any case: one step beside two misses kinks."""


class Run(Protocol):
    """What goes from step to step; ``state`` can be put back."""

    evolution: Evolution

    @property
    def state(self) -> tuple:
        """Everything that the next step starts from."""

    def restore(self, state: tuple) -> None:
        """Go back to an earlier state."""

    def solve_step(self, time: float, level: int) -> tuple[Status, str]:
        """One step; how it ended, and why."""


class Difference:
    """How far two histories are apart, relative to the largest values that they have had."""

    def __init__(self, points: Points) -> None:
        self._points = points
        self._stress = 0.0
        self._force = 0.0

    def see(self, step: EvolutionStep) -> None:
        """Take note of how large stress and force of contact become."""
        strain = tensors(self._points, step.fields.elastic_strain)
        force = np.array(step.record.contact_resultant)
        self._stress = max(self._stress, self._norm(step, strain))
        self._force = max(self._force, float(np.linalg.norm(force)))

    def __call__(self, fine: EvolutionStep, coarse: EvolutionStep) -> float:
        """The larger relative difference of the stress and of the force of contact."""
        self.see(fine)
        strain = tensors(self._points, fine.fields.elastic_strain)
        other_strain = tensors(self._points, coarse.fields.elastic_strain)
        of_stress = self._norm(fine, strain - other_strain)

        force = np.array(fine.record.contact_resultant)
        other_force = np.array(coarse.record.contact_resultant)
        of_force = float(np.linalg.norm(force - other_force))
        return max(relative(of_stress, self._stress), relative(of_force, self._force))

    def _norm(self, step: EvolutionStep, elastic: np.ndarray) -> float:
        """(int C e : e)^(1/2), a norm of the stress C e."""
        energy = elastic_energy(self._points, step.problem.material, elastic)
        return math.sqrt(2 * energy)


def relative(size: float, largest: float) -> float:
    """A size over the largest one; 0 where nothing has happened."""
    return size / largest if largest > 0 else 0.0


def advance_by_accuracy(
    fine: Run,
    coarse: Run,
    ends: list[float],
    begin: float,
    accuracy: float,
    most_halvings: int,
    monitor: Callable[[EvolutionStep], None] | None,
) -> None:
    """Take two steps of ``fine`` for each of ``coarse``, shorter ones where they part too fast.

    A step may add its share of time, times ``accuracy``, to the difference of the histories.  The
    estimate stands in the records and the message of ``fine``.
    """
    evolution = fine.evolution
    difference = Difference(evolution.memory.functions.points)
    preview(coarse, ends, difference)
    duration = ends[-1] - begin
    pending = listed(ends, begin, halve=len(ends) < FEW)
    now = begin
    before = 0.0
    too_coarse = 0.0
    try:
        while pending:
            end, level = pending.pop()
            states = fine.state, coarse.state
            middle = 0.5 * (now + end)
            status, message, failed_at = _both(fine, coarse, middle, end, level)
            apart = math.inf
            if status.is_success:
                apart = difference(evolution.steps[-1], coarse.evolution.steps[-1])
            allowed = before + accuracy * (end - now) / duration
            if apart > allowed and level < most_halvings:
                fine.restore(states[0])
                coarse.restore(states[1])
                log.info("step to time %g: %.2g apart, halved", end, apart)
                pending += [(end, level + 1), (middle, level + 1)]
                continue
            if not status.is_success:
                evolution.status = status
                evolution.message = f"In the step to time {failed_at:g}: {message}"
                return
            if status is not Status.CONVERGED:
                evolution.status = status
                evolution.message = f"In the step to time {failed_at:g}: {message}"
            if apart > allowed:
                too_coarse = max(too_coarse, apart)
            last = evolution.steps[-1]
            record = replace(last.record, time_error=apart)
            evolution.steps[-1] = replace(last, record=record)
            if monitor is not None:
                for step in evolution.steps[-2:]:
                    monitor(step)
            now = end
            before = apart
    except (StopIteration, KeyboardInterrupt):
        evolution.status = Status.STOPPED
        evolution.message = f"After {len(evolution.steps)} steps."
        return
    if too_coarse > accuracy:
        told = f"the increments are about {too_coarse:.2g} off, asked {accuracy:g}"
        evolution.status = Status.STEP_LIMIT
        evolution.message = f"By {most_halvings} halvings of a step {told}."


def preview(run: Run, ends: list[float], difference: Difference) -> None:
    """Go through the listed steps once, as far as they converge, for the size of the answer."""
    state = run.state
    for end in ends:
        status, _ = run.solve_step(end, 0)
        if not status.is_success:
            break
        difference.see(run.evolution.steps[-1])
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


def _both(
    fine: Run, coarse: Run, middle: float, end: float, level: int
) -> tuple[Status, str, float]:
    """One step of the coarse run and two of the fine one: how they ended, why, and where."""
    worst = Status.CONVERGED, "", end
    for run, time in ((coarse, end), (fine, middle), (fine, end)):
        status, message = run.solve_step(time, level)
        if status is not Status.CONVERGED:
            worst = status, message, time
        if not status.is_success:
            break
    return worst
