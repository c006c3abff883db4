"""Algorithm 7.1: the globalised semismooth Newton method for one regularised dual problem.

The first row of the Newton system (7.1) is negated: the second derivative of the saddle function S
is then symmetric and quasi-definite, so that LDL^T needs no pivoting.  That row is linear: once
D y = Lambda* v - l holds it holds along the whole step, so that J*_gamma(v + t dv) is a parabola
plus the nonsmooth terms and trials of the line search need no solve.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from functools import partial

from ngsolve import InnerProduct
from ngsolve.la import BaseMatrix, BaseVector

from ngepc._deprecated import old_names
from ngepc.checks.sentences import counted
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional, DualIterate
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import Tolerances, ended, judged
from ngepc.linalg.direct import (
    FROM_LOWER_TRIANGLE,
    SOLVER_ERRORS,
    FactorisationError,
    SparseSum,
)
from ngepc.linalg.linesearch import Descent, FullSteps, LineSearch, Step
from ngepc.results.outcome import History, IterationRecord, Monitor, Status

logger = logging.getLogger(__name__)


def algorithm_7_1(
    system: NewtonSystem,
    functional: DualFunctional,
    v: BaseVector,
    aim: Tolerances,
    search: LineSearch | None,
    max_iterations: int,
    monitor: Monitor | None = None,
) -> DualResult:
    """Algorithm 7.1 from v, until the tolerances are met or the run is stopped.

    The Newton system may have been used before; without a line search all steps are full ones.
    """
    search = FullSteps() if search is None else search
    history = History()
    step = Step(length=1.0, energy=math.nan, halvings=0)
    status = None
    cause = ""
    here = before = functional.at(v)
    try:
        while True:
            record(here, step, history, monitor)
            here, status, cause = judged(
                here, before, history, aim, max_iterations, system.solve
            )
            if status is not None:
                break
            system.factorise(functional, here.hessian())
            # (a) the Newton system (7.1)
            dy, dv = system.solve((-here.residual).Evaluate())
            line = DualLine(here, dy, dv)
            # (b) Armijo's rule
            step = search.search(line) if line.slope_0 < 0 else None
            if step is None:
                status = line.fault()
                break
            before = here
            here = line.at(step.length)  # (c) the update of y and v
    except FactorisationError as error:
        status = Status.NONFINITE
        cause = f"{error}."
    except (StopIteration, KeyboardInterrupt):
        status = Status.STOPPED
        cause = f"after {counted(len(history.records) - 1, 'step')}"
    return ended(here, status, cause, history, aim)


def record(
    here: DualIterate, step: Step, history: History, monitor: Monitor | None
) -> None:
    """Record an iterate and the step that led to it, log it and show it to the monitor."""
    contact, plastic = here.norms
    pressed, yielding = here.active
    record = IterationRecord(
        iteration=len(history.records),
        residual_norm=here.residual_norm,
        contact_residual_norm=float(contact),
        plastic_residual_norm=float(plastic),
        energy=here.energy,
        step_length=step.length,
        halvings=step.halvings,
        back_substitutions=int(len(history.records) > 0),
        contact_active=pressed,
        plastic_active=yielding,
    )
    history.records.append(record)
    logger.info(
        "it:%(iteration)4d residual:%(residual_norm).3e energy:%(energy).12e",
        vars(record),
    )
    if monitor is not None:
        state = here.functional, here.y, here.v, Status.STOPPED, ""
        snapshot = partial(DualResult, *state, History(list(history.records)))
        monitor(replace(record, snapshot=snapshot))


class NewtonSystem:
    """(7.1) in one fixed sparsity pattern: constant part, B / gamma_T, Newton derivatives.

    ``inverse`` is NGSolve's name of the direct solver.
    """

    def __init__(self, blocks: LinearBlocks, inverse: str) -> None:
        self._blocks = blocks
        self._solver = inverse
        self._first = blocks.Y.ndof
        mirrored = inverse not in FROM_LOWER_TRIANGLE
        self._sum = SparseSum(blocks.saddle.mat, mirrored=mirrored)
        self._saddle = self._sum.values.copy()
        self._inverse = None

    def factorise(self, functional: DualFunctional, hessian: BaseMatrix | None) -> None:
        """Assemble and factorise the Newton matrix; None leaves the nonsmooth terms out.

        FactorisationError if the direct solver gives up; ValueError for other blocks.
        """
        if functional.blocks is not self._blocks:
            raise ValueError(
                "functional was made with other blocks: one with the blocks of this "
                "system is needed"
            )
        self._sum.values[:] = self._saddle
        self._sum.add(self._blocks.B, self._first, 1 / functional.weights.tichonov)
        if hessian is not None:
            self._sum.add(hessian, self._first)
        matrix = self._sum.matrix()
        try:
            self._invert(matrix)
        except SOLVER_ERRORS as error:
            raise FactorisationError(
                f"{self._solver} could not factorise the Newton matrix: {error}"
            ) from error

    def _invert(self, matrix: BaseMatrix) -> None:
        if self._inverse is None:
            free = self._blocks.X.FreeDofs(coupling=True)
            self._inverse = matrix.Inverse(free, inverse=self._solver)
        else:
            self._inverse.Update()

    def solve(self, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """(delta y, delta v) of (7.1) for the right hand side (0, r), with the last factors."""
        saddle = self._blocks.saddle
        ends = self._blocks.X.ndof
        right, x = (saddle.mat.CreateColVector() for _ in range(2))
        right[:] = 0.0
        right.Range(self._first, ends).data = r
        x.data = self._inverse * right
        x.data += saddle.harmonic_extension * x
        dy = x.Range(0, self._first)
        dv = x.Range(self._first, ends)
        return (1.0 * dy).Evaluate(), (1.0 * dv).Evaluate()


class DualLine(Descent):
    """J*_gamma along (y + t dy, v + t dv)."""

    def __init__(self, here: DualIterate, dy: BaseVector, dv: BaseVector) -> None:
        self.here = here
        self.dy = dy
        self.dv = dv
        functional = here.functional
        self.energy_0 = here.energy
        self.magnitude = here.magnitude
        self.slope_0 = InnerProduct(here.residual, dv)
        image = (functional.blocks.Lambda * dy).Evaluate()
        self._smooth_slope = InnerProduct(
            functional.linear_residual(here.y, here.v), dv
        )
        self._curvature = InnerProduct(image, dv) + functional.tichonov(dv, dv)
        self._last = 0.0, here

    def at(self, t: float) -> DualIterate:
        """The iterate at a step length; the last one is kept."""
        if self._last[0] != t:
            here = self.here
            y = self.here.y + t * self.dy
            v = self.here.v + t * self.dv
            self._last = t, here.functional.at(v.Evaluate(), y.Evaluate())
        return self._last[1]

    def energy(self, t: float) -> float:
        """J*_gamma(v + t dv)."""
        parabola = t * self._smooth_slope + t**2 / 2 * self._curvature
        return self.here.smooth_energy + parabola + sum(self.at(t).penalties)

    def derivative(self, t: float) -> float:
        """d/dt J*_gamma(v + t dv)."""
        smooth = self._smooth_slope + t * self._curvature
        return smooth + InnerProduct(self.at(t).multipliers, self.dv)

    def fault(self) -> Status:
        """The status of a line search without a step length."""
        again = self.here.functional.at(self.here.v, self.here.y)
        values = (
            self.slope_0,
            *again.penalties,
            InnerProduct(again.multipliers, self.dv),
        )
        if not math.isfinite(sum(values)):
            return Status.NONFINITE
        limited_by_rounding = self.slope_0 >= 0 and self.is_rounding(self.slope_0)
        return Status.STAGNATED if limited_by_rounding else Status.LINESEARCH_FAILED


__getattr__ = old_names(__name__)
