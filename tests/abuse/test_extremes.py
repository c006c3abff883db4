"""Arguments that failed late: errors that no mesh reaches, classes, coefficients."""

import pytest
from ngsolve import x

from ngepc import (
    Problem,
    evolve,
    lshape_problem,
    primal_newton,
    semismooth_newton,
    solve_to,
)
from ngepc.geometries import lshape
from ngepc.model.material import Material

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
)


@pytest.mark.parametrize("error", [1e-320, 1e-13, 1.0, 2])
def test_errors_within_rounding_or_beyond_all_are_refused(error):
    problem = lshape_problem(lshape.paper_mesh(33))
    with pytest.raises(ValueError, match=f"relative_error={error}.*>= 1e-12 and < 1"):
        solve_to(problem, error)
    with pytest.raises(ValueError, match=f"error={error}.*>= 1e-12 and < 1"):
        evolve(problem, [(1.0, {})], error=error)


@pytest.mark.parametrize("mesh", [Problem, lshape, None, 3])
def test_what_is_no_mesh_is_named(mesh):
    with pytest.raises(TypeError, match=r"mesh=.*: an ngsolve\.Mesh is needed"):
        Problem(mesh, STEEL)


@pytest.mark.parametrize("solve", [semismooth_newton, primal_newton])
def test_a_coefficient_is_no_monitor(solve):
    problem = lshape_problem(lshape.paper_mesh(33))
    with pytest.raises(TypeError, match=r"monitor=.*a function of a record is needed"):
        solve(problem, monitor=x)
