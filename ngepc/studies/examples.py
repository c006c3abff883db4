"""The paper's examples by name, on their mesh families, and the methods that solve them by name."""

from __future__ import annotations

from functools import lru_cache

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.geometries import lshape, wrench
from ngepc.model.examples import lshape_problem, wrench_problem
from ngepc.model.problem import Problem
from ngepc.primal.solver import PrimalOptions, primal_newton
from ngepc.results.result import Result

BODIES = {"lshape": lshape, "wrench": wrench}
PROBLEMS = {"lshape": lshape_problem, "wrench": wrench_problem}
TITLES = {"lshape": "Example (a)", "wrench": "Example (b)"}
THRESHOLDS = {"lshape": 0.1, "wrench": 1e-2}
"""The |p|_F above which the paper's Figures 2 and 6 show the plastic zone."""
FAMILIES = {name: body.PAPER_NODES for name, body in BODIES.items()}


@lru_cache(maxsize=16)
def example(name: str, nodes: int | None = None, maxh: float | None = None) -> Problem:
    """An example on a member of its mesh family, by default the first of the paper's table.

    Its name is 'lshape' or 'wrench'; ``maxh``, the width of a CSG mesh (length), is in place of the
    nodes.  ValueError if there is no such mesh, or both are given.
    """
    if nodes and maxh:
        raise ValueError(f"nodes={nodes} and maxh={maxh:g}: leave one of them out")
    body = BODIES[name]
    mesh = body.mesh(maxh) if maxh else body.paper_mesh(nodes or FAMILIES[name][0])
    return PROBLEMS[name](mesh)


def solved_by(
    method: str | float,
    problem: Problem,
    start: Result | None = None,
    options: NewtonOptions | None = None,
    monitor: object = None,
) -> Result:
    """The result of the method called 'default' or 'primal', or of the paper's own at a gamma."""
    if method == "primal":
        same = ("tolerance", "max_iterations") if options is not None else ()
        chosen = PrimalOptions(**{name: getattr(options, name) for name in same})
        return primal_newton(problem, start, chosen, monitor=monitor)
    gamma = None if method == "default" else float(method)
    return semismooth_newton(problem, gamma, start, options, monitor)


def coarse_start(name: str, gamma: float, options: NewtonOptions) -> Result:
    """The solution for gamma on the coarse mesh of an example, reached in factors of ten."""
    problem, result = example(name, BODIES[name].COARSE_NODES), None
    gammas = [g for g in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9) if g < gamma]
    for value in (*gammas, gamma):
        result = semismooth_newton(problem, value, result, options).or_interrupted()
    return result
