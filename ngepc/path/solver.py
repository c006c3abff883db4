"""Algorithm 7.2: inexact path-following in gamma."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ngsolve.la import BaseVector

from ngepc.checks.distributed import check_supported, require_one_process
from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.carried import carried_over
from ngepc.dual.contact_newton import newton_system
from ngepc.dual.functional import DualFunctional, NewtonSystem
from ngepc.dual.newton import Monitor, run
from ngepc.dual.regularisation import Coupled, Regularisation, require_regularisation
from ngepc.dual.result import DualResult
from ngepc.dual.widths import contact_mesh_width, mesh_width
from ngepc.model.problem import Problem
from ngepc.path.options import InnerRule, PathOptions
from ngepc.path.result import PathResult
from ngepc.path.state import PathState, PathStep, PathStore
from ngepc.results.outcome import Status

logger = logging.getLogger(__name__)

PathMonitor = Callable[[PathStep], None]


def follow_path(
    problem: Problem,
    options: PathOptions | None = None,
    monitor: PathMonitor | None = None,
    *,
    start: DualResult | None = None,
    regularisation: Callable[[float], Regularisation] = Coupled,
    closing: Callable[[float], Regularisation] | None = None,
    checkpoint: Path | str | None = None,
    newton_monitor: Monitor | None = None,
    observer: Callable[[DualResult], None] | None = None,
) -> PathResult:
    """Follow the path of solutions of (D_gamma) by Algorithm 7.2.

    Parameters
    ----------
    problem
        The data.
    options
        Start, growth, tolerances; None for those of Table 3.
    monitor
        Called with the record of each gamma; raising StopIteration stops.
    start
        A result on this or another mesh of the body; None starts from v = 0.
    regularisation
        Maps gamma to a regularisation.  Its Tichonov choice, units and hardening share must not
        depend on gamma.
    closing
        Maps gamma to the regularisation of one last problem, solved at the gamma where the path
        ends, from its multipliers and to the same tolerances.  With
        ``regularisation=lambda gamma: split(Coupled(gamma))`` and ``closing=Coupled`` the
        paper's problem is reached along its hardening split, docs/balanced.md.
    checkpoint
        File that is written after each gamma.  A later call with the same problem and options
        goes on from there, to the same digits when it uses one thread.
    newton_monitor
        Called with the record of each Newton iterate.
    observer
        Called with the result for each gamma, for instance to measure fields along the path.

    Returns
    -------
    PathResult
        Status, records and the last result; the state reached is always there.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the checkpoint is damaged or belongs to other work.
    OSError
        If the checkpoint cannot be written.
    """
    options = PathOptions() if options is None else options
    check_arguments(problem, options, start, regularisation)
    if checkpoint is not None:
        require_one_process(f"checkpoint={checkpoint!r}", problem.mesh, "None is needed")
    if closing is not None:
        require_function("closing", closing, "gamma")
        require_regularisation(closing(options.gamma_start))
    for name, watcher in (
        ("monitor", monitor),
        ("newton_monitor", newton_monitor),
        ("observer", observer),
    ):
        require_function(name, watcher, "what it is shown", optional=True)
    walk = _Walk(problem, options, regularisation)
    store = PathStore(checkpoint, options, walk.functional, start)
    state = store.load(walk.blocks)
    if state is None:
        v = walk.blocks.H_vector() if start is None else carried_over(start, walk.functional)
        state = PathState([], v, [])
    path = followed(walk, store, state, newton_monitor, (observer, monitor))
    if closing is None or path.status is not Status.CONVERGED:
        return path
    return closed(path, _Walk(problem, options, closing), newton_monitor)


def followed(
    walk: _Walk,
    store: PathStore,
    state: PathState,
    newton_monitor: Monitor | None,
    watchers: tuple[Callable[[DualResult], None] | None, PathMonitor | None],
) -> PathResult:
    """The path from ``state`` to its end; ``watchers`` are shown each result, each record."""
    observer, monitor = watchers
    status, result = walk.verdict(state.steps), walk.restored(state)
    try:
        while status is None:
            result = walk.solve(state, newton_monitor)
            state = state.after(result, walk.gamma)
            status = walk.verdict(state.steps)
            if status is None and walk.options.predictor is not None:
                state = replace(state, start=walk.predicted(state))
            if result.status is Status.CONVERGED:
                store.save(state)
            logger.info("gamma %.4g: %s", walk.gamma, state.steps[-1])
            if observer is not None:
                observer(result)
            if monitor is not None:
                monitor(state.steps[-1])
    except (StopIteration, KeyboardInterrupt):
        if result is None:
            raise  # there is no state yet
        status = Status.STOPPED
    message = describe(status, state.steps, result.message, walk.options)
    return PathResult(status, message, tuple(state.steps), result)


def closed(path: PathResult, walk: _Walk, monitor: Monitor | None) -> PathResult:
    """The path with one more problem, that of ``walk`` at the gamma where the path has ended."""
    walk.move_to(path.gamma_end)
    state = PathState(list(path.steps), carried_over(path.result, walk.functional), [])
    result = walk.solve_here(state, monitor)
    state = state.after(result, walk.gamma)
    message = describe(result.status, state.steps, result.message, walk.options)
    return PathResult(result.status, message, tuple(state.steps), result)


def check_arguments(
    problem: object, options: object, start: object, regularisation: object
) -> None:
    """Refuse arguments of the wrong kind before any work."""
    require_instance("problem", problem, Problem, "a Problem")
    require_instance("options", options, PathOptions, "PathOptions(...)")
    if start is not None and not isinstance(start, DualResult):
        raise TypeError(f"start={start!r}: a result of semismooth_newton or None is needed")
    require_function("regularisation", regularisation, "gamma")
    first = regularisation(options.gamma_start)
    require_regularisation(first)
    check_supported(problem, first, options.newton.inverse, start)


class _Walk:
    """The matrices of a path, and one gamma at a time."""

    def __init__(
        self,
        problem: Problem,
        options: PathOptions,
        regularisation: Callable[[float], Regularisation],
    ) -> None:
        self.options, self._regularisation = options, regularisation
        self.gamma = options.gamma_start
        first = regularisation(self.gamma)
        self.blocks = LinearBlocks(problem, first, options.newton.inverse)
        self.functional = self._functional(first)
        self._system: NewtonSystem | None = None
        length = first.units.length
        self.h = mesh_width(problem.mesh) / length
        self.h_contact = contact_mesh_width(problem) / length

    def _functional(self, regularisation: Regularisation) -> DualFunctional:
        return DualFunctional(self.blocks, regularisation, self.options.newton.quadrature_points)

    def inner_rule(self, guarded: bool) -> InnerRule:
        """The tolerances for the present gamma; ``guarded`` once the safeguard has acted."""
        o, unit = self.options, self.functional.residual_unit
        loose = o.inner_tolerance / math.sqrt(self.gamma)
        most = o.residual_tolerance / math.sqrt(2) if guarded else math.inf
        widths = (self.h_contact, self.h)
        bounds = [min(o.inner_scale * max(h, loose), most) * unit for h in widths]
        return InnerRule(*bounds, zero=o.newton.tolerance * unit)

    def move_to(self, gamma: float) -> None:
        """Make J*_gamma for this gamma the functional in use."""
        self.gamma = gamma
        self.functional = self._functional(self._regularisation(gamma))

    def solve(self, state: PathState, monitor: Monitor | None) -> DualResult:
        """The next problem (D_gamma_k), inexactly."""
        self.move_to(self.options.gamma(len(state.steps)))
        return self.solve_here(state, monitor)

    def solve_here(self, state: PathState, monitor: Monitor | None) -> DualResult:
        """The problem for the gamma in use, from the v of ``state``."""
        v = self.blocks.H_vector()
        v.data = state.v if state.start is None else state.start
        self._renew_system()
        rule = self.inner_rule(guarded=self._reductions(state.steps) > 0)
        return run(self.functional, self._system, v, self.options.newton, monitor, rule)

    def predicted(self, state: PathState) -> BaseVector:
        """The predictor's start for the next gamma, by the last factors."""
        gamma = self.options.gamma(len(state.steps))
        following = self._functional(self._regularisation(gamma))
        return self.options.predictor.start(self._system, following, state.v)

    def _renew_system(self) -> None:
        """The system of the last gamma where it has no memory of its iterates, else a new one."""
        if self._system is None or self.functional.constraint is not None:
            self._system = newton_system(self.functional, self.options.newton.inverse)
        else:
            self._system.use(self.functional)

    def verdict(self, steps: list[PathStep]) -> Status | None:
        """How the path has ended after these steps, None if it goes on."""
        if not steps:
            return None
        if steps[-1].status is not Status.CONVERGED:
            return steps[-1].status
        if self._has_ended(steps):
            return Status.CONVERGED
        limit = len(steps) >= self.options.max_outer_iterations
        return Status.ITERATION_LIMIT if limit else None

    def _has_ended(self, steps: list[PathStep]) -> bool:
        if self.options.gamma_end is not None:
            return steps[-1].gamma >= self.options.gamma_end
        return self._settled(steps[-1], self._reductions(steps[:-1])) and self._sharp(steps[-1])

    def _reductions(self, steps: list[PathStep]) -> int:
        """How often the safeguard has reduced tau_out in a path that has not ended."""
        number = 0
        for step in steps:
            number += self._settled(step, number)
        return number if self.options.residual_tolerance is not None else 0

    def _settled(self, step: PathStep, reductions: int) -> bool:
        """The condition of step (iv) of Algorithm 7.2."""
        tau = self.options.outer_tolerance * self.options.reduction**reductions
        return step.change is not None and step.change < tau * self.h

    def _sharp(self, step: PathStep) -> bool:
        """The residual check of the safeguard."""
        tolerance = self.options.residual_tolerance
        if tolerance is None:
            return True
        return step.residual_norm < tolerance * self.functional.residual_unit

    def restored(self, state: PathState) -> DualResult | None:
        """The result that a checkpoint stands for, None at the start of a path."""
        if not state.steps:
            return None
        self.move_to(state.steps[-1].gamma)
        return state.result(self.functional)


def describe(
    status: Status, steps: list[PathStep], inner_message: str, options: PathOptions
) -> str:
    """What was seen, and what to try, for a path that did not converge."""
    if status is Status.CONVERGED:
        return ""
    if not steps:
        return inner_message
    last = steps[-1]
    where = f"At gamma = {last.gamma:.3g}, value {len(steps)} of the path"
    if last.status is not Status.CONVERGED:
        return f"{where}: {inner_message} A smaller growth than {options.growth:g} may help."
    change = "nothing to compare" if last.change is None else f"{last.change:.3g} of V_gamma"
    seen = f"{where}, the last change is {change}, the residual {last.residual_norm:.3g}."
    if status is Status.ITERATION_LIMIT:
        return f"{seen} Raise max_outer_iterations or outer_tolerance."
    return seen
