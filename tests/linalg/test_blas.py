"""BLAS has one thread while ngepc computes, and as many as before afterwards."""

from multiprocessing.pool import ThreadPool

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ngepc
from ngepc import Material, Problem, load_cycle
from ngepc.geometries import block
from ngepc.linalg.blas import one_blas_thread

COMPUTE = [
    "calibrate",
    "confidence",
    "contact_force_bracket",
    "displacement_bracket",
    "duality_report",
    "error_bound",
    "error_indicators",
    "evolve",
    "follow_path",
    "goal_bound",
    "gradient",
    "limit_load",
    "material_point",
    "primal_newton",
    "semismooth_newton",
    "solve_to",
    "tangent",
    "verdict",
    "write_receipt",
]


def blas_threads():
    """The numbers of threads of all BLAS libraries that are loaded."""
    return {
        each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"
    }


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip("this BLAS has no second thread")
        yield


@pytest.fixture(scope="module")
def problem():
    metal = Material.metal(
        young=210e3, poisson=0.3, yield_stress=235.0, tangent_modulus=2100.0
    )
    mesh = block.structured_mesh(2, 2)
    return Problem(mesh, metal, body_force=(0.0, -1.0), contact="contact", gap=-0.001)


def test_the_number_is_restored_after_the_outermost_function():
    inner = one_blas_thread(blas_threads)
    outer = one_blas_thread(lambda: [blas_threads(), inner(), blas_threads()])
    assert outer() == [{1}, {1}, {1}]
    assert blas_threads() == {2}


def test_the_number_is_restored_after_an_error():
    with pytest.raises(ZeroDivisionError):
        one_blas_thread(divmod)(1, 0)
    assert blas_threads() == {2}


def test_threads_of_python_do_no_harm():
    with ThreadPool(3) as pool:
        found = pool.map(
            one_blas_thread(lambda i: np.linalg.det(np.eye(200) * i)), range(9)
        )
    assert found[:2] == [0, 1]
    assert blas_threads() == {2}


def test_a_solve_and_a_history_have_one_thread(problem):
    seen = []
    watch = lambda *_: seen.append(blas_threads())  # noqa: E731
    ngepc.semismooth_newton(problem, monitor=watch)
    ngepc.primal_newton(problem, monitor=watch)
    ngepc.evolve(problem, load_cycle(problem, [1.0], steps=1), monitor=watch)
    ngepc.RepeatedSolver()(problem, monitor=watch)
    assert seen
    assert all(number == {1} for number in seen)
    assert blas_threads() == {2}


@pytest.mark.parametrize("name", COMPUTE)
def test_what_computes_is_guarded(name):
    assert hasattr(getattr(ngepc, name), "__wrapped__"), (
        f"{name} is not decorated with @one_blas_thread"
    )
