"""The iteration of the primal solver: Newton on the displacement, contact exact in every step."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ngepc.checks.arguments import require_integer, require_number
from ngepc.discretisation.balance import EPSILON
from ngepc.discretisation.contact_step import ContactWork, with_contact
from ngepc.linalg.compliance import Compliance
from ngepc.linalg.direct import SOLVER_ERRORS
from ngepc.linalg.linesearch import Bracket
from ngepc.primal.energy import ReducedEnergy
from ngepc.primal.result import PrimalResult
from ngepc.primal.state import PrimalState
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

log = logging.getLogger(__name__)

CURVATURE = 0.2
"""The line search ends where |phi'(t)| <= CURVATURE |phi'(0)|."""

MOST_TRIALS = 40
"""Trial points of one line search."""

SLOPE_ROUNDING = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""

SETTLED = 0.5
"""Within rounding, a step that leaves more than this part of the residual ends the run."""


@dataclass(frozen=True, kw_only=True)
class PrimalOptions:
    """How far ``primal_newton`` iterates.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the nodal forces out of balance and of
        what contact leaves, relative to the larger of the norms of applied and internal forces,
        or to the smaller of beta/h and 4e-6 |K| |u|, where strains cancel; in [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: float = 1e-10
    max_iterations: int = 100

    def __post_init__(self) -> None:
        require_integer("max_iterations", self.max_iterations, 1)
        if require_number("tolerance", self.tolerance, 1e-13) >= 1:
            raise ValueError(f"tolerance={self.tolerance!r}: a number < 1 is needed")


class Interrupted(Exception):
    """Why a run ended before it converged: ``status`` and a sentence."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


class Run:
    """One run of ``primal_newton``: the discrete problem, the current state, the history.

    Parameters
    ----------
    reduced
        The discrete energy.
    u
        Nodal displacements to start from, shape (nodes, N).
    options, monitor
        As for ``primal_newton``.
    """

    def __init__(
        self, reduced: ReducedEnergy, u: np.ndarray, options: PrimalOptions, monitor: Monitor | None
    ) -> None:
        self.reduced, self.contact = reduced, reduced.contact
        self.options, self.monitor, self.history = options, monitor, History()
        self.compliance = Compliance(1 / reduced.row_stiffness)
        self.state, self.before = PrimalState(reduced, u, np.zeros(len(self.contact))), None

    def result(self) -> PrimalResult:
        """Newton steps until the residual is small or something stops them."""
        try:
            self._record(1.0, 0)
            while not self._converged():
                self._step()
            status, message = Status.CONVERGED, ""
        except Interrupted as stop:
            status, message = stop.status, str(stop)
        except (StopIteration, KeyboardInterrupt):
            status, message = Status.STOPPED, f"after {self._steps} steps"
        return PrimalResult(self.state, status, message, self.history)

    @property
    def _steps(self) -> int:
        return len(self.history.records) - 1

    def _converged(self) -> bool:
        """Whether the current state is the solution.

        Raises
        ------
        Interrupted
            If the run has to end without it.
        """
        here, before = self.state, self.before
        if not np.isfinite(here.residual_norm + here.energy):
            cause = "The energy or the residual is NaN or infinite: check the coefficients."
            raise Interrupted(Status.NONFINITE, cause)
        touching = here.penetration <= here.touching_distance
        if here.residual_norm <= self.options.tolerance and touching:
            return True
        settled = before is not None and here.residual_norm > SETTLED * before.residual_norm
        if settled and here.residual_norm <= here.rounding:
            raise Interrupted(Status.STAGNATED, self._drowned())
        if self._steps == self.options.max_iterations:
            advice = "try more steps, a smaller load step or a start from a coarser mesh."
            seen = f"{self._steps} steps, relative residual {here.residual_norm:.3g}; {advice}"
            raise Interrupted(Status.ITERATION_LIMIT, seen)
        return False

    def _step(self) -> None:
        here = self.state
        change, contact = self._direction()
        length, trials = 1.0, 0
        if here.penetration <= here.touching_distance:
            length, trials = self._line_search(change, contact)
        if length < 1:
            contact = here.contact + length * (contact - here.contact)
        self.before = here
        self.state = PrimalState(self.reduced, here.u + length * change, contact)
        self._record(length, trials)

    def _direction(self) -> tuple[np.ndarray, np.ndarray]:
        """The step to the solution of Newton's model with contact, and the contact forces there."""
        reduced, here = self.reduced, self.state
        try:
            reduced.factorise(here.u)
        except SOLVER_ERRORS as error:
            raise Interrupted(Status.NONFINITE, f"the factorisation failed: {error}") from error
        free = reduced.solve(-here.imbalance)
        if not np.isfinite(free).all():
            raise Interrupted(Status.NONFINITE, "the tangent stiffness is singular")
        found = with_contact(
            self.contact, reduced.solve, here.u, here.contact, free, self.compliance
        )
        if found is None:
            raise Interrupted(Status.NONFINITE, self.contact.unsolvable)
        return found

    def _line_search(self, change: np.ndarray, following: np.ndarray) -> tuple[float, int]:
        """The step length at most 1 where the energy is nearly smallest, and trials before it."""
        reduced, here = self.reduced, self.state
        work = ContactWork(
            self.contact, here.u, here.contact, change, following, here.touching_distance
        )
        rest = np.where(reduced.free, work.held - reduced.load, 0.0)
        terms = SLOPE_ROUNDING * np.abs(change) + 2 * EPSILON * np.abs(here.u)
        noise = float(np.vdot(np.abs(here.internal_forces), terms))

        def slope(t: float) -> float:
            forces = reduced.internal_forces(here.u + t * change) + rest
            return float(np.vdot(forces, change)) + work.slope(t)

        first = slope(0.0)
        bracket = Bracket(first, 1.0)
        for trials in range(MOST_TRIALS):
            t, here_slope = bracket.trial, slope(bracket.trial)
            flat = abs(here_slope) <= max(-CURVATURE * first, noise)
            if flat or (here_slope <= 0 and t == 1):
                return t, trials
            if first >= 0:
                break
            bracket.narrow(here_slope)
        if first < 0 < bracket.low:
            return bracket.low, MOST_TRIALS
        raise self._stuck(first)

    def _stuck(self, slope: float) -> Interrupted:
        if self.state.residual_norm <= self.state.rounding:
            return Interrupted(Status.STAGNATED, self._drowned())
        seen = f"the slope is {slope:.3g} and the relative residual {self.state.residual_norm:.3g}"
        advice = "try a smaller load step or a start from a coarser mesh."
        return Interrupted(Status.LINESEARCH_FAILED, f"In step {self._steps + 1} {seen}: {advice}")

    def _record(self, length: float, trials: int) -> None:
        state = self.state
        record = IterationRecord(
            iteration=len(self.history.records),
            residual_norm=state.residual_norm,
            energy=state.energy,
            step_length=length,
            halvings=trials,
            contact_active=float(self.contact.rows.weights[state.multipliers > 0].sum()),
            plastic_active=self.reduced.plastic_measure(state.u),
        )
        self.history.append(record)
        log.info(
            "it:%(iteration)4d residual:%(residual_norm).3e energy:%(energy).12e", vars(record)
        )
        if self.monitor is not None:
            ending, seen = f"after {record.iteration} steps", History(list(self.history.records))
            stopped = partial(PrimalResult, state, Status.STOPPED, ending, seen)
            self.monitor(replace(record, snapshot=stopped))

    def _drowned(self) -> str:
        state = self.state
        return (
            f"After {self._steps} steps the relative residual is {state.residual_norm:.3g}. "
            f"Rounding alone leaves about {state.rounding:.2g} of it where strains as huge as "
            "these cancel: the hardening is small beside the elastic moduli. "
            f"A tolerance above {1.1 * state.rounding:.2g} is within reach."
        )
