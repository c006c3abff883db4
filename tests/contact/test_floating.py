"""Bodies that rigid obstacles alone hold: weight, closed forms, refusals by name."""

from dataclasses import replace

import numpy as np
import pytest
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import CF, GridFunction, Mesh, x, y

from ngepc import (
    Coulomb,
    Material,
    Problem,
    Status,
    error_bound,
    gradient,
    primal_newton,
    semismooth_newton,
    write_receipt,
)
from ngepc.geometries import block

WEIGHT = 3.0
COLUMN = Material.kinematic(
    lame_lambda=0.0, lame_mu=1e3, yield_stress=1e6, hardening=100.0
)
"""Without lateral strain: the body is a sum of columns that do not mix."""

SOFTER = Material.metal(young=2500, poisson=0.25, yield_stress=1.5, tangent_modulus=140)


def on_the_floor(cells, friction=None, gap=0.0, material=COLUMN, **data):
    """A block that stands on a floor under its weight, with one symmetry roller."""
    N = len(cells)
    roller = (0, *(None,) * (N - 1))
    return Problem(
        block.structured_mesh(*cells, simplices=True),
        material,
        clamped=None,
        contact="clamped",
        gap=gap,
        prescribed={"left": roller},
        body_force=(*(0.0,) * (N - 1), -WEIGHT),
        friction=friction,
        **data,
    )


@pytest.mark.parametrize(
    ("solver", "friction", "cells", "gap"),
    [
        (semismooth_newton, None, (4, 4), 0.0),
        (semismooth_newton, None, (2, 2, 2), 0.02),
        (semismooth_newton, 0.5, (4, 4), 0.02),
        (semismooth_newton, Coulomb(0.3), (4, 4), 0.0),
        (semismooth_newton, Coulomb(0.3), (2, 2, 2), 0.02),
        (primal_newton, None, (4, 4), 0.02),
        (primal_newton, 0.5, (2, 2, 2), 0.02),
        (primal_newton, Coulomb(0.3), (4, 4), 0.02),
    ],
)
def test_a_block_stands_on_the_floor(cells, friction, gap, solver):
    """u_y = -gap - w (H y - y^2/2) / (2 mu): the pressure on the floor is that of the weight."""
    result = solver(on_the_floor(cells, friction, gap, order=2))
    assert result.status is Status.CONVERGED
    assert result.contact_force == pytest.approx(WEIGHT, rel=1e-9)
    pressure = result.nodal_contact_forces / result.rows.weights
    assert pressure == pytest.approx(WEIGHT, rel=1e-7)
    places = np.array([v.point for v in result.problem.mesh.vertices])
    y = places[:, -1]
    exact = -gap - WEIGHT * (y - y**2 / 2) / (2 * COLUMN.lame_mu)
    assert result.state.u[: len(y), -1] == pytest.approx(exact, abs=1e-9)
    assert abs(result.primal_energy + result.dual_energy) < 1e-9


def test_both_programs_agree_on_a_yielding_block():
    soft = replace(COLUMN, lame_lambda=1e3, yield_stress=1.25)
    problem = on_the_floor((4, 4), Coulomb(0.3), 0.01, soft)
    one = semismooth_newton(problem).raise_for_status()
    two = primal_newton(problem).raise_for_status()
    assert one.state.at.yields.any()
    assert np.abs(one.state.u - two.state.u).max() < 1e-8
    slopes = gradient(one, "primal_energy", ["gap"])
    assert slopes["gap"] == pytest.approx(-WEIGHT, rel=1e-9)


@pytest.mark.parametrize(
    ("solver", "friction", "material"),
    [
        (semismooth_newton, None, COLUMN),
        (semismooth_newton, Coulomb(0.3), COLUMN),
        (primal_newton, None, COLUMN),
        (primal_newton, 0.5, COLUMN),
    ],
)
@pytest.mark.parametrize("stiffer", [1.0, 1e3, 1e6])
def test_a_block_falls_however_far(solver, friction, material, stiffer):
    """Its travel is up to 1e9 times its strains; only loads and gaps say how long it is."""
    stiff = replace(material, lame_mu=stiffer * material.lame_mu)
    result = solver(on_the_floor((4, 4), friction, 0.7, stiff))
    assert result.status is Status.CONVERGED
    assert result.iterations <= 4
    assert result.contact_force == pytest.approx(WEIGHT, rel=1e-7)
    assert result.displacement(result.problem.mesh(0.3, 0.0))[1] == pytest.approx(-0.7)


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 80.0])
@pytest.mark.parametrize("friction", [0.3, Coulomb(0.3)])
def test_friction_in_space_holds_as_much_in_every_direction(angle, friction):
    """The block slides where the shear exceeds .3 of the weight, not .3 of its components."""
    across = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    cube = block.structured_mesh(2, 2, 2, simplices=True)
    stands = Problem(
        cube, COLUMN, None, contact="clamped", gap=0.0, friction=friction, order=1
    )
    for part, status in ((0.99, Status.CONVERGED), (1.001, Status.UNHELD)):
        shear = [0.3 * part * c for c in across]
        result = semismooth_newton(replace(stands, traction={"contact": (*shear, -1)}))
        assert result.status is status, result.message
        if status is Status.UNHELD:
            assert "tolerance" not in result.message


