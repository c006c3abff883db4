"""Load histories: the implicit Euler steps of section 2, which pass on p_0 and alpha_0.

Each step is a problem of the kind (2.14) with the plastic strain and the hardening variables that
the steps before left behind.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ngsolve import GridFunction

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_function, require_instance, require_path
from ngepc.checks.sentences import in_words
from ngepc.evolution.file import EvolutionFile
from ngepc.evolution.increments import Increments
from ngepc.evolution.load_path import Schedule, as_schedule
from ngepc.evolution.remarks import remarks
from ngepc.evolution.result import Evolution, EvolutionStep
from ngepc.evolution.run import Run, StepSolver
from ngepc.goals.adaptive import SMALLEST_ERROR
from ngepc.goals.refinement import Refinement
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.local.solver import RepeatedSolver
from ngepc.model.problem import Problem


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
    if accuracy is not None:
        require_number("accuracy", accuracy, 0, strict=True, below=1)
        check_alone("accuracy", accuracy, steps, error=error, checkpoint=checkpoint)
    run = Run(problem, schedule, solver, cuts, monitor, error, refinement)
    if accuracy is not None:
        beside_a_coarse_one(run, accuracy).advance(list(schedule.times))
    else:
        if path is not None:
            run.resume(EvolutionFile(path, problem, schedule, solver))
        run.advance()
    evolution = run.evolution
    evolution.message = evolution.message or remarks(evolution.steps, evolution.memory)
    return evolution


def beside_a_coarse_one(run: Run, accuracy: float) -> Increments:
    """A run that is compared with one of doubled steps, which has a solver of its own."""
    solver = run.solver
    if isinstance(solver, RepeatedSolver):
        solver = RepeatedSolver(solver.options)
    coarse = replace(run, solver=solver, monitor=None)
    begin = run.schedule.begin
    return Increments(run, coarse, begin, accuracy, run.cuts, run.monitor)


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
