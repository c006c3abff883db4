"""The driver that chooses gamma and the mesh: estimates against known errors."""

import math
from dataclasses import replace

import pytest
from ngepc.geometries import lshape, wrench

from ngepc import (
    Balanced,
    Material,
    NewtonOptions,
    Problem,
    SolverError,
    Status,
    lshape_problem,
    semismooth_newton,
    solve_automatically,
    wrench_problem,
)
from ngepc.dual.automatic import bisected
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.contact_newton import newton_system
from ngepc.dual.functional import DualFunctional
from ngepc.dual.newton import run
from ngepc.dual.regularisation_error import regularisation_part
from ngepc.model.normals import outward_normal
from ngepc.studies.krylov import indented_block

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


def solved(problem, regularisation, options):
    """A result, and the Newton system with the factors it was found with."""
    blocks = LinearBlocks(problem, regularisation, options.inverse)
    functional = DualFunctional(blocks, regularisation, options.quadrature_points)
    system = newton_system(functional, options.inverse)
    return run(functional, system, blocks.H_vector(), options), system


def true_part(result, options):
    """V minus its value for a gamma_T that is 1e6 times larger."""
    sharp = result.functional.regularisation
    sharp = replace(sharp, gamma=1e6 * sharp.gamma)
    limit = semismooth_newton(result.problem, start=result, options=options, regularisation=sharp)
    return result.dual_energy - limit.dual_energy


EXACT = NewtonOptions()
COARSE = NewtonOptions(tolerance=1e-8, quadrature_points=60)


@pytest.mark.parametrize(
    ("body", "options", "least", "most"),
    [
        (lambda: lshape_problem(lshape.paper_mesh(417)), EXACT, 0.99, 1.05),
        (lambda: wrench_problem(wrench.paper_mesh(873)), EXACT, 1.0, 1.3),
        (lambda: indented_block(1), COARSE, 0.99, 1.05),
    ],
    ids=["example a", "example b", "block under a sphere"],
)
def test_regularisation_part_is_the_distance_to_a_large_gamma(body, options, least, most):
    problem = body()
    result, system = solved(problem, Balanced().resolved(problem), options)
    estimate, power = regularisation_part(result, system)
    assert least < estimate / true_part(result, options) < most
    assert 0.1 <= power <= 1.0


@pytest.mark.parametrize("gamma", [1e6, 1e8])
def test_regularisation_part_for_other_gammas(problem, gamma):
    result, system = solved(problem, Balanced(gamma), EXACT)
    estimate, _ = regularisation_part(result, system)
    assert estimate == pytest.approx(true_part(result, EXACT), rel=0.35)


def test_power_is_the_second_derivative(problem):
    """1 + tau V'' / V' with V' = b(v, v) / 2, by differences in tau = 1 / gamma."""
    gamma, step = 1e6, 1e-3
    result, system = solved(problem, Balanced(gamma), EXACT)
    _, power = regularisation_part(result, system)
    slopes = []
    for factor in (1 - step, 1 + step):
        other = semismooth_newton(problem, start=result, regularisation=Balanced(gamma / factor))
        slopes.append(other.functional.tichonov(other.v, other.v) / factor)
    assert power == pytest.approx(1 + math.log(slopes[1] / slopes[0]) / (2 * step), abs=1e-3)


def test_factors_may_be_made_afresh(problem):
    result, system = solved(problem, Balanced(1e7), EXACT)
    fresh = newton_system(result.functional, "sparsecholesky")
    assert regularisation_part(result, fresh) == pytest.approx(
        regularisation_part(result, system), rel=1e-4
    )


def test_tichonov_term_bounds_the_regularisation_error_from_below(problem):
    """V is concave in 1/gamma with the derivative b(v, v) / 2."""
    gammas = (1e5, 1e6, 1e7)
    results = [semismooth_newton(problem, regularisation=Balanced(g)) for g in gammas]
    limit = semismooth_newton(problem, regularisation=Balanced(1e12)).dual_energy
    for r in results:
        f = r.functional
        assert f.tichonov(r.v, r.v) / 2 < r.dual_energy - limit


def test_few_steps_on_each_mesh(automatic):
    """The estimate takes no Newton step: about 7 on each mesh, 9 with a second solve for it."""
    assert max(level.iterations for level in automatic.levels) <= 8


def test_gamma_grows_where_its_part_is_too_large(problem, monkeypatch):
    """A first gamma that is 1000 times too small is found out by the estimate and raised."""
    monkeypatch.setattr("ngepc.dual.balanced.FINENESS", 0.5)
    result = solve_automatically(problem, tolerance=0.02)
    assert result.status is Status.CONVERGED
    for level in result.levels[2:]:
        assert level.regularisation <= 0.2 * max(level.discretisation, 0.02 * level.energy)
    assert abs(result.result.dual_energy / LIMIT - 1) <= 0.02
    assert result.iterations < 60


def millimetres(mesh, length=1e3, stress=1e6):
    """Example (a) with lengths in mm and stresses in Pa, from units of m and MPa."""
    for point in mesh.ngmesh.Points():
        point[0], point[1] = length * point[0], length * point[1]
    material = Material.kinematic(
        lame_lambda=1e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=1.25 * stress,
        hardening=100 * stress,
    )
    load = {"load": -10.0 * stress * outward_normal(mesh)}
    return Problem(mesh, material, "clamped", load, contact="contact", gap=0.1 * length)


def test_units_do_not_matter(automatic):
    scaled = solve_automatically(millimetres(lshape.paper_mesh(33)), tolerance=0.02)
    assert [level.iterations for level in scaled.levels] == [
        level.iterations for level in automatic.levels
    ]
    for level, other in zip(automatic.levels, scaled.levels, strict=True):
        assert other.relative_error == pytest.approx(level.relative_error, rel=1e-6)


def test_body_without_energy(problem):
    """V = 0 without loads: no error, known once two meshes can be compared."""
    result = solve_automatically(replace(problem, traction={}), max_nodes=300)
    assert result.status is Status.CONVERGED
    assert [level.relative_error for level in result.levels] == [math.inf, math.inf, 0.0]


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
