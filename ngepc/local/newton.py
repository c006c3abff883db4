"""The loop: Algorithm 7.1 for the discrete problem itself, globalised by its energy."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

import numpy as np

from ngepc.local.factors import Tangent, TangentError
from ngepc.local.result import ExactResult
from ngepc.local.step import ExactTarget, Line, Target, TargetFinder, step_length
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

log = logging.getLogger(__name__)

QUADRATIC = 5.0
"""A full step that divides the residual by more puts w on the sphere |w| = beta.

That is the derivative of the radial return itself, with which convergence ends quadratically; far
from the solution the w that is carried along keeps the tangent from being too soft.
"""

LINE = "it:%(iteration)4d residual:%(residual_norm).3e energy:%(energy).12e"

SETTLED = 0.5
"""Within rounding, a step that leaves more than this part of the residual ends the run."""


def primal_dual_newton(
    discrete: DiscreteProblem,
    state: State,
    tangent: Tangent,
    tolerance: float,
    max_iterations: int,
    monitor: Monitor | None = None,
    target: TargetFinder | None = None,
) -> ExactResult:
    """Newton steps from a state until the residual is small or something stops them.

    Parameters
    ----------
    discrete, state
        The discrete problem and where to start.
    tangent
        The linear solver.
    tolerance
        Bound for ``State.residual_norm``.
    max_iterations
        Most Newton steps.
    monitor
        Called with the record of each iterate; raising StopIteration stops.
    target
        What finds where Newton's model is smallest; None for ``ExactTarget``.
    """
    target = ExactTarget(discrete) if target is None else target
    history, before, length, trials = History(), None, 1.0, 0
    status, message = None, ""
    try:
        while status is None:
            record = record_of(state, len(history.records), length, trials, tangent)
            history.append(record)
            log.info(LINE, vars(record))
            if monitor is not None:
                monitor(watched(record, state, history))
            status, message = end_of(state, before, history, tolerance, max_iterations)
            if status is None:
                before = state.residual_norm
                state, length, trials = following(state, target(state, tangent))
    except TangentError as error:
        status, message = Status.NONFINITE, f"{error}."
    except StuckError as stuck:
        status, message = stuck.status, str(stuck)
    except (StopIteration, KeyboardInterrupt):
        status, message = Status.STOPPED, f"after {len(history.records) - 1} steps"
    return ExactResult(state, status, message, history)


def following(here: State, target: Target) -> tuple[State, float, int]:
    """The next state, the step length and its trials."""
    line = Line(here, target)
    if here.penetration > here.touching_distance:
        return line.state(1.0), 1.0, 0  # the first step makes u feasible
    found = step_length(line)
    if found is None:
        raise StuckError(here)
    t, trials = found
    state = line.state(t)
    if t == 1.0 and here.residual_norm > QUADRATIC * state.residual_norm:
        state = state.on_sphere()
    return state, t, trials


def end_of(
    here: State, before: float | None, history: History, tolerance: float, max_iterations: int
) -> tuple[Status | None, str]:
    """Whether the run ends with a state, the residual before it, and why; None to go on."""
    steps, residual = len(history.records) - 1, here.residual_norm
    if not np.isfinite(residual + here.energy):
        return Status.NONFINITE, "The energy or the residual is NaN or infinite."
    if residual <= tolerance and here.penetration <= here.touching_distance:
        return Status.CONVERGED, ""
    settled = before is not None and residual > SETTLED * before
    if settled and residual <= here.rounding:
        return Status.STAGNATED, drowned(here, steps)
    if steps == max_iterations:
        return Status.ITERATION_LIMIT, (
            f"{steps} steps, relative residual {residual:.3g}, last step length "
            f"{history.records[-1].step_length:.3g}; try more steps or a smaller load step."
        )
    return None, ""


class StuckError(Exception):
    """No step length lowers the energy."""

    def __init__(self, here: State) -> None:
        within = here.residual_norm <= here.rounding
        self.status = Status.STAGNATED if within else Status.LINESEARCH_FAILED
        text = "No step length lowers the energy; try a smaller load step."
        super().__init__(drowned(here) if within else text)


def drowned(here: State, steps: int | None = None) -> str:
    """The sentences for a tolerance that rounding does not let any iterate meet."""
    after = "The" if steps is None else f"After {steps} steps the"
    return (
        f"{after} relative residual is {here.residual_norm:.3g}. Rounding alone leaves about "
        f"{here.rounding:.2g} of it: strains as large as these cancel in the stress, the hardening "
        "is small beside the elastic moduli. "
        f"A tolerance above {1.1 * here.rounding:.2g} is within reach."
    )


def record_of(
    state: State, iteration: int, length: float, trials: int, tangent: Tangent
) -> IterationRecord:
    """The numbers of an iterate."""
    points, rows = state.discrete.points, state.discrete.rows
    return IterationRecord(
        iteration=iteration,
        residual_norm=state.residual_norm,
        contact_residual_norm=state.contact_residual_norm,
        energy=state.energy,
        step_length=length,
        halvings=trials,
        back_substitutions=tangent.back_substitutions if iteration else 0,
        linear_iterations=tangent.linear_iterations if iteration else 0,
        contact_active=float(rows.weights[state.multipliers > 0].sum()),
        friction_active=float(rows.weights[state.sliding].sum()),
        plastic_active=points.integral(state.at.yields.astype(float)),
    )


def watched(record: IterationRecord, state: State, history: History) -> IterationRecord:
    """The record as monitors get it, with the result of a run that had stopped here."""
    seen = History(list(history.records))
    message = f"after {record.iteration} steps"
    return replace(record, snapshot=partial(ExactResult, state, Status.STOPPED, message, seen))
