"""What RELIABILITY.md promises of the exact method, on bodies of every shape.

``local/test_exactness.py`` has each of them with each order.
"""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import VOL, x
from ngsolve.meshes import MakeStructured3DMesh

from ngepc import (
    Material,
    NewtonOptions,
    Problem,
    lshape_problem,
    outward_normal,
    semismooth_newton,
    wrench_problem,
)
from ngepc.geometries import block, lshape, ring, wrench

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
OBSTACLE = 0.3 * (x - 0.3) ** 2 - 0.01
ROLLERS = {"clamped": (None, 0), "left": (0, None)}


def square(kinematics, *, simplices):
    supports = {"clamped": "clamped"}
    if kinematics == "axisymmetric":
        supports = {"clamped": None, "prescribed": ROLLERS}
    mesh = block.structured_mesh(6, 6, simplices=simplices)
    return Problem(
        mesh, STEEL, **supports, contact="contact", gap=OBSTACLE, kinematics=kinematics
    )


def cube(mesh, clamped="clamped", contact="contact"):
    return Problem(mesh, STEEL, clamped, contact=contact, gap=OBSTACLE)


def curved_ring():
    mesh = ring.quarter_mesh(0.15)
    mesh.Curve(2)
    rollers = {"left": (0, None), "bottom": (None, 0)}
    load = {"inner": -1.5 * outward_normal(mesh)}
    return Problem(
        mesh, STEEL, None, load, prescribed=rollers, contact="outer", gap=4e-4
    )


BODIES = {
    "Example (a)": lambda: lshape_problem(lshape.paper_mesh(225)),
    "Example (a), plane strain": lambda: replace(
        lshape_problem(lshape.paper_mesh(225)), kinematics="plane strain"
    ),
    "Example (b)": lambda: wrench_problem(wrench.paper_mesh(245)),
    "triangles": lambda: square("plane strain", simplices=True),
    "quadrilaterals": lambda: square("plane strain", simplices=False),
    "triangles, axisymmetric": lambda: square("axisymmetric", simplices=True),
    "quadrilaterals, axisymmetric": lambda: square("axisymmetric", simplices=False),
    "tetrahedra": lambda: cube(block.structured_mesh(3, 3, 3, simplices=True)),
    "hexahedra": lambda: cube(block.structured_mesh(3, 3, 3)),
    "prisms": lambda: cube(
        MakeStructured3DMesh(nx=3, ny=3, nz=3, prism=True), "bottom", "top"
    ),
    "curved triangles": curved_ring,
}


@pytest.fixture(
    scope="module", params=[(b, 1 + k % 2) for k, b in enumerate(BODIES)], ids=str
)
def solved(request):
    body, order = request.param
    sharp = NewtonOptions(tolerance=1e-12)
    result = semismooth_newton(replace(BODIES[body](), order=order), options=sharp)
    assert str(result.status) == "converged"
    return result


def test_certificate(solved):
    assert abs(solved.primal_energy + solved.dual_energy) < 1e-12 * abs(
        solved.primal_energy
    )


def test_forces_balance_and_nothing_penetrates(solved):
    forces = np.stack([solved.applied_force, solved.contact_resultant, solved.reaction])
    first = 1 if solved.problem.kinematics.hoop else 0  # a radial sum is no force
    assert abs(forces.sum(axis=0)[first:]).max() < 1e-10 * abs(forces).max()
    assert solved.state.penetration < 1e-12  # of the rows
    assert solved.penetration < 1e-12 + overlap_between_nodes(solved.problem)


def overlap_between_nodes(problem):
    """What interpolation of the gap leaves: none at order two on straight facets.

    At order one the error of linear interpolation, h^2/8 times the second derivative .6 of the
    gap; on curved facets normals vary, and a hundred-thousandth of the gap is allowed.
    """
    if isinstance(problem.gap, float):
        return 1e-5 * problem.gap if problem.mesh.GetCurveOrder() > 1 else 0.0
    if problem.order == 2:
        return 0.0
    cells = 6 if problem.N == 2 else 3
    return 0.6 / 8 / cells**2


def test_no_point_is_beyond_yield(solved):
    points = solved.problem.mesh.MapToAllElements(solved.discrete.points.rules, VOL)
    assert np.max(solved.yield_function(points)) < 1e-10 * solved.problem.beta
