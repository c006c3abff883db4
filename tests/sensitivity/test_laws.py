"""Derivatives with laws of hardening, one of one's own among them, and with initial strains."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import Integrate, ds, x

from ngepc import (
    Hill,
    Material,
    Norton,
    Overlay,
    Problem,
    Reaction,
    Schedule,
    Tabulated,
    Voce,
    evolve,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.model.hardening import HardeningLaw
from ngepc.sensitivity.calibration import Curve, calibrate
from ngepc.sensitivity.equations import STENCIL
from ngepc.sensitivity.functionals import as_functional
from ngepc.sensitivity.gradient import gradient, require_one_material, states_of
from ngepc.sensitivity.law_data import PartDatum
from ngepc.sensitivity.law_equations import equations_of_law
from ngepc.sensitivity.parameters import Direction
from ngepc.sensitivity.tangent import tangent

ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3}


@dataclass(frozen=True, eq=False)
class Logarithmic(HardeningLaw):
    """A law of one's own: R = start + gain log(1 + x / scale)."""

    start: float
    gain: float
    scale: float

    def energy(self, x):
        return self.start * x + self.gain * (
            (x + self.scale) * np.log1p(x / self.scale) - x
        )

    def stress(self, x):
        return self.start + self.gain * np.log1p(x / self.scale)

    def slope(self, x):
        return self.gain / (x + self.scale)


OWN = {"start": 1.5, "gain": 0.8, "scale": 0.01}


def pressed(law, **data):
    """A block under a parabola, pulled to the side."""
    return Problem(
        block.structured_mesh(4, 3, size=(2.0, 1.0), simplices=True),
        Material.with_law(**ELASTIC, law=law),
        contact="contact",
        gap=(x - 1) ** 2 / 2 - 0.05,
        traction={"right": (0.5, 0.0)},
        order=1,
        **data,
    )


def difference(value, datum, amount):
    """The derivative of value(datum) by a central difference of fourth order."""
    step = 1e-4 * amount
    values = [value(datum + k * step) for k in STENCIL]
    return np.dot(list(STENCIL.values()), values) / step


def test_an_own_law_needs_only_its_formulas():
    """Solve, certificate, and gradients by its data."""
    result = semismooth_newton(pressed(Logarithmic(**OWN))).raise_for_status()
    assert result.plastic_increment.vec.Norm() > 0
    energy = result.primal_energy
    assert energy + result.dual_energy == pytest.approx(0.0, abs=1e-9 * abs(energy))
    names = [f"law.{name}" for name in OWN]
    found = gradient(result, "contact_force", names)

    for name, given in OWN.items():

        def force(value, name=name):
            law = Logarithmic(**OWN | {name: value})
            return semismooth_newton(pressed(law)).contact_force

        expected = difference(force, given, given)
        assert found[f"law.{name}"] == pytest.approx(expected, rel=1e-6)
        forwards = tangent(result, f"law.{name}").contact_force
        assert forwards == pytest.approx(found[f"law.{name}"], rel=1e-9)


def test_histories_carry_peeq():
    """Loading, unloading and loading again: the second step starts with the PEEQ of the first."""
    law = Voce(1.5, 1.0, 50.0)

    def driven(law):
        problem = pressed(law)
        steps = [
            (t, {"gap": (x - 1) ** 2 / 2 - depth})
            for t, depth in ((1.0, 0.05), (2.0, 0.035), (3.0, 0.055))
        ]
        return evolve(problem, steps).raise_for_status()

    run = driven(law)
    names = ["law.saturation", "law.rate"]
    functionals = ("contact_force", "dissipation")
    found = [gradient(run, functional, names) for functional in functionals]
    for name in names:
        field = name.removeprefix("law.")

        def last(value, field=field):
            changed = driven(replace(law, **{field: value}))
            return np.array([changed.column(f)[-1] for f in functionals])

        given = getattr(law, field)
        slopes = [of_functional[name] for of_functional in found]
        assert slopes == pytest.approx(difference(last, given, given), rel=1e-5)


def test_entries_of_a_table_and_a_table_as_a_whole():
    table = (1.5, 1.7, 2.6)
    strains = (0.0, 0.001, 0.05)
    result = semismooth_newton(pressed(Tabulated(strains, table)))
    names = [f"law.stress_there[{k}]" for k in range(3)]
    whole = {"all": Direction("law.stress_there", table)}
    parts = gradient(result, "contact_force", names)
    together = gradient(result, "contact_force", whole)["all"]
    assert np.dot(list(parts.values()), table) == pytest.approx(together, rel=1e-9)

    def force(last):
        law = Tabulated(strains, (*table[:2], last))
        return semismooth_newton(pressed(law)).contact_force

    expected = difference(force, table[2], 1.0)
    assert parts[names[2]] == pytest.approx(expected, rel=1e-6)


