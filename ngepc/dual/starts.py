"""Starts that the paper's examples take: solutions on coarse meshes."""

from __future__ import annotations

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.geometries import lshape, wrench
from ngepc.model.examples import lshape_problem, wrench_problem
from ngepc.model.problem import Problem


def coarse_problem(name: str) -> Problem:
    """The example on its coarse mesh: 417 nodes in the paper's Table 1, 437 for the wrench."""
    if name == "lshape":
        return lshape_problem(lshape.paper_mesh(lshape.COARSE_NODES))
    return wrench_problem(wrench.paper_mesh(wrench.COARSE_NODES))


def coarse_start(name: str, gamma: float, options: NewtonOptions) -> DualResult:
    """The solution on the coarse mesh of an example, reached in factors of ten of gamma.

    Parameters
    ----------
    name
        'lshape' or 'wrench'.
    gamma
        The coupled gamma.
    options
        Newton options, also for the solve that starts from the result.
    """
    problem, result = coarse_problem(name), None
    gammas = [g for g in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9) if g < gamma]
    for value in (*gammas, gamma):
        result = semismooth_newton(problem, value, result, options).or_interrupted()
    return result
