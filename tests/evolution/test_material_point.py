"""Material points: published values of NAFEMS and Code_Aster, bars in closed form."""

import math

import numpy as np
import pytest

from ngepc import (
    Material,
    Status,
    Swift,
    Tabulated,
    Voce,
    lame_parameters,
    material_point,
)

STRAINS = [
    (0.25, 0),
    (0.5, 0),
    (0.5, 0.25),
    (0.5, 0.5),
    (0.25, 0.5),
    (0, 0.5),
    (0, 0.25),
    (0, 0),
]
NL1 = {
    62.5e3: [5.000, 5.862, 5.482, 6.362, 6.640, 7.322, 4.230, 5.673],
    0.0: [5, 5, 5, 5, 5, 5, 3.917, 5],
}


def metal(young, poisson, law, **more):
    lame_lambda, lame_mu = lame_parameters(young, poisson)
    return Material.with_law(lame_lambda=lame_lambda, lame_mu=lame_mu, law=law, **more)


@pytest.mark.parametrize("modulus", NL1)
def test_nafems_nl1(modulus):
    """NAFEMS NNB rev. 1 (1989), NL1: all strains given, the von Mises stress at the corners.

    The published values of the last two corners stand one percent above the limit of small
    increments.
    """
    cube = metal(250e3, 0.25, Tabulated([0, 1], [5.0, 5.0 + modulus]))
    corners = 1e-4 * np.array(STRAINS)
    rest = dict.fromkeys(("zz", "xy", "xz", "yz"), 0.0)
    path = {"xx": corners[:, 0], "yy": corners[:, 1], **rest}
    found = material_point(cube, strain=path, steps=200)
    sizes = found.von_mises[found.corners]
    assert sizes[:-2] == pytest.approx(NL1[modulus][:-2], rel=2e-3)
    assert sizes[-2:] == pytest.approx(NL1[modulus][-2:], rel=0.012)


SLOPE = 195e3 * 1930 / (195e3 - 1930)
PATH = {"xx": [151.2, 257.2], "xy": [93.1, 33.1]}


def test_ssnp15():
    """Code_Aster V6.03.015 (AFNOR): stress-controlled, isotropic hardening, at A and B.

    Backward Euler is of order one: 50 and 100 increments for each leg are extrapolated.
    """
    steel = metal(195e3, 0.3, Tabulated([0, 10], [181.0, 181.0 + 10 * SLOPE]))
    coarse, found = (material_point(steel, stress=PATH, steps=n) for n in (50, 100))
    strain, peeq = (
        found.strain[found.corners],
        found.accumulated_plastic_strain[found.corners],
    )
    strain = 2 * strain - coarse.strain[coarse.corners]
    assert strain[0, 0, :2] == pytest.approx([0.0148297, 0.0136014], rel=1e-5)
    assert strain[1, 0, :2] == pytest.approx([0.035265, 0.020471], rel=1e-4)
    assert peeq == pytest.approx([0.0205473, 0.042329], rel=1e-5)
    assert found.stress[found.corners[1], 0, :2] == pytest.approx(
        [257.2, 33.1], rel=1e-10
    )


def test_ssnp14():
    """Code_Aster SSNP14: the same path with kinematic hardening; published at A."""
    lame_lambda, lame_mu = lame_parameters(195e3, 0.3)
    steel = Material.kinematic(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=math.sqrt(2 / 3) * 181.0,
        hardening=2 / 3 * SLOPE,
    )
    found = material_point(steel, stress=PATH, steps=10)
    at_A = found.corners[0]
    assert found.strain[at_A, 0, :2] == pytest.approx([0.0148297, 0.0136014], rel=1e-5)
    assert found.accumulated_plastic_strain[at_A] == pytest.approx(0.0205473, rel=1e-5)


@pytest.mark.parametrize("law", [Voce(250.0, 120.0, 40.0), Swift(250.0, 0.004, 0.2)])
def test_bar_under_strain(law):
    """sigma = R(eps - sigma/E) on the way up, and -R(PEEQ) after the reversal; all else is free."""
    found = material_point(
        metal(200e3, 0.3, law), strain={"xx": [0.05, -0.05]}, steps=20
    )
    stress, peeq = found.stress[:, 0, 0], found.accumulated_plastic_strain
    yields = peeq > np.append(0.0, peeq[:-1])
    assert np.abs(stress)[yields] == pytest.approx(law.stress(peeq)[yields], rel=1e-9)
    assert found.strain[:, 0, 0] == pytest.approx(
        stress / 200e3 + found.plastic_strain[:, 0, 0], rel=1e-12
    )
    assert peeq[19] == pytest.approx(0.05 - stress[19] / 200e3, rel=1e-9)
    others = np.abs(found.stress.reshape(-1, 9)[:, 1:])
    assert others.max() < 1e-9 * 250


def test_a_stress_that_cannot_be_is_said():
    found = material_point(
        metal(200e3, 0.3, Tabulated([0], [181.0])), {}, {"xx": [200.0]}, 20
    )
    assert found.status is Status.LIMIT_LOAD
    assert found.stress[-1, 0, 0] == pytest.approx(180.0)


BAD = {
    "name": ({"strain": {"rr": 1.0}}, "components are needed"),
    "twice": (
        {"strain": {"xx": 1.0}, "stress": {"xx": 1.0}},
        "'xx' is given in strain too",
    ),
    "lengths": (
        {"strain": {"xx": [1.0, 2.0]}, "stress": {"yy": [1.0, 2, 3]}},
        "the same number of corners",
    ),
    "steps": ({"steps": 0}, "steps=0"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_paths_are_refused(name):
    arguments, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        material_point(metal(200e3, 0.3, Tabulated([0], [181.0])), **arguments)


def test_curves_begin_at_the_origin():
    found = material_point(
        metal(200e3, 0.3, Voce(250.0, 120.0, 40.0)), stress={"xy": 200.0}, steps=3
    )
    strain, stress = found.curve("xy")
    assert strain[0] == stress[0] == 0.0
    assert np.array_equal(strain[1:], found.strain[:, 0, 1])
    assert stress[1:] == pytest.approx(found.stress[:, 1, 0])
    assert stress[-1] == pytest.approx(200.0)
    with pytest.raises(ValueError, match=r"component='yx'.*xx, yy, zz, xy, xz, yz"):
        found.curve("yx")