def test_initial_strains():
    """A body that swells by a field, and a number in place of it."""
    field = 1e-3 * (1 + x)
    law = Voce(1.5, 1.0, 50.0)

    def force(factor):
        return semismooth_newton(
            pressed(law, initial_strain=factor * field)
        ).contact_force

    result = semismooth_newton(pressed(law, initial_strain=field))
    found = gradient(result, "contact_force", "initial_strain")["initial_strain"]
    assert found == pytest.approx(difference(force, 1.0, 1.0), rel=1e-6)
    by_field = {"swelling": Direction("initial_strain", field)}
    assert gradient(result, "contact_force", by_field)["swelling"] == pytest.approx(
        found
    )


CYCLIC = Material.cyclic(
    young=2600.0, poisson=0.3, curve=[(5e-4, 1.3), (2e-3, 2.0), (1e-2, 3.0)]
)
CREEPING = Material.metal(
    young=2600.0,
    poisson=0.3,
    yield_stress=1.0,
    plastic_modulus=100.0,
    rate=Norton(2.0, 2.0),
)
SHEET = replace(
    Material.metal(young=2600.0, poisson=0.3, yield_stress=1.3, plastic_modulus=100.0),
    hill=Hill.r_values(1.8, 1.2, 2.3),
)
ALL_LAWS = {
    "law": (
        Material.with_law(**ELASTIC, law=Voce(1.5, 1.0, 50.0)),
        {"law.saturation": 0.8, "law.rate": 45.0},
    ),
    "overlay": (CYCLIC, {"overlay.bounds[0]": 1.1, "overlay.shares[1]": 0.15}),
    "rate": (CREEPING, {"rate.overstress": 2.5, "rate.exponent": 1.8}),
    "hill": (SHEET, {"hill.H": 0.6}),
}
"""Materials, and first guesses of some of their data."""


def pulled_to_and_fro(material):
    """A bar by its strain, and what its support bears."""
    bar = Problem(
        block.structured_mesh(1, 1, simplices=True),
        material,
        clamped=None,
        prescribed={"left": (0, None), "clamped": (None, 0), "right": (1e-3, None)},
        kinematics="plane stress",
        order=1,
    )

    def to_strain(t):
        """A corner at t = 2."""
        strain = 6e-3 * (t / 2 if t <= 2 else 2 - t / 2 - (t - 2) / 2)
        return {"prescribed": {**bar.prescribed, "right": (strain, None)}}

    return bar, Schedule((0.5, 1.0, 2.0, 2.5, 3.0), to_strain), Reaction("right", 0)


def indented(material):
    """A block under a parabola that comes down."""
    body = replace(pressed(Voce(1.5, 1.0, 50.0)), material=material, traction=None)

    def deeper(t):
        """The depth."""
        return {"gap": (x - 1) ** 2 / 2 - 0.05 * t}

    return body, Schedule((0.2, 0.5, 0.8, 1.0), deeper), "contact_force"


@pytest.mark.parametrize(
    ("part", "test"),
    [
        ("law", pulled_to_and_fro),
        ("overlay", pulled_to_and_fro),
        ("rate", indented),
        ("hill", pulled_to_and_fro),
    ],
)
def test_calibration_of_all_laws(part, test):
    """From a bar or from an indentation, the data that have made the curve are found again."""
    material, start = ALL_LAWS[part]
    problem, schedule, measure = test(material)
    run = evolve(problem, schedule).raise_for_status()
    steps = [run.times.index(time) for time in schedule.times]
    states = states_of(run)
    functional = as_functional(measure)
    values = [functional.slope(states[step]()).value for step in steps]
    found = calibrate(problem, Curve(schedule, measure, values), start)
    assert found.converged
    for name in start:
        expected = start_of(material, name)
        assert found.values[name] == pytest.approx(expected, rel=1e-3), name
        kept = start_of(found.problem.material, name)
        assert kept == pytest.approx(found.values[name], rel=1e-12), name


def start_of(material, name):
    """The value of a datum of a material or of one of its parts."""
    return PartDatum.of(material, name).value if "." in name else material.yield_stress


def test_shares_of_a_whole_change_together():
    """Without a rest that never yields one share alone cannot grow."""
    overlay = Overlay((0.6, 0.4), (1.0, 5.0))
    whole = Material(lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, overlay=overlay)
    result = semismooth_newton(replace(indented(whole)[0]))
    with pytest.raises(ValueError, match="the shares have the sum 1"):
        gradient(result, "contact_force", ["overlay.shares[0]"])
    with pytest.raises(ValueError, match="lame_mu"):
        gradient(result, "contact_force", ["yield_stress"])
    together = {"both": Direction("overlay.shares", (1.0, -1.0))}
    found = gradient(result, "contact_force", together)["both"]

    def force(share):
        shares = (share, 1 - share)
        material = replace(whole, overlay=replace(overlay, shares=shares))
        return semismooth_newton(indented(material)[0]).contact_force

    assert found == pytest.approx(difference(force, 0.6, 0.6), rel=1e-5)


