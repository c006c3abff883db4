"""Nodal forces of loads: resultants and moments of body forces, tractions and forces at points."""

import numpy as np
import pytest
from ngsolve import CF, H1, GridFunction, x, y

from ngepc import Fields, Material, Point, Problem
from ngepc.discretisation.loads import applied_forces, displacement_space, nodal
from ngepc.geometries import block

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)
SQUARE = block.structured_mesh(3, 2)


def work(problem, motion):
    """The work of the nodal forces along a motion of at most degree one."""
    space = displacement_space(problem)
    u = GridFunction(space)
    u.Set(motion)
    values = nodal(u.vec.FV().NumPy(), problem)
    return float(np.vdot(applied_forces(problem, space), values))


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
    found = [work(problem, motion) for motion in motions]
    assert found == pytest.approx(expected, abs=1e-12)


def test_fields_of_the_wrong_shape_are_named():
    problem = Problem(SQUARE, METAL)
    scalar = GridFunction(H1(SQUARE))
    with pytest.raises(ValueError, match=r"displacement has shape scalar"):
        Fields(problem, scalar, CF((0.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="plastic_increment has shape"):
        Fields(problem, GridFunction(displacement_space(problem)), CF((0.0, 0.0)))
