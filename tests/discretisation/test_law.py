"""The laws at the points: derivatives against differences, conjugates, one law inside the other."""

from dataclasses import replace

import numpy as np
import pytest

from ngepc import Hill, Material, Norton, Problem, Voce
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.discretisation.resistance import Resistance
from ngepc.geometries import block
from ngepc.primal.energy import ReducedEnergy

SQUARE = block.structured_mesh(3, 3, simplices=True)
HARD = Voce(1.5, 2.0, 40.0)
SHEET = Hill.r_values(1.8, 1.1, 2.3)
ELASTIC = {"lame_lambda": 900.0, "lame_mu": 700.0}
METALS = {
    "kinematic": Material.kinematic(**ELASTIC, yield_stress=1.2, hardening=90.0),
    "law": Material.with_law(**ELASTIC, law=HARD, hardening=30.0),
    "rate": replace(
        Material.with_law(**ELASTIC, law=HARD, hardening=30.0), rate=Norton(2.0, 3.0)
    ),
    "Hill": replace(
        Material.kinematic(**ELASTIC, yield_stress=1.5, hardening=30.0), hill=SHEET
    ),
}


@pytest.fixture(params=METALS, ids=str)
def law(request):
    """A law whose points start from some history."""
    duration = {"duration": 0.7} if request.param == "rate" else {}
    problem = Problem(SQUARE, METALS[request.param], **duration)
    law = law_of(problem, Points(SQUARE, problem.kinematics, 1))
    random = np.random.default_rng(2)
    law.back = 0.2 * random.normal(size=law.back.shape)
    law.initial = 1e-3 * random.normal(size=law.back.shape)
    isotropic = law.resistance.isotropic
    if request.param == "Hill":  # problems refuse both together, the formulas do not
        isotropic = replace(HARD)
    accumulated = random.uniform(0, 0.02, len(law.beta))
    law.resistance = Resistance(
        law.beta, isotropic, accumulated, law.resistance.rate, 0.7
    )
    return law


def strains(law):
    """Traces and deviators, some of which yield."""
    random = np.random.default_rng(3)
    shape = law.back.shape
    return 1e-3 * random.normal(size=shape[0]), 4e-3 * random.normal(size=shape)


def test_resistance_and_its_derivatives(law):
    """The energy has the bound as its derivative, that has the slope; both by PEEQ, too."""
    resistance = law.resistance
    g = np.random.default_rng(4).uniform(1e-3, 0.05, len(law.beta))
    h = 1e-7
    slope = (resistance.bound(g + h) - resistance.bound(g - h)) / (2 * h)
    np.testing.assert_allclose(resistance.slope(g), slope, rtol=1e-5, atol=1e-5)
    bound = (resistance.energy(g + h) - resistance.energy(g - h)) / (2 * h)
    np.testing.assert_allclose(resistance.bound(g), bound, rtol=1e-6)
    np.testing.assert_allclose(
        resistance.hardened(g), resistance.energy(g) - law.beta * g, atol=1e-15
    )
    by = resistance.by_accumulated(g)
    ahead, behind = (
        Resistance(
            law.beta,
            resistance.isotropic,
            resistance.accumulated + s * h,
            resistance.rate,
            0.7,
        )
        for s in (1, -1)
    )
    moved = (ahead.bound(g) - behind.bound(g)) / (2 * h)
    np.testing.assert_allclose(by[0], moved, rtol=1e-5, atol=1e-6)
    moved = (ahead.energy(g) - behind.energy(g)) / (2 * h)
    np.testing.assert_allclose(by[1], moved, rtol=1e-5, atol=1e-6)
    if resistance.isotropic is not None:
        h = 1e-6
        law_there = resistance.isotropic
        before = resistance.accumulated
        started = law_there.stress(before + h) - law_there.stress(before - h)
        expected = np.sqrt(2 / 3) * started / (2 * h)
        np.testing.assert_allclose(resistance.growth, expected, rtol=1e-5)


def test_gained_solves_its_equation(law):
    """M g + beta(g) = size; nothing is gained below beta."""
    resistance = law.resistance
    size = np.random.default_rng(5).uniform(0.2, 20.0, len(law.beta))
    g = resistance.gained_at(size, law.modulus)
    yields = size > law.beta
    rest = law.modulus * g + resistance.bound(g) - size
    np.testing.assert_allclose(rest[yields], 0.0, atol=1e-13)
    assert (g[~yields] == 0).all()
    assert (g[yields] > 0).all()


