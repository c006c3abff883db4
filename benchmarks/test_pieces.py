"""The pieces of a Newton step on Example (a) with 6273 nodes, timed by pytest-benchmark.

    make benchmark-pieces      or      python -m pytest benchmarks

``ngepc benchmark`` measures whole steps against an elastic solve; here one sees which piece has
become dearer.  The times of one run compare with each other; nothing is asserted about them.
"""

from itertools import cycle

import pytest
from ngsolve import SetNumThreads

from ngepc import Coupled, lshape_problem, primal_newton, semismooth_newton
from ngepc.discretisation.element_stiffness import ElementStiffness
from ngepc.discretisation.symbolic_stiffness import by_moduli
from ngepc.dual.algorithm import DualLine, NewtonSystem
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional, DualIterate
from ngepc.geometries import lshape
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.studies.cost import elastic_solve
from ngepc.studies.large import indented_block

COUPLED = Coupled(1e4)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    SetNumThreads(1)


@pytest.fixture(scope="module")
def problem():
    return lshape_problem(lshape.paper_mesh(6273))


class Pieces:
    """A functional with a plastified iterate, its Newton system and direction."""

    def __init__(self, problem):
        result = semismooth_newton(problem, regularisation=COUPLED)
        self.functional, self.here = (
            result.functional,
            DualIterate(result.functional, result.v),
        )
        self.system = NewtonSystem(self.functional.blocks, "sparsecholesky")
        self.system.factorise(self.functional, self.here.hessian())
        self.dy, self.dv = self.system.solve(self.here.residual)


@pytest.fixture(scope="module")
def pieces(problem):
    return Pieces(problem)


def test_elastic_solve(benchmark, problem):
    benchmark(elastic_solve, problem)


@pytest.mark.parametrize("kind", [ElementStiffness, by_moduli])
def test_assembly_in_space(benchmark, kind):
    """Directly, and by symbolic forms."""
    discrete = DiscreteProblem(indented_block(2))
    stiffness = kind(discrete.points, discrete.free).with_added(discrete.added)
    benchmark(stiffness.values, starting_state(discrete, None).moduli)


def test_linear_blocks(benchmark, problem):
    benchmark(LinearBlocks, problem, COUPLED, "sparsecholesky")


def test_functional_on_given_blocks(benchmark, pieces):
    f = pieces.functional
    benchmark(DualFunctional, f.blocks, 400, COUPLED.gamma)


def test_nonsmooth_energy(benchmark, pieces):
    benchmark(lambda: DualIterate(pieces.functional, pieces.here.v).penalties)


def test_nonsmooth_gradient(benchmark, pieces):
    benchmark(lambda: DualIterate(pieces.functional, pieces.here.v).multipliers)


def test_assembly_and_factorisation(benchmark, pieces):
    f, here = pieces.functional, pieces.here
    benchmark(lambda: pieces.system.factorise(f, here.hessian()))


def test_direction_with_given_factors(benchmark, pieces):
    benchmark(pieces.system.solve, pieces.here.residual)


def test_energy_along_a_line(benchmark, pieces):
    line = DualLine(pieces.here, pieces.dy, pieces.dv)
    steps = cycle((0.5, 0.25))  # the line keeps its last trial
    benchmark(lambda: line.energy(next(steps)))


def test_residual_norms(benchmark, pieces):
    benchmark(pieces.functional.residual_norms, pieces.here.residual)


def test_whole_exact_solve(benchmark, problem):
    benchmark.extra_info["iterations"] = semismooth_newton(problem).iterations
    benchmark.pedantic(semismooth_newton, (problem,), rounds=2)


def test_whole_primal_solve(benchmark, problem):
    benchmark.extra_info["iterations"] = primal_newton(problem).iterations
    benchmark.pedantic(primal_newton, (problem,), rounds=2)
