"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy phi(u) under the nodal conditions n_i . u_i <= psi_i.  Each step minimises
Newton's quadratic model of phi over the *feasible* set: one factorisation, and a complementarity
problem on the contact nodes that is solved exactly by primal-dual active sets.  All iterates are
feasible, every step goes downhill, and the line search on phi makes cycles impossible.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve import GridFunction

from ngepc.complementarity import solve_complementarity
from ngepc.nodal_contact import NodalContact, nodal_contact
from ngepc.primal_result import PrimalResult, State
from ngepc.problem import Problem
from ngepc.prolongation import at_points
from ngepc.reduced_energy import ReducedEnergy
from ngepc.results import History, IterationRecord, Status
from ngepc.validation import require_integer, require_number

log = logging.getLogger(__name__)

Monitor = Callable[[IterationRecord], None]

_TOUCHING = 1e-12
"""Open gap below which a node touches the obstacle, relative to the largest displacement."""
_ROUNDING = 1e-13
"""Changes of the energy below this part of its terms are rounding."""
_ROUNDING_STEPS = 5
_ASK_FOR_LESS = "it is at the level of rounding, ask for a larger tolerance."


@dataclass(frozen=True, kw_only=True)
class PrimalOptions:
    """How far and how carefully ``primal_newton`` iterates.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the nodal forces out of balance,
        contact forces >= 0 at touching nodes included, relative to the larger of the norms of
        the applied and of the internal nodal forces; within [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.
    decrease
        Armijo's constant: energies must fall by this part of the slope, within (0, 1/2).
    curvature
        The line search ends where |phi'(t)| <= curvature |phi'(0)|, within (0, 1).
    max_evaluations
        Trial points of one line search, >= 1.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: float = 1e-10
    max_iterations: int = 100
    decrease: float = 1e-4
    curvature: float = 0.2
    max_evaluations: int = 40

    def __post_init__(self) -> None:
        require_number("tolerance", self.tolerance, 1e-13)
        require_integer("max_iterations", self.max_iterations, 1)
        require_integer("max_evaluations", self.max_evaluations, 1)
        for name, most in {"tolerance": 1.0, "decrease": 0.5, "curvature": 1.0}.items():
            value = require_number(name, getattr(self, name), 0, strict=True)
            if value >= most:
                raise ValueError(f"{name}={value!r}: a number < {most:g} is needed")


class Interrupted(Exception):
    """Why a run ended before it converged: ``status`` and a sentence."""

    def __init__(self, status: Status, message: str) -> None:
        super().__init__(message)
        self.status = status


def primal_newton(
    problem: Problem,
    start: GridFunction | object | None = None,
    options: PrimalOptions = PrimalOptions(),
    monitor: Monitor | None = None,
) -> PrimalResult:
    """Minimise J(u, p) of (2.14) over P1 displacements and pointwise plastic strains, exactly.

    On quadrilaterals and hexahedra u is (multi)linear and p lives at the 2 x 2 (x 2) Gauss points.

    Parameters
    ----------
    problem
        Data of the time step.
    start
        A displacement to start from: a GridFunction or any result with ``displacement``, on this
        or on another mesh of the body (it is evaluated at the vertices).  None starts from zero.
    options
        Tolerance and limits.
    monitor
        Called with the record of every iterate; raising StopIteration ends the run.

    Returns
    -------
    PrimalResult
        ``status`` is CONVERGED only if the residual of the returned state meets the tolerance.

    Raises
    ------
    TypeError
        If ``problem``, ``start`` or ``options`` is of the wrong kind.
    """
    if not isinstance(problem, Problem):
        raise TypeError(f"problem={problem!r}: a Problem is needed")
    if not isinstance(options, PrimalOptions):
        raise TypeError(f"options={options!r}: PrimalOptions are needed")
    run = _Run(problem, start, options, monitor)
    status, message = run.iterate()
    return PrimalResult.at(run.energy, run.contact, run.state, run.history, status, message)


def nodal_values(start: object, problem: Problem) -> np.ndarray:
    """The displacement ``start`` at the vertices of the problem's mesh, shape (N, vertices).

    Parameters
    ----------
    start
        A P1 displacement, or anything with such a ``displacement``.
    problem
        The problem whose mesh receives the values.

    Raises
    ------
    TypeError, ValueError
        If ``start`` is no displacement in N dimensions.
    """
    source = getattr(start, "displacement", start)
    N, mesh = problem.N, problem.mesh
    if not isinstance(source, GridFunction):
        raise TypeError(f"start={start!r}: a displacement or a result that has one is needed")
    own = source.space.mesh
    if own.dim != N or source.dim != N:
        raise ValueError(f"start has {source.dim} components: a displacement of {N} is needed")
    values = np.array([c.vec.FV().NumPy()[: own.nv] for c in source.components])
    points, here = (np.asarray(m.ngmesh.Coordinates())[: m.nv, :N] for m in (mesh, own))
    if np.array_equal(points, here):
        return values
    return at_points(own, values.T, points).T


class Bracket:
    """Where the slope of a convex function changes sign, narrowed by safeguarded secants.

    Parameters
    ----------
    slope
        The slope at 0, negative.
    """

    def __init__(self, slope: float) -> None:
        self._low, self._low_slope = 0.0, slope
        self._high, self._high_slope = 1.0, None
        self.trial = 1.0

    def narrow(self, slope: float) -> None:
        """Take note of the slope at ``trial`` and choose the next trial."""
        if not slope <= 0:  # NaN counts as too far
            self._high, self._high_slope = self.trial, slope
        else:
            self._low, self._low_slope = self.trial, slope
        width = self._high - self._low
        if self._high_slope is None or not np.isfinite(self._high_slope):
            self.trial = self._low + 0.5 * width
            return
        secant = self._low - self._low_slope * width / (self._high_slope - self._low_slope)
        self.trial = min(max(secant, self._low + 0.1 * width), self._high - 0.1 * width)


class _Run:
    """One run: the discrete problem, the current state, the history."""

    def __init__(
        self, problem: Problem, start: object, options: PrimalOptions, monitor: Monitor | None
    ) -> None:
        self.options, self.monitor = options, monitor
        self.energy = ReducedEnergy(problem)
        self.contact: NodalContact = nodal_contact(problem, self.energy.space)
        self.history = History()
        self._drowned = 0
        u = self.energy.lift
        if start is not None:
            u = np.where(self.energy.free, nodal_values(start, problem), u)
        self.state = self._state(u)
        self.active = self.state.multipliers > 0

    def iterate(self) -> tuple[Status, str]:
        """Newton steps until the residual is small or something stops them."""
        try:
            self._record(1.0, 0)
            self._require_finite(self.state)
            while self.state.residual_norm > self.options.tolerance:
                if len(self.history.records) > self.options.max_iterations:
                    return Status.ITERATION_LIMIT, self._advice()
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
        except Exception as error:  # NGSolve raises bare exceptions for singular matrices
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
        self.active = forces > 0
        return free - energy.solve(contact.nodal_forces(forces - multipliers, vertices))

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
            self.monitor(record)

    def _advice(self) -> str:
        last = self.history.records[-1]
        return (
            f"{last.iteration} steps, relative residual {last.residual_norm:.3g}, last step "
            f"length {last.step_length:.3g}; try more steps, a smaller load step or a start from "
            "a coarser mesh."
        )
