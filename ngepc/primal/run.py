"""The iteration of the primal solver: directions, line search, stopping."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ngepc.discretisation.contact import NodalContact, nodal_contact
from ngepc.linalg.complementarity import solve_complementarity
from ngepc.linalg.direct import SOLVER_ERRORS
from ngepc.model.problem import Problem
from ngepc.primal.energy import ReducedEnergy
from ngepc.primal.result import PrimalResult, State
from ngepc.results.outcome import History, IterationRecord, Status

if TYPE_CHECKING:
    from ngepc.primal.options import PrimalOptions

log = logging.getLogger(__name__)

Monitor = Callable[[IterationRecord], None]

_TOUCHING = 1e-12
"""Open gap below which a node touches the obstacle, relative to the largest displacement."""
_ROUNDING = 1e-13
"""Changes of the energy below this part of its terms are rounding."""
_ROUNDING_STEPS = 5
_IN_A_ROW = 3
"""Trials on one side of a minimum after which secants are taken to creep."""
_ASK_FOR_LESS = "it is at the level of rounding, ask for a larger tolerance."


class Interrupted(Exception):
    """Why a run ended before it converged: ``status`` and a sentence."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


class Bracket:
    """Where the slope of a convex function changes sign, narrowed by safeguarded secants.

    The slope may jump, as where a soft plastic element turns elastic: secants then creep towards
    the jump from one side, so that many trials in a row on a side are followed by the middle.

    Parameters
    ----------
    slope
        The slope at 0, negative.
    """

    def __init__(self, slope: float) -> None:
        self._low, self._low_slope = 0.0, slope
        self._high, self._high_slope = 1.0, None
        self.trial, self._row = 1.0, 0

    def narrow(self, slope: float) -> None:
        """Take note of the slope at ``trial`` and choose the next trial."""
        if not slope <= 0:  # NaN counts as too far
            self._high, self._high_slope = self.trial, slope
            self._row = max(self._row, 0) + 1
        else:
            self._low, self._low_slope = self.trial, slope
            self._row = min(self._row, 0) - 1
        width = self._high - self._low
        sloped = self._high_slope is not None and np.isfinite(self._high_slope)
        if not sloped or abs(self._row) > _IN_A_ROW:
            self.trial = self._low + 0.5 * width
            return
        secant = self._low - self._low_slope * width / (self._high_slope - self._low_slope)
        self.trial = min(max(secant, self._low + 0.1 * width), self._high - 0.1 * width)


