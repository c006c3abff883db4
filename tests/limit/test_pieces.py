"""Pieces of limit loads beside plain statements: widths, units, moving supports, mechanisms."""

import math

import numpy as np
import pytest

from ngepc import Material, Problem, limit_load
from ngepc.geometries import block
from ngepc.limit.bracket import bracket_on
from ngepc.limit.data import GROWS
from ngepc.limit.fields import corner_values
from ngepc.limit.load import width_of
from ngepc.limit.reading import limit_data
from ngepc.limit.yielding import SHAPES

CLAY = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=math.sqrt(2), hardening=1.0
)
"""Shear yield stress one."""


def test_widths():
    """(upper - lower) / |lower|; without one of the bounds, or a scale, there is none."""
    assert width_of(2.0, 3.0) == 0.5
    assert width_of(-2.0, -1.0) == 0.5
    for lower, upper in ((0.0, 1.0), (1.0, math.inf), (-math.inf, 1.0)):
        assert width_of(lower, upper) == math.inf


@pytest.mark.parametrize("loads", [{"traction": 2e-3}, {"body_force": -5e-4}])
def test_numbers_without_units_are_about_one(loads):
    """The largest length, yield bound and load are in [1, 2), also for loads that are small.

    Units are powers of two: numbers keep their digits.
    """
    ((name, size),) = loads.items()
    given = (size, 0.0)
    data = {name: {"right": given} if name == "traction" else given}
    mesh = block.structured_mesh(2, 2, size=(4.0, 1.0), simplices=True)
    names = ("right",) if name == "traction" else (name,)
    plain, unit = limit_data(Problem(mesh, CLAY, "left", **data), names).without_units()
    assert 1 <= np.ptp(plain.cells.points, axis=0).max() < 2
    assert 1 <= plain.bound.max() < 2
    largest = max(np.abs(plain.force[GROWS]).max(), np.abs(plain.traction[GROWS]).max())
    assert 1 <= largest < 2
    assert math.log2(unit) == int(math.log2(unit))
    stress = math.sqrt(2) / plain.bound.max()
    load = abs(size) * (4.0 if name == "body_force" else 1.0)
    assert unit * load / largest == pytest.approx(stress)


def test_a_smooth_plate_moves_a_square():
    """The force is the uniform stress in plane strain, twice the shear yield stress."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None), "contact": (None, -1)}
    found = limit_load(Problem(mesh, CLAY, None, prescribed=supports), 1e-3)
    assert found.lower == pytest.approx(2.0, rel=1e-6)
    assert found.upper == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("size", [1e-2, 1.0])
def test_a_mechanism_in_space_dissipates_what_it_says(size):
    """Strain rates are the gradients of the velocity; cells and slips dissipate the upper bound."""
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    problem = Problem(mesh, CLAY, "clamped", traction={"contact": (size, 0, 0)})
    data = limit_data(problem, ("contact",))
    shape = SHAPES["solid"]
    bracket, _ = bracket_on(data, shape, None)
    found = bracket.mechanism
    cells = data.cells
    corners = corner_values(found.values, found.degree)
    gradients = np.einsum("tai,taj->tij", corners, cells.gradients)
    rates = np.einsum("tij,cij->tc", gradients, shape.basis)
    assert np.abs(rates).max() > 0
    np.testing.assert_allclose(
        found.strain[:, 0], rates, atol=1e-9 * np.abs(rates).max()
    )
    deviators = np.linalg.norm(rates[:, shape.free :], axis=1)
    dissipated = data.bound * cells.volume * deviators
    np.testing.assert_allclose(found.dissipated, dissipated, atol=1e-9 * found.factor)
    total = dissipated.sum() + found.slipped.sum()
    assert total == pytest.approx(found.factor, rel=1e-6)
    assert bracket.lower <= bracket.upper
