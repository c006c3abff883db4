"""The paper's method: one regularised problem (D_gamma) by Algorithm 7.1."""

from __future__ import annotations

from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.dual.algorithm import NewtonSystem, algorithm_7_1
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.dual.stopping import Tolerances
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import Monitor


def solve_regularised(
    problem: Problem,
    regularisation: Coupled,
    start: DualResult | None,
    options: NewtonOptions,
    monitor: Monitor | None,
) -> DualResult:
    """Solve (D_gamma) from zero or from an earlier result.

    The same arguments as ``semismooth_newton``.
    """
    if not isinstance(options.direct_solver, str):
        raise ValueError(
            f"inverse={in_words(options.inverse)}: a direct solver is needed with gamma"
        )
    kinds = (DualResult, type(None))
    require_instance("start", start, kinds, "a result of semismooth_newton or None")
    functional = prepared(problem, regularisation, options)
    aim = Tolerances(options.tolerance * functional.blocks.residual_unit)
    system = NewtonSystem(functional.blocks, options.direct_solver)
    v = functional.blocks.H_vector()
    if start is not None:
        v = functional.carried(start.functional, start.v)
    how = aim, options.linesearch, options.max_iterations, monitor
    return algorithm_7_1(system, functional, v, *how)


def prepared(
    problem: Problem, regularisation: Coupled, options: NewtonOptions
) -> DualFunctional:
    """J*_gamma of a regularised problem with its matrices assembled."""
    blocks = LinearBlocks(problem, regularisation, options.direct_solver)
    gammas = regularisation.gamma, regularisation.gamma_tichonov
    return DualFunctional(blocks, options.quadrature_points, *gammas)
