"""Adaptive refinement to a tolerance, by the guaranteed bound."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace

from ngepc.bounds.copies import with_matching
from ngepc.bounds.counterpart import check_on_simplices, problem_on_simplices
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.outcome import ErrorBound, thickened
from ngepc.bounds.rollers import in_components
from ngepc.bounds.thickness import is_of_thickness_one, with_other_thickness
from ngepc.bounds.transfer import carried_state, discrete_on, on_mesh
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_function, require_instance
from ngepc.checks.sentences import in_words
from ngepc.goals.ends import (
    about_zero,
    ending,
    lost_bound,
    too_fine,
    without_bound,
    without_stress,
)
from ngepc.goals.goal_bound import COVERS as GOALS
from ngepc.goals.goal_bound import INSTEAD
from ngepc.goals.goal_interval import GoalBound, half_in_percent, thick_goal
from ngepc.goals.goal_terms import check_goal
from ngepc.goals.kinds import as_goal
from ngepc.goals.one_mesh import LEFT, Tools, solved
from ngepc.goals.planning import Pace, planned_part, refined_mesh
from ngepc.goals.refinement import ENERGIES, BoundedResult, MeshRecord, Refinement
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.features import FEATURES, require_covered
from ngepc.model.problem import Problem
from ngepc.model.round import round_note

log = logging.getLogger(__name__)

Monitor = Callable[[MeshRecord], None]

Hopeless = Callable[[GoalBound | None, GoalBound | None], str]

SMALLEST_ERROR = 1e-12
"""Smaller relative errors of the energy are below rounding errors."""


@one_blas_thread
def solve_to(
    problem: Problem,
    relative_error: float | None = None,
    options: Refinement | None = None,
    monitor: Callable[[MeshRecord], None] | None = None,
    *,
    goal: object = None,
    percent: float | None = None,
) -> BoundedResult:
    """Solve to a guaranteed relative error of the energy, or of a force or displacement.

    Parameters
    ----------
    problem
        The data; refinement starts from a copy of its mesh, with quadrilaterals cut into triangles
        and then displacements of order two.
    relative_error
        Bound for ``ErrorBound.relative``, >= 1e-12 (rounding errors) and < 1; 0.01 by default.
    options
        Options of refinement.
    monitor
        Called with the record of each mesh; raising StopIteration ends the run.
    goal
        A goal of ``goal_bound``: meshes are refined by its indicators until half the width of its
        interval is at most ``percent`` percent of its middle.
    percent
        The percentage of a goal, > 0; 1 by default.

    Raises
    ------
    TypeError, ValueError
        For illegal arguments, and for problems that no bound covers.
    """
    require_instance("problem", problem, Problem, "a Problem")
    tolerance = tolerance_of(problem, relative_error, goal, percent)
    run = run_to(problem, tolerance, options, monitor, goal, about_zero)
    notes = filter(None, (run.message, round_note(problem)))
    return replace(run, message=" ".join(notes))


def run_to(
    problem: Problem,
    tolerance: float,
    options: Refinement | None,
    monitor: Monitor | None,
    goal: object,
    hopeless: Hopeless,
) -> BoundedResult:
    """``solve_to`` a tolerance; ``hopeless`` says of two intervals why none can reach it."""
    require_function("monitor", monitor, "a record", optional=True)
    options = Refinement() if options is None else options
    require_instance("options", options, Refinement, "Refinement(...)")
    problem = in_components(problem)
    check_on_simplices(problem)
    if goal is not None:
        check_goal(goal, problem)
    if not is_of_thickness_one(problem):
        return thick_run(problem, tolerance, options, monitor, goal, hopeless)
    return refined(problem, tolerance, options, monitor, goal, hopeless)


def refined(
    problem: Problem,
    tolerance: float,
    options: Refinement,
    monitor: Monitor | None,
    goal: object,
    hopeless: Hopeless,
) -> BoundedResult:
    """Solve on meshes that follow the indicators, until the relative error is small enough."""
    records: list[MeshRecord] = []
    state = first_state(problem)
    small = 0.0
    pace = Pace()
    interval: GoalBound | None = None
    finite: BoundedResult | None = None
    while True:
        result, bound, steps, tools = solved(state, small, options.max_iterations)
        before = interval
        if goal is not None:
            interval = interval_of(goal, bound, tools, before)
        here = BoundedResult(result, bound, tolerance, records, "", interval)
        records.append(mesh_record(here, steps, goal))
        message = ending(result, reported(records[-1], monitor))
        message = message or hopeless(before, interval) or without_bound(here)
        message = message or without_stress(here)
        if message or here.reached:
            return replace(here, message=message)
        if math.isfinite(bound.total):
            finite = here
        elif finite is not None:
            return replace(finite, message=lost_bound(here))

        estimate = bound if interval is None else interval
        old = result.problem.mesh
        error = proved_error(here)
        part = planned_part(tolerance / error, old.dim)
        pace = pace.after(error, part)
        part = part / pace.slowness
        mesh, parents = refined_mesh(
            result.problem, estimate.per_cell, part, options.marking
        )
        if mesh.nv > options.max_nodes:
            return replace(here, message=too_fine(mesh, bound, options))
        state = carried_state(result, discrete_on(result, mesh, parents), parents)
        small = LEFT * bound.total if math.isfinite(bound.total) else 0.0


def thick_run(
    problem: Problem,
    tolerance: float,
    options: Refinement,
    monitor: Monitor | None,
    goal: object,
    hopeless: Hopeless,
) -> BoundedResult:
    """The same for a body of another thickness than one, from that of thickness one."""
    t = problem.kinematics.thickness
    is_mean = goal is not None and as_goal(goal).form(problem).is_mean
    size = 1.0 if is_mean else t
    records: list[MeshRecord] = []

    def thick(record: MeshRecord) -> None:
        """Keep the record of the given thickness, and pass it on."""
        energies = {name: t * getattr(record, name) for name in ENERGIES}
        ends = {name: size * getattr(record, name) for name in ("lower", "upper")}
        records.append(replace(record, **energies, **ends))
        if monitor is not None:
            monitor(records[-1])

    thin = replace(problem, thickness=None)
    run = refined(thin, tolerance, options, thick, goal, hopeless)
    result = with_other_thickness(run.result, problem.thickness)
    interval = None if run.goal is None else thick_goal(run.goal, result.problem)
    bound = thickened(run.bound, result.problem)
    return replace(run, result=result, bound=bound, records=records, goal=interval)


def first_state(problem: Problem) -> State:
    """The state from which the first solve starts; meshes of two bodies are made to match."""
    problem = problem_on_simplices(problem)
    matching = with_matching(problem, None)
    if matching is not None:
        problem = on_mesh(problem, *matching)
    return starting_state(DiscreteProblem(problem), None)


def tolerance_of(
    problem: Problem, relative_error: float | None, goal: object, percent: float | None
) -> float:
    """The tolerance for the relative error: of the energy, or of the goal if there is one."""
    given = relative_error is not None
    relative_error = require_number(
        "relative_error", relative_error if given else 0.01, SMALLEST_ERROR, below=1
    )
    if goal is not None and given:
        raise ValueError(
            f"relative_error={relative_error:g}: that of the energy; of a goal it is percent"
        )
    if goal is None:
        if percent is not None:
            raise ValueError(
                f"percent={in_words(percent)}: a goal is needed with it; the error of the energy "
                "is relative_error"
            )
        return relative_error
    advice = "; solve_to(problem, relative_error) refines for the energy"
    require_covered(problem, "a goal", FEATURES.keys() - (BOUNDED - GOALS), advice)
    require_covered(problem, "a goal", GOALS, INSTEAD)
    percent = 1.0 if percent is None else percent
    return require_number("percent", percent, 0, strict=True) / 100


def interval_of(
    goal: object, bound: ErrorBound, tools: Tools, before: GoalBound | None
) -> GoalBound | None:
    """The interval of a goal; None where the error bound is infinite.

    ``before`` is the interval on the last mesh, if there is one.
    """
    if not math.isfinite(bound.total):
        return None
    near = None if before is None else before.factor
    return tools.goals(bound).bound_of(goal, near)


def mesh_record(here: BoundedResult, steps: int, goal: object) -> MeshRecord:
    """The record of a mesh that took this number of Newton steps, with the interval of a goal."""
    bound = here.bound
    interval = () if goal is None else (-math.inf, math.inf)
    if here.goal is not None:
        interval = here.goal.interval
    return MeshRecord(
        here.result.problem.mesh.nv,
        steps,
        bound.energy,
        bound.total,
        bound.algebraic,
        bound.relative,
        *interval,
    )


def proved_error(here: BoundedResult) -> float:
    """The relative error that the next mesh is planned by: of a goal, as the proof has it."""
    if here.goal is None:
        return here.relative_error
    return half_in_percent(*here.goal.proved) / 100


def reported(record: MeshRecord, monitor: Callable[[MeshRecord], None] | None) -> str:
    """Log a record and pass it to the monitor; the reason to stop, empty if there is none."""
    log.info("nodes:%(nodes)6d energy:%(energy).8e bound:%(total).2e", vars(record))
    if monitor is not None:
        try:
            monitor(record)
        except StopIteration:
            return "The monitor ended the run."
    return ""
