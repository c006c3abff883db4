"""How many Newton steps: upper bounds that the method has to keep."""

import dataclasses

import pytest
from ngsolve import sqrt, x, y

from ngepc import Problem, lshape_problem, semismooth_newton, wrench_problem
from ngepc.geometries import block, lshape, wrench
from ngepc.model.material import Material

LSHAPE, WRENCH = (417, 833, 1601, 3201), (873, 1641, 3281, 6353)


def cold_and_nested(problem_of, meshes):
    """Steps from zero, and from the solution on the mesh before."""
    cold, nested, coarser = [], [], None
    for mesh in meshes:
        problem = problem_of(mesh)
        cold.append(semismooth_newton(problem).raise_for_status())
        coarser = semismooth_newton(problem, start=coarser).raise_for_status()
        nested.append(coarser)
        assert coarser.primal_energy == pytest.approx(cold[-1].primal_energy, rel=1e-12)
    return [r.iterations for r in cold], [r.iterations for r in nested]


def test_example_a():
    cold, nested = cold_and_nested(lshape_problem, map(lshape.paper_mesh, LSHAPE))
    assert max(cold) <= 11
    assert sum(nested) <= 26


def test_example_b():
    cold, nested = cold_and_nested(wrench_problem, map(wrench.paper_mesh, WRENCH))
    assert max(cold) <= 8
    assert sum(nested) <= 22


@pytest.mark.parametrize(
    ("nodes", "ratio", "most"),
    [
        *(
            (833, r, n)
            for r, n in ((1, 5), (1e-1, 10), (1e-2, 15), (1e-3, 22), (1e-4, 25))
        ),
        *((1601, r, n) for r, n in ((1e-1, 11), (1e-3, 22))),
    ],
)
def test_small_hardening(nodes, ratio, most):
    """Example (a) with h/mu varied: fewer steps than the primal method at every ratio."""
    problem = lshape_problem(lshape.paper_mesh(nodes))
    mu = 1e3
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=mu, yield_stress=1.25, hardening=ratio * mu
    )
    result = semismooth_newton(dataclasses.replace(problem, material=material))
    assert result.iterations <= most
    assert result.residual_norm <= max(1e-10, result.residual_rounding)


def indented_block(mesh, ratio):
    """A sphere of radius 1 pressed 0.03 into the unit cube, h/mu given."""
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=ratio * 1e3
    )
    gap = 1.0 - sqrt(1.0 - (x - 0.5) ** 2 - (y - 0.5) ** 2) - 0.03
    return Problem(mesh, steel, contact="contact", gap=gap)


@pytest.mark.parametrize(
    ("shape", "ratio", "most"), [("tetrahedra", 1e-3, 12), ("hexahedra", 1e-1, 10)]
)
def test_sphere_on_a_block(shape, ratio, most):
    """Cells and their halves, displacements of order two: the same few steps."""
    for level in (0, 1):
        mesh = block.structured_mesh(*3 * [2 * (level + 1)])
        if shape == "tetrahedra":
            mesh = block.mesh(maxh=0.4)
            for _ in range(level):
                mesh.Refine()
        problem = indented_block(mesh, ratio)
        result = semismooth_newton(problem).raise_for_status()
        assert result.iterations <= most
        gap = result.primal_energy + result.dual_energy
        assert abs(gap) < 1e-12 * abs(result.primal_energy)
