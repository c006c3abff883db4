"""Algorithm 7.1: the globalised semismooth Newton method for one regularised dual problem."""

from __future__ import annotations

import math

from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.dual.iterates import DualLine, Iterate
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import End, ResidualBelow, RunLog, final_check
from ngepc.dual.system import NewtonSystem
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.linesearch import ROUNDING, FullSteps, LineSearch, Step
from ngepc.results.outcome import Monitor, Status

ROUNDING_STEPS = 8
"""Steps in a row that change the energy by no more than rounding end a run."""


def algorithm_7_1(
    system: NewtonSystem,
    v: BaseVector,
    rule: ResidualBelow,
    search: LineSearch | None,
    max_iterations: int,
    monitor: Monitor | None = None,
) -> DualResult:
    """The loop of Algorithm 7.1 from v until ``rule`` is met or something stops it.

    The Newton system may have been used before; without a line search all steps are full ones.
    """
    log, search = RunLog(rule, monitor), FullSteps() if search is None else search
    here = before = Iterate.at(system.functional, v)
    try:
        while True:
            log.note(here)
            here = tested(system, here, before, log, max_iterations)
            system.factorise(here.terms)
            dy, dv = system.solve((-here.residual).Evaluate())  # (a) the Newton system (7.1)
            line = DualLine(here, dy, dv)
            step = step_along(line, search)  # (b) Armijo's rule for J*_gamma
            before, here = here, line.iterate(step)  # (c) the update of y and v
    except End as end:
        return log.result(end.here, end.status, end.cause)
    except (StopIteration, KeyboardInterrupt):
        return log.result(here, Status.STOPPED)
    except FactorisationError as error:
        return log.result(here, Status.NONFINITE, f"{error}.")


def tested(
    system: NewtonSystem, here: Iterate, before: Iterate, log: RunLog, max_iterations: int
) -> Iterate:
    """The iterate to go on from, test by test; ``End`` if the iteration is over."""
    if not math.isfinite(here.norms.total + here.energy):
        raise End(Status.NONFINITE, before)
    if log.rule.met(here.norms, here.number):
        here = final_check(system, here, log.rule)
    if here.number == max_iterations:
        raise End(Status.ITERATION_LIMIT, here)
    if log.drowned >= ROUNDING_STEPS:
        raise End(Status.STAGNATED, here)
    return here


def step_along(line: DualLine, search: LineSearch) -> Step:
    """The step length along a Newton direction; ``End`` if there is none."""
    here, slope = line.here, line.slope
    if not math.isfinite(slope):
        raise End(Status.NONFINITE, here)
    if slope >= 0:
        rounding = slope <= ROUNDING * here.magnitude
        raise End(Status.STAGNATED if rounding else Status.LINESEARCH_FAILED, here)
    step = search.search(line.descent)
    if step is None:
        terms = here.functional.terms(here.v)  # the data may have changed
        sane = math.isfinite(terms.energy + InnerProduct(terms.gradient, line.dv))
        raise End(Status.LINESEARCH_FAILED if sane else Status.NONFINITE, here)
    return step