@pytest.mark.parametrize("name", ["law.nothing", "law.stress_there[7]", "law.rate[0]"])
def test_data_that_a_law_has_not(name):
    result = semismooth_newton(pressed(Tabulated((0.0, 0.01), (1.5, 2.0))))
    with pytest.raises(ValueError, match="parameters='law"):
        gradient(result, "contact_force", [name])


@pytest.mark.parametrize("kind", ["isotropic", "kinematic"])
def test_derivatives_by_numbers_of_a_data_sheet(kind):
    """By R, H' and E of ``Material.metal``, as docs/sensitivities.md has them."""

    def bent(given):
        yield_stress, plastic_modulus, young = given
        metal = Material.metal(
            young=young,
            poisson=0.3,
            yield_stress=yield_stress,
            plastic_modulus=plastic_modulus,
            kind=kind,
        )
        mesh = block.structured_mesh(4, 2, size=(2.0, 1.0))
        load = {"right": (0.0, -60.0)}
        return Problem(mesh, metal, clamped="left", traction=load)

    def sag(given):
        solved = semismooth_newton(bent(given)).raise_for_status()
        sagging = solved.displacement[1] * ds("right")
        return Integrate(sagging, solved.problem.mesh)

    data = np.array([170.0, 700.0, 210e3])
    result = semismooth_newton(bent(data))
    metal = result.problem.material
    modulus = "hardening_stiffness" if kind == "isotropic" else "hardening"
    slopes = gradient(
        result,
        lambda u, p, stress: u[1] * ds("right"),
        ["yield_stress", modulus, "lame_lambda", "lame_mu"],
    )
    lame = ("lame_lambda", "lame_mu")
    by_young = sum(getattr(metal, name) * slopes[name] for name in lame) / 210e3
    by_bound = slopes["yield_stress"]
    by_modulus = slopes[modulus]
    if kind == "isotropic":
        ratio = 2 * metal.hardening_stiffness / metal.yield_stress
        by_bound = by_bound - ratio * by_modulus
        by_modulus = by_modulus / (metal.hardening_modulus * metal.yield_stress) ** 2
    found = np.array([np.sqrt(2 / 3) * by_bound, 2 / 3 * by_modulus, by_young])
    steps = 1e-4 * np.diag(data)
    central = [(sag(data + h) - sag(data - h)) / (2 * h.sum()) for h in steps]
    assert abs(found / central - 1).max() < 1e-5


@pytest.mark.parametrize("name", ["Hill", "Voce"])
def test_each_equation_of_a_law_has_its_transpose(name):
    """<w, B v> = <B' w, v> for all pairs of products in the equations."""
    metals = {
        "Hill": replace(
            Material.kinematic(**ELASTIC, yield_stress=1.5, hardening=30.0),
            hill=Hill.r_values(1.8, 1.1, 2.3),
        ),
        "Voce": Material.with_law(**ELASTIC, law=Voce(1.5, 2.0, 40.0), hardening=30.0),
    }
    mesh = block.structured_mesh(2, 2, simplices=True)
    load = {"right": (0.01, 0.0)}
    problem = Problem(mesh, metals[name], "left", prescribed=load, order=1)
    state = semismooth_newton(problem).state
    assert state.at.yields.any()
    random = np.random.default_rng(0)
    count, d = state.discrete.law.back.shape
    pairs = [e for e in equations_of_law(state) if isinstance(e[2], tuple)]
    assert pairs
    for _, of, (product, transposed) in pairs:
        v = random.normal(size=(count, d, d) if of == "form" else (count, d))
        try:
            there = product(v)
        except ValueError:  # of a number at each point
            there = product(random.normal(size=count))
        w = random.normal(size=there.shape)
        back = transposed(w)
        v = random.normal(size=back.shape)
        there = product(v)
        assert np.vdot(w, there) == pytest.approx(
            np.vdot(back, v), rel=1e-10, abs=1e-12
        )


def test_the_step_whose_material_differs_is_named():
    metals = [
        Material.kinematic(**ELASTIC, yield_stress=s, hardening=9.0) for s in (1, 1, 2)
    ]
    steps = [
        SimpleNamespace(problem=SimpleNamespace(material=metal)) for metal in metals
    ]
    points = SimpleNamespace(at=lambda value: value)
    memory = SimpleNamespace(functions=SimpleNamespace(points=points))
    require_one_material(SimpleNamespace(memory=memory, steps=steps[:2]))
    with pytest.raises(ValueError, match="material of step 3 is"):
        require_one_material(SimpleNamespace(memory=memory, steps=steps))
