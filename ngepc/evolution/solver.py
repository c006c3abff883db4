"""Load histories: the implicit Euler steps of section 2, which pass on p_0 and alpha_0.

Each step is a problem of the kind (2.14) with the plastic strain and the hardening variables that
the steps before left behind.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.bounds.bound import error_bound
from ngepc.bounds.counterpart import problem_on_simplices
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.transfer import carried_function, check_carried, on_mesh
from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_function, require_instance, require_path
from ngepc.checks.sentences import counted, in_words
from ngepc.discretisation.loads import displacement_space
from ngepc.evolution.file import EvolutionFile
from ngepc.evolution.increments import Increments
from ngepc.evolution.kept import Store
from ngepc.evolution.load_path import Schedule, as_schedule
from ngepc.evolution.memory import Memory, check_kind
from ngepc.evolution.remarks import remarks
from ngepc.evolution.result import Evolution, EvolutionStep, StepRecord
from ngepc.goals.adaptive import SMALLEST_ERROR, Refinement, next_mesh
from ngepc.goals.brackets import COVERS
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.local.result import ExactResult
from ngepc.local.solver import RepeatedSolver
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

CONSTANT = ("anisotropic yield", "cyclic hardening")
"""Features whose bounds need a plastic strain that is constant on each element."""

IN_MEMORY = 2
"""The last steps, from which the next one starts: their arrays are in memory, not in a file."""

StepSolver = Callable[..., Result]
"""Called as solver(problem, start=a displacement or None).

The displacement is close to that of the step: the last one, or the line through the last two.
"""

LONGEST = 2.0
"""A step up to so many times as long as the last one starts from the line through two steps."""


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
        """Solve a step from zero, whatever the start."""
        return solver(problem, **settings)

    names = ", ".join(
        f"{key}={in_words(value)}" for key, value in sorted(settings.items())
    )
    solve.__qualname__ = (
        f"cold_start({getattr(solver, '__qualname__', solver)}, {names})"
    )
    return solve


@one_blas_thread
@crew()
def evolve(
    problem: Problem,
    steps: Schedule | object,
    solver: StepSolver | None = None,
    *,
    cuts: int = 6,
    checkpoint: str | Path | None = None,
    monitor: Callable[[EvolutionStep], None] | None = None,
    error: float | None = None,
    refinement: Refinement | None = None,
    accuracy: float | None = None,
) -> Evolution:
    """Run time steps one after the other, each with the p_0 and alpha_0 of the last one.

    Parameters
    ----------
    problem
        The body, its supports and loads, and its state at the beginning.
    steps
        A ``Schedule`` (``load_cycle`` makes one), or pairs (time, changes); the changes apply to
        ``problem``: (1.0, {'gap': 0.1}).  Pairs begin at time 0; ``Schedule.listed(pairs, begin)``
        begins at another one.
    solver
        Called as solver(problem, start=displacement), ``semismooth_newton`` or ``primal_newton``
        for example; ``cold_start`` wraps solvers that take no displacement.  The displacement is
        that of the last step, or the line through the last two of them at the new time.
        None for ``RepeatedSolver()``: the exact method, which reuses what does not change from
        step to step.
    cuts
        A step of a Schedule that fails is halved, up to so many times; 0 for never.
    checkpoint
        File that keeps the finished steps; a rerun of the same work continues from it.
    monitor
        Called with each finished step; raising StopIteration ends the run.
    error
        Refine the mesh in a step until ``ErrorBound.relative`` of the step, from the history that
        it starts with, is at most this; ``StepRecord.error_bound`` and ``.nodes`` say how it went.
        With order 2 the variable of isotropic hardening passes on to the next step as its mean over
        each element.  Quadrilaterals and hexahedra are cut into triangles and tetrahedra with
        displacements of order 2.  None for the mesh as it is.
    refinement
        Options of the refinement; None for ``Refinement()``.
    accuracy
        Choose the increments of a Schedule so that the time error of stress and contact force is
        about this, relative to their largest values, 0 < accuracy < 1.  The history is computed
        twice, with the steps and with half steps (at most ``cuts`` halvings).  The half steps are
        returned; the difference is their estimated error ``StepRecord.time_error``.  None for the
        steps as they are.

    Returns
    -------
    Evolution
        The finished steps; ``status`` says whether all steps were done.

    Raises
    ------
    TypeError, ValueError
        If an argument or the changes of a step are not legal, or the checkpoint is damaged or
        belongs to other work.
    OSError
        If the checkpoint cannot be written, before any work.
    """
    require_instance("problem", problem, Problem, "a Problem")
    solver = RepeatedSolver() if solver is None else solver
    require_function("solver", solver, "problem and start")
    require_function("monitor", monitor, "a step", optional=True)
    path = None if checkpoint is None else require_path("checkpoint", checkpoint)
    schedule = as_schedule(steps)
    cuts = require_integer("cuts", cuts, 0, 30)
    cuts = cuts if schedule.divisible else 0
    if error is not None:
        require_number("error", error, SMALLEST_ERROR, below=1)
        if path is not None:
            raise ValueError(
                f"checkpoint={checkpoint!r} with error={error:g}: leave one out"
            )
    refinement = Refinement() if refinement is None else refinement
    require_instance("refinement", refinement, Refinement, "Refinement(...)")
    run = _Run(problem, schedule, solver, cuts, monitor, error, refinement)
    if accuracy is not None:
        require_number("accuracy", accuracy, 0, strict=True, below=1)
        check_alone("accuracy", accuracy, steps, error=error, checkpoint=path)
        other = solver
        if isinstance(solver, RepeatedSolver):
            other = RepeatedSolver(solver.options)
        coarse = _Run(problem, schedule, other, cuts, None, None, refinement)
        pair = Increments(run, coarse, schedule.begin, accuracy, cuts, monitor)
        pair.advance(list(schedule.times))
    else:
        if path is not None:
            run.resume(EvolutionFile(path, problem, schedule, solver))
        run.advance()
    evolution = run.evolution
    evolution.message = evolution.message or remarks(evolution.steps, evolution.memory)
    return evolution


def check_alone(name: str, value: float, steps: object, **others: object) -> None:
    """Options that choose increments need a Schedule and exclude some others."""
    if not isinstance(steps, Schedule):
        raise ValueError(
            f"{name}={value:g}: a Schedule is needed, which gives the loads at all times"
        )
    for other, given in others.items():
        if given is not None:
            raise ValueError(
                f"{name}={value:g} with {other}={in_words(given)}: leave one out"
            )


def check_refined(step: Problem) -> None:
    """Refuse a step whose bound is not known, or not that of the next one."""
    check_carried(step)
    for feature in CONSTANT:
        if FEATURES[feature].found(step):
            covers = COVERS - {"order 2", "quadrilaterals", "hexahedra"}
            require_covered(step, f"error=... with {feature}", covers)


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
                if status is not Status.CONVERGED:
                    evolution.status = status
                    evolution.message = f"In the step to time {time:g}: {message}"
                if not status.is_success:
                    return
                if self.file is not None:
                    self.file.save(evolution.steps, self.pending)
                if self.monitor is not None:
                    self.problem.processes.show(self.monitor, evolution.steps[-1])
        except (StopIteration, KeyboardInterrupt) as error:
            self.problem.processes.check_stop(error)
            evolution.status = Status.STOPPED
            evolution.message = f"After {counted(len(evolution.steps), 'step')}."

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
        mesh, parents = next_mesh(bound, part, self.refinement)
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
