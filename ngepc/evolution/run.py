"""The run of a load history, step after step: what a step starts from, and what it leaves."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve import GridFunction

from ngepc.bounds.bound import error_bound
from ngepc.bounds.counterpart import check_on_simplices, problem_on_simplices
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.transfer import carried_function, on_mesh
from ngepc.checks.sentences import counted, in_words
from ngepc.discretisation.spaces import displacement_space
from ngepc.evolution.file import EvolutionFile
from ngepc.evolution.kept import Store
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.memory import Memory, check_kind
from ngepc.evolution.result import Evolution, EvolutionStep, StepRecord
from ngepc.goals.adaptive import Refinement
from ngepc.goals.brackets import COVERS
from ngepc.goals.planning import next_mesh
from ngepc.local.result import ExactResult
from ngepc.model.elements import has_more_corners
from ngepc.model.features import FEATURES, require_covered
from ngepc.model.own import OwnCopies
from ngepc.model.problem import Problem
from ngepc.results.fields import Fields
from ngepc.results.outcome import Status
from ngepc.results.result import DiscreteSolution, Result
from ngepc.results.stored import array_of, stored_record

log = logging.getLogger(__name__)

UNCUT = (Status.STOPPED, Status.MESH_LIMIT)
"""Statuses that a shorter step would not change."""

CONSTANT = ("anisotropic yield", "cyclic hardening", "axisymmetric")
"""Features whose bounds need a plastic strain that is constant on each element."""

IN_MEMORY = 2
"""The last steps, from which the next one starts: their arrays are in memory, not in a file."""

StepSolver = Callable[..., Result]
"""Called as solver(problem, start=a displacement or None).

