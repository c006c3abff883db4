"""Algorithm 7.2: inexact path-following in gamma.

The paper does not define the mesh width h that its tolerances refer to.  Here it is the width in
the geometric sense, the distance between the two closest parallel planes with an element between
them, of the narrowest element.  With it the outer iterations of Table 3 come out as printed; with
the longest edge, more than twice that on the same meshes, paths end earlier (docs/reading.md).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ngsolve import BND, VOL, Integrate, Mesh

from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.algorithm import algorithm_7_1
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.dual.path_options import InnerRule, PathOptions
from ngepc.dual.path_steps import PathResult, PathStep, PathStore
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled, DualSpaces
from ngepc.dual.system import NewtonSystem
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Monitor, Status

logger = logging.getLogger(__name__)


def follow_path(
    problem: Problem,
    options: PathOptions | None = None,
    monitor: Callable[[PathStep], None] | None = None,
    *,
    spaces: DualSpaces | None = None,
    checkpoint: Path | str | None = None,
    newton_monitor: Monitor | None = None,
    observer: Callable[[DualResult], None] | None = None,
) -> PathResult:
    """Follow the path of solutions of (D_gamma) by Algorithm 7.2 from v = 0.

    Parameters
    ----------
    problem
        The data.
    options
        Start, growth, tolerances; None for those of Table 3.
    monitor
        Called with the record of each gamma; raising StopIteration stops.
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
    require_instance("spaces", spaces, DualSpaces, "DualSpaces(...)")
    watchers = {"monitor": monitor, "newton_monitor": newton_monitor, "observer": observer}
    for name, watcher in watchers.items():
        require_function(name, watcher, "what it is shown", optional=True)
    store = PathStore(checkpoint, problem, options, spaces)
    saved, walk = store.load(), _Walk(problem, options, spaces)
    if saved is not None:
        walk.resume(*saved)
    try:
        while (status := walk.status()) is None:
            walk.solve(newton_monitor)
            store.save(walk.steps, walk.last)
            logger.info("gamma %.4g: %s", walk.steps[-1].gamma, walk.steps[-1])
            if observer is not None:
                observer(walk.last)
            if monitor is not None:
                monitor(walk.steps[-1])
    except (StopIteration, KeyboardInterrupt):
        if walk.last is None:
            raise  # there is no state yet
        status = Status.STOPPED
    return PathResult(status, walk.message(status), tuple(walk.steps), walk.last)


class _Walk:
    """What a path has reached: steps, the last result, dual variable; one gamma at a time."""

    def __init__(self, problem: Problem, options: PathOptions, spaces: DualSpaces) -> None:
        self.options, length = options, spaces.units.length
        self.blocks = LinearBlocks(problem, spaces, options.newton.inverse)
        self.h, self.h_c = mesh_width(problem.mesh) / length, contact_mesh_width(problem) / length
        self.system: NewtonSystem | None = None
        self.steps: list[PathStep] = []
        self.last: DualResult | None = None
        self.v = self.blocks.H_vector()

    def functional(self, gamma: float) -> DualFunctional:
        """J*_gamma."""
        tichonov, units = self.blocks.choice.tichonov, self.blocks.choice.units
        regularisation = Coupled(gamma, tichonov=tichonov, units=units)
        return DualFunctional(self.blocks, regularisation, self.options.newton.quadrature_points)

    def resume(self, steps: list[PathStep], v: np.ndarray, history: History) -> None:
        """Go on from the steps, the dual variable and the last history of a checkpoint."""
        self.steps, functional = steps, self.functional(steps[-1].gamma)
        self.v.FV().NumPy()[:] = v
        self.last = DualResult.at(functional, self.v, steps[-1].status, history)

    def solve(self, monitor: Monitor | None) -> None:
        """The next problem (D_gamma_k), inexactly, from the last v."""
        newton, gamma = self.options.newton, self.options.gamma(len(self.steps))
        functional = self.functional(gamma)
        if self.system is None:
            self.system = NewtonSystem(functional, newton.inverse)
        self.system.use(functional)
        rule, search = self.inner_rule(gamma), newton.linesearch
        self.last = algorithm_7_1(self.system, self.v, rule, search, newton.max_iterations, monitor)
        self.v = self.last.v
        self.steps = [*self.steps, PathStep.after(self.steps, self.last)]

    def inner_rule(self, gamma: float) -> InnerRule:
        """The tolerances for a gamma, sharper once the safeguard has acted."""
        o, unit = self.options, self.blocks.residual_unit
        loose, guarded = o.inner_tolerance / math.sqrt(gamma), self.reductions(self.steps) > 0
        most = o.residual_tolerance / math.sqrt(2) if guarded else math.inf
        bounds = [min(o.inner_scale * max(h, loose), most) * unit for h in (self.h_c, self.h)]
        return InnerRule(o.newton.tolerance * unit, *bounds)

    def status(self) -> Status | None:
        """How the path has ended, None if it goes on."""
        if not self.steps:
            return None
        if self.steps[-1].status is not Status.CONVERGED:
            return self.steps[-1].status
        if self.has_ended(self.steps[-1]):
            return Status.CONVERGED
        limit = len(self.steps) >= self.options.max_outer_iterations
        return Status.ITERATION_LIMIT if limit else None

    def has_ended(self, last: PathStep) -> bool:
        """Step (iv) of Algorithm 7.2, with the safeguard."""
        o, tolerance = self.options, self.options.residual_tolerance
        if o.gamma_end is not None:
            return last.gamma >= o.gamma_end
        sharp = tolerance is None or last.residual_norm < tolerance * self.blocks.residual_unit
        return sharp and self.settled(last, self.reductions(self.steps[:-1]))

    def reductions(self, steps: list[PathStep]) -> int:
        """How often the safeguard has reduced tau_out in a path that has not ended."""
        number = 0
        if self.options.residual_tolerance is not None:
            for step in steps:
                number += self.settled(step, number)
        return number

    def settled(self, step: PathStep, reductions: int) -> bool:
        """Whether V_gamma has changed by less than the fraction tau_out h."""
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
            return f"{where}: {inner} A smaller growth than {self.options.growth:g} may help."
        change = "nothing to compare" if last.change is None else f"{last.change:.3g} of V_gamma"
        seen = f"{where}, the last change is {change}, the residual {last.residual_norm:.3g}."
        if status is Status.ITERATION_LIMIT:
            return f"{seen} Raise max_outer_iterations or outer_tolerance."
        return seen


def mesh_width(mesh: Mesh) -> float:
    """h, the smallest width of an element: of a triangle its smallest altitude (length).

    Other elements than triangles count as cubes, with width |T|^(1/N).
    """
    volumes = np.array(Integrate(1.0, mesh, VOL, element_wise=True))
    nodes = element_nodes(mesh)
    if mesh.dim != 2 or (nodes[:, 3] >= 0).any():
        return float(volumes.min() ** (1 / mesh.dim))
    x = vertex_coordinates(mesh)[nodes[:, :3]]
    longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    return float((2 * volumes / longest).min())


def contact_mesh_width(problem: Problem) -> float:
    """h_c, the largest |S|^(1/(N-1)) over the elements S of Gamma_c; 0 without contact (length)."""
    if not problem.contact_names:
        return 0.0
    mesh = problem.mesh
    region = mesh.Boundaries("|".join(problem.contact_names))
    measures = Integrate(1.0, mesh, BND, definedon=region, element_wise=True)
    return float(max(measures)) ** (1 / (mesh.dim - 1))
