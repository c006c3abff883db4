"""Cold solves with order two of soft plane bodies go by way of order one."""

from dataclasses import replace

import pytest
from ngsolve import GridFunction

from ngepc import Material, Problem, Status, lshape_problem, semismooth_newton
from ngepc.discretisation.spaces import displacement_space
from ngepc.geometries import block, lshape
from ngepc.local import solver
from ngepc.studies.counts import problem_with

MOST = 15
"""The largest number of steps of order two for a hardening of 1e-3 mu."""


def at_rest(problem):
    """The displacement zero: a start that leaves out order one."""
    return GridFunction(displacement_space(problem))


def solves(history):
    """All solves with the factors of a run."""
    return sum(history.column("back_substitutions"))


@pytest.mark.parametrize(("law", "nodes"), [("Hill", 417), ("plane stress", 833)])
def test_fewer_steps_to_the_same_solution(law, nodes):
    problem = problem_with(law, nodes, 1e-3)
    cold = semismooth_newton(problem, start=at_rest(problem)).raise_for_status()
    result = semismooth_newton(problem).raise_for_status()
    assert cold.order_one is None
    assert result.iterations <= MOST < cold.iterations
    assert abs(result.primal_energy / cold.primal_energy - 1) < 1e-10
    assert solves(result.order_one) + solves(result.history) < 1.1 * solves(
        cold.history
    )
    before = result.order_one.records[-1].iteration
    assert f"{result.iterations} after {before} of order one" in str(result)


def sheet(load, **data):
    """A sheet of soft steel under tension; it yields at 250 (MPa)."""
    steel = Material.metal(
        young=210e3, poisson=0.3, yield_stress=250.0, tangent_modulus=1000.0
    )
    given = {"clamped": "left", "kinematics": "plane stress", **data}
    mesh = block.structured_mesh(3, 3, size=(1.0, 1.0))
    return Problem(mesh, steel, traction={"right": (load, 0.0)}, **given)


@pytest.mark.parametrize(
    "problem",
    [
        sheet(100.0),
        sheet(300.0, order=1),
        sheet(300.0, initial_accumulated=0.01),
        replace(lshape_problem(lshape.paper_mesh(113)), order=2),
    ],
    ids=["elastic", "order one", "a history", "hardening of a tenth of mu"],
)
def test_others_start_from_zero(problem):
    assert semismooth_newton(problem).raise_for_status().order_one is None


def test_beyond_the_limit_load_the_status_is_the_same():
    perfect = Material.metal(
        young=210e3, poisson=0.3, yield_stress=1.0, plastic_modulus=0.0
    )
    problem = problem_with("plane stress", 113, 1e-3)
    beyond = semismooth_newton(replace(problem, material=perfect, gap=1e3))
    assert beyond.order_one is not None
    assert beyond.status is Status.LIMIT_LOAD


def test_an_interrupt_of_order_one_stops_the_run(monkeypatch):
    call = solver.RepeatedSolver.__call__

    def interrupted(self, problem, *others):
        def press(record):
            raise StopIteration

        return call(self, problem, None, press)

    monkeypatch.setattr(solver.RepeatedSolver, "__call__", interrupted)
    result = semismooth_newton(problem_with("plane stress", 113, 1e-3))
    assert result.status is Status.STOPPED
