"""Algorithm 7.2: inexact path-following in gamma.

The paper does not define the mesh width h that its tolerances refer to.  Here it is the width in
the geometric sense, the distance between the two closest parallel planes with an element between
them, of the narrowest element.  With it the outer iterations of Table 3 come out as printed; with
the longest edge, more than twice that on the same meshes, paths end earlier (docs/reading.md).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from ngsolve import BND, VOL, Integrate, Mesh

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared, Fraction, Positive
from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.algorithm import NewtonSystem, algorithm_7_1
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.dual.path_steps import PathResult, PathStep, PathStore
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import DualSpaces
from ngepc.dual.stopping import Tolerances
from ngepc.linalg.blas import one_blas_thread
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.model.own import own_copy
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import Monitor, Status

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PathOptions(Declared):
    """Options of Algorithm 7.2; the defaults are those of Table 3.

    Parameters
    ----------
    gamma_start, growth
        gamma_0 > 0 and theta > 1: gamma_k = gamma_0 theta^k.
    inner_tolerance
        tau_in > 0: problem k is solved until ||Psi_z|| < c max(h_c, tau_in / sqrt(gamma_k)) and
        ||Psi_q|| < c max(h, tau_in / sqrt(gamma_k)), after one Newton step at least.
    inner_scale
        c > 0.  With c = 1 as printed the start v = 0 of Example (b) passes; 0.1 is the plastic
        residual there (docs/reading.md).
    outer_tolerance
        tau_out > 0: the path ends when V_gamma changes by less than the fraction tau_out h.
    gamma_end
        Follow the path up to this gamma instead, whatever V_gamma does.
    residual_tolerance, reduction
        The safeguard of section 7: a path that ends with ||Psi_gamma|| above the tolerance goes
        on with tau_out times ``reduction`` in (0, 1).  From there on the inner tolerances are
        at most this one; alone they stay above c h, however far the path is followed.  None for
        no such check.
    max_outer_iterations
        Largest number of values of gamma.
    newton
        Limits, quadrature, line search and direct solver of Algorithm 7.1.  Its tolerance is the
        residual that counts as zero: it ends a problem without a step.

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    gamma_start: Positive = 10.0
    growth: Annotated[float, Check(require_number, least=1, strict=True)] = 7.0
    inner_tolerance: Positive = 10.0
    inner_scale: Positive = 0.1
    outer_tolerance: Positive = 0.7
    gamma_end: Positive | None = None
    residual_tolerance: Positive | None = None
    reduction: Fraction = 0.5
    max_outer_iterations: Count = 30
    newton: NewtonOptions = field(
        default_factory=partial(NewtonOptions, max_iterations=1000)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma_end is not None:
            require_number("gamma_end", self.gamma_end, self.gamma_start)
            if self.residual_tolerance is not None:
                raise ValueError(
                    "gamma_end and residual_tolerance: give one of them, not both"
                )
        require_instance("newton", self.newton, NewtonOptions, "NewtonOptions(...)")


@one_blas_thread
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
        The Tichonov choice and the units of the whole path; None for (R2).
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
    watchers = ("monitor", monitor), ("newton_monitor", newton_monitor)
    for name, watcher in (*watchers, ("observer", observer)):
        require_function(name, watcher, "what it is shown", optional=True)
    store = PathStore(checkpoint, problem, spaces, options)
    newton = options.newton
    blocks = LinearBlocks(own_copy(problem), spaces, newton.direct_solver)
    rules = Rules(options, blocks)
    system = NewtonSystem(blocks, newton.direct_solver)
    functional = partial(DualFunctional, blocks, newton.quadrature_points)
    limits = newton.linesearch, newton.max_iterations, newton_monitor
    steps, kept = store.load()
    last = store.restored(functional(steps[-1].gamma), kept) if steps else None
    try:
        while (status := rules.status(steps)) is None:
            gamma, aim = rules.next(steps)
            v = blocks.H_vector() if last is None else last.v
            last = algorithm_7_1(system, functional(gamma), v, aim, *limits)
            steps.append(PathStep.after(steps, last))
            store.save(steps, last)
            logger.info("gamma %.4g: %s", gamma, steps[-1])
            if observer is not None:
                observer(last)
            if monitor is not None:
                monitor(steps[-1])
    except (StopIteration, KeyboardInterrupt):
        if last is None:
            raise  # there is no state yet
        status = Status.STOPPED
    return PathResult(status, rules.message(status, steps, last), tuple(steps), last)


class Rules:
    """The tolerances of a path, which depend on the mesh widths, and its termination."""

    def __init__(self, options: PathOptions, blocks: LinearBlocks) -> None:
        length = blocks.choice.units.length
        self.options = options
        self.unit = blocks.residual_unit
        self.h = mesh_width(blocks.problem.mesh) / length
        self.h_c = contact_mesh_width(blocks.problem) / length

    def settled(self, steps: Sequence[PathStep]) -> tuple[int, bool]:
        """How often V_gamma has changed by less than tau_out h (relative), and whether it just did.

        The safeguard reduces tau_out each time.
        """
        times = 0
        now = False
        for step in steps:
            tau = self.options.outer_tolerance * self.options.reduction**times
            now = step.change is not None and step.change < tau * self.h
            times += now
        return times, now

    def next(self, steps: Sequence[PathStep]) -> tuple[float, Tolerances]:
        """The next gamma and its inner tolerances, sharper once the safeguard has acted."""
        o = self.options
        unit = self.unit
        gamma = o.gamma_start * o.growth ** len(steps)
        gamma = gamma if o.gamma_end is None else min(gamma, o.gamma_end)
        guarded = o.residual_tolerance is not None and self.settled(steps)[0] > 0
        most = o.residual_tolerance / math.sqrt(2) if guarded else math.inf
        loose = o.inner_tolerance / math.sqrt(gamma)
        bounds = (
            min(o.inner_scale * max(h, loose), most) * unit for h in (self.h_c, self.h)
        )
        return gamma, Tolerances(o.newton.tolerance * unit, tuple(bounds))

    def status(self, steps: Sequence[PathStep]) -> Status | None:
        """How the path has ended, None if it goes on: step (iv), with the safeguard."""
        if not steps:
            return None
        o = self.options
        last = steps[-1]
        if last.status is not Status.CONVERGED:
            return last.status
        tolerance = o.residual_tolerance
        sharp = tolerance is None or last.residual_norm < tolerance * self.unit
        there = sharp and self.settled(steps)[1]
        if last.gamma >= o.gamma_end if o.gamma_end is not None else there:
            return Status.CONVERGED
        return Status.ITERATION_LIMIT if len(steps) >= o.max_outer_iterations else None

    def message(
        self, status: Status, steps: Sequence[PathStep], result: DualResult
    ) -> str:
        """A message for a path that did not converge: what happened, and what to try."""
        if status is Status.CONVERGED or not steps:
            return result.message
        last = steps[-1]
        growth = self.options.growth
        where = f"At gamma = {last.gamma:.3g}, value {len(steps)} of the path"
        if last.status is not Status.CONVERGED:
            return (
                f"{where}: {result.message} A smaller growth than {growth:g} may help."
            )
        change = (
            "nothing to compare"
            if last.change is None
            else f"{last.change:.3g} of V_gamma"
        )
        seen = f"{where}, the last change is {change}, the residual {last.residual_norm:.3g}."
        advice = " Raise max_outer_iterations or outer_tolerance."
        return seen + advice * (status is Status.ITERATION_LIMIT)


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
    region = problem.mesh.Boundaries("|".join(problem.contact_names))
    measures = Integrate(1.0, problem.mesh, BND, definedon=region, element_wise=True)
    return float(max(measures)) ** (1 / (problem.N - 1))
