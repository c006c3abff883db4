"""Processor time of error bounds, goal intervals and adaptive meshes, relative to what they follow.

    python -m pytest benchmarks/test_bounds.py -s

Runs are interleaved, so that a busy machine slows all of them alike; medians and ranges of the
quotients are printed.  "inside" is a bound where Newton's method has left its factors, as in
``solve_to``; "alone" has factors of its own, on the mesh of the result; "copy" is ``error_bound``.
A step is the time of the whole solve over the number of steps.  Goals begin with what the solve has
learned of the contact rows, as in ``goal_bound``.  Nothing is asserted about times.
Threads of BLAS and NGSolve wait busily for each other, which counts as processor time: both have
one.
"""

import statistics
import time
from collections import defaultdict

import pytest
from ngsolve import SetNumThreads, TaskManager
from pyngcore import GetNumThreads

from ngepc import error_bound, semismooth_newton, solve_to
from ngepc.bounds.of_state import bound_and_search, bound_data_of, bound_of, data_on
from ngepc.discretisation.factors import Factors
from ngepc.goals.goal_bound import GoalProblem
from ngepc.linalg.blas import one_blas_thread
from ngepc.studies.bounds import LIMITS, STARTS, TARGETS, bounded_example

RUNS = 5
CASES = {
    "(a), order 1": ("lshape", "uniform", 24833),
    "(b), order 1": ("wrench", "uniform", 24993),
    "(a), order 2": ("lshape", "order 2", 1601),
    "(b), order 2": ("wrench", "order 2", 1641),
}
GOALS = {"lshape": ("work", "contact_force"), "wrench": ("work",)}


@pytest.fixture(autouse=True)
def one_thread():
    with TaskManager():
        before = GetNumThreads()
    SetNumThreads(1)
    yield
    SetNumThreads(before)


def timed(work, *arguments, **options):
    """What ``work`` returns, and its processor time."""
    start = time.process_time()
    found = work(*arguments, **options)
    return found, time.process_time() - start


def bound_alone(result):
    """The bound on the mesh of a result, with factors of its own."""
    return bound_of(bound_data_of(result.discrete), result.state)


def printed(capsys, name, quotients):
    """Print the median and the range of each list of quotients."""
    parts = [
        f"{what} {statistics.median(q):.2f} ({min(q):.2f} to {max(q):.2f})"
        for what, q in quotients.items()
    ]
    with capsys.disabled():
        print(f"\n{name}: {', '.join(parts)}")


@pytest.mark.parametrize("name", CASES)
@one_blas_thread
def test_bounds_and_goals(name, capsys):
    body, kind, nodes = CASES[name]
    problem = bounded_example(body, kind, nodes)
    found = defaultdict(list)
    for _ in range(RUNS):
        result, whole = timed(semismooth_newton, problem)
        step = whole / result.iterations
        state = result.state
        tangent = Factors(result.discrete, "sparsecholesky")
        tangent.update(state.moduli)

        bound_data, setup = timed(data_on, result.discrete)
        (bound, search), inside = timed(bound_and_search, bound_data, state, tangent)
        _, alone = timed(bound_alone, result)
        sharper, copy = timed(error_bound, result)
        assert sharper.total <= bound.total
        found["inside/step"].append((setup + inside) / step)
        found["alone/step"].append(alone / step)
        found["copy/alone"].append(copy / alone)

        learned = result.compliance
        intervals = GoalProblem.of_bound(bound_data, bound, tangent, search, learned)
        for goal in GOALS[body]:
            _, cost = timed(intervals.bound_of, goal)
            found[f"{goal}/copy"].append(cost / copy)
    printed(capsys, name, found)


@pytest.mark.parametrize("name", list(CASES)[:2])
@one_blas_thread
def test_adaptive_meshes(name, capsys):
    body, kind, nodes = CASES[name]
    uniform = bounded_example(body, kind, nodes)
    start = bounded_example(body, kind, STARTS[body][0])
    target = TARGETS[body, "adaptive"]

    def stopped(mesh):
        if mesh.energy - LIMITS[body] <= target:
            raise StopIteration

    found = defaultdict(list)
    for _ in range(RUNS):
        result, solve = timed(semismooth_newton, uniform)
        bound, proof = timed(error_bound, result)
        tolerance = target / STARTS[body][1]
        _, strict = timed(solve_to, start, tolerance, monitor=stopped)
        _, equal = timed(solve_to, start, bound.relative)
        found["bound below the uniform error, over the solve"].append(strict / solve)
        found["equal bounds, over solve and bound"].append(equal / (solve + proof))
    printed(capsys, name, found)
