"""Bounds with laws of hardening and initial strains: integrals from the safe side, bounds hold."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from ngsolve import CF, ET, IntegrationRule, x
from pairs import in_turn

from ngepc import (
    Material,
    Problem,
    Swift,
    Tabulated,
    Voce,
    error_bound,
    semismooth_newton,
)
from ngepc.bounds.conjugate import Conjugate
from ngepc.bounds.flow_potentials import flow_potential, least_potential
from ngepc.bounds.of_state import bound_of, data_on
from ngepc.bounds.simplices import FACETS
from ngepc.discretisation.resistance import Resistance
from ngepc.geometries import block
from ngepc.model.hardening import HardeningLaw

ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3}


@dataclass(frozen=True, eq=False)
class Root(HardeningLaw):
    """A law of one's own: R = start + gain ((1 + x / scale)^(1/2) - 1), slopes not told."""

    start: float
    gain: float
    scale: float

    def energy(self, x):
        rest = 2 * self.scale / 3 * ((1 + x / self.scale) ** 1.5 - 1) - x
        return self.start * x + self.gain * rest

    def stress(self, x):
        return self.start + self.gain * (np.sqrt(1 + x / self.scale) - 1)

    def slope(self, x):
        return self.gain / (2 * self.scale) / np.sqrt(1 + x / self.scale)


LAWS = {
    "Voce": (Voce(1.5, 1.0, 50.0), 40.0),
    "Swift": (Swift(1.5, 0.004, 0.4), 0.0),
    "table": (Tabulated((0.0, 0.001, 0.5), (1.5, 1.8, 60.0)), 0.0),
    "own": (Root(1.5, 1.0, 0.004), 0.0),
}


def pulled(law, hardening, n, **data):
    return Problem(
        block.structured_mesh(n, n, size=(1.0, 1.0), simplices=True),
        Material.with_law(**ELASTIC, law=law, hardening=hardening),
        traction={"right": (1.6, 0.3)},
        **data,
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("nodes", [9, 18])
def test_integrals_are_bounded_from_above(law, nodes):
    """Against a rule of degree 20 on each of the three parts of a triangle."""
    result = semismooth_newton(pulled(*LAWS[law], 1))
    conjugate = Conjugate(result.discrete.law, 3).of(np.array([0]))
    conjugate.whole = True  # z are m and d themselves: nothing is completed
    rule = IntegrationRule(ET.TRIG, 20)
    places = np.array(rule.points)[:, :2]
    shares = np.column_stack([1 - places.sum(axis=1), places])
    weights = 2 * np.array(rule.weights)
    random = np.random.default_rng(1)
    for size in (0.3, 1.0, 3.0):
        z = size * random.normal(size=(1, nodes, 4)) + np.array([0.5, 1.0, 0.4, 0.2])
        parts = z.reshape(3, -1, 4)
        if nodes == 18:
            a, b, c = shares.T
            ends = [(2 * s - 1) * s for s in (a, b, c)]
            pairs = {(0, 1): a * b, (0, 2): a * c, (1, 2): b * c}
            edges = [4 * pairs[tuple(sorted(pair))] for pair in FACETS[2]]
            values = np.matmul(np.stack([*ends, *edges], axis=1), parts)
        else:
            values = np.matmul(shares, parts)
        exact = 0.0
        for part in values:
            at = conjugate.completed(part[None])
            exact += float(conjugate.value(at)[0] @ weights) / 3
        bound = conjugate.integrals(z, np.ones(1), np.zeros(1))[0]
        assert exact * (1 - 1e-9) <= bound <= 1.25 * exact


@pytest.mark.parametrize("law", LAWS)
def test_integrals_of_the_strain_energy_are_bounded_from_below(law):
    there = LAWS[law][0].at(lambda value: np.full(1, value))
    resistance = Resistance(np.array([1.2]), there, np.array([0.002]))
    modulus = np.array([2000.0])
    rule = IntegrationRule(ET.TRIG, 20)
    places = np.array(rule.points)[:, :2]
    shares = np.column_stack([1 - places.sum(axis=1), places])
    random = np.random.default_rng(2)
    for size in (0.1, 0.5, 2.0):
        s = size * random.normal(size=(1, 3, 3)) + np.array([1.0, 1.0, 0.5])
        sizes = np.linalg.norm(shares @ s[0], axis=1)
        columns = resistance.of(np.s_[:, None])
        gained = columns.gained_at(sizes[None], modulus[:, None])
        values = flow_potential(columns, modulus[:, None], sizes[None], gained)
        exact = float(values[0] @ np.array(rule.weights)) * 2
        bound = least_potential(resistance, modulus, s, np.ones(1))[0]
        assert 0.2 * exact <= bound <= exact * (1 + 1e-4)


@pytest.mark.parametrize(
    ("law", "order"), [("Voce", 1), ("Swift", 2), ("table", 1), ("own", 2)]
)
def test_the_bound_is_above_the_error(law, order):
    """The energy of a finer mesh of order two is no less than the least one."""
    coarse = semismooth_newton(pulled(*LAWS[law], 3, order=order))
    fine = semismooth_newton(pulled(*LAWS[law], 6, order=2))
    bound = error_bound(coarse)
    error = coarse.primal_energy - fine.primal_energy
    assert 0 < error <= bound.total <= 8 * error
    assert error_bound(fine).total < bound.total


def test_a_stress_that_no_hardening_carries_is_told():
    """A law that saturates below the stress at a corner: the bound is infinite."""
    result = semismooth_newton(pulled(Voce(1.5, 1.0, 50.0), 0.0, 4, order=1))
    assert result.status.is_success
    assert error_bound(result).total == np.inf


def test_a_bound_on_the_mesh_itself_where_that_on_its_bisected_copy_is_infinite(
    monkeypatch,
):
    """A stress on the copy may exceed what the law reaches where that on the mesh does not."""
    result = semismooth_newton(pulled(*LAWS["Voce"], 4, order=1))
    own = bound_of(data_on(result.discrete), result.state)
    infinite = replace(own, total=np.inf)
    monkeypatch.setattr("ngepc.bounds.bound.bound_on_copy", lambda result: infinite)
    assert error_bound(result).total == pytest.approx(own.total, rel=1e-9)
    monkeypatch.setattr("ngepc.bounds.bound.bound_of", lambda *given: infinite)
    assert error_bound(result) is infinite


@pytest.mark.parametrize(
    ("kinematics", "law"), in_turn(["plane strain", "two-dimensional"], [None, "Swift"])
)
def test_initial_strains(kinematics, law):
    """A body that may swell freely has no stress: the bound sees no error; held, it is no less."""
    given = LAWS["Swift"]
    swelling = 2e-3
    data = {"kinematics": kinematics, "initial_strain": swelling, "order": 1}

    def problem(n, clamped="left"):
        one = pulled(*given, n, clamped=clamped, **data)
        if law is None:
            linear = Material.kinematic(**ELASTIC, yield_stress=1.2, hardening=60.0)
            one = one.changed(material=linear)
        return one

    coarse = semismooth_newton(problem(3))
    fine = semismooth_newton(problem(12))
    bound = error_bound(coarse)
    assert 0 < coarse.primal_energy - fine.primal_energy <= bound.total
    by_region = CF(swelling) * (1 + 0 * x)
    again = semismooth_newton(problem(3).changed(initial_strain=by_region))
    assert error_bound(again).total == pytest.approx(bound.total, rel=1e-10)
    with pytest.raises(ValueError, match="initial_strain varies inside elements"):
        error_bound(semismooth_newton(problem(3).changed(initial_strain=swelling * x)))
