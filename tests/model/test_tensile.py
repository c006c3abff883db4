"""A metal by the numbers of a tensile test: bars that are pulled and pushed, by closed forms."""

import numpy as np
import pytest
from ngsolve import CF

from ngepc import (
    Hill,
    Material,
    Norton,
    Problem,
    error_bound,
    material_point,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.model.tensile import lame_parameters

E, NU, R, H = 210e3, 0.3, 200.0, 2500.0
TANGENT = E * H / (E + H)
ELASTIC = {"young": E, "poisson": NU, "yield_stress": R}
STRAIN = 0.02


def bar(material, *strains, steps=40):
    """Axial strains and stresses of a bar along a path of strains."""
    history = material_point(material, strain={"xx": list(strains)}, steps=steps)
    return history.strain[:, 0, 0], history.stress[:, 0, 0]


@pytest.mark.parametrize("kind", ["isotropic", "kinematic", "mixed"])
@pytest.mark.parametrize(
    "given", [{"tangent_modulus": TANGENT}, {"plastic_modulus": H}]
)
def test_a_bar_follows_the_data_sheet_there_and_back(kind, given):
    share = {"isotropic": 0.0, "kinematic": 1.0, "mixed": 0.4}[kind]
    more = {"kinematic_share": share} if kind == "mixed" else {}
    metal = Material.metal(**ELASTIC, **given, kind=kind, **more)
    strain, stress = bar(metal, STRAIN, -STRAIN)
    top = R + TANGENT * (STRAIN - R / E)
    assert stress[39] == pytest.approx(top, rel=1e-11)
    # The elastic range: 2 R, and twice what isotropic hardening has added.
    plastic = STRAIN - top / E
    radius = R + (1 - share) * H * plastic
    yields = STRAIN - 2 * radius / E
    bottom = top - 2 * radius + TANGENT * (strain[-1] - yields)
    assert stress[-1] == pytest.approx(bottom, rel=1e-11)


def test_the_factors_are_those_of_the_papers_names():
    metal = Material.metal(**ELASTIC, plastic_modulus=H, kind="kinematic")
    assert metal.yield_stress == pytest.approx(np.sqrt(2 / 3) * R)
    assert metal.hardening == pytest.approx(2 / 3 * H)
    isotropic = Material.metal(**ELASTIC, plastic_modulus=H)
    assert isotropic.effective_hardening == pytest.approx(2 / 3 * H)
    assert isotropic.hardening == 0
    lam, mu = lame_parameters(E, NU)
    assert (metal.lame_lambda, metal.lame_mu) == (lam, mu)
    assert (metal.young, metal.poisson) == pytest.approx((E, NU))
    assert metal.tensile_yield_stress == pytest.approx(R)


def test_perfect_plasticity():
    _, stress = bar(Material.metal(**ELASTIC, plastic_modulus=0.0), STRAIN)
    assert stress[-1] == pytest.approx(R)


POINTS = [(0.0, 0.0), (R / E, R), (0.01, 280.0), (0.05, 350.0), (0.1, 350.0)]


R_VALUES = (1.8, 1.2, 2.3)


@pytest.mark.parametrize(
    "given", [{"plastic_modulus": H}, {"tangent_modulus": TANGENT}, {"curve": None}]
)
def test_a_rolled_sheet_follows_the_data_sheet_along_its_axis(given):
    """The numbers are those of a bar along the axis 1, whose width and thickness differ."""
    if "curve" in given:
        given = {"curve": [(R / E, R), (1.0, R + TANGENT * (1.0 - R / E))]}
    rolled = Material.metal(**ELASTIC, **given, hill=Hill.r_values(*R_VALUES))
    history = material_point(rolled, strain={"xx": [STRAIN, -STRAIN]}, steps=3)
    top = R + TANGENT * (STRAIN - R / E)
    assert history.stress[2, 0, 0] == pytest.approx(top, rel=1e-9)
    yields = STRAIN - 2 * top / E
    bottom = -top + TANGENT * (-STRAIN - yields)
    assert history.stress[-1, 0, 0] == pytest.approx(bottom, rel=1e-9)
    p = history.plastic_strain[2]
    assert p[1, 1] / p[2, 2] == pytest.approx(R_VALUES[0], rel=1e-9)


def test_a_rolled_sheet_prints_as_it_was_given():
    rolled = Material.metal(
        **ELASTIC,
        plastic_modulus=H,
        hill=Hill(F=0.4, G=0.6, H=0.4),
        rate=Norton(1.0, 5),
    )
    assert repr(eval(repr(rolled))) == repr(rolled)
    assert "hill=Hill(F=0.4, G=0.6, H=0.4)" in repr(rolled)


@pytest.mark.parametrize("points", [POINTS, POINTS[1:]])
def test_a_measured_curve_is_met(points):
    metal = Material.metal(young=E, poisson=NU, curve=points)
    strains = [pair[0] for pair in POINTS[2:]]
    _, stress = bar(metal, *strains, steps=20)
    assert stress[19::20] == pytest.approx([280.0, 350.0, 350.0], rel=1e-10)


def test_points_below_the_yield_stress_are_elastic():
    noisy = [(0.0, 0.0), (0.0005, 104.0), (0.002, 199.0), (0.01, 280.0)]
    metal = Material.metal(**ELASTIC, curve=noisy)
    _, stress = bar(metal, R / E, 0.01, steps=20)
    assert stress[[19, 39]] == pytest.approx([R, 280.0], rel=1e-10)


@pytest.mark.parametrize("yield_stress", [None, R])
def test_a_curve_of_plastic_strains_is_refused(yield_stress):
    """As decks of other programs have it: its other points would be read as total strains."""
    plastic = [(0.0, R), (0.02, 280.0), (0.1, 350.0)]
    needed = "at the stress 200 the strain is 0, .*: total strains are needed"
    with pytest.raises(ValueError, match=needed):
        Material.metal(young=E, poisson=NU, yield_stress=yield_stress, curve=plastic)


PLATEAU = [(0.0, 0.0), (R / E, R), (0.02, R), (0.1, 300.0)]


@pytest.mark.parametrize("yield_stress", [None, R])
def test_a_yield_plateau_is_met(yield_stress):
    """Mild steel flows at its yield stress, from 0.1 to 2 percent, before it hardens."""
    metal = Material.metal(
        young=E, poisson=NU, yield_stress=yield_stress, curve=PLATEAU
    )
    _, stress = bar(metal, 0.01, 0.02, 0.1, steps=20)
    assert stress[19::20] == pytest.approx([R, R, 300.0], rel=1e-10)


def test_cycles_have_no_plateau_before_hardening():
    with pytest.raises(ValueError, match="it bends upwards at the stress 200"):
        Material.cyclic(young=E, poisson=NU, curve=PLATEAU)


def test_it_prints_as_it_was_given():
    metal = Material.metal(**ELASTIC, tangent_modulus=2000.0, kind="kinematic")
    assert repr(metal) == (
        "Material.metal(young=210000.0, poisson=0.3, yield_stress=200.0, "
        "tangent_modulus=2000.0, kind='kinematic')"
    )
    assert repr(eval(repr(metal))) == repr(metal)
    plain = Material.kinematic(
        lame_lambda=1.0, lame_mu=2.0, yield_stress=3.0, hardening=4.0
    )
    assert repr(plain).startswith("Material(lame_lambda=1.0, lame_mu=2.0")


def test_data_may_differ_from_place_to_place():
    mesh = block.structured_mesh(2, 2)
    varying = CF(E) * CF(1.0)
    given = {"yield_stress": R, "tangent_modulus": 2000.0, "poisson": NU}
    load = {"traction": {"right": (100.0, 60.0)}, "order": 1}
    one, two = (
        semismooth_newton(
            Problem(mesh, Material.metal(young=young, **given), **load)
        ).primal_energy
        for young in (E, varying)
    )
    assert two == pytest.approx(one, rel=1e-12)


def test_linear_hardening_has_bounds():
    """It is the linear law of the paper, with other names."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    metal = Material.metal(**ELASTIC, tangent_modulus=2000.0)
    problem = Problem(mesh, metal, traction={"right": (100.0, 60.0)}, order=1)
    assert error_bound(semismooth_newton(problem)).total > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "no hardening given: one of tangent_modulus, plastic_modulus, curve"),
        (
            {"tangent_modulus": 1.0, "plastic_modulus": 1.0},
            "tangent_modulus and plastic",
        ),
        ({"tangent_modulus": 3e5}, "tangent_modulus=300000: less than young=210000"),
        ({"plastic_modulus": -1.0}, "plastic_modulus"),
        ({"poisson": 0.5, "plastic_modulus": 1.0}, "poisson=0.5"),
        ({"young": 0.0, "plastic_modulus": 1.0}, "young=0"),
        ({"yield_stress": None, "plastic_modulus": 1.0}, "yield_stress=None"),
        ({"plastic_modulus": 1.0, "kind": "linear"}, "kind='linear': one of isotropic"),
        ({"plastic_modulus": 1.0, "kind": "mixed"}, "kinematic_share in"),
        ({"plastic_modulus": 1.0, "kinematic_share": 0.5}, "kind='mixed' is needed"),
        ({"curve": POINTS, "kind": "kinematic"}, "kind='isotropic' is needed"),
        (
            {"plastic_modulus": 1.0, "kind": "kinematic", "hill": Hill()},
            "kind='kinematic': kind='isotropic' is needed with hill",
        ),
        ({"plastic_modulus": 1.0, "hill": 1.0}, r"hill=1.0: Hill\(...\) is needed"),
        ({"curve": [(0.002, 150.0)], "yield_stress": None}, "yield_stress= is needed"),
        ({"curve": [(0.1, 300.0), (0.2, 250.0)]}, "the stress falls from 300 to 250"),
        ({"curve": [(0.1, 300.0), (0.1, 350.0)]}, "increasing ones are needed"),
        ({"curve": [(0.1, 300.0, 1.0)]}, r"curve\[0\]"),
        ({"curve": [], "yield_stress": None}, "points beyond the origin"),
        (
            {"curve": [(0.0005, 104.0), (0.01, 180.0)]},
            "yield_stress=200: the curve ends",
        ),
    ],
)
def test_what_no_data_sheet_says_is_refused(changes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        Material.metal(**ELASTIC | changes)


def test_the_two_dimensional_law_of_the_paper_has_other_factors():
    metal = Material.metal(**ELASTIC, plastic_modulus=H)
    with pytest.raises(ValueError, match=r"two-dimensional.*Material.kinematic"):
        Problem(block.structured_mesh(1, 1), metal, kinematics="two-dimensional")
