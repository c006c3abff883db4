"""Several time steps: implicit Euler steps of section 2 one after the other, p_0, alpha_0 carried.

Each step is a problem of the kind (2.14) with the plastic strain and the hardening variables that
the steps before left behind.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ngsolve import GridFunction

from ngepc.bounds.adaptive import Refinement, next_mesh
from ngepc.bounds.bound import ErrorBound, error_bound
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.transfer import check_carried, on_mesh, parents
from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_function, require_instance, require_path
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.prolongation import nodal_values
from ngepc.dual.newton import semismooth_newton
from ngepc.evolution.file import EvolutionFile
from ngepc.evolution.load_path import Schedule, as_schedule, check_changes
from ngepc.evolution.memory import Memory, is_zero
from ngepc.evolution.result import Evolution, EvolutionStep, StepRecord
from ngepc.model.limits import require_without
from ngepc.model.problem import Problem
from ngepc.results.exact import DiscreteSolution
from ngepc.results.fields import Fields
from ngepc.results.outcome import Status
from ngepc.results.result import Result

log = logging.getLogger(__name__)

UNCUT = (Status.STOPPED, Status.MESH_LIMIT)
"""Ends of a step that a shorter one would not change."""


class StepSolver(Protocol):
    """What solves one step: ``semismooth_newton``, ``primal_newton``, or ``cold_start`` of one."""

    def __call__(self, problem: Problem, start: GridFunction | None) -> Result:
        """The solution, or how far it came."""


def cold_start(solver: Callable, **settings: object) -> StepSolver:
    """A step solver that calls ``solver(problem, **settings)`` and ignores the start.

    ``evolve(problem, steps, cold_start(semismooth_newton, gamma=1e4))`` runs the dual method.

    Raises
    ------
    TypeError
        If ``solver`` is no function.
    """
    require_function("solver", solver, "a problem and the settings")

    def solve(problem: Problem, start: GridFunction | None) -> object:
        return solver(problem, **settings)

    names = ", ".join(f"{key}={value!r}" for key, value in sorted(settings.items()))
    solve.__qualname__ = f"cold_start({getattr(solver, '__qualname__', solver)}, {names})"
    return solve


def evolve(
    problem: Problem,
    steps: Schedule | object,
    solver: StepSolver = semismooth_newton,
    *,
    cuts: int = 6,
    checkpoint: str | Path | None = None,
    monitor: Callable[[EvolutionStep], None] | None = None,
    error: float | None = None,
    refinement: Refinement | None = None,
) -> Evolution:
    """Run time steps one after the other, each with the p_0 and alpha_0 that the last one left.

    Parameters
    ----------
    problem
        The body, its supports and loads, and its state at the begin.
    steps
        A ``Schedule`` (``load_cycle`` makes one), or pairs (time, changes); the changes apply to
        ``problem``: (1.0, {'gap': 0.1}).
    solver
        Called as solver(problem, start=displacement of the last step); ``cold_start`` wraps
        solvers that take no displacement.
    cuts
        A step of a Schedule that fails is halved, up to so many times; 0 for never.
    checkpoint
        File that keeps the finished steps; a rerun of the same work continues from it.
    monitor
        Called with each finished step; raising StopIteration ends the run.
    error
        Refine the mesh in a step until ``ErrorBound.relative`` of the step, from the history that
        it starts with, is at most this; ``StepRecord.error_bound`` and ``.nodes`` say how it went.
        None for the mesh as it is.
    refinement
        How meshes follow the bound; None for ``Refinement()``.

    Returns
    -------
    Evolution
        The finished steps; ``status`` tells whether all were done.

    Raises
    ------
    TypeError, ValueError
        If an argument or the changes of a step are not legal, or the checkpoint is damaged or
        belongs to other work.
    OSError
        If the checkpoint cannot be written, before any work.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_function("solver", solver, "problem and start")
    require_function("monitor", monitor, "a step", optional=True)
    path = None if checkpoint is None else require_path("checkpoint", checkpoint)
    schedule, cuts = as_schedule(steps), require_integer("cuts", cuts, 0, 30)
    cuts = cuts if isinstance(steps, Schedule) else 0  # what holds in between is not known
    if error is not None:
        require_number("error", error, 0, strict=True)
        if path is not None:
            raise ValueError(f"checkpoint={checkpoint!r} with error={error:g}: leave one out")
    refinement = Refinement() if refinement is None else refinement
    require_instance("refinement", refinement, Refinement, "Refinement(...)")
    run = _Run(problem, schedule, solver, cuts, monitor, error, refinement)
    if path is not None:
        run.resume(EvolutionFile(path, problem, schedule, solver))
    run.advance()
    return run.evolution


