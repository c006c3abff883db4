"""Thermal and other initial strains in closed form, by both methods, and in histories."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, Id, Integrate, Norm, x, y

from ngepc import (
    Material,
    Problem,
    Swift,
    evolve,
    lame_parameters,
    load_cycle,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.results.fields import frobenius

E, NU = 200e3, 0.3
LAW = Swift(250.0, 0.004, 0.2)
ELASTIC = dict(zip(("lame_lambda", "lame_mu"), lame_parameters(E, NU), strict=True))
STEEL = Material.with_law(**ELASTIC, law=LAW)
ROLLERS = {"clamped": (None, 0), "left": (0, None)}

both_methods = pytest.mark.parametrize("method", [semismooth_newton, primal_newton])


def solved(problem, method):
    result = method(problem).raise_for_status()
    gap = abs(result.primal_energy + result.dual_energy)
    assert gap <= 1e-9 * abs(result.primal_energy) + 1e-16 * E
    return result


@both_methods
def test_free_expansion_is_without_stress(method):
    """u = a x, in a body of revolution and in space: the energy is zero too."""
    for mesh, kinematics in (
        (block.structured_mesh(3, 3), "axisymmetric"),
        (block.structured_mesh(2, 2, 2, simplices=True), "solid"),
    ):
        prescribed = ROLLERS
        if mesh.dim == 3:
            prescribed = {
                "clamped": (None, None, 0), "left": (0, None, None), "front": (None, 0, None),
            }  # fmt: skip
        problem = Problem(
            mesh,
            STEEL,
            None,
            prescribed=prescribed,
            kinematics=kinematics,
            initial_strain=0.01,
        )
        result = solved(problem, method)
        corner = (1.0,) * mesh.dim
        assert np.array(result.displacement(mesh(*corner))) == pytest.approx(
            0.01 * np.array(corner), rel=1e-10
        )
        assert Integrate(frobenius(result.stress), mesh) < 1e-9 * E * 0.01
        assert abs(result.primal_energy) < 1e-15 * E


@both_methods
def test_a_body_that_cannot_expand(method):
    """sigma = -3 K a I, elastic however large, in plane strain as in space."""
    mesh = block.structured_mesh(2, 2)
    sides = {"|".join(mesh.GetBoundaries()): (0, 0)}
    result = solved(
        Problem(mesh, STEEL, None, prescribed=sides, initial_strain=0.02), method
    )
    bulk = E / (1 - 2 * NU) * 0.02
    assert Integrate(frobenius(result.stress + bulk * Id(3)), mesh) < 1e-9 * bulk
    assert result.history.records[-1].plastic_active == 0


@both_methods
@pytest.mark.parametrize("strain", [0.001, 0.02])
def test_a_bar_between_walls(method, strain):
    """sigma = -E (a - PEEQ), with R(PEEQ) = |sigma| where it yields; u_r = a + nu sigma/E ..."""
    mesh = block.structured_mesh(2, 2)
    problem = Problem(
        mesh,
        STEEL,
        None,
        prescribed=ROLLERS | {"contact": (None, 0)},
        kinematics="axisymmetric",
        initial_strain=CF(strain) * Id(3),
    )
    result = solved(problem, method)
    peeq = 0.0
    if E * strain > 250:
        low, high = 0.0, strain
        for _ in range(100):
            peeq = 0.5 * (low + high)
            low, high = (
                (peeq, high) if E * (strain - peeq) > LAW.stress(peeq) else (low, peeq)
            )
    stress = E * (strain - peeq)
    there = mesh(0.3, 0.4)
    assert result.von_mises(there) == pytest.approx(stress, rel=1e-9)
    assert result.accumulated_plastic_strain(there) == pytest.approx(
        peeq, rel=1e-8, abs=1e-14
    )
    radial = strain + NU * stress / E + peeq / 2
    assert result.displacement(mesh(1.0, 0.5))[0] == pytest.approx(radial, rel=1e-9)


def test_heating_and_cooling_leave_tension():
    """A bar between walls, heated until it yields and cooled again: sigma = E PEEQ < R(PEEQ)."""
    mesh, strain = block.structured_mesh(1, 1), 0.002
    problem = Problem(
        mesh,
        STEEL,
        None,
        prescribed=ROLLERS | {"contact": (None, 0)},
        kinematics="axisymmetric",
        initial_strain=strain,
    )
    hot, cold = (s.fields for s in evolve(problem, load_cycle(problem, [1, 0])).steps)
    there = mesh(0.4, 0.4)
    peeq = hot.accumulated_plastic_strain(there)
    assert hot.stress(there)[4] == pytest.approx(-LAW.stress(peeq), rel=1e-9)
    assert cold.stress(there)[4] == pytest.approx(E * peeq, rel=1e-9)
    assert cold.accumulated_plastic_strain(there) == pytest.approx(peeq, rel=1e-12)


def test_methods_agree_under_a_temperature_field():
    """An uneven field with contact: u to 1e-10, J + J* = 0."""
    problem = Problem(
        block.structured_mesh(6, 6, simplices=True),
        replace(STEEL, hardening=1e3),
        contact="contact",
        gap=0.002,
        initial_strain=0.01 * y * (1 + x),
        order=2,
    )
    one, two = solved(problem, semismooth_newton), solved(problem, primal_newton)
    assert np.abs(one.state.u - two.state.u).max() < 1e-10 * np.abs(one.state.u).max()
    assert one.contact_force > 1
    assert one.state.at.yields.any()
    assert Integrate(Norm(one.displacement), problem.mesh) > 0
    assert math.isfinite(one.dual_energy)


LINEAR = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
WARM = {"initial_strain": 0.01, "mesh": block.structured_mesh(2, 2, simplices=True)}


def test_the_regularised_method_knows_no_initial_strain():
    problem = Problem(material=LINEAR, **WARM)
    with pytest.raises(ValueError, match=r"initial_strain=0\.01"):
        semismooth_newton(problem, gamma=1e3)
