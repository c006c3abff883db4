"""Algorithm 7.1: the globalised semismooth Newton method for one regularised dual problem."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.distributed import check_supported
from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.carried import carried_over
from ngepc.dual.contact_newton import newton_system
from ngepc.dual.diagnosis import RecentDuals, describe
from ngepc.dual.functional import DualFunctional, FactorisationError, NewtonSystem
from ngepc.dual.iterates import Iterate, Line
from ngepc.dual.regularisation import Coupled, Regularisation, require_regularisation
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import ResidualBelow, StoppingRule, judge
from ngepc.krylov.iterative import KrylovError
from ngepc.linalg.direct import LinearSolver, require_linear_solver
from ngepc.linalg.linesearch import ROUNDING, ByRegularisation, Descent, FullSteps, LineSearch
from ngepc.local.solver import solve_exactly
from ngepc.model.problem import Problem
from ngepc.primal.solver import nodal_values
from ngepc.results.outcome import History, IterationRecord, Status

logger = logging.getLogger(__name__)

Monitor = Callable[[IterationRecord], None]

ROUNDING_STEPS = 8

TRUE_RESIDUAL = (Status.ITERATION_LIMIT, Status.LINESEARCH_FAILED, Status.STAGNATED)
"""Statuses whose message quotes the residual computed afresh."""


@dataclass(frozen=True, kw_only=True)
class NewtonOptions:
    """How Algorithm 7.1 is run.

    Parameters
    ----------
    tolerance
        Bound for ||Psi_gamma||_{H*}, in the regularisation's reference units; 1e-10 in the paper.
    max_iterations
        Most Newton steps.
    quadrature_points
        Points for the nonsmooth terms on each element that a kink crosses; 400 in the paper.
    linesearch
        ``Armijo()``, ``NearMinimum()`` or None for full steps; by default the regularisation's
        own choice, Armijo for ``Coupled``.
    inverse
        What solves the linear systems: NGSolve's name of a direct solver that does LDL^T, or, for
        large bodies without gamma, ``PETSc()`` (``Krylov()`` with gamma).

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    tolerance: float = 1e-10
    max_iterations: int = 300
    quadrature_points: int = 400
    linesearch: LineSearch | ByRegularisation | None = field(default_factory=ByRegularisation)
    inverse: str | LinearSolver = "sparsecholesky"

    def __post_init__(self) -> None:
        require_number("tolerance", self.tolerance, 1e-16)
        require_integer("max_iterations", self.max_iterations, 1)
        require_integer("quadrature_points", self.quadrature_points, 1, 900)
        require_linear_solver("inverse", self.inverse)
        legal = self.linesearch is None or isinstance(self.linesearch, ByRegularisation)
        if not legal and not hasattr(self.linesearch, "search"):
            raise TypeError(f"linesearch={self.linesearch!r}: Armijo(...) or None is needed")


def checked_options(options: NewtonOptions | None) -> NewtonOptions:
    """The options, the defaults for None; TypeError for anything else."""
    options = NewtonOptions() if options is None else options
    require_instance("options", options, NewtonOptions, "NewtonOptions(...)")
    return options


def semismooth_newton(
    problem: Problem,
    gamma: float | None = None,
    start: DualResult | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: Regularisation | None = None,
) -> DualResult:
    """Solve (D_gamma) by Algorithm 7.1.

    Parameters
    ----------
    problem
        The data.
    gamma
        Short for ``regularisation=Coupled(gamma)``.
    start
        A result on this or another mesh of the body, carried over by P1 interpolation; None
        starts from v = 0.
    options
        Tolerance, limits, quadrature, line search; None for the defaults.
    monitor
        Called with the record of each iterate, start included; raising StopIteration stops.
    regularisation
        The regularisation; give this or ``gamma``.  With neither it is ``Balanced()``.

    Returns
    -------
    DualResult
        Status, history and fields; the state reached is always there.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("problem", problem, Problem, "a Problem")
    options = checked_options(options)
    require_function("monitor", monitor, "a record", optional=True)
    if gamma is not None and regularisation is not None:
        raise ValueError(f"gamma={gamma!r}: give either gamma or regularisation")
    if regularisation is None and gamma is None:
        tolerance, limit = options.tolerance, options.max_iterations
        return solve_exactly(problem, start, tolerance, limit, options.inverse, monitor)
    if regularisation is None:
        regularisation = Coupled(gamma)
    require_regularisation(regularisation)
    if hasattr(options.inverse, "tangent"):
        raise ValueError(f"inverse={options.inverse!r}: a direct solver is needed with gamma")
    if start is not None and not isinstance(start, DualResult):
        raise TypeError(f"start={start!r}: a result of semismooth_newton or None is needed")
    check_supported(problem, regularisation, options.inverse, start)
    blocks = LinearBlocks(problem, regularisation, options.inverse)
    functional = DualFunctional(blocks, regularisation, options.quadrature_points)
    v = start_vector(functional, start, options)
    system = newton_system(functional, options.inverse)
    return run(functional, system, v, options, monitor)


def start_vector(
    functional: DualFunctional, start: DualResult | None, options: NewtonOptions
) -> BaseVector:
    """v = 0, or an earlier result carried over, with the predictor's help from another mesh."""
    if start is None:
        return functional.blocks.H_vector()
    problem, predictor = functional.blocks.problem, functional.regularisation.predictor
    v = carried_over(start, functional)
    if start.problem.mesh is problem.mesh or predictor is None:
        return v
    return predictor.start(functional, v, nodal_values(start, problem), options.inverse)


