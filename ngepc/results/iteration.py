"""The Newton loop of both exact methods: tests first, each with its reason, then a step.

What a method puts into it is one object, its step; the state is a value with everything in it.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from ngepc.discretisation.balance import Balance
from ngepc.linalg.direct import FactorisationError
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

log = logging.getLogger(__name__)

LINE = "it:%(iteration)4d residual:%(residual_norm).3e energy:%(energy).12e"

FREE = 100.0
"""|p| beyond which a body that hardens no more is on its way to infinity."""

SETTLED = 0.5
"""Within rounding, a step that leaves more than this part of the residual ends the run."""


class ExactIterate(Balance):
    """An iterate: what is left of balance, its energy, the largest |p| where nothing hardens."""

    energy: float
    flowing: float


class NewtonStep(Protocol):
    """What one method puts into the loop."""

    def __call__(self, here: Any) -> tuple[Any, float, int] | None:
        """The next state, the step length and its trials; None if no length lowers the energy."""

    def numbers(self, state: Any) -> dict[str, float]:
        """Fields of ``IterationRecord`` that this method alone knows."""

    def rival(self, state: Any) -> tuple[bool, str]:
        """Whether friction allows other equilibria beside a solution, and a sentence about it."""

    def result(self, state: Any, status: Status, message: str, history: History) -> Any:
        """The result of a run that ends with a state."""


def newton_iteration(
    state: ExactIterate,
    step: NewtonStep,
    tolerance: float,
    max_iterations: int,
    monitor: Monitor | None = None,
) -> Any:
    """Newton steps from a state until its residual is within the tolerance or something stops them.

    The monitor gets the record of each iterate and may raise StopIteration.  What is returned is
    the method's ``result`` with the last state, whatever its status says.
    """
    history, before, length, trials = History(), None, 1.0, 0
    status, message = None, ""
    try:
        while status is None:
            record = IterationRecord(
                iteration=len(history.records),
                residual_norm=state.residual_norm,
                contact_residual_norm=state.contact_residual_norm,
                energy=state.energy,
                step_length=length,
                halvings=trials,
                contact_active=state.frame.contact.area(state.multipliers > 0),
                **step.numbers(state),
            )
            history.records.append(record)
            log.info(LINE, vars(record))
            if monitor is not None:
                monitor(replace(record, snapshot=_snapshot(state, step, history)))
            status, message = end_of(state, before, history, tolerance, max_iterations)
            if status is Status.CONVERGED:
                several, message = step.rival(state)
                status = Status.NOT_UNIQUE if several else status
            if status is None:
                before, following = state.residual_norm, step(state)
                if following is None:
                    status, message = stuck(state)
                else:
                    state, length, trials = following
    except FactorisationError as error:
        status, message = Status.NONFINITE, f"{error}."
    except (StopIteration, KeyboardInterrupt):
        status, message = Status.STOPPED, f"after {len(history.records) - 1} steps"
    return step.result(state, status, message, history)


def end_of(
    here: ExactIterate,
    before: float | None,
    history: History,
    tolerance: float,
    max_iterations: int,
) -> tuple[Status | None, str]:
    """Whether the run ends with a state, the residual before it, and why; None to go on."""
    steps, residual = len(history.records) - 1, here.residual_norm
    if not np.isfinite(residual + here.energy):
        return Status.NONFINITE, "The energy or the residual is NaN or infinite."
    if residual <= tolerance and here.penetration <= here.touching_distance:
        return Status.CONVERGED, ""
    if here.frame.floating.unheld:
        return Status.UNHELD, here.frame.floating.unheld
    if here.flowing > FREE:
        return Status.LIMIT_LOAD, (
            f"After {steps} steps |p| reaches {here.flowing:.2g} where nothing hardens any "
            "more: the loads are at or beyond the limit load."
        )
    settled = before is not None and residual > SETTLED * before
    if settled and residual <= here.rounding:
        return Status.STAGNATED, drowned(here, steps)
    if steps == max_iterations:
        return Status.ITERATION_LIMIT, (
            f"{steps} steps, relative residual {residual:.3g}, last step length "
            f"{history.records[-1].step_length:.3g}; try more steps or a smaller load step."
        )
    return None, ""


def stuck(here: ExactIterate) -> tuple[Status, str]:
    """Why no step length lowers the energy."""
    if here.residual_norm <= here.rounding:
        return Status.STAGNATED, drowned(here)
    return (
        Status.LINESEARCH_FAILED,
        f"No step length lowers the energy at the relative residual {here.residual_norm:.3g}; try "
        "a smaller load step.",
    )


def drowned(here: ExactIterate, steps: int | None = None) -> str:
    """The sentences for a tolerance that rounding does not let any iterate meet."""
    after = "The" if steps is None else f"After {steps} steps the"
    return (
        f"{after} relative residual is {here.residual_norm:.3g}. Rounding alone leaves about "
        f"{here.rounding:.2g} of it: strains as large as these cancel in the stress, the hardening "
        "is small beside the elastic moduli. "
        f"A tolerance above {1.1 * here.rounding:.2g} is within reach."
    )


def _snapshot(state: ExactIterate, step: NewtonStep, history: History) -> partial:
    """What makes the result of a run that had stopped here."""
    seen = History(list(history.records))
    return partial(step.result, state, Status.STOPPED, f"after {len(seen.records) - 1} steps", seen)