The displacement is close to that of the step: the last one, or the line through the last two.
"""

LONGEST = 2.0
"""A step up to so many times as long as the last one starts from the line through two steps."""


def check_refined(step: Problem) -> None:
    """Refuse a step whose bound is not known, or not that of the next one."""
    check_on_simplices(step)
    for feature in CONSTANT:
        if FEATURES[feature].found(step):
            covers = COVERS - {"order 2", "quadrilaterals", "hexahedra"} | {feature}
            require_covered(step, f"error=... with {feature}", covers)


def say_ending(evolution: Evolution, time: float, status: Status, message: str) -> None:
    """Keep how the step to a time ended, unless it converged."""
    if status is not Status.CONVERGED:
        evolution.status = status
        evolution.message = f"In the step to time {time:g}: {message}"


def stop(evolution: Evolution, error: BaseException) -> None:
    """End a history where a monitor or the user has stopped it."""
    evolution.problem.processes.check_stop(error)
    evolution.status = Status.STOPPED
    evolution.message = f"After {counted(len(evolution.steps), 'step')}."


@dataclass(eq=False)
class Run:
    """The steps of a history that are done, and those that are pending.

    A step that fails is halved, ``cuts`` times at most.  With ``error`` the mesh is refined in each
    step; ``file`` keeps the finished ones.
    """

    problem: Problem
    schedule: Schedule
    solver: StepSolver
    cuts: int
    monitor: Callable[[EvolutionStep], None] | None
    error: float | None
    refinement: Refinement
    file: EvolutionFile | None = None
    start: GridFunction | None = None  # the displacement of the last step

    def __post_init__(self) -> None:
        if self.error is not None and has_more_corners(self.problem.mesh):
            check_refined(self.problem)
            self.problem = problem_on_simplices(self.problem)
        self.evolution = Evolution(self.problem, [], Memory.initial(self.problem))
        self._checked: dict[float, tuple[Problem, dict, Problem]] = {}
        self._store = Store()
        self._before: dict[int, Memory] = {}  # histories before the last steps
        for time in self.schedule.times:
            step = self._checked_step(time)
            if self.error is not None:
                check_refined(step)
        # (end, halvings)
        self.pending = [(time, 0) for time in reversed(self.schedule.times)]

    def resume(self, file: EvolutionFile) -> None:
        """Read the finished steps of a checkpoint, if there is one."""
        self.file = file
        own = OwnCopies()
        steps, pending = file.load()
        for row, arrays in steps:
            digest = row.pop("fingerprint")
            record = stored_record(file.path, StepRecord, row)
            problem = own.of(self._problem_at(record.time))
            functions = self.evolution.memory.functions
            file.check(problem, record.time, digest)
            u = GridFunction(displacement_space(problem), name="displacement")
            p = functions.function(
                np.zeros((len(functions.points), problem.kinematics.d))
            )
            for function, name in ((u, "u"), (p, "p")):
                values = function.vec.FV().NumPy()
                values[:] = array_of(file.path, arrays, name, len(values))
            fields = Fields(problem, u, p)
            self._append(EvolutionStep(fields, record, arrays["contact"]))
        self.pending = pending if steps else self.pending

    @property
    def state(self) -> tuple:
        """The state from which the next step starts, for ``restore``."""
        return len(self.evolution.steps), self.evolution.memory, self.start

    def restore(self, state: tuple) -> None:
        """Go back to an earlier ``state``."""
        count, self.evolution.memory, self.start = state
        del self.evolution.steps[count:]

    def advance(self) -> None:
        """Solve the pending steps, cutting those that fail."""
        evolution = self.evolution
        try:
            while self.pending:
                time, level = self.pending.pop()
                status, message = self.solve_step(time, level)
                if not status.is_success and status not in UNCUT and level < self.cuts:
                    middle = 0.5 * (self._now + time)
                    log.info(
                        "step to time %g failed (%s): cut at %g",
                        time,
                        status.label,
                        middle,
                    )
                    self.pending += [(time, level + 1), (middle, level + 1)]
                    continue
                say_ending(evolution, time, status, message)
                if not status.is_success:
                    return
                if self.file is not None:
                    self.file.save(evolution.steps, self.pending)
                if self.monitor is not None:
                    self.problem.processes.show(self.monitor, evolution.steps[-1])
        except (StopIteration, KeyboardInterrupt) as error:
            stop(evolution, error)

    @property
    def _now(self) -> float | None:
        """The time that has been reached, None if it is unknown."""
        times = self.evolution.times
        return times[-1] if times else self.schedule.begin

    def _checked_step(self, time: float) -> Problem:
        """A step before any is solved: its data are legal, and its material follows the history."""
        step = self._stated(time, self._duration(time))
        self.evolution.memory.with_material(step.material)
        if step.friction is not None:
            self.schedule.dragged(self._now, time, step.N)
        return step

    def _duration(self, time: float) -> float | None:
        """The length of a step to a time, None if it is unknown."""
        now = self._now
        return None if now is None else time - now

    def _problem_at(self, time: float) -> Problem:
        now = self._now
        left: dict[str, object] = {"duration": self._duration(time)}
        step = self._stated(time, left["duration"])
        if step.friction is not None:
            left["initial_displacement"] = self._start_of_slip(now, time)
        return self.evolution.memory.before(step, **left)

    def _stated(self, time: float, duration: float | None) -> Problem:
        """The problem with the changes of a step, and any history.

        It is checked once if the changes are the same objects when the step is solved.
        """
        changes = dict(self.schedule.at(time))
        base, before, step = self._checked.get(time, (None, {}, self.problem))
        known = base is self.problem and changes.keys() == before.keys()
        if not known or any(changes[name] is not before[name] for name in changes):
            step = self.problem.changed(**changes, duration=duration)
            check_kind(self.problem.material, step.material)
            self._checked[time] = self.problem, changes, step
        return step

    def _start_of_slip(self, before: float | None, time: float) -> object:
        """The displacement at which nothing has slipped in the step; None for zero.

        That of the last step, with what the surface of the obstacles moves since then.
        """
        problem = self.problem
        dragged = self.schedule.dragged(before, time, problem.N)
        start = self.start
        if dragged is None:
            return problem.initial_displacement if start is None else start
        here = isinstance(start, GridFunction) and start.space.mesh is problem.mesh
        space = start.space if here else displacement_space(problem)
        moved = GridFunction(space, name="start_of_slip")
        moved.Set(dragged)
        if start is None and problem.u_0 is not None:
            start = GridFunction(moved.space)
            start.Set(problem.u_0)
        if start is not None:
            moved.vec.data += start.vec
        return moved

    def solve_step(self, time: float, level: int) -> tuple[Status, str]:
        """One step, on meshes that follow its bound; how it ended."""
        start = self._predicted(time)
        relative = None
        proved = None
        while True:
            result = self._solved(time, start)
            if not result.status.is_success:
                return result.status, result.message
            if self.error is None:
                break
            bound = error_bound(result)
            start = result.displacement
            relative = bound.relative
            proved = bound.guaranteed
            if relative <= self.error:
                break
            if message := self._refine(bound, time):
                return Status.MESH_LIMIT, message
        functions = self.evolution.memory.functions
        if isinstance(result, ExactResult):
            functions.points.misses_like(result.discrete.points)
        increment = functions.function(functions.points.at(result.plastic_increment))
        fields = Fields(result.problem, result.displacement, increment)
        known = {"time": time, "cuts": level, "error_bound": relative}
        known["guaranteed"] = proved
        record = StepRecord.of(result, fields, self.evolution.memory, **known)
        rows = result.state.contact if isinstance(result, DiscreteSolution) else None
        self._append(EvolutionStep(fields, record, rows))
        if result.status is Status.CONVERGED:  # ``remarks`` at the end are of all steps
            return result.status, ""
        return result.status, result.message

    def _solved(self, time: float, start: GridFunction | None) -> Result:
        """The result of a step from a start; from the last displacement if that fails."""
        problem = self._problem_at(time)
        for first in (start, self.start):
            result = self.solver(problem, start=first)
            if not isinstance(result, Result):
                raise TypeError(
                    f"solver={in_words(self.solver)} returned {result!r}: a function "
                    "that returns a "
                    "result like those of ngepc's solvers is needed"
                )
            done = result.status.is_success or result.status in UNCUT
            if done or first is self.start:
                break
        return result

    def _predicted(self, time: float) -> GridFunction | None:
        """Where a step starts: the line through the last two displacements, or the last one."""
        steps = self.evolution.steps[-2:]
        if len(steps) < 2:
            return self.start
        before, last = (step.fields.displacement for step in steps)
        times = self.evolution.times
        ratio = (time - times[-1]) / (times[-1] - times[-2])
        if before.space.mesh is not last.space.mesh or not 0 < ratio <= LONGEST:
            return self.start
        start = GridFunction(last.space, name="start")
        start.vec.data = (1 + ratio) * last.vec - ratio * before.vec
        return start

    def _refine(self, bound: ErrorBound, time: float) -> str:
        """Continue on a finer mesh; a message if that is not possible."""
        old = bound.problem.mesh
        most = self.refinement.max_nodes
        part = self.error / bound.relative
        mesh, parents = next_mesh(bound, part, self.refinement.marking)
        share = f"{bound.relative:.2g}"
        asked = f"{self.error:g}"
        reason = (
            f"the bound of the energy error is {share} on {old.nv} nodes, error={asked}"
        )
        if mesh.nv > most:
            return f"{reason}; the next mesh has {mesh.nv} nodes, max_nodes={most}."
        log.info("step to time %g: %s, refined to %d nodes", time, reason, mesh.nv)
        if self.start is not None:
            self.start = carried_function(self.start, self.problem, mesh, parents)
        self.problem = on_mesh(self.problem, mesh, parents)
        self.evolution.memory = self.evolution.memory.on(self.problem, parents)
        return ""

    def _append(self, step: EvolutionStep) -> None:
        before = self.evolution.memory
        memory = before.after_step(step.problem, step.fields)
        if self.error is not None:
            memory = memory.as_bounds_need_it()
        self.evolution.memory = memory
        self.evolution.steps.append(step)
        self.start = step.fields.displacement
        number = len(self.evolution.steps) - 1
        self._before[number] = before
        old = number - IN_MEMORY
        if old in self._before:
            self.evolution.steps[old].put_away(self._store, self._before.pop(old))
