"""Derivatives with laws of hardening, one of one's own among them, and with initial strains."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from ngsolve import x

from ngepc import (
    Material,
    Problem,
    Schedule,
    Tabulated,
    Voce,
    evolve,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.model.hardening import HardeningLaw
from ngepc.sensitivity.calibration import Curve, calibrate
from ngepc.sensitivity.gradient import gradient, tangent
from ngepc.sensitivity.parameters import STENCIL, Direction

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
        **data,
    )


def difference(value, datum, amount):
    """The derivative of value(datum) by a central difference of fourth order."""
    step = 1e-4 * amount
    values = [value(datum + k * step) for k in STENCIL]
    return float(np.dot(list(STENCIL.values()), values)) / step


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
    names = ["law.yield_stress", "law.saturation", "law.rate"]
    for functional in ("contact_force", "dissipation"):
        found = gradient(run, functional, names)
        column = functional

        for name in names:
            field = name.removeprefix("law.")

            def last(value, field=field, column=column):
                return driven(replace(law, **{field: value})).column(column)[-1]

            given = getattr(law, field)
            expected = difference(last, given, given)
            assert found[name] == pytest.approx(expected, rel=1e-5)


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


def test_calibration_finds_the_data_of_a_law():
    truth = Voce(1.5, 1.0, 50.0)
    problem = pressed(truth)

    def changes(t):
        return {"gap": (x - 1) ** 2 / 2 - 0.06 * t}

    schedule = Schedule((0.25, 0.5, 0.75, 1.0), changes)
    measured = evolve(problem, schedule).column("contact_force")
    start = {"law.yield_stress": 2.0, "law.saturation": 0.6, "law.rate": 40.0}
    found = calibrate(problem, Curve(schedule, "contact_force", measured), start)
    assert found.converged
    for name in start:
        expected = getattr(truth, name.removeprefix("law."))
        assert found.values[name] == pytest.approx(expected, rel=1e-4)
    bound = found.problem.material.yield_stress
    assert bound == pytest.approx(np.sqrt(2 / 3) * 1.5, rel=1e-4)


@pytest.mark.parametrize("name", ["law.nothing", "law.stress_there[7]", "law.rate[0]"])
def test_data_that_a_law_has_not(name):
    result = semismooth_newton(pressed(Tabulated((0.0, 0.01), (1.5, 2.0))))
    with pytest.raises(ValueError, match="parameters='law"):
        gradient(result, "contact_force", [name])
