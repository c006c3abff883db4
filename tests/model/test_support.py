"""Supports beside an obstacle: what is given must not overlap it."""

import pytest

from ngepc import Material, Problem
from ngepc.geometries import block

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)


@pytest.mark.parametrize(("lifted", "gap"), [(0.2, 0.1), (0.0, -0.1), (-0.1, -0.2)])
def test_a_side_is_not_moved_into_the_obstacle_above(lifted, gap):
    """Its upper corner belongs to the contact boundary; as far as the gap it may be moved."""
    mesh = block.structured_mesh(2, 2)
    given = {"clamped": None, "contact": "contact"}
    sides = {"right": (None, lifted), "clamped": (0, None)}
    with pytest.raises(ValueError, match="must not exceed the gap there"):
        Problem(mesh, METAL, prescribed=sides, gap=gap, **given)
    Problem(mesh, METAL, prescribed=sides, gap=lifted, **given)
    Problem(mesh, METAL, prescribed=sides, gap=lifted + 0.1, **given)