@pytest.mark.parametrize("friction", [Coulomb(0.3), 0.3])
def test_a_block_that_friction_holds_only_just_finds_its_place(friction):
    """The shear is .9994 of what friction holds: the block slides before it sticks.

    Loads that differ by 1e-9 to 1e-5 take 6 to 24 steps, 103 and 128 where a step along the motion
    that is nearest to it tilts the block.
    """
    cube = block.structured_mesh(2, 2, 2, simplices=True)
    floor = {"contact": "clamped", "gap": 0.0, "friction": friction}
    problem = Problem(cube, SOFTER, None, {"contact": (0.212, 0.212, -1.0)}, **floor)
    result = semismooth_newton(problem)
    assert result.status is Status.CONVERGED
    assert result.iterations <= 40
    assert result.friction_force == pytest.approx((-0.212, -0.212, 0), abs=1e-8)


def test_large_forces_that_move_a_part_are_said_without_a_tolerance():
    """Where they are all that acts, no tolerance is advised."""
    discrete = semismooth_newton(on_the_floor((3, 3), traction=None)).state.discrete
    moving = discrete.floating.springs * discrete.floating.motions[:, :, 0]
    moving *= WEIGHT / np.linalg.norm(moving)
    discrete.load = moving
    said = discrete.at_rest().drifting
    assert "contact and friction hold it only just" in said
    assert "tolerance" not in said


@pytest.mark.parametrize("friction", [None, 0.3])
def test_what_is_moved_until_it_touches_is_not_called_out_of_balance(friction):
    """Supports move the block up to the obstacle; then 1e-8 further, which presses it."""
    for further, said in ((0.0, True), (1e-8, False)):
        problem = Problem(
            block.structured_mesh(4, 4, simplices=True),
            *(SOFTER, None),
            prescribed={"clamped": (0, 0.1 + further)},
            contact="contact",
            gap=0.1,
            friction=friction,
        )
        message = semismooth_newton(problem).message
        assert ("the contact forces are rounding errors" in message) == said
        assert "out of balance" not in message


def test_whatever_lifts_a_block_is_said():
    up = on_the_floor((4, 4), traction={"contact": (0.0, 4.0)})
    result = semismooth_newton(up)
    assert result.status is Status.UNHELD
    assert "Contact cannot hold the part around (0.5, 0.5)" in str(result)


def test_what_needs_supports_says_so(tmp_path):
    problem = on_the_floor((4, 4), kinematics="two-dimensional", order=1)
    assert "held by contact" in problem.features
    with pytest.raises(ValueError, match="needs supports that hold every part"):
        semismooth_newton(problem, gamma=1e3)
    result = semismooth_newton(problem)
    assert error_bound(result).total < 0.5 * error_bound(result).strain_energy
    with pytest.raises(ValueError, match="a receipt needs supports that hold"):
        write_receipt(result, tmp_path / "receipt.npz")


def test_print_shows_the_message():
    """What ``print`` shows is the summary and, below it, what a user must know."""
    far = on_the_floor((4, 4), traction={"right": (400.0, 0.0)})
    result = semismooth_newton(far)
    assert result.message
    first, *others = str(result).split("\n")
    assert first == repr(result)
    assert "\n".join(others) == result.message


def pin(springs, friction):
    """A round pin of order two above a floor, pressed against it by its weight of 10 pi."""
    face = WorkPlane().Circle(0, 0, 1).Face()
    face.edges.name = "rim"
    mesh = Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=0.25)).Curve(2)
    steel = Material.kinematic(
        lame_lambda=1.2e5, lame_mu=8e4, yield_stress=250.0, hardening=1e3
    )
    held = {"clamped": None, "springs": {"rim": springs}, "friction": friction}
    load = {"body_force": (0.0, -10.0), "contact": "rim", "gap": y + 1.01}
    return Problem(mesh, steel, kinematics="plane strain", order=2, **held, **load)


@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("stiffness", [1e-3, 1e-1])
def test_springs_much_softer_than_a_pin_let_it_find_the_floor(stiffness, friction):
    """Without a floor it would travel 5000 diameters; after .01 the springs carry little."""
    result = semismooth_newton(pin((stiffness, stiffness), friction))
    assert result.raise_for_status().residual_norm <= 1e-10
    carried = -result.applied_force[1] - result.contact_resultant[1]
    assert carried == pytest.approx(2 * np.pi * 0.01 * stiffness, rel=0.4)


def test_a_rotation_that_springs_do_not_hold_is_said():
    """A foundation along the normals of a circle leaves its rotation to rounding errors."""
    pushed = replace(pin(1e-3, None), body_force=(30.0, -10.0))
    result = semismooth_newton(pushed)
    assert result.status is Status.STAGNATED
    assert "against one of its rigid motions" in result.message


@pytest.mark.parametrize(
    ("friction", "loose"), [(None, 3), (0.01, 0), (Coulomb(0.05), 0)]
)
def test_rows_that_slip_determine_the_motion_across(friction, loose):
    """The foot of a cube spreads and slips outwards around its centre, and cannot turn."""
    cube = block.structured_mesh(2, 2, 2, simplices=True)
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=1e3, plastic_modulus=100.0
    )
    stands = Problem(
        cube,
        metal,
        clamped=None,
        pressure={"clamped": 1.0},
        contact="contact",
        gap=0.0,
        friction=friction,
    )
    result = semismooth_newton(stands).raise_for_status()
    assert result.undetermined_motions == loose
    if loose:
        return
    turned = GridFunction(result.displacement.space)
    turned.Set(result.displacement + 1e-4 * CF((0.5 - y, x - 0.5, 0)))
    again = semismooth_newton(stands, start=turned)
    u, v = (r.displacement.vec.FV().NumPy() for r in (result, again))
    np.testing.assert_allclose(v, u, atol=1e-8 * np.abs(u).max())