@dataclass(eq=False)
class _Run:
    problem: Problem
    schedule: Schedule
    solver: StepSolver
    cuts: int
    monitor: Callable[[EvolutionStep], None] | None
    error: float | None
    refinement: Refinement
    file: EvolutionFile | None = None
    pending: list[tuple[float, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.evolution = Evolution(self.problem, [], Memory.initial(self.problem))
        for time in self.schedule.times:
            step = self._problem_at(time)
            if self.error is not None:
                check_covered(step)
                check_carried(step)
                if step.order == 2 and not is_zero(step.material.isotropic_hardening):
                    raise ValueError(
                        f"order={step.order}: error=... needs 1 with isotropic hardening, whose "
                        "variable may be negative where it is affine on cells"
                    )
                require_without(step, "error=...", "friction")
        self.pending = [(time, 0) for time in reversed(self.schedule.times)]

    def resume(self, file: EvolutionFile) -> None:
        """Take up the finished steps of a checkpoint, if there is one."""
        self.file, (steps, pending) = file, file.load()
        for stored in steps:
            functions = self.evolution.memory.functions
            self._append(file.step(self._problem_at(stored[0]["time"]), stored, functions))
        self.pending = pending if steps else self.pending

    def advance(self) -> None:
        """Solve the pending steps, cutting those that fail."""
        try:
            while self.pending:
                time, level = self.pending.pop()
                status, message = self._solve(time, level)
                where = f"In the step to time {time:g}: {message}"
                if status.is_success:
                    if status is not Status.CONVERGED:
                        self._end(status, where)
                elif status in UNCUT or level >= self.cuts:
                    self.pending.append((time, level))
                    return self._end(status, where)
                else:
                    begin = self._last.record.time if self._last else self.schedule.begin
                    middle = 0.5 * (begin + time)
                    log.info("step to time %g failed (%s): cut at %g", time, status.label, middle)
                    self.pending += [(time, level + 1), (middle, level + 1)]
        except (StopIteration, KeyboardInterrupt):
            self._end(Status.STOPPED, f"After {len(self.evolution.steps)} steps.")

    @property
    def _last(self) -> EvolutionStep | None:
        return self.evolution.steps[-1] if self.evolution.steps else None

    def _end(self, status: Status, message: str) -> None:
        self.evolution.status, self.evolution.message = status, message

    def _problem_at(self, time: float) -> Problem:
        changes = dict(check_changes(self.schedule.changes(time), time))
        rough = changes.get("friction", self.problem.friction) is not None
        if rough and self._last is not None:
            u_0 = nodal_values(self._last.fields.displacement, self.problem)
            changes["initial_displacement"] = Supports(self.problem).function(u_0)
        return self.evolution.memory.problem(self.problem, changes)

    def _solve(self, time: float, level: int) -> tuple[Status, str]:
        result, relative = self._solved(time, self._last and self._last.fields.displacement), None
        while result.status.is_success and self.error is not None:
            bound = error_bound(result)
            relative = bound.relative
            if relative <= self.error:
                break
            if message := self._refine(bound, time):
                return Status.MESH_LIMIT, message
            result = self._solved(time, result.displacement)
        if not result.status.is_success:
            return result.status, result.message
        functions = self.evolution.memory.functions
        increment = functions.function(functions.points.at(result.plastic_increment))
        fields = Fields(result.problem, result.displacement, increment)
        known = {"time": time, "cuts": level, "error_bound": relative}
        record = StepRecord.of(result, fields, functions.points, **known)
        rows = result.state.contact if isinstance(result, DiscreteSolution) else None
        self._append(EvolutionStep(fields, record, rows))
        if self.file is not None:
            self.file.save(self.evolution.steps, self.pending)
        if self.monitor is not None:
            self.monitor(self._last)
        return result.status, result.message

    def _solved(self, time: float, start: GridFunction | None) -> Result:
        """A step on the mesh as it is."""
        result = self.solver(self._problem_at(time), start=start)
        if not isinstance(result, Result):
            needed = "a function that returns a result like those of ngepc's solvers"
            raise TypeError(f"solver={self.solver!r} returned {result!r}: {needed} is needed")
        return result

    def _refine(self, bound: ErrorBound, time: float) -> str:
        """Go on with a finer mesh and the history on it; or why not."""
        old, most = bound.problem.mesh, self.refinement.max_nodes
        mesh = next_mesh(bound, self.error, self.refinement)
        share, asked = f"{bound.relative:.2g}", f"{self.error:g}"
        told = f"the energy error may be {share} on {old.nv} nodes, asked {asked}"
        if mesh.nv > most:
            return f"{told}; the next mesh has {mesh.nv} nodes, max_nodes={most}."
        log.info("step to time %g: %s, refined to %d nodes", time, told, mesh.nv)
        self.problem = on_mesh(self.problem, mesh)
        self.evolution.memory = self.evolution.memory.on(self.problem, parents(old, mesh))
        return ""

    def _append(self, step: EvolutionStep) -> None:
        memory, points = self.evolution.memory, self.evolution.memory.functions.points
        p = points.at(step.fields.plastic_increment)
        self.evolution.memory = memory.after(step.problem.material, p)
        self.evolution.steps.append(step)