def test_changes_of_the_return(law):
    """p and w follow the trial stress as differences say: ``flow_change`` and ``moved``."""
    volume, e = strains(law)
    at = law.returned(volume, e)
    assert at.yields.any()
    clear = np.abs(at.size - law.beta) > 1e-2 * law.beta
    direction = np.random.default_rng(6).normal(size=e.shape)
    h = 1e-8
    ahead, behind = (law.returned(volume, e + s * h * direction) for s in (1, -1))
    ds = law.two_mu[:, None] * direction
    flow = (ahead.plastic_strain - behind.plastic_strain) / (2 * h)
    found = law.flow_change(at, ds)
    np.testing.assert_allclose(found[clear], flow[clear], atol=2e-6)
    w = law.yielding_part(at)
    moved = (law.yielding_part(ahead) - law.yielding_part(behind)) / (2 * h)
    change = law.moved(at, w, ds) - w
    np.testing.assert_allclose(change[clear], moved[clear], atol=2e-3)
    tangent = law.moduli(at, w)
    stress = [law.stress(one)[1] for one in (ahead, behind)]
    expected = (stress[0] - stress[1]) / (2 * h)
    found = tangent(direction)
    np.testing.assert_allclose(found[clear], expected[clear], atol=2e-3)


@pytest.mark.parametrize("name", ["kinematic", "Hill"])
def test_the_free_component_has_no_stress(name):
    """In plane stress: of moduli alone, and of what ``linearised`` and ``condensed`` make of it."""
    problem = Problem(SQUARE, METALS[name], kinematics="plane stress")
    law = law_of(problem, Points(SQUARE, problem.kinematics, 1))
    random = np.random.default_rng(8)
    volume = 1e-3 * random.normal(size=len(law.beta))
    at = law.returned(volume, 4e-3 * random.normal(size=law.back.shape))
    assert at.yields.any()
    w = law.yielding_part(at)
    moduli = law.closed_moduli(at, w)
    volume, e = random.normal(size=volume.shape), random.normal(size=law.back.shape)
    whole, completed = law.with_free_component(moduli, volume, e)
    mean, stress = moduli.stress(whole, completed)
    size = moduli.bulk * (np.abs(volume) + np.linalg.norm(e, axis=1))
    assert np.abs((mean + stress @ law.across) / size).max() < 1e-12
    np.testing.assert_allclose(completed - e, np.outer(whole - volume, law.across))
    others = law.moduli(at, w).stress(volume, e)
    np.testing.assert_allclose(others[0], mean, atol=1e-9)
    np.testing.assert_allclose(others[1], stress, atol=1e-9)
    found = law.linearised(at, w, volume, e)
    ahead = law.moved(at, w, law.two_mu[:, None] * completed)
    np.testing.assert_allclose(found, ahead)


def test_conjugate_of_the_energy(law):
    """Young: phi(e) + phi*(s) = s : e for the stress of a strain, more for all others."""
    volume, e = strains(law)
    at = law.returned(volume, e)
    pressure, stress = law.stress(at)
    energy = law.energy_density(at)
    work = pressure * volume + np.einsum("pd,pd->p", stress, e)
    both = energy + law.complementary_density(pressure, stress)
    np.testing.assert_allclose(both, work, rtol=1e-9, atol=1e-12)
    other = stress * 1.05
    work = pressure * volume + np.einsum("pd,pd->p", other, e)
    assert (energy + law.complementary_density(pressure, other) > work).all()


def test_w_is_put_back_onto_the_yield_surface(law):
    """Where it lies beyond; elsewhere it stays."""
    at = law.returned(*strains(law))
    w = 1.5 * law.yielding_part(at)
    back = law.projected(w, at)
    size = law.measured(w)
    inside = size <= at.radius
    assert (back[inside] == w[inside]).all()
    np.testing.assert_allclose(law.measured(back)[~inside], at.radius[~inside])
    turn = np.einsum("pd,pd->p", back, w) / np.linalg.norm(w, axis=1)
    np.testing.assert_allclose(turn, np.linalg.norm(back, axis=1), rtol=1e-12)


@pytest.mark.parametrize("name", ["sparsecholesky", "umfpack"])
def test_factors_multiply_and_solve(name):
    """K (K^-1 f) = f where nothing is held, and what is held does not move."""
    problem = Problem(SQUARE, METALS["kinematic"], "clamped", order=2)
    body = ReducedEnergy(problem)
    factors = Factors(body, name)
    factors.update(np.zeros(body.free.shape))  # the tangent where nothing yields
    forces = np.random.default_rng(7).normal(size=body.free.shape)
    u = factors.solve(forces)
    assert (u[~body.free] == 0).all()
    again = factors.multiply(u)
    np.testing.assert_allclose(again[body.free], forces[body.free], atol=1e-9)
    np.testing.assert_allclose(factors.multiply(2 * u), 2 * again, atol=1e-9)
