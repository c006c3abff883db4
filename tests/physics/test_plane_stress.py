"""Plane stress against closed forms: bar, disc, ring to its limit, contact, thickness."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ngepc import (
    Coulomb,
    Material,
    Problem,
    Swift,
    Tabulated,
    Voce,
    error_bound,
    evolve,
    lame_parameters,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.model.hardening import HardeningLaw
from ngepc.sensitivity.gradient import gradient
from ngepc.studies import material_problems
from ngepc.studies.material_problems import RADII

YOUNG = 1000.0
POISSON = 0.3
YIELD = 1.0
PLASTIC = 50.0  # d stress / d plastic strain of a bar
LAMBDA, MU = lame_parameters(YOUNG, POISSON)
ELASTIC = {"lame_lambda": LAMBDA, "lame_mu": MU}
LINEAR = Material.kinematic(
    **ELASTIC, yield_stress=np.sqrt(2 / 3) * YIELD, hardening=2 / 3 * PLASTIC
)
THIN = {"kinematics": "plane stress"}


def sheet(material=LINEAR, n=2, **data):
    """A square sheet on two frictionless sides."""
    mesh = block.structured_mesh(n, n, size=(1.0, 1.0), simplices=True)
    held = {"left": (0, None), "clamped": (None, 0)}
    return Problem(mesh, material, clamped=None, prescribed=held, **THIN | data)


def at_middle(value, problem):
    return np.array(value(problem.mesh(0.4, 0.3))).reshape(3, 3)


@dataclass(frozen=True, eq=False)
class Straight(HardeningLaw):
    """A law of one's own: R = YIELD + PLASTIC x."""

    gain: float = PLASTIC

    def energy(self, x):
        return YIELD * x + self.gain * x**2 / 2

    def stress(self, x):
        return YIELD + self.gain * x

    def slope(self, x):
        return self.gain + 0.0 * x


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("law", [None, Straight()])
def test_a_bar(order, law):
    """Strains and stresses of the tensile test; eps_zz equals eps_yy."""
    tension = 1.5
    material = LINEAR if law is None else Material.with_law(**ELASTIC, law=law)
    problem = sheet(material, traction={"right": (tension, 0.0)}, order=order)
    result = semismooth_newton(problem)
    plastic = (tension - YIELD) / PLASTIC
    along = tension / YOUNG + plastic
    across = -POISSON * tension / YOUNG - plastic / 2
    strain = at_middle(result.strain, problem)
    assert strain == pytest.approx(np.diag([along, across, across]), abs=1e-9 * along)
    stress = at_middle(result.stress, problem)
    assert stress == pytest.approx(np.diag([tension, 0, 0]), abs=1e-9 * tension)
    energy = result.primal_energy
    assert energy + result.dual_energy == pytest.approx(0, abs=1e-12 * abs(energy))


def test_a_sheet_pulled_on_all_sides_and_unloaded():
    """Equal stresses in the plane yield at the yield stress of a bar: eps_zz = -2 of the others."""
    tension = 1.4
    sides = {"right": (tension, 0.0), "contact": (0.0, tension)}
    steps = [(1.0, {"traction": sides}), (2.0, {"traction": {}})]
    run = evolve(sheet(traction=sides), steps).raise_for_status()
    plastic = (tension - YIELD) / PLASTIC / 2
    loaded, unloaded = (step.fields for step in run.steps)
    expected = (1 - POISSON) * tension / YOUNG + plastic
    strain = at_middle(loaded.strain, run.problem)
    assert strain[:2, :2] == pytest.approx(expected * np.eye(2), abs=1e-9)
    thinning = -2 * POISSON * tension / YOUNG - 2 * plastic
    assert strain[2, 2] == pytest.approx(thinning, rel=1e-8)
    left = at_middle(unloaded.strain, run.problem)
    assert left == pytest.approx(np.diag([plastic, plastic, -2 * plastic]), abs=1e-9)


def test_a_sheet_between_rigid_sides():
    """Plane stress in one direction alone: pulled where the other side cannot move."""
    held = {"left": (0, None), "clamped": (None, 0), "contact": (None, 0)}
    problem = sheet(traction={"right": (0.5, 0.0)}).changed(prescribed=held)
    result = semismooth_newton(problem)
    stress = at_middle(result.stress, problem)
    assert stress == pytest.approx(np.diag([0.5, POISSON * 0.5, 0]), abs=1e-10)


