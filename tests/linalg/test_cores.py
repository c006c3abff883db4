"""Threads of a solve: same digits, none left, none in workers."""

import multiprocessing
import os
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from itertools import count
from types import SimpleNamespace

import pytest
from ngsolve import SetNumThreads, TaskManager
from pyngcore import GetNumThreads

import ngepc
from ngepc import NewtonOptions, PyAMG, lshape_problem
from ngepc.discretisation import element_strains, factors, summands
from ngepc.geometries import block, lshape
from ngepc.linalg import cores, cycle
from ngepc.studies.large import pressed


def plane(nodes=833):
    return lshape_problem(lshape.paper_mesh(nodes)), NewtonOptions()


def solid():
    pytest.importorskip("pyamg")
    mesh = block.structured_mesh(3, 3, 3, simplices=True)
    return pressed(mesh, 100.0, order=2), NewtonOptions(inverse=PyAMG())


@pytest.mark.parametrize("make", [plane, solid])
def test_several_threads_give_the_digits_of_one(make, monkeypatch):
    for module in (cycle, summands):
        monkeypatch.setattr(module, "LARGE", 100)
    monkeypatch.setattr(element_strains, "SMALL", 1000)
    monkeypatch.setattr(element_strains, "CHUNK", 10_000)
    problem, options = make()
    found = []
    for number in (1, 2, 4):
        with cores.crew(number):
            result = ngepc.semismooth_newton(problem, options=options)
        found.append((result.primal_energy, result.history.column("residual_norm")))
    assert found[0] == found[1] == found[2]


def test_threads_of_ngsolve_change_rounding_only(two_threads, monkeypatch):
    monkeypatch.setattr(cores, "FREE", 0.0)
    monkeypatch.setattr(factors, "LARGE", 100)
    problem, options = plane(417)
    energies = []
    for number in (1, 2):
        with cores.crew(number):
            result = ngepc.semismooth_newton(problem, options=options)
        energies.append(result.primal_energy)
    assert energies[1] == pytest.approx(energies[0], rel=1e-12)


def test_values_come_in_order_and_no_thread_is_left():
    parts = list(range(200))
    before = threading.active_count()
    with cores.crew(3) as crew:
        assert list(cores.in_order(lambda k: k * k, parts)) == [k * k for k in parts]
        assert threading.active_count() > before
        assert crew.helps
    assert threading.active_count() == before


def test_an_error_in_a_thread_is_raised_and_no_thread_is_left():
    before = threading.active_count()
    with pytest.raises(ZeroDivisionError), cores.crew(2):
        list(cores.in_order(lambda k: 1 // (k - 30), list(range(60))))
    assert threading.active_count() == before


def test_a_loop_inside_a_part_has_no_threads():
    """Threads beside those of the outer loop would wait for a core."""
    both = threading.Barrier(2)

    def inner(_):
        both.wait()
        return set(cores.in_order(lambda _: threading.get_ident(), [0, 1, 2]))

    with cores.crew(2):
        first, second = cores.in_order(inner, [0, 1])
        assert len(first) == len(second) == 1
        assert first != second


def test_an_inner_function_has_the_threads_of_the_outer_one():
    with cores.crew(2) as outer, cores.crew(5) as inner:
        assert inner is outer


@pytest.mark.parametrize(("each", "free"), [(0.9, True), (0.6, False)])
def test_cores_are_free_if_threads_compute_all_the_time(each, free, monkeypatch):
    """The helping thread computes one part, for so much of a loop that takes a second."""
    wall = count(0.0, 1.0)
    busy = count(0.0, each)
    clocks = SimpleNamespace(perf_counter=wall.__next__, thread_time=busy.__next__)
    monkeypatch.setattr(cores, "time", clocks)
    both = threading.Barrier(2)
    with cores.crew(2) as crew:
        assert not crew.has_free_cores
        list(cores.in_order(lambda _: both.wait(), [0, 1]))
        assert crew.has_free_cores is free
        assert isinstance(cores.threads_of_ngsolve(), TaskManager) is free


def test_the_number_is_that_of_ngsolve(two_threads):
    assert cores.usable_threads() == min(2, cores.cores())
    SetNumThreads(1)
    assert cores.usable_threads() == 1
    assert GetNumThreads() == 1


def test_workers_have_one_thread(two_threads):
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        assert pool.submit(cores.usable_threads).result() == 1
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(cores.usable_threads).result() == 1


def test_processes_of_mpi_have_one_thread(two_threads, monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    assert cores.usable_threads() == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_inside_computes_alone():
    with cores.crew(2):
        list(cores.in_order(abs, list(range(20))))
        child = os.fork()
        if child == 0:
            right = list(cores.in_order(abs, [-1, -2])) == [1, 2]
            os._exit(0 if right else 1)
        assert os.waitpid(child, 0)[1] == 0
