"""Nodal forces of loads: resultants and moments of body forces, tractions and forces at points."""

import numpy as np
import pytest
from bodies import distorted, prisms, tapered
from ngsolve import CF, H1, GridFunction, IfPos, Mesh, x, y, z

from ngepc import Fields, Material, Point, Problem
from ngepc.discretisation.loads import applied_forces
from ngepc.discretisation.spaces import displacement_space, nodal
from ngepc.geometries import block

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)
SQUARE = block.structured_mesh(3, 2)
SHAPES = {
    "triangles": lambda: block.structured_mesh(2, 2, simplices=True),
    "quadrilaterals": lambda: block.structured_mesh(2, 2),
    "tetrahedra": lambda: block.structured_mesh(2, 1, 1, simplices=True),
    "prisms": lambda: prisms(2, 1),
    "hexahedra": lambda: block.structured_mesh(2, 1, 1),
}


def works(problem, motions):
    """The works of the nodal forces along motions of at most degree one."""
    space = displacement_space(problem)
    forces = applied_forces(problem, space.components[0])
    u = GridFunction(space)
    found = []
    for motion in motions:
        u.Set(motion)
        values = nodal(u.vec.FV().NumPy(), problem)
        found.append(float(np.vdot(forces, values)))
    return found


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("load", "expected"),
    [
        ({"body_force": (0.0, -2.0)}, (0.0, -2.0, -1.0)),
        ({"body_force": CF((y, 0.0))}, (0.5, 0.0, -1 / 3)),
        ({"traction": {"right": (0.0, 3.0)}}, (0.0, 3.0, 3.0)),
        ({"traction": {"right": CF((y, 1.0))}}, (0.5, 1.0, 1.0 - 1 / 3)),
        ({"traction": {Point((1.0, 1.0)): (2.0, 5.0)}}, (2.0, 5.0, 5.0 - 2.0)),
        ({"pressure": {"right": 4.0}}, (-4.0, 0.0, 2.0)),
    ],
    ids=["weight", "varying", "traction", "varying traction", "point", "pressure"],
)
def test_resultants(load, expected, order):
    """Forces along x and y, and the moment about the origin, by hand."""
    problem = Problem(SQUARE, METAL, order=order, **load)
    motions = (CF((1.0, 0.0)), CF((0.0, 1.0)), CF((-y, x)))
    assert works(problem, motions) == pytest.approx(expected, abs=1e-12)


TAPER = 0.3
"""The part by which the top of the tapered cube is narrower."""


def moved_prisms():
    """The unit cube as prisms, the vertices inside moved."""
    mesh = prisms(3).ngmesh
    random = np.random.default_rng(2)
    for point in mesh.Points():
        if all(0.1 < point[axis] < 0.9 for axis in range(3)):
            for axis, by in enumerate(random.uniform(-0.12, 0.12, 3)):
                point[axis] += by
    for element in (*mesh.Elements3D(), *mesh.Elements2D()):
        element.curved = True
    mesh.Update()
    return Mesh(mesh)


def of_taper():
    """int x^4 + y^4 + x y z^2 over the tapered cube, by a rule in z that is exact."""
    places, weights = np.polynomial.legendre.leggauss(4)
    height = (1 + places) / 2
    width = 1 - TAPER * height
    return float((weights / 2) @ (2 / 5 * width**6 + width**4 * height**2 / 4))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("mesh", "kinematics", "expected"),
    [
        (lambda: distorted(3), None, 2 / 5),
        (lambda: distorted(3), "axisymmetric", 2 * np.pi * (1 / 6 + 1 / 10)),
        (moved_prisms, None, 2 / 5 + 1 / 12),
        (lambda: tapered(2, taper=TAPER), None, of_taper()),
    ],
    ids=["quadrilaterals", "revolution", "prisms", "hexahedra"],
)
def test_cubic_loads_do_exact_work_on_distorted_elements(
    mesh, kinematics, expected, order
):
    """The load (x^3, y^3, x y z) along the motion (x, y, z); the map of elements is not affine."""
    mesh = mesh()
    N = mesh.dim
    load = CF((x**3, y**3, x * y * z)[:N])
    data = {"kinematics": kinematics, "order": order, "body_force": load}
    problem = Problem(mesh, METAL, **data)
    assert works(problem, [CF((x, y, z)[:N])]) == pytest.approx([expected], rel=1e-13)


WIDTH = {2: 0.02, 3: 0.06}
"""Of a strip around x = 0.29: 1/25 of an edge in the plane, 1/8 in space."""


def strip(width):
    """A function with the integral one over the unit square or cube."""
    half = width / 2
    return IfPos(x - 0.29 + half, IfPos(0.29 + half - x, 1 / width, 0.0), 0.0)


@pytest.mark.parametrize(
    ("shape", "order"),
    [
        ("triangles", 1),
        ("triangles", 2),
        ("quadrilaterals", 1),
        ("quadrilaterals", 2),
        ("tetrahedra", 1),
        ("hexahedra", 1),
        ("prisms", 1),
    ],
)
def test_narrow_loads_are_not_missed(shape, order):
    """Cells that are 1/2 wide across the strip, most of whose rules have no point in it."""
    mesh = SHAPES[shape]()
    N = mesh.dim
    narrow = strip(WIDTH[N])
    rest = (0.0,) * (N - 1)
    motions = [CF((1.0, *rest)), CF((x, *rest))]

    inside = Problem(mesh, METAL, order=order, body_force=(narrow, *rest))
    assert works(inside, motions) == pytest.approx([1.0, 0.29], rel=0.05)

    pulled = {"contact": (narrow, *rest)}
    outside = Problem(mesh, METAL, order=order, traction=pulled)
    assert works(outside, motions) == pytest.approx([1.0, 0.29], rel=0.05)


def test_fields_of_the_wrong_shape_are_named():
    problem = Problem(SQUARE, METAL)
    scalar = GridFunction(H1(SQUARE))
    with pytest.raises(ValueError, match=r"displacement has shape scalar"):
        Fields(problem, scalar, CF((0.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="plastic_increment has shape"):
        Fields(problem, GridFunction(displacement_space(problem)), CF((0.0, 0.0)))