@pytest.mark.parametrize("change", [replace, Problem.changed])
def test_thickness_multiplies_forces_and_energies(change):
    load = {"traction": {"right": (1.5, 0.0)}}
    one = semismooth_newton(sheet(**load))
    thick = semismooth_newton(change(one.problem, thickness=0.4))
    assert thick.primal_energy == pytest.approx(0.4 * one.primal_energy, rel=1e-12)
    pulled = thick.equilibrium.reactions["left"][0]
    assert pulled == pytest.approx(-0.4 * 1.5, rel=1e-10)
    assert np.abs(thick.state.u - one.state.u).max() < 1e-13
    with pytest.raises(ValueError, match=r"thickness=2.0 with kinematics='axisym"):
        sheet(**load).changed(kinematics="axisymmetric", thickness=2.0)
    with pytest.raises(ValueError, match="thickness=0:"):
        sheet(**load, thickness=0)


def quarter_ring(n, material, pressure, **data):
    """A quarter of a ring under inner pressure, of curved quadrilaterals."""
    mesh = material_problems.quarter_ring(n)
    held = {"bottom": (None, 0), "top": (0, None)}
    given = {"prescribed": held, "pressure": {"left": pressure}, "order": 2}
    return Problem(mesh, material, clamped=None, **given, **THIN | data)


def limit_pressure():
    """Where the whole ring yields (Nadai): d sigma_r/dr = (sigma_t - sigma_r)/r on the ellipse."""

    def slope(r, radial):
        s = radial[0]
        around = (s + np.sqrt(max(4 * YIELD**2 - 3 * s**2, 0.0))) / 2
        return [(around - s) / r]

    run = solve_ivp(slope, RADII[::-1], [0.0], rtol=1e-10, atol=1e-12)
    return float(-run.y[0, -1])


def test_an_elastic_ring():
    """Lame's solution."""
    pressure = 0.1
    problem = quarter_ring(8, LINEAR, pressure)
    result = semismooth_newton(problem)
    a, b = RADII
    c = pressure * a**2 / (b**2 - a**2)
    moved = c / YOUNG * ((1 - POISSON) * b + (1 + POISSON) * b)
    found = result.displacement(problem.mesh(b * (1 - 1e-6), 1e-6))[0]
    assert found == pytest.approx(moved, rel=1e-3)  # a polygon


def test_a_ring_to_its_limit():
    """Perfect plasticity carries the pressure below Nadai's limit, not that above it."""
    perfect = Material.with_law(**ELASTIC, law=Tabulated((0.0,), (YIELD,)))
    limit = limit_pressure()
    assert 0.35 < limit < 2 / np.sqrt(3) * np.log(1.5) * YIELD
    below = semismooth_newton(quarter_ring(4, perfect, 0.99 * limit))
    assert below.status.is_success
    above = semismooth_newton(quarter_ring(4, perfect, 1.01 * limit))
    assert above.status.label == "limit load" or not above.status.is_success


@pytest.mark.parametrize("law", [None, Voce(1.0, 0.5, 40.0), Swift(1.0, 0.01, 0.3)])
def test_contact_friction_certificate_and_bound(law):
    """A sheet pressed by a wall that it rubs on."""
    material = (
        LINEAR if law is None else Material.with_law(**ELASTIC, law=law, hardening=20)
    )
    data = {"contact": "contact", "gap": -0.004, "traction": {"right": (0.6, 0.2)}}
    problem = sheet(material, n=4, **data)
    result = semismooth_newton(problem.changed(friction=Coulomb(0.2)))
    assert result.status.is_success
    assert result.contact_force > 0.5
    assert result.plastic_increment.vec.Norm() > 0
    fine = semismooth_newton(sheet(material, n=8, **data))
    for order in (1, 2):
        bound = error_bound(semismooth_newton(problem.changed(order=order)))
        assert 0 < bound.energy - fine.primal_energy <= bound.total


def test_gradients():
    def solved(E):
        lam, mu = lame_parameters(E, POISSON)
        material = Material.with_law(
            lame_lambda=lam, lame_mu=mu, law=Voce(1, 0.5, 40.0)
        )
        return semismooth_newton(sheet(material, n=3, traction={"right": (1.2, 0.3)}))

    result = solved(YOUNG)
    found = gradient(result, "primal_energy", ["lame_lambda", "lame_mu"])
    by_young = found["lame_lambda"] * LAMBDA / YOUNG + found["lame_mu"] * MU / YOUNG
    step = 1e-3 * YOUNG
    ahead = solved(YOUNG + step).primal_energy
    behind = solved(YOUNG - step).primal_energy
    assert by_young == pytest.approx((ahead - behind) / (2 * step), rel=1e-5)
