"""The Newton loop shared by the exact and the primal method: check for termination, take a step.

A step goes towards the minimum of Newton's model over N u <= gaps, with friction; the step length
decreases the energy.  A tangent has ``linearise(state)`` and ``solve(forces)``, both (nodes, N);
``examined`` are the most solves that tell whether friction allows other equilibria, ``stiffened``,
if there is one, makes ``solve`` with springs of the rows.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np

from ngepc._deprecated import old_names
from ngepc.checks.sentences import counted
from ngepc.discretisation.body import EPSILON, DiscreteBody, Iterate
from ngepc.discretisation.contact_step import (
    ROUNDING,
    contact_work,
    several_solutions,
    with_contact,
    with_travel,
)
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.linesearch import nearly_flat
from ngepc.linalg.secants import Compliance
from ngepc.results.ending import end_of, no_descent
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

log = logging.getLogger(__name__)

LINE = "it:%(iteration)4d residual:%(residual_norm).3e energy:%(energy).12e"

QUADRATIC = 5.0
"""After a full step that divides the residual by more, w is set to the radial return."""

NEAR = 1e-2
"""If it is smaller than this, too, the factors of the tangent give one more step."""

NOISE = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""

VANISHED = 1e-12
"""If less than this part of u is left of the start, it is rounding errors."""

CLEARLY = 1e4
"""Times the touching distance that u is inside an obstacle, if that is no rounding."""


class Target(Protocol):
    """Minimiser of Newton's model."""

    def __call__(
        self, here: Any, tangent: Any, before: float | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """A step du (nodes, N), and the forces of the contact rows at its end.

        ``before`` is the residual norm one iterate before, None at first.
        """

    def closer(self) -> Target | None:
        """A more accurate one, for steps that do not lower the energy."""


class ExactTarget:
    """Newton's model solved exactly; the compliance of the contact rows is kept between steps.

    ``compliance`` gives a guess for it, None for that of the body.
    """

    def __init__(
        self, body: DiscreteBody, compliance: Callable[[], Compliance] | None = None
    ) -> None:
        self._guess = compliance or body.compliance

    @cached_property
    def _compliance(self) -> Compliance:
        """The compliance that is learned; its first guess may need solves."""
        return self._guess()

    def __call__(
        self, here: Iterate, tangent: Any, before: float | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take the tangent at a state and solve; FactorisationError if that cannot be done."""
        tangent.linearise(here)
        return self.step(here, tangent)

    def step(self, here: Iterate, tangent: Any) -> tuple[np.ndarray, np.ndarray]:
        """The same with the last factors of a tangent."""
        return with_contact(here, tangent.solve, self._compliance)

    def closer(self) -> None:
        """There is no more accurate one."""


def newton_iteration(
    state: Iterate,
    tangent: Any,
    result: Callable[..., Any],
    tolerance: float,
    max_iterations: int,
    monitor: Monitor | None = None,
    target: Target | None = None,
    *,
    second: Callable[[Any], Iterate] | None = None,
    history: History | None = None,
) -> Any:
    """Newton steps from a state until its residual is within the tolerance or something stops them.

    The monitor gets the record of each iterate and may raise StopIteration; ``target`` is exact by
    default; ``second`` may replace the iterate after the first step.  With ``history``, whose last
    record is that of the state, a run goes on.  What is returned is ``result`` of the last state,
    whatever its status says.
    """
    history = History(list(history.records) if history else [])
    target = target or ExactTarget(state.body)
    start = state

    def seen(length: float, trials: int) -> tuple[Status | None, str]:
        """Record and show the state that a step has led to; whether and how the run ends there."""
        record = record_of(state, tangent, len(history.records), length, trials)
        history.records.append(record)
        log.info(LINE, vars(record))
        show_iterate(monitor, history, partial(result, state, Status.STOPPED), state)
        return end_of(state, history, tolerance, max_iterations)

    try:
        status, message = (None, "") if history.records else seen(1.0, 0)
        while status is None:
            step = newton_step(state, tangent, target, history.before, tolerance)
            if step is None:
                status, message = no_descent(state, history, tolerance)
            else:
                following, length, trials = step
                state = replaced(start, following, history, second)
                status, message = seen(length, trials)
        if status is Status.CONVERGED and state.body.contact.friction.d:
            status, message = uniqueness(state.with_radial_return(), tangent)
    except FactorisationError as error:
        status = Status.NONFINITE
        message = f"{error}."
    except (StopIteration, KeyboardInterrupt) as error:
        state.body.contact.processes.check_stop(error)
        status = Status.STOPPED
        message = f"after {counted(len(history.records) - 1, 'step')}"
    return result(state, status, message, history)


def replaced(
    start: Iterate,
    following: Iterate,
    history: History,
    second: Callable[[Any], Iterate] | None,
) -> Iterate:
    """The iterate to go on from after a step: of the first one what ``second`` makes of it."""
    if second is not None and len(history.records) == 1:
        return second(following)
    return resting(start, following)


def resting(start: Iterate, following: Iterate) -> Iterate:
    """The state after a step, or the body at rest if that is the solution and near enough.

    Residuals are relative to the forces: without loads steps would go on until numbers underflow.
    """
    if following.touching_distance > VANISHED * start.touching_distance:
        return following
    rest = start.body.at_rest()
    solves = rest.residual_norm == rest.penetration == 0
    return rest if solves else following


def show_iterate(
    monitor: Monitor | None,
    history: History,
    snapshot: Callable[..., Any],
    state: Iterate,
) -> None:
    """Call a monitor with the last record, and a result of a run that ends there."""
    if monitor is None:
        return
    record = history.records[-1]
    seen = History(list(history.records))
    ending = f"after {counted(record.iteration, 'step')}"
    shown = replace(record, snapshot=partial(snapshot, ending, seen))
    state.body.contact.processes.show(monitor, shown)


def record_of(
    state: Iterate, tangent: Any, number: int, length: float, trials: int
) -> IterationRecord:
    """The history record of a state and of the step that led to it."""
    area = state.body.contact.area
    return IterationRecord(
        iteration=number,
        residual_norm=state.residual_norm,
        contact_residual_norm=state.contact_residual_norm,
        energy=state.energy,
        step_length=length,
        halvings=trials,
        back_substitutions=tangent.back_substitutions,
        linear_iterations=tangent.linear_iterations,
        contact_active=area(state.multipliers > 0),
        plastic_active=state.plastic_measure,
        friction_active=area(state.sliding),
    )


def newton_step(
    here: Iterate,
    tangent: Any,
    target: Target,
    before: float | None,
    tolerance: float = 0.0,
) -> tuple[Iterate, float, int] | None:
    """The next state, the step length and its trials; None if no length lowers the energy."""
    found = None
    accurate: Target | None = target
    while found is None and accurate is not None:
        found = searched(here, *accurate(here, tangent, before))
        accurate = accurate.closer()
    if found is None:
        return None
    state, length, trials = found
    if length < 1.0 or here.penetration > here.touching_distance:
        return found
    if not converges(here, state):
        return found
    state = settled(here, state)
    near = tolerance < state.residual_norm < NEAR
    exact = state.rounding < NEAR * state.residual_norm
    if near and exact and isinstance(target, ExactTarget):
        state = corrected(state, tangent, target)
    return state, length, trials


def converges(here: Iterate, following: Iterate) -> bool:
    """Whether a step divides the residual by more than ``QUADRATIC``."""
    return here.residual_norm > QUADRATIC * following.residual_norm


def settled(here: Iterate, following: Iterate) -> Iterate:
    """The state after a step, with w by radial return if the step converges."""
    return following.with_radial_return() if converges(here, following) else following


def corrected(state: Iterate, tangent: Any, target: ExactTarget) -> Iterate:
    """The state after a further step with the same factors, if its residual is smaller.

    One more solve for the factors saves the last ones of Newton's method.
    """
    if state.penetration > state.touching_distance:
        return state
    found = searched(state, *target.step(state, tangent))
    if found is None:
        return state
    closer, length, _ = found
    if not closer.residual_norm < state.residual_norm:
        return state
    return settled(state, closer) if length == 1.0 else closer


def searched(
    here: Iterate, change: np.ndarray, contact: np.ndarray
) -> tuple[Iterate, float, int] | None:
    """The state along a step, its length and the trials; None if no length lowers the energy."""
    internal_work, moved = here.along(change)
    rows_slope, held = contact_work(here, change, contact)
    outer_work = here.body.contact.processes.dot(here.body.load - held, change)

    def slope(t: float) -> float:
        """d/dt of J(u + t du), friction with the bounds of the target included."""
        return internal_work(t) + rows_slope(t) - outer_work

    if here.penetration > CLEARLY * here.touching_distance:
        return moved(1.0, contact), 1.0, 0  # the first step makes u feasible
    found = nearly_flat(slope, slope_rounding(here, change, contact))
    if found is None:
        return None
    length, trials = found
    if length == 1.0:
        if here.body.floating.centres:
            farther = with_travel(here, change, contact)
            if farther is not change:
                _, moved = here.along(farther)
        return moved(1.0, contact), length, trials
    forces = here.contact + length * (contact - here.contact)
    return moved(length, forces), length, trials


def slope_rounding(here: Iterate, change: np.ndarray, contact: np.ndarray) -> float:
    """The rounding error of a slope, also where du is only a rounding error of u.

    Weak springs of a floating part answer rounding errors of the forces with a rigid motion.
    """
    body = here.body
    processes = here.body.contact.processes
    size = np.abs(here.u)
    forces = np.abs(contact)
    terms = NOISE * np.abs(change) + 2 * EPSILON * size
    summed = processes.dot(np.abs(here.internal_forces), terms)
    pressing = processes.total(float(forces[body.contact.own].sum()))
    answers = processes.maximum(forces / body.row_stiffness)
    rigid = processes.maximum(forces * (body.floating.compliance**2).sum(axis=1))
    moved = ROUNDING * max(processes.maximum(size), answers) + EPSILON * rigid
    return summed + pressing * moved


def uniqueness(here: Iterate, tangent: Any) -> tuple[Status, str]:
    """Whether friction allows several equilibria, and a message about it."""
    tangent.linearise(here)
    several, message = several_solutions(
        here, tangent.solve, tangent.examined, tangent.stiffened
    )
    return Status.NOT_UNIQUE if several else Status.CONVERGED, message


__getattr__ = old_names(__name__)
