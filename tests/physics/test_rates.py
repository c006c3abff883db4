"""Materials with a rate: closed Euler steps of a bar, first order in time, creep, press fits."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from pairs import every_pair, in_turn
from scipy.optimize import brentq

from ngepc import (
    Material,
    Norton,
    Problem,
    RateLaw,
    Schedule,
    Status,
    evolve,
    material_point,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block

E, NU, R, H, K = 210e3, 0.3, 200.0, 2500.0, 400.0
ELASTIC = {"young": E, "poisson": NU, "yield_stress": R}


def euler_step(strain, plastic, dt, n, hardening=H, bound=R):
    """The plastic strain of a bar after an implicit Euler step, and its stress."""

    def excess(gained):
        over = K * (gained / dt) ** (1 / n)
        return (
            E * (strain - plastic - gained)
            - bound
            - hardening * (plastic + gained)
            - over
        )

    if excess(0.0) > 0:
        plastic += brentq(excess, 0.0, strain, xtol=1e-18, rtol=1e-15)
    return plastic, E * (strain - plastic)


def bar(material, **data):
    """A quarter of a round bar on rollers, free at its side."""
    mesh = block.structured_mesh(1, 1)
    held = {"clamped": (None, 0), "left": (0, None)}
    return Problem(
        mesh, material, None, prescribed=held | data.pop("prescribed", {}),
        kinematics="axisymmetric", **data,
    )  # fmt: skip


def axial_stress(fields):
    return fields.stress(fields.problem.mesh(0.3, 0.4))[4]


@pytest.mark.parametrize(
    ("kind", "solver", "power"),
    every_pair(
        ["isotropic", "kinematic"], [None, primal_newton], [(1.0, 1e-10), (5.0, 1e-8)]
    ),
)
def test_steps_of_a_bar_are_those_of_implicit_euler(power, solver, kind):
    n, accuracy = power
    rate = Norton(K, n)
    metal = Material.metal(**ELASTIC, plastic_modulus=H, kind=kind, rate=rate)
    times = (0.1, 0.15, 0.5, 1.0, 3.0)
    speed = 0.01

    def stretched(time):
        return {
            "prescribed": {**bar(metal).prescribed, "contact": (None, speed * time)}
        }

    history = evolve(bar(metal), Schedule(times, stretched), solver).raise_for_status()
    plastic = 0.0
    before = 0.0
    for time, step in zip(times, history.steps, strict=True):
        plastic, stress = euler_step(speed * time, plastic, time - before, n)
        before = time
        assert axial_stress(step.fields) == pytest.approx(stress, rel=accuracy)


@pytest.mark.parametrize("n", [1.0, 5.0])
def test_relaxation_is_of_first_order_in_time(n):
    """A bar that is held: d sigma / dt = -E ((sigma - R)/K)^n, without hardening."""
    metal = Material.metal(**ELASTIC, plastic_modulus=0.0, rate=Norton(K, n))
    strain, duration = 0.003, 0.004 if n == 1 else 2.0
    over = E * strain - R
    if n == 1:
        left = over * np.exp(-E / K * duration)
    else:
        left = (over ** (1 - n) + (n - 1) * E * duration / K**n) ** (1 / (1 - n))
    errors = []
    for steps in (20, 40, 80):
        path = {"xx": [strain] * steps}
        held = material_point(metal, strain=path, duration=duration / steps)
        errors.append(held.stress[-1, 0, 0] - R - left)
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(1.0, abs=0.1)
    assert abs(errors[-1]) < 0.05 * left


def test_nortons_creep_under_a_constant_stress():
    """Strain = sigma/E + A sigma^n t, without a yield stress; exact for each step length."""
    A, n, stress, duration = 1e-15, 5.0, 100.0, 2000.0
    metal = Material.metal(
        young=E,
        poisson=NU,
        yield_stress=1e-9,
        plastic_modulus=0.0,
        rate=Norton(A ** (-1 / n), n),
    )
    crept = material_point(metal, stress={"xx": [stress] * 4}, duration=duration / 4)
    rates = np.diff([0.0, *crept.strain[:, 0, 0] - stress / E]) / (duration / 4)
    assert rates == pytest.approx(A * stress**n, rel=1e-8)


def pressed(rate, order=1, **data):
    """A block that is pulled up against a ceiling and to the side."""
    mesh = block.structured_mesh(4, 4, simplices=True)
    metal = Material.metal(**ELASTIC, plastic_modulus=H, rate=rate)
    load = {"contact": (0.0, 300.0), "right": (150.0, 0.0)}
    return Problem(
        mesh, metal, traction=load, contact="contact", gap=5e-4, order=order, **data
    )


def values(result):
    return result.displacement.vec.FV().NumPy()


@pytest.mark.parametrize(("order", "n"), in_turn([1, 2], [1.0, 3.0, 10.0]))
def test_both_solvers_agree_and_the_certificate_closes(n, order):
    problem = pressed(Norton(K, n), order, duration=0.5)
    result = semismooth_newton(problem).raise_for_status()
    witness = primal_newton(problem).raise_for_status()
    size = np.abs(values(witness)).max()
    assert np.abs(values(result) - values(witness)).max() < 1e-9 * size
    assert abs(result.primal_energy + result.dual_energy) < 1e-9 * abs(
        result.primal_energy
    )
    assert result.contact_force > 1.0
    assert result.iterations <= 15


def test_slow_loads_feel_no_rate_and_fast_ones_no_flow():
    slow = semismooth_newton(pressed(Norton(K, 2.0), duration=1e30))
    without = semismooth_newton(replace(pressed(None)))
    size = np.abs(values(without)).max()
    assert np.abs(values(slow) - values(without)).max() < 1e-9 * size
    fast = semismooth_newton(pressed(Norton(K, 1.0), duration=1e-15))
    stiff = Material.metal(**ELASTIC | {"yield_stress": 1e9}, plastic_modulus=H)
    elastic = semismooth_newton(replace(pressed(None), material=stiff))
    assert np.abs(values(fast) - values(elastic)).max() < 1e-9 * size


def test_a_pressed_block_creeps_until_it_is_that_without_a_rate():
    problem = pressed(Norton(K, 3.0))
    times = tuple(np.geomspace(1e-4, 1e6, 12))
    history = evolve(problem, Schedule(times, lambda time: {})).raise_for_status()
    largest = history.column("max_plastic_strain")
    assert (np.diff(largest) > 0).all()
    assert max(history.column("iterations")) <= 15


def test_a_press_fit_relaxes():
    """A ring on a rigid shaft that is too large for it: the force falls to that without a rate."""
    mesh = block.structured_mesh(6, 1, size=(1.0, 0.2))
    mesh.ngmesh.Coordinates()[:, 0] += 1.0
    rate = Norton(K, 4.0)
    fit = {"kinematics": "axisymmetric", "contact": "left", "gap": -1.6e-3, "order": 2}
    held = {"clamped": (None, 0), "contact": (None, 0)}
    metal = Material.metal(**ELASTIC, plastic_modulus=H, rate=rate)
    ring = Problem(mesh, metal, None, prescribed=held, **fit)
    times = tuple(np.geomspace(1e-6, 1e8, 15))
    history = evolve(ring, Schedule(times, lambda time: {})).raise_for_status()
    forces = history.column("contact_force")
    assert (np.diff(forces) < 0).all()
    still = replace(ring, material=Material.metal(**ELASTIC, plastic_modulus=H))
    last = semismooth_newton(still).contact_force
    assert last < forces[-1] < 1.01 * last
    assert forces[0] > 1.2 * last


def test_a_rate_without_a_time_step_is_refused_by_name():
    for solve in (semismooth_newton, primal_newton):
        with pytest.raises(
            ValueError, match=r"material.rate=Norton.*duration= is needed"
        ):
            solve(pressed(Norton(K, 1.0)))
    with pytest.raises(ValueError, match="duration= is needed"):
        material_point(pressed(Norton(K)).material, strain={"xx": 0.01})
    with pytest.raises(ValueError, match="duration= is needed"):
        evolve(pressed(Norton(K)), [(0.0, {}), (1.0, {})])


@pytest.mark.parametrize(
    ("given", "message"),
    [((0.0, 1.0), "overstress"), ((1.0, 0.5), "exponent"), ((1.0, 100.0), "exponent")],
)
def test_bad_rates_are_named(given, message):
    with pytest.raises(ValueError, match=message):
        Norton(*given)


@dataclass(frozen=True, eq=False)
class Saturating(RateLaw):
    """A law of one's own: K arsinh(x / x_0), from thermally activated glide."""

    overstress: float
    slowest: float

    def energy(self, x):
        y = x / self.slowest
        part = y * np.arcsinh(y) - np.sqrt(1 + y * y) + 1
        return self.overstress * self.slowest * part

    def stress(self, x):
        return self.overstress * np.arcsinh(x / self.slowest)

    def slope(self, x):
        y = x / self.slowest
        return self.overstress / self.slowest / np.sqrt(1 + y * y)

    def rate(self, overstress):
        return self.slowest * np.sinh(overstress / self.overstress)


class Falling(Saturating):
    """Its overstress falls beyond the rate x_0."""

    def stress(self, x):
        y = x / self.slowest
        return self.overstress * y / (1 + y * y)


class Exponential(Saturating):
    """Its overstress is beyond all numbers from 710 x_0 on."""

    def stress(self, x):
        return self.overstress * np.expm1(x / self.slowest)


@pytest.mark.parametrize("time", [1e-12, 1.0, 1e15])
def test_laws_are_checked_in_every_unit_of_time(time):
    """A law that falls beyond the rate 1e9 was accepted, an exponential one of 1e3 refused."""
    pressed(Saturating(30.0, 1e-3 / time), duration=0.1 * time)
    pressed(Exponential(30.0, 1.0 / time), duration=0.1 * time)
    with pytest.raises(ValueError, match="values that never fall are needed"):
        pressed(Falling(30.0, 1.0 / time), duration=0.1 * time)


def test_a_law_of_ones_own():
    problem = pressed(Saturating(30.0, 1e-3), duration=0.1)
    result = semismooth_newton(problem).raise_for_status()
    assert result.status is Status.CONVERGED
    assert abs(result.primal_energy + result.dual_energy) < 1e-9 * abs(
        result.primal_energy
    )
