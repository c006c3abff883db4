"""The driver that chooses gamma and the mesh: estimates against known errors."""

import math
from dataclasses import replace

import pytest
from ngepc.geometries import lshape

from ngepc import (
    Balanced,
    NewtonOptions,
    SolverError,
    Status,
    lshape_problem,
    semismooth_newton,
    solve_automatically,
)
from ngepc.automatic import bisected, regularisation_part

LIMIT = 0.37525
"""V of Example (a) in the limit of fine meshes, to four digits, from the two larger families."""


@pytest.fixture(scope="module")
def problem():
    return lshape_problem(lshape.paper_mesh(33))


@pytest.fixture(scope="module")
def automatic(problem):
    return solve_automatically(problem, tolerance=0.02)


def test_tolerance_is_met(automatic, problem):
    assert automatic.status is Status.CONVERGED
    assert automatic.message == ""
    assert automatic.levels[-1].relative_error <= 0.02
    assert abs(automatic.result.dual_energy / LIMIT - 1) <= 0.02
    assert problem.mesh.nv == 33
    assert [level.nodes for level in automatic.levels][:3] == [33, 65, 113]
    assert automatic.iterations == sum(level.iterations for level in automatic.levels)
    assert automatic.raise_for_status() is automatic


def test_discretisation_part_is_the_error(automatic):
    """The estimate is no less than the distance to the limit, and at most three times it."""
    for level in automatic.levels[2:]:
        true = abs(level.energy - LIMIT)
        assert true < level.discretisation < 3 * true


def test_regularisation_is_a_small_part(automatic):
    for level in automatic.levels[2:]:
        assert 0 < level.regularisation < 0.2 * max(level.discretisation, 0.02 * level.energy)


@pytest.mark.parametrize("gamma", [1e6, 1e8])
def test_regularisation_part_is_the_distance_to_a_large_gamma(problem, gamma):
    limit = semismooth_newton(problem, regularisation=Balanced(1e12)).dual_energy
    result = semismooth_newton(problem, regularisation=Balanced(gamma))
    estimate, steps = regularisation_part(result, NewtonOptions())
    assert estimate == pytest.approx(result.dual_energy - limit, rel=0.35)
    assert steps < 12


def test_tichonov_term_bounds_the_regularisation_error_from_below(problem):
    """V is concave in 1/gamma with the derivative b(v, v) / 2."""
    gammas = (1e5, 1e6, 1e7)
    results = [semismooth_newton(problem, regularisation=Balanced(g)) for g in gammas]
    limit = semismooth_newton(problem, regularisation=Balanced(1e12)).dual_energy
    for r in results:
        f = r.functional
        assert f.tichonov(r.v, r.v) / 2 < r.dual_energy - limit


def test_budget_of_nodes_is_a_named_end(problem):
    result = solve_automatically(problem, tolerance=1e-4, max_nodes=70)
    assert result.status is Status.ITERATION_LIMIT
    assert "max_nodes=70" in result.message
    assert result.result.status is Status.CONVERGED
    assert [level.nodes for level in result.levels] == [33, 65]
    assert math.isinf(result.levels[0].discretisation)
    with pytest.raises(SolverError, match="max_nodes=70"):
        result.raise_for_status()


def test_failure_of_a_solve_is_passed_on(problem):
    result = solve_automatically(problem, options=NewtonOptions(max_iterations=2))
    assert result.status is Status.ITERATION_LIMIT
    assert "After 2 steps" in result.message
    assert len(result.levels) == 1


def test_bisection_leaves_the_mesh_alone(problem):
    finer = bisected(problem.mesh)
    assert (problem.mesh.nv, finer.nv) == (33, 65)
    assert replace(problem, mesh=finer).contact_names == ("contact",)


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -0.1, math.nan])
def test_illegal_tolerance(problem, tolerance):
    with pytest.raises(ValueError, match="tolerance="):
        solve_automatically(problem, tolerance=tolerance)


def test_wrong_kinds_are_refused(problem):
    with pytest.raises(TypeError, match="a Problem is needed"):
        solve_automatically(problem.mesh)