def run(
    functional: DualFunctional,
    system: NewtonSystem,
    v: BaseVector,
    options: NewtonOptions,
    monitor: Monitor | None = None,
    rule: StoppingRule | None = None,
) -> DualResult:
    """The loop of Algorithm 7.1 from v, with a Newton system that may have been used before.

    It ends by ``rule``, or by ``options.tolerance`` when that is None.
    """
    rule = ResidualBelow(options.tolerance * functional.residual_unit) if rule is None else rule
    functional.make_feasible(v)
    history, here, recent = History(), Iterate.at(functional, v), RecentDuals(functional)
    before, status, drowned, cause = here, None, 0, ""
    try:
        while status is None:
            record = here.record(functional, len(history.records))
            history.append(record)
            recent.append(here.v)
            log(record)
            if monitor is not None:
                monitor(watched(record, functional, here, history))
            found = judge(functional, system, here, before, record, rule)
            here, status, cause = found.iterate, found.status, found.cause
            if status is None and record.iteration == options.max_iterations:
                status = Status.ITERATION_LIMIT
            elif status is None and drowned >= ROUNDING_STEPS:
                status = Status.STAGNATED
            elif status is None:
                following = newton_step(functional, system, here, options)
                if isinstance(following, Status):
                    status = following
                else:
                    unmoved = abs(following.energy - here.energy) <= ROUNDING * here.magnitude
                    drowned = drowned + 1 if unmoved else 0
                    before, here = here, following
    except (StopIteration, KeyboardInterrupt):
        status = Status.STOPPED
    except FactorisationError as error:
        status, cause = Status.NONFINITE, f"{error}."
    except KrylovError as error:
        status, cause = Status.LINEAR_SOLVER_FAILED, f"{error}."
    last = history.records[-1] if history.records else None
    if status in TRUE_RESIDUAL:
        here.refresh(functional)
        last = here.record(functional, last.iteration)
    message = describe(status, history, last, rule, recent, cause)
    return DualResult(functional, here.y, here.v, status, message, history)


def watched(
    record: IterationRecord, functional: DualFunctional, here: Iterate, history: History
) -> IterationRecord:
    """The record as monitors get it, with the result of a run that had stopped here."""

    def snapshot() -> DualResult:
        seen = History(history.records[: record.iteration + 1])
        return DualResult(functional, here.y, here.v, Status.STOPPED, "", seen)

    return replace(record, snapshot=snapshot)


def log(record: IterationRecord) -> None:
    """One line for each iterate."""
    logger.info(
        "it:%4d residual:%.3e energy:%.12e step:%.4g",
        *(record.iteration, record.residual_norm, record.energy, record.step_length),
    )


def newton_step(
    functional: DualFunctional, system: NewtonSystem, here: Iterate, options: NewtonOptions
) -> Iterate | Status:
    """Steps (a) to (c) of Algorithm 7.1: solve (7.1), choose the step length, update.

    Raises
    ------
    FactorisationError
        If the direct solver gives up.
    """
    dy, dv = system.step(here.v, here.residual)
    slope = InnerProduct(here.residual, dv)
    if not math.isfinite(slope):
        return Status.NONFINITE
    if slope >= 0:
        return Status.STAGNATED if slope <= ROUNDING * here.magnitude else Status.LINESEARCH_FAILED
    line = Line(functional, here, dy, dv)
    phi = Descent(
        energy=line.energy,
        derivative=line.derivative,
        energy_0=here.energy,
        slope_0=slope,
        magnitude=here.magnitude,
        longest=functional.longest_step(here.v, dv),
    )
    step = line_search(functional, options).search(phi)
    if step is None:
        sane = math.isfinite(line.derivative(0.0) + functional.penalty(here.v))
        return Status.LINESEARCH_FAILED if sane else Status.NONFINITE
    step = replace(
        step,
        back_substitutions=system.back_substitutions,
        linear_iterations=system.linear_iterations,
    )
    following = line.iterate(step)
    predictor = functional.regularisation.predictor
    if predictor is None:
        return following
    return predictor.improved(functional, line, following, options.inverse)


def line_search(functional: DualFunctional, options: NewtonOptions) -> LineSearch:
    """The step length rule that the options ask for."""
    if options.linesearch is None:
        return FullSteps()
    if isinstance(options.linesearch, ByRegularisation):
        return functional.regularisation.linesearch
    return options.linesearch
