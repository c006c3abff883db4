"""The paper's examples and the methods that solve them, by name; time and memory of a solve."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ngepc.geometries import lshape, wrench
from ngepc.methods.newton import semismooth_newton
from ngepc.model.problem import Problem, lshape_problem, wrench_problem
from ngepc.primal.solver import PrimalOptions, primal_newton
from ngepc.results.options import NewtonOptions
from ngepc.results.result import Result

BODIES = {"lshape": lshape, "wrench": wrench}
PROBLEMS = {"lshape": lshape_problem, "wrench": wrench_problem}
TITLES = {"lshape": "Example (a)", "wrench": "Example (b)"}
THRESHOLDS = {"lshape": 0.1, "wrench": 1e-2}
"""The |p|_F above which the paper's Figures 2 and 6 show the plastic zone."""
FAMILIES = {name: body.PAPER_NODES for name, body in BODIES.items()}
METHODS = ("default", "primal")
"""Methods without a gamma."""


@lru_cache(maxsize=16)
def example(name: str, nodes: int | None = None, maxh: float | None = None) -> Problem:
    """An example on a member of its mesh family, by default the first of the paper's table.

    ``name`` is 'lshape' or 'wrench'.  ``maxh``, the width of a CSG mesh (length), may be given in
    place of ``nodes``.  ValueError if there is no such mesh, or if both are given.
    """
    if nodes and maxh:
        raise ValueError(f"nodes={nodes} and maxh={maxh:g}: leave one of them out")
    body = BODIES[name]
    return PROBLEMS[name](
        body.mesh(maxh) if maxh else body.paper_mesh(nodes or FAMILIES[name][0])
    )


def solved_by(
    method: str | float,
    problem: Problem,
    start: Result | None = None,
    options: NewtonOptions | None = None,
    monitor: object = None,
) -> Result:
    """The result of the method 'default' or 'primal', or of the paper's method at a gamma."""
    if method == "primal":
        same = ("tolerance", "max_iterations") if options is not None else ()
        chosen = PrimalOptions(**{name: getattr(options, name) for name in same})
        return primal_newton(problem, start, chosen, monitor=monitor)
    gamma = None if method == "default" else float(method)
    return semismooth_newton(problem, gamma, start, options, monitor)


@lru_cache(maxsize=8)
def coarse_start(
    name: str, method: str | float, options: NewtonOptions | None = None
) -> Result:
    """The solution on the coarse mesh of an example; gamma is increased by factors of ten."""
    problem = example(name, BODIES[name].COARSE_NODES)
    result = None
    ways = [method]
    if method not in METHODS:
        ways = [
            *(10.0**k for k in range(3, 10) if 10.0**k < float(method)),
            float(method),
        ]
    for way in ways:
        result = solved_by(way, problem, result, options).or_interrupted()
    return result


@lru_cache(maxsize=8)
def nested(
    name: str, method: str | float, nodes: int, options: NewtonOptions | None = None
) -> Result:
    """The solution of an example by nested iteration through all coarser meshes of its family."""
    family = (BODIES[name].COARSE_NODES, *FAMILIES[name])
    if nodes == family[0]:
        return coarse_start(name, method, options)
    start = nested(name, method, family[family.index(nodes) - 1], options)
    return solved_by(method, example(name, nodes), start, options).or_interrupted()


def timed(solve: Callable[..., Result], *given: object) -> tuple[Result, dict]:
    """The result of a solver, and its status, steps, energy J and processor time."""
    begin = time.process_time()
    result = solve(*given).or_interrupted()
    seconds = time.process_time() - begin
    return result, {
        "status": result.status.label,
        "iterations": result.iterations,
        "energy": result.primal_energy,
        "cpu_s": seconds,
    }


def in_own_process(work: Callable[..., Any], *given: object) -> Any:
    """The value of a function of a module, called in a new process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *given).result()


def peak_memory() -> float | None:
    """Peak resident memory of this process (MB); None if the system does not provide it."""
    status = Path("/proc/self/status")
    found = status.read_text().partition("VmHWM:")[2] if status.is_file() else ""
    return int(found.split()[0]) / 1024 if found else None
