"""The library sets no threads; ``with TaskManager()`` around user code changes rounding only."""

import os
import subprocess
import sys

import pytest
from ngsolve import TaskManager

from ngepc import (
    Coupled,
    NewtonOptions,
    PrimalOptions,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import lshape

METHODS = {
    "coupled": lambda problem: semismooth_newton(
        problem, regularisation=Coupled(1e3), options=NewtonOptions(max_iterations=1)
    ),
    "primal": lambda problem: primal_newton(
        problem, options=PrimalOptions(max_iterations=2)
    ),
}
"""A few steps assemble, factorise and search, again and again; the other thread waits meanwhile."""


@pytest.mark.parametrize("method", METHODS)
def test_two_threads_take_the_steps_of_one_to_the_same_energy(method, two_threads):
    problem, solve = lshape_problem(lshape.paper_mesh(33)), METHODS[method]
    one = solve(problem)
    with TaskManager():
        two = solve(problem)
    assert two.status is one.status
    assert two.iterations == one.iterations
    assert two.primal_energy == pytest.approx(one.primal_energy, rel=1e-9)


def test_no_solve_changes_the_number_of_threads():
    """In a process of its own, where the calls that set threads end it."""
    code = (
        "import ngsolve, ngepc; from ngepc.geometries import lshape\n"
        "def refuse(*a, **k): raise SystemExit('the library set threads')\n"
        "ngsolve.SetNumThreads = ngsolve.TaskManager = refuse\n"
        "problem = ngepc.lshape_problem(lshape.paper_mesh(33))\n"
        "ngepc.semismooth_newton(problem, 1e3); ngepc.primal_newton(problem)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run(
        [sys.executable, "-c", code], check=True, env=environment, timeout=120
    )
