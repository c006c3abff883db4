"""Laws of hardening, of the rate and of the yield surface as functions of numbers."""

import inspect

import numpy as np
import pytest
from ngsolve import CF, x

from ngepc import HardeningLaw, Hill, Norton, Swift, Tabulated, Voce
from ngepc.geometries import block
from ngepc.model.hardening import Potential
from ngepc.model.kinematics import PLANE_STRAIN, SOLID

LAWS = {
    "Voce": Voce(2.0, 1.5, 30.0),
    "Swift": Swift(2.0, 0.01, 0.3),
    "table": Tabulated([0.0, 0.02, 0.1], [2.0, 2.5, 2.9]),
    "linear rate": Norton(3.0),
    "rate": Norton(3.0, 4.0),
}
STRAINS = np.array([1e-4, 0.003, 0.017, 0.05, 0.09, 0.3])
HARDENING = [name for name, law in LAWS.items() if isinstance(law, HardeningLaw)]


def laws_below(base):
    """The classes of the package that derive from ``base`` and are complete."""
    for cls in base.__subclasses__():
        if cls.__module__.startswith("ngepc.") and not inspect.isabstract(cls):
            yield cls
        yield from laws_below(cls)


def test_every_law_of_the_package_is_here():
    """The tests of this file look at those in ``LAWS``."""
    missing = set(laws_below(Potential)) - set(map(type, LAWS.values()))
    assert not missing, "add one to LAWS"


@pytest.fixture(params=LAWS, ids=str)
def law(request):
    return LAWS[request.param]


def test_stress_and_slope_are_derivatives(law):
    """Of the energy and of the stress; no energy at the start."""
    h = 1e-6
    stress = (law.energy(STRAINS + h) - law.energy(STRAINS - h)) / (2 * h)
    np.testing.assert_allclose(law.stress(STRAINS), stress, rtol=1e-5)
    slope = (law.stress(STRAINS + h) - law.stress(STRAINS - h)) / (2 * h)
    np.testing.assert_allclose(law.slope(STRAINS), slope, rtol=1e-3, atol=1e-8)
    assert law.energy(np.zeros(1)) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("name", HARDENING)
def test_slopes_between_two_strains(name):
    """Bounds of all slopes between them, each attained for laws that saturate."""
    law = LAWS[name]
    for first, last in ((0.0, 0.01), (0.005, 0.05), (0.03, 0.2)):
        least, largest = law.slopes(np.array([first]), np.array([last]))
        between = law.slope(np.linspace(first, last, 200)[:-1])
        assert least <= between.min() * (1 + 1e-12)
        assert largest >= between.max() * (1 - 1e-12)
        assert largest <= between.max() * (1 + 1e-9)


def test_rates_invert_the_overstress():
    law = LAWS["rate"]
    np.testing.assert_allclose(law.rate(law.stress(STRAINS)), STRAINS, rtol=1e-12)
    assert np.isfinite(law.slope(np.zeros(1))).all()


def test_coefficients_are_numbers_at_points(law):
    """Energy, stress and slope of a coefficient have the values of those of its values."""
    mesh = block.structured_mesh(2, 1)
    for of in (law.energy, law.stress, law.slope):
        found = of(0.1 * x + 1e-3)
        there = [found(mesh(a, 0.3)) for a in (0.1, 0.4, 0.9)]
        expected = of(np.array([0.011, 0.041, 0.091]))
        np.testing.assert_allclose(there, expected, rtol=1e-10)


TENSORS = np.array(
    [
        [[1.0, 0.3, 0.2], [0.3, -0.7, 0.1], [0.2, 0.1, -0.3]],
        [[0.2, -0.5, 0.4], [-0.5, 0.5, -0.3], [0.4, -0.3, -0.7]],
    ]
)
SHEET = Hill(F=0.3, G=0.4, H=0.6, L=1.2, M=1.7, N=2.1, angle=0.4)


@pytest.mark.parametrize("kinematics", [PLANE_STRAIN, SOLID], ids=["plane", "solid"])
def test_the_form_is_the_measure(kinematics):
    """Of stresses that the basis spans: coordinates and tensors give one number."""
    mesh = block.structured_mesh(1, 1)
    form = SHEET.form(kinematics.basis, lambda value: np.full(1, float(value)))[0]
    for s in TENSORS:
        coordinates = np.einsum("dij,ij->d", kinematics.basis, s)
        tensor = np.einsum("d,dij->ij", coordinates, kinematics.basis)
        measured = SHEET.measure(CF(tuple(tensor.ravel()), dims=(3, 3)))
        expected = np.sqrt(coordinates @ form @ coordinates)
        assert measured(mesh(0.5, 0.5)) == pytest.approx(expected, rel=1e-12)


def uniaxial(degrees):
    """A unit stress in a direction of the plane, and the one across it."""
    angle = np.radians(degrees)
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    return np.outer(along, along), along, across


@pytest.mark.parametrize(
    ("degrees", "ratio"), [(0.0, 1.8), (45.0, 1.1), (90.0, 2.3)], ids=str
)
def test_r_values_are_ratios_of_flow(degrees, ratio):
    """The flow is A s: across over thickness is R; a bar along the axis 1 has the yield stress."""
    sheet = Hill.r_values(1.8, 1.1, 2.3)
    stress, _, across = uniaxial(degrees)
    form = sheet.form(SOLID.basis, lambda value: np.full(1, float(value)))[0]
    coordinates = np.einsum("dij,ij->d", SOLID.basis, stress)
    flow = np.einsum("d,dij->ij", form @ coordinates, SOLID.basis)
    assert across @ flow @ across / flow[2, 2] == pytest.approx(ratio, rel=1e-12)
    if degrees == 0:
        square = coordinates @ form @ coordinates
        assert square == pytest.approx(2 / 3, rel=1e-12)


def test_yield_ratios_are_those_of_bars_and_shears():
    ratios = {
        "r_11": 1.1,
        "r_22": 0.9,
        "r_33": 1.2,
        "r_12": 0.8,
        "r_23": 1.05,
        "r_31": 0.95,
    }
    mesh = block.structured_mesh(1, 1)
    sheet = Hill.yield_ratios(**ratios)
    for name, ratio in ratios.items():
        i, j = int(name[2]) - 1, int(name[3]) - 1
        s = np.zeros((3, 3))
        s[i, j] = s[j, i] = 1.0 if i == j else 1 / np.sqrt(3)  # S = 1 for von Mises
        measured = sheet.measure(CF(tuple(s.ravel()), dims=(3, 3)))(mesh(0.5, 0.5))
        assert np.sqrt(1.5) * measured == pytest.approx(1 / ratio, rel=1e-12)


def test_tables_that_fall_are_refused_where_they_are_made():
    with pytest.raises(ValueError, match="stresses that do not fall"):
        Tabulated([0, 0.1], [200.0, 100.0])
