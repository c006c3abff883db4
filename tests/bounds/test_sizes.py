"""Bounds in extreme units: they scale as energies, forces and lengths do, or are refused."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import Mesh

from ngepc import (
    Material,
    MeanDisplacement,
    Problem,
    Roller,
    confidence,
    error_bound,
    goal_bound,
    semismooth_newton,
)
from ngepc.bounds.sizes import check_sizes, nothing_moves
from ngepc.geometries import block
from ngepc.local.system import DiscreteProblem

COUNTS = {2: (2, 2), 3: (1, 1, 1)}
PULL = {2: (2.0, 1.5), 3: (2.0, 0.5, 1.0)}


def in_units(N, stress, length):
    """A block that yields below a flat obstacle, in other units of stress and length."""
    mesh = block.structured_mesh(*COUNTS[N], simplices=True).ngmesh
    for point in mesh.Points():
        for axis in range(N):
            point[axis] *= length
    mesh.Update()
    metal = Material.kinematic(
        lame_lambda=stress,
        lame_mu=stress,
        yield_stress=1.25e-3 * stress,
        hardening=0.1 * stress,
    )
    return Problem(
        Mesh(mesh),
        metal,
        traction={"right": tuple(1e-3 * stress * part for part in PULL[N])},
        contact="contact",
        gap=3e-4 * length,
        order=1,
    )


def numbers(N, stress, length):
    """An energy, a force and the width of an interval of a displacement, without units."""
    result = semismooth_newton(in_units(N, stress, length))
    force = stress * length ** (N - 1)
    return [
        error_bound(result).total / (force * length),
        goal_bound(result, "contact_force").upper / force,
        goal_bound(result, MeanDisplacement("right", 0)).width / length,
    ]


@pytest.fixture(scope="module")
def plain():
    """The numbers in units of one, by dimension."""
    return {N: numbers(N, 1.0, 1.0) for N in (2, 3)}


@pytest.mark.parametrize(
    ("N", "stress", "length"),
    [
        (2, 1e100, 1.0),
        (2, 1e-95, 1.0),
        (2, 1e50, 1e-49),
        (2, 1e-90, 1e48),
        (3, 1e100, 1.0),
        (3, 1e-95, 1.0),
        (3, 1.0, 1e-30),
        (3, 1e-10, 1e30),
    ],
)
def test_bounds_do_not_depend_on_units(N, stress, length, plain):
    """In space the search for the stress ends at a tolerance, with other digits in other units."""
    found = numbers(N, stress, length)
    assert found == pytest.approx(plain[N], rel=1e-8 if N == 2 else 1e-2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((1e-150, 1.0, 1.0), "the least shear modulus is 1.0e-150"),
        ((1e110, 1.0, 1.0), "the least shear modulus is 1.0e"),
        ((1.0, 1e-60, 1.0), "the volume of the body is 1.0e-120"),
        ((1.0, 1.0, 1e-170), "the largest force at a node is"),
        ((1.0, 1.0, 1e-60), "stiffness times the square of the displacement is"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_numbers_that_are_lost_are_refused_by_name(change, message):
    """With moduli of 1e-110 the bound was negative, with forces of 1e-170 it was zero."""
    stress, length, part = change
    problem = in_units(2, stress, length)
    pull = tuple(np.multiply(problem.traction["right"], part))
    result = semismooth_newton(replace(problem, traction={"right": pull}))
    for bound in (error_bound, lambda r: goal_bound(r, "work")):
        with pytest.raises(ValueError, match=message):
            bound(result)
    assert message in confidence(result)


@pytest.mark.parametrize("pulled", [False, True])
def test_rounding_errors_of_a_body_at_rest_are_no_displacement(pulled):
    """Displacements of 1e-172 are refused unless nothing moves the body."""
    problem = in_units(2, 1.0, 1.0)
    pull = tuple(1e-170 * np.array(problem.traction["right"]))
    loads = {"right": pull} if pulled else None
    result = semismooth_newton(replace(problem, traction=loads))
    u = result.state.u
    nearly = replace(result.state, u=np.where(u, u, 1e-172))
    if not pulled:
        check_sizes(nearly)
        return
    with pytest.raises(ValueError, match="largest"):
        check_sizes(nearly)


@pytest.mark.parametrize("value", [0.0, 1e-170, -1e-170])
def test_a_roller_that_moves_moves_the_body(value):
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=0.1
    )
    roller = {"right": Roller((1, 1), value)}
    problem = Problem(mesh, metal, "left", prescribed=roller, order=1)
    assert nothing_moves(DiscreteProblem(problem)) == (value == 0)