class Run:
    """One run of ``primal_newton``: the discrete problem, the current state, the history.

    Parameters
    ----------
    problem, options, monitor
        As for ``primal_newton``.
    start
        Nodal displacements, shape (N, vertices); None for zero.
    """

    def __init__(
        self,
        problem: Problem,
        start: np.ndarray | None,
        options: PrimalOptions,
        monitor: Monitor | None,
    ) -> None:
        self.options, self.monitor = options, monitor
        self.energy = ReducedEnergy(problem)
        self.contact: NodalContact = nodal_contact(problem, self.energy.space)
        self.history = History()
        self._drowned = 0
        u = self.energy.lift
        if start is not None:
            u = np.where(self.energy.free, start, u)
        self.state = self._state(u)
        self.active = self.state.multipliers > 0

    def iterate(self) -> tuple[Status, str]:
        """Newton steps until the residual is small or something stops them."""
        try:
            self._record(1.0, 0)
            self._require_finite(self.state)
            last = np.inf
            while self.state.residual_norm > self.options.tolerance:
                if len(self.history.records) > self.options.max_iterations:
                    return Status.ITERATION_LIMIT, self._advice()
                if self._in_rounding and self.state.residual_norm > 0.5 * last:
                    return Status.STAGNATED, self._drowned_in_rounding()
                last = self.state.residual_norm
                self._step()
        except Interrupted as stop:
            return stop.status, str(stop)
        except (StopIteration, KeyboardInterrupt):
            return Status.STOPPED, f"after {len(self.history.records) - 1} steps"
        return Status.CONVERGED, ""

    def _step(self) -> None:
        before = self.state
        feasible = self.contact.violation(before.u) <= self._touching_distance(before.u)
        direction = self._direction()
        if feasible:
            length, trials = self._line_search(direction)
        else:
            full = self.contact.snapped(before.u + direction, self.active)
            self.state, length, trials = self._state(full), 1.0, 1
        self._require_finite(self.state)
        self._record(length, trials - 1)
        if feasible and self.state.residual_norm > self.options.tolerance:
            self._count_drowned(before)

    def _direction(self) -> np.ndarray:
        """The minimiser of Newton's model over the feasible set, minus the current state."""
        energy, contact, u = self.energy, self.contact, self.state.u
        try:
            energy.factorise(u)
        except SOLVER_ERRORS as error:
            raise Interrupted(Status.NONFINITE, f"the factorisation failed: {error}") from error
        vertices, multipliers = u.shape[1], self.state.multipliers
        free = energy.solve(-self.state.gradient - contact.nodal_forces(multipliers, vertices))
        if not np.isfinite(free).all():
            raise Interrupted(Status.NONFINITE, "the tangent stiffness is singular")
        forces = solve_complementarity(
            lambda i: contact.free_displacement(energy.solve(contact.unit_force(i, vertices))),
            contact.open_gap(u) - contact.free_displacement(free),
            self.active,
            multipliers,
        )
        if forces is None:
            raise Interrupted(
                Status.NONFINITE, "the contact conditions of neighbouring nodes are dependent"
            )
        self.active = forces.values > 0
        return free - energy.solve(contact.nodal_forces(forces.change, vertices))

    def _line_search(self, direction: np.ndarray) -> tuple[float, int]:
        """Move along ``direction`` to where phi is low enough; returns length and evaluations."""
        options, before = self.options, self.state
        hold = self._held_forces()
        slope = before.slope(direction, hold)
        noise = 1e-14 * np.vdot(np.abs(before.forces), np.abs(direction))
        bracket = Bracket(slope)
        for trial in range(1, options.max_evaluations + 1):
            t = bracket.trial
            active = self.active if t == 1 else np.zeros_like(self.active)
            state = self._state(self.contact.snapped(before.u + t * direction, active))
            s = state.slope(direction, hold)
            fallen = state.energy - before.energy <= (
                options.decrease * t * slope + 1e-14 * before.size
            )
            flat = abs(s) <= max(-options.curvature * slope, noise) and fallen
            if flat or (s <= 0 and t == 1):
                self.state = state
                return t, trial
            if slope >= 0:
                break
            bracket.narrow(s)
        raise self._stuck(slope)

    def _held_forces(self) -> np.ndarray:
        """Contact forces at the nodes that stay in contact along the step: they do no work."""
        multipliers = np.where(self.active, self.state.multipliers, 0.0)
        forces = self.contact.nodal_forces(multipliers, self.state.u.shape[1])
        return np.where(self.energy.free, forces, 0.0)

    def _stuck(self, slope: float) -> Interrupted:
        seen = (
            f"In step {len(self.history.records)} the slope is {slope:.3g} and the relative "
            f"residual {self.state.residual_norm:.3g}: "
        )
        if self._in_rounding:
            return Interrupted(Status.STAGNATED, self._drowned_in_rounding())
        if abs(slope) <= _ROUNDING * self.state.size:
            return Interrupted(Status.STAGNATED, seen + _ASK_FOR_LESS)
        return Interrupted(
            Status.LINESEARCH_FAILED,
            seen + "try a smaller load step or a start from a coarser mesh.",
        )

    def _count_drowned(self, before: State) -> None:
        """End the run when several steps in a row change the energy by rounding only."""
        drowned = before.energy - self.state.energy <= _ROUNDING * before.size
        improved = self.state.residual_norm < 0.5 * before.residual_norm
        self._drowned = self._drowned + 1 if drowned and not improved else 0
        if self._drowned >= _ROUNDING_STEPS:
            raise Interrupted(
                Status.STAGNATED,
                f"After {len(self.history.records) - 1} steps the relative residual stays near "
                f"{self.state.residual_norm:.3g}: " + _ASK_FOR_LESS,
            )

    def _state(self, u: np.ndarray) -> State:
        touching = self._touching_distance(u)
        return State.at(self.energy, self.contact, u, touching)

    def _touching_distance(self, u: np.ndarray) -> float:
        return _TOUCHING * float(np.abs(u).max())

    def _require_finite(self, state: State) -> None:
        sane = np.isfinite(state.energy) and np.isfinite(state.gradient).all()
        if not sane or np.isnan(state.residual_norm):
            raise Interrupted(
                Status.NONFINITE,
                "the energy or the residual is NaN or infinite: check the coefficients",
            )

    def _record(self, length: float, halvings: int) -> None:
        state = self.state
        record = IterationRecord(
            iteration=len(self.history.records),
            residual_norm=state.residual_norm,
            energy=state.energy,
            step_length=length,
            halvings=halvings,
            contact_active=float(self.contact.masses[state.multipliers > 0].sum()),
            plastic_active=self.energy.plastic_measure(state.u),
        )
        self.history.append(record)
        log.info("it:%(iteration)d residual:%(residual_norm).3e energy:%(energy).9e", vars(record))
        if self.monitor is not None:
            self.monitor(replace(record, snapshot=partial(self._stopped, state, record.iteration)))

    def _stopped(self, state: State, iteration: int) -> PrimalResult:
        """The result of a run that had stopped at this iterate."""
        history = History(self.history.records[: iteration + 1])
        message = f"after {iteration} steps"
        return PrimalResult.at(self.energy, self.contact, state, history, Status.STOPPED, message)

    @property
    def _in_rounding(self) -> bool:
        """Whether the residual is no more than what rounding may leave of it."""
        return self.state.residual_norm <= self.state.rounding

    def _drowned_in_rounding(self) -> str:
        state = self.state
        return (
            f"After {len(self.history.records) - 1} steps the relative residual is "
            f"{state.residual_norm:.3g}. Rounding alone leaves about {state.rounding:.2g} of it "
            "where strains as huge as these cancel: the hardening is small beside the elastic "
            "moduli. "
            f"A tolerance above {1.1 * state.rounding:.2g} is within reach."
        )

    def _advice(self) -> str:
        last = self.history.records[-1]
        return (
            f"{last.iteration} steps, relative residual {last.residual_norm:.3g}, last step "
            f"length {last.step_length:.3g}; try more steps, a smaller load step or a start from "
            "a coarser mesh."
        )
