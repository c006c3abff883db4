"""Bounds and intervals of a time step with a law of the rate."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import value_of
from ngsolve import x

from ngepc import (
    Material,
    Norton,
    Problem,
    Voce,
    error_bound,
    evolve,
    goal_bound,
    semismooth_newton,
)
from ngepc.bounds.flow_potentials import flow_potential, least_potential
from ngepc.bounds.polynomials import triangle_rule
from ngepc.discretisation.resistance import Resistance
from ngepc.geometries import block
from ngepc.model.tensile import PEEQ
from ngepc.model.viscosity import RateLaw

LAME = {"lame_lambda": 1.5e3, "lame_mu": 1e3}
LINEAR = Material.kinematic(**LAME, yield_stress=1.25, hardening=60.0)
SATURATING = Material.with_law(**LAME, law=Voce(1.5, 0.5, 100.0), hardening=50.0)
DURATION = 0.1


@dataclass(frozen=True, eq=False)
class Quadratic(RateLaw):
    """A law of one's own, the overstress K x^2, which says nothing of its slopes."""

    K: float

    def energy(self, x):
        return self.K * x**3 / 3

    def stress(self, x):
        return self.K * x**2

    def slope(self, x):
        return 2 * self.K * x

    def rate(self, overstress):
        return (overstress / self.K) ** 0.5


RATES = {
    "linear": replace(LINEAR, rate=Norton(5.0)),
    "power": replace(LINEAR, rate=Norton(2.0, 4.0)),
    "own": replace(LINEAR, rate=Quadratic(400.0)),
    "Voce": replace(SATURATING, rate=Norton(1.0, 3.0)),
}


def pulled(material, order=1, n=4, **data):
    """A clamped square that is pulled until a part of it flows."""
    mesh = block.structured_mesh(n, n, simplices=True)
    given = {"traction": {"right": (1.5, 0.8)}, "duration": DURATION, "order": order}
    return Problem(mesh, material, **given | data)


@pytest.mark.parametrize("order", [1, 2])
def test_a_linear_rate_is_linear_hardening_in_one_step(order):
    """K (2/3)^(1/2) |p|/dt is the bound of isotropic hardening with the modulus 2/3 K/dt.

    With order two the integral of phi is known a little less well for general laws.
    """
    rate = RATES["linear"]
    modulus = PEEQ**2 * rate.rate.overstress / DURATION
    hard = replace(LINEAR, hardening=LINEAR.hardening + modulus)
    one, two = (
        error_bound(semismooth_newton(pulled(material, order)))
        for material in (rate, hard)
    )
    assert one.state.at.yields.any()
    assert -1e-6 < (one.energy - two.energy) / two.total < 0.05
    assert one.total == pytest.approx(two.total, rel=0.06)


@pytest.mark.parametrize("name", RATES)
def test_slopes_enclose_differences(name):
    """And the integral of the conjugate from below is below a fine rule."""
    material = RATES[name]
    one = np.ones(1)
    law = None if material.law is None else material.law.at(lambda v: v * one)
    rate = material.rate.at(lambda v: v * one)
    resistance = Resistance(1.2 * one, law, 0.002 * one, rate, DURATION)
    many = resistance.of(np.zeros(400, dtype=int))
    for first, last in ((0.0, 1e-4), (1e-4, 3e-3)):
        g = np.linspace(first, last, 400)
        slopes = np.diff(many.bound(g)) / np.diff(g)
        low, high = resistance.slopes(first * one, last * one)
        assert low <= slopes.min() * (1 + 1e-8)
        assert high >= slopes.max() * (1 - 1e-8)

    modulus = 2000.0 * one
    places, weights = triangle_rule(20)
    random = np.random.default_rng(2)
    for size in (0.1, 0.5, 2.0):
        s = size * random.normal(size=(1, 3, 3)) + np.array([1.0, 1.0, 0.5])
        sizes = np.linalg.norm(places @ s[0], axis=1)[None]
        columns = resistance.of(np.s_[:, None])
        gained = columns.gained_at(sizes, modulus[:, None])
        values = flow_potential(columns, modulus[:, None], sizes, gained)
        exact = float(values[0] @ weights)
        bound = least_potential(resistance, modulus, s, one)[0]
        assert 0.2 * exact <= bound <= exact * (1 + 1e-4)


@pytest.mark.parametrize(
    ("order", "name"), [(1, "linear"), (2, "power"), (1, "own"), (2, "Voce")]
)
def test_energies_and_goals_of_finer_meshes(name, order):
    problem = pulled(RATES[name], order)
    result = semismooth_newton(problem)
    fine = semismooth_newton(finer(replace(problem, order=2), 1))
    bound = error_bound(result)
    better = error_bound(fine)
    assert bound.guaranteed
    assert bound.least_energy < better.least_energy < better.energy < bound.energy
    assert bound.total < 2 * (bound.energy - better.least_energy)
    interval = goal_bound(result, "work")
    assert interval.lower < value_of(fine, "work") < interval.upper


def test_steps_of_a_history_follow_their_bounds():
    steps = [(0.1, {}), (0.3, {"traction": {"right": (-1.0, 0.5)}})]
    problem = replace(pulled(RATES["power"], 2), duration=None)
    history = evolve(problem, steps, error=0.02).raise_for_status()
    assert max(history.column("error_bound")) <= 0.02


def test_data_that_vary_inside_elements_are_refused():
    varying = replace(LINEAR, rate=Norton(1.0 + x))
    with pytest.raises(ValueError, match=r"material.rate \(datum 0\) varies inside"):
        error_bound(semismooth_newton(pulled(varying)))
