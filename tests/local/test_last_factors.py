"""A Newton step is one tangent and one factorisation; near the solution a second correction.

The counts of docs/method/exact.md:

    python -m pytest tests/local/test_last_factors.py -s
"""

import pytest

from ngepc import lshape_problem, semismooth_newton, wrench_problem
from ngepc.geometries import lshape, wrench
from ngepc.results import iteration
from ngepc.results.iteration import ExactTarget

BODIES = {
    "(a), 417 nodes": lambda: lshape_problem(lshape.paper_mesh(417)),
    "(a), 833 nodes": lambda: lshape_problem(lshape.paper_mesh(833)),
    "(a), 1601 nodes": lambda: lshape_problem(lshape.paper_mesh(1601)),
    "(b), 873 nodes": lambda: wrench_problem(wrench.paper_mesh(873)),
    "(b), 1641 nodes": lambda: wrench_problem(wrench.paper_mesh(1641)),
}


@pytest.fixture
def counted(monkeypatch):
    """How often a tangent is taken, and how often Newton's model is solved."""
    numbers = {"tangents": 0, "models": 0}
    take, solve = ExactTarget.__call__, ExactTarget.step

    def taken(self, *given):
        numbers["tangents"] += 1
        return take(self, *given)

    def solved(self, *given):
        numbers["models"] += 1
        return solve(self, *given)

    monkeypatch.setattr(ExactTarget, "__call__", taken)
    monkeypatch.setattr(ExactTarget, "step", solved)
    return numbers


@pytest.mark.parametrize("name", BODIES)
def test_a_step_is_a_factorisation_and_one_or_two_have_a_second_correction(
    name, counted
):
    result = semismooth_newton(BODIES[name]()).raise_for_status()
    solves = sum(result.history.column("back_substitutions"))
    further = counted["models"] - counted["tangents"]
    print(f"{name}: {result.iterations} steps, {further} further, {solves} solves")
    assert counted["tangents"] == result.iterations
    assert 1 <= further <= 2
    assert solves >= counted["models"]


@pytest.mark.parametrize("name", ["(b), 873 nodes"])
def test_without_contact_each_correction_is_one_solve(name, counted):
    result = semismooth_newton(BODIES[name]())
    solves = sum(result.history.column("back_substitutions"))
    assert solves == counted["models"]


@pytest.mark.parametrize("name", BODIES)
def test_second_corrections_save_at_most_two_factorisations(name, monkeypatch):
    once = semismooth_newton(BODIES[name]())
    monkeypatch.setattr(iteration, "corrected", lambda state, *others: state)
    without = semismooth_newton(BODIES[name]()).raise_for_status()
    print(f"{name}: {without.iterations} steps without second corrections")
    assert once.iterations <= without.iterations <= once.iterations + 2
    assert abs(without.primal_energy / once.primal_energy - 1) < 1e-11
