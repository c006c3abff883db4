"""Algorithm 7.2: inexact path-following in gamma."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.algorithm import algorithm_7_1
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.carried import carried_over
from ngepc.dual.functional import DualFunctional
from ngepc.dual.path_options import InnerRule, PathOptions
from ngepc.dual.path_steps import PathResult, PathStep, PathStore
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled, DualSpaces
from ngepc.dual.system import NewtonSystem
from ngepc.dual.widths import contact_mesh_width, mesh_width
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Monitor, Status

logger = logging.getLogger(__name__)

PathMonitor = Callable[[PathStep], None]


def follow_path(
    problem: Problem,
    options: PathOptions | None = None,
    monitor: PathMonitor | None = None,
    *,
    start: DualResult | None = None,
    spaces: DualSpaces | None = None,
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
    spaces
        The Tichonov choice and the units, which stay along the path; None for (R2).
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
    spaces = DualSpaces() if spaces is None else spaces
    require_instance("problem", problem, Problem, "a Problem")
    require_instance("options", options, PathOptions, "PathOptions(...)")
    kinds = (DualResult, type(None))
    require_instance("start", start, kinds, "a result of semismooth_newton or None")
    require_instance("spaces", spaces, DualSpaces, "DualSpaces(...)")
    watchers = {"monitor": monitor, "newton_monitor": newton_monitor, "observer": observer}
    for name, watcher in watchers.items():
        require_function(name, watcher, "what it is shown", optional=True)
    store = PathStore(checkpoint, problem, options, spaces, start)
    saved, walk = store.load(), _Walk(problem, options, spaces, start)
    if saved is not None:
        walk.resume(*saved)
    shown = (observer, lambda: walk.last), (monitor, lambda: walk.steps[-1])
    try:
        while (status := walk.status()) is None:
            walk.solve(newton_monitor)
            store.save(walk.steps, walk.last)
            logger.info("gamma %.4g: %s", walk.gamma, walk.steps[-1])
            for watcher, what in shown:
                if watcher is not None:
                    watcher(what())
    except (StopIteration, KeyboardInterrupt):
        if walk.last is None:
            raise  # there is no state yet
        status = Status.STOPPED
    return PathResult(status, walk.message(status), tuple(walk.steps), walk.last)


class _Walk:
    """The matrices of a path, what it has reached, and one gamma at a time."""

    def __init__(
        self, problem: Problem, options: PathOptions, spaces: DualSpaces, start: DualResult | None
    ) -> None:
        self.options = options
        self.blocks = LinearBlocks(problem, spaces, options.newton.inverse)
        self._system: NewtonSystem | None = None
        length = spaces.units.length
        self.h = mesh_width(problem.mesh) / length
        self.h_contact = contact_mesh_width(problem) / length
        self.steps: list[PathStep] = []
        self.last: DualResult | None = None
        self.move_to(options.gamma_start)
        self._v = carried_over(start, self.functional)

    def resume(self, steps: list[PathStep], v: np.ndarray, history: History) -> None:
        """Go on from the steps, the dual variable and the last history of a checkpoint."""
        self.steps = steps
        self.move_to(steps[-1].gamma)
        self._v.FV().NumPy()[:] = v
        self.last = DualResult.at(self.functional, self._v, steps[-1].status, history)

    def move_to(self, gamma: float) -> None:
        """Make J*_gamma for this gamma the functional in use."""
        spaces, points = self.blocks.choice, self.options.newton.quadrature_points
        self.gamma, regularisation = gamma, Coupled(gamma, spaces.tichonov, spaces.units)
        self.functional = DualFunctional(self.blocks, regularisation, points)

    def inner_rule(self, guarded: bool) -> InnerRule:
        """The tolerances for the present gamma; ``guarded`` once the safeguard has acted."""
        o, unit = self.options, self.blocks.residual_unit
        loose = o.inner_tolerance / math.sqrt(self.gamma)
        most = o.residual_tolerance / math.sqrt(2) if guarded else math.inf
        widths = (self.h_contact, self.h)
        bounds = [min(o.inner_scale * max(h, loose), most) * unit for h in widths]
        return InnerRule(o.newton.tolerance * unit, *bounds)

    def solve(self, monitor: Monitor | None) -> None:
        """The next problem (D_gamma_k), inexactly, from the last v."""
        newton = self.options.newton
        self.move_to(self.options.gamma(len(self.steps)))
        if self._system is None:
            self._system = NewtonSystem(self.functional, newton.inverse)
        self._system.use(self.functional)
        rule, work = self.inner_rule(self._reductions(self.steps) > 0), (self._system, self._v)
        limits = newton.linesearch, newton.max_iterations
        self.last = algorithm_7_1(*work, rule, *limits, monitor)
        self._v = self.last.v
        self.steps = [*self.steps, PathStep.after(self.steps, self.last)]

    def status(self) -> Status | None:
        """How the path has ended, None if it goes on."""
        if not self.steps:
            return None
        if self.steps[-1].status is not Status.CONVERGED:
            return self.steps[-1].status
        if self._has_ended(self.steps[-1]):
            return Status.CONVERGED
        limit = len(self.steps) >= self.options.max_outer_iterations
        return Status.ITERATION_LIMIT if limit else None

    def _has_ended(self, last: PathStep) -> bool:
        o, tolerance = self.options, self.options.residual_tolerance
        if o.gamma_end is not None:
            return last.gamma >= o.gamma_end
        sharp = tolerance is None or last.residual_norm < tolerance * self.blocks.residual_unit
        return sharp and self._settled(last, self._reductions(self.steps[:-1]))

    def _reductions(self, steps: list[PathStep]) -> int:
        """How often the safeguard has reduced tau_out in a path that has not ended."""
        number = 0
        if self.options.residual_tolerance is not None:
            for step in steps:
                number += self._settled(step, number)
        return number

    def _settled(self, step: PathStep, reductions: int) -> bool:
        """The condition of step (iv) of Algorithm 7.2."""
        tau = self.options.outer_tolerance * self.options.reduction**reductions
        return step.change is not None and step.change < tau * self.h

    def message(self, status: Status) -> str:
        """What was seen, and what to try, for a path that did not converge."""
        if status is Status.CONVERGED:
            return ""
        if not self.steps:
            return self.last.message
        last, inner = self.steps[-1], self.last.message
        where = f"At gamma = {last.gamma:.3g}, value {len(self.steps)} of the path"
        if last.status is not Status.CONVERGED:
            growth = self.options.growth
            return f"{where}: {inner} A smaller growth than {growth:g} may help."
        change = "nothing to compare" if last.change is None else f"{last.change:.3g} of V_gamma"
        seen = f"{where}, the last change is {change}, the residual {last.residual_norm:.3g}."
        if status is Status.ITERATION_LIMIT:
            return f"{seen} Raise max_outer_iterations or outer_tolerance."
        return seen
