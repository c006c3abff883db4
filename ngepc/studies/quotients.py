"""Figure 4: convergence quotients Q_j of the last Newton steps, for both examples.

    Q_j = ||v^(omega-5+j) - v*||_H / ||v^(omega-6+j) - v*||_H,  j = 1, ..., 5,

with omega the number of steps for the tolerance 1e-10 and v* the solution for 1e-14.  Rounding may
keep the residual above 1e-14: then v* is the last iterate before the residual stops falling.  One
more Newton correction there shows the size of the rounding errors; distances below ten times that
are no distances to the solution, and their quotients are marked.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ngsolve.la import BaseVector

from ngepc.dual.carried import carried_over
from ngepc.dual.functional import DualFunctional
from ngepc.dual.iterates import Iterate
from ngepc.dual.newton import NewtonOptions, newton_step, prepared
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.dual.system import NewtonSystem
from ngepc.model.problem import Problem
from ngepc.results.outcome import Status

LAST = 6
"""Iterates that enter the five quotients."""

FURTHER_STEPS = 12
"""Most steps beyond the tolerance on the way to the reference solution."""


@dataclass(frozen=True, kw_only=True)
class Quotients:
    """The quotients of one run with what they were computed from.

    Parameters
    ----------
    gamma, nodes
        Regularisation and mesh.
    iterations
        Omega.
    status
        How the run with the first tolerance ended.
    quotients
        Q_1, ..., Q_5, fewer if the run has fewer than five steps.
    distances
        ||v^j - v*||_H of the last six iterates (stress).
    meaningful
        For each quotient, whether its distances are above ten times the rounding.
    reference_residual, rounding
        ||Psi_gamma||_{H*} at v*, and ||.||_H of one more Newton correction there.
    reached
        Whether the reference meets its tolerance of 1e-14.
    """

    gamma: float
    nodes: int
    iterations: int
    status: str
    quotients: list[float]
    distances: list[float]
    meaningful: list[bool]
    reference_residual: float
    rounding: float
    reached: bool


def convergence_quotients(
    problem: Problem,
    gamma: float,
    start: DualResult | None = None,
    options: NewtonOptions | None = None,
    reference_tolerance: float = 1e-14,
) -> Quotients:
    """Run Algorithm 7.1 and compare its last iterates with a more precise solution.

    Parameters
    ----------
    problem, gamma, start, options
        As in ``semismooth_newton``.
    reference_tolerance
        Tolerance for v*; 1e-14 in the paper.
    """
    options = NewtonOptions() if options is None else options
    functional = prepared(problem, Coupled(gamma), options)
    v = functional.blocks.H_vector() if start is None else carried_over(start, functional)
    steps = iterates(functional, v, options)
    kept: deque[np.ndarray] = deque(maxlen=LAST)
    omega, residual = -1, math.inf
    for omega, here in enumerate(steps):
        kept.append(here.v.FV().NumPy().copy())
        residual = _residual(functional, here)
        if residual < options.tolerance or omega == options.max_iterations:
            break
    status = Status.CONVERGED if residual < options.tolerance else Status.ITERATION_LIMIT
    v_star, reference_residual, rounding = reference(
        functional, steps, kept[-1], residual, reference_tolerance
    )
    distances = [h_norm(functional, w - v_star) for w in kept]
    pairs = list(pairwise(distances))
    return Quotients(
        gamma=gamma,
        nodes=problem.mesh.nv,
        iterations=omega,
        status=status.label,
        quotients=[after / before if before > 0 else 0.0 for before, after in pairs],
        distances=distances,
        meaningful=[after > 10 * rounding for _, after in pairs],
        reference_residual=reference_residual,
        rounding=rounding,
        reached=reference_residual < reference_tolerance,
    )


def iterates(
    functional: DualFunctional, v: BaseVector, options: NewtonOptions
) -> Iterator[Iterate]:
    """The iterates of Algorithm 7.1 without a stopping rule, as long as steps are possible."""
    system, here = NewtonSystem(functional, options.inverse), Iterate.at(functional, v)
    end = None
    while end is None:
        yield here
        here, end = newton_step(functional, system, here, options.linesearch)


def _residual(functional: DualFunctional, here: Iterate) -> float:
    """||Psi|| with y by the factors alone, one linear map for all iterates.

    Refinement would bring y closer to D y = Lambda* v - l, but differently for each v: quotients of
    distances far below 1e-10 need the smaller scatter, not the smaller error.
    """
    return here.refresh(functional, refinements=0)


def reference(
    functional: DualFunctional,
    steps: Iterator[Iterate],
    v: np.ndarray,
    residual: float,
    tolerance: float,
) -> tuple[np.ndarray, float, float]:
    """V*, its residual, and ||w - v*||_H for the iterate w after it, which is rounding."""
    best = (v, residual)
    for _ in range(FURTHER_STEPS):
        here = next(steps, None)
        if here is None:
            return *best, math.nan
        now, residual = here.v.FV().NumPy().copy(), _residual(functional, here)
        if best[1] < tolerance or residual >= best[1]:
            return *best, h_norm(functional, now - best[0])
        best = (now, residual)
    return *best, math.nan


def h_norm(functional: DualFunctional, w: np.ndarray) -> float:
    """||w||_H = b(w, w)^(1/2) of a coefficient vector on H."""
    v = functional.blocks.H_vector()
    v.FV().NumPy()[:] = w
    return math.sqrt(max(0.0, functional.tichonov(v, v) * functional.weights.tichonov))
