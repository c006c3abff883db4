"""Laws of hardening: potentials, bars in closed form, both solvers, limit loads."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from ngsolve import CF, IfPos, x, y
from pairs import in_turn
from samples import stop_after

from ngepc import (
    Material,
    NewtonOptions,
    Problem,
    Status,
    Swift,
    Tabulated,
    Voce,
    evolve,
    lame_parameters,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.evolution.load_path import Schedule
from ngepc.geometries import block, lshape, punch
from ngepc.model.hardening import HardeningLaw

E, NU = 200e3, 0.3
ELASTIC = dict(zip(("lame_lambda", "lame_mu"), lame_parameters(E, NU), strict=True))
LAWS = {
    "Voce": Voce(250.0, 120.0, 40.0),
    "Swift": Swift(250.0, 0.004, 0.2),
    "table": Tabulated([0, 0.01, 0.02, 0.1], [250.0, 250.0, 290.0, 380.0]),
}
INVERSE = {
    "Voce": lambda s: -math.log(1 - (s - 250) / 120) / 40,
    "Swift": lambda s: 0.004 * ((s / 250) ** 5 - 1),
    "table": lambda s: float(
        np.interp(s, [250.0 + 1e-9, 290.0, 380.0], [0.01, 0.02, 0.1])
    ),
}
"""PEEQ of a bar under a stress."""

every_law = pytest.mark.parametrize("name", LAWS)


@every_law
def test_potentials(name):
    """R = E', R' by central differences; a coefficient gives the same numbers."""
    law, there = LAWS[name], np.array([0.001, 0.005, 0.015, 0.07, 0.4])
    step = 1e-6
    quotient = (law.energy(there + step) - law.energy(there - step)) / (2 * step)
    assert quotient == pytest.approx(law.stress(there), rel=1e-7)
    quotient = (law.stress(there + step) - law.stress(there - step)) / (2 * step)
    assert quotient == pytest.approx(law.slope(there), rel=1e-5, abs=1e-6)
    assert law.energy(0.0) == pytest.approx(0.0, abs=1e-12)
    mesh = block.structured_mesh(1, 1)
    for part in (law.energy, law.stress, law.slope):
        found = [part(x)(mesh(value, 0.5)) for value in there]
        assert found == pytest.approx(list(part(there)), rel=1e-13)


def bar(law, stress, **changes):
    """A cylinder of height 1 under axial stress, free to contract."""
    return Problem(
        block.structured_mesh(2, 2),
        Material.with_law(**ELASTIC, law=law, **changes),
        clamped=None,
        prescribed={"clamped": (None, 0), "left": (0, None)},
        traction={"contact": (0, stress)},
        kinematics="axisymmetric",
    )


@pytest.mark.parametrize(
    ("name", "method"), in_turn(LAWS, [semismooth_newton, primal_newton])
)
def test_bar_in_tension(name, method):
    """eps = sigma/E + PEEQ(sigma), and u_r = -(nu sigma/E + PEEQ/2) r."""
    for stress in (200.0, 265.0, 320.0, 365.0):
        peeq = INVERSE[name](stress) if stress > 250 else 0.0
        result = method(bar(LAWS[name], stress)).raise_for_status()
        radial, axial = result.displacement(result.problem.mesh(1.0, 1.0))
        assert axial == pytest.approx(stress / E + peeq, rel=1e-9)
        assert radial == pytest.approx(-NU * stress / E - peeq / 2, rel=1e-9)
        there = result.problem.mesh(0.3, 0.4)
        assert result.accumulated_plastic_strain(there) == pytest.approx(peeq, rel=1e-9)
        assert result.yield_function(there) <= 1e-9 * stress
        gap = abs(result.primal_energy + result.dual_energy)
        assert gap < (1e-9 if method is primal_newton else 1e-12) * abs(
            result.primal_energy
        )


CYCLE = [265.0, 320.0, 0.0, -310.0, -340.0, 100.0, 350.0]


@pytest.mark.parametrize(("name", "hardening"), in_turn(LAWS, [2e3, 0.0]))
def test_bar_in_a_history(name, hardening, tmp_path):
    """The surface grows with PEEQ and moves with k p; a checkpoint goes on where it stopped."""
    problem, law = bar(LAWS[name], 0.0, hardening=hardening), LAWS[name]
    steps = [(float(i), {"traction": {"contact": (0, s)}}) for i, s in enumerate(CYCLE)]
    file = tmp_path / "history.npz"
    evolve(problem, steps, checkpoint=file, monitor=stop_after(3))
    history = evolve(problem, steps, checkpoint=file)
    assert history.status is Status.CONVERGED
    plastic, peeq = 0.0, 0.0
    for step, stress in zip(history.steps, CYCLE, strict=True):
        sign = math.copysign(1.0, stress - 1.5 * hardening * plastic)

        def excess(g, sign=sign, stress=stress, plastic=plastic, peeq=peeq):
            left = sign * stress - 1.5 * hardening * (sign * plastic + g)
            return left - law.stress(peeq + g)

        if excess(0.0) > 1e-9:
            grown = _root(excess)
            plastic, peeq = plastic + sign * grown, peeq + grown
        there = problem.mesh(1.0, 1.0)
        found = step.fields.displacement(there)[1]
        assert found == pytest.approx(stress / E + plastic, rel=1e-8, abs=1e-12)
        assert step.fields.accumulated_plastic_strain(there) == pytest.approx(
            peeq, rel=1e-8
        )
    assert peeq > 1.2 * abs(plastic)


def _root(function, low=0.0, high=1.0):
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) > 0 else (low, middle)
    return low


def example_a(nodes, **changes):
    """Example (a) in plane strain with a law and a little kinematic hardening."""
    return replace(
        lshape_problem(lshape.paper_mesh(nodes)), kinematics="plane strain", **changes
    )


@pytest.mark.parametrize(("name", "order"), [("Voce", 2), ("table", 1)])
def test_both_methods_agree_with_contact(name, order):
    """Example (a): u to 1e-10, J to 1e-12, J + J* = 0, |q| within the bound that was reached."""
    material = Material.with_law(
        lame_lambda=1e3, lame_mu=1e3, law=SOFT[name], hardening=CF(1.0) + 0.1 * x
    )
    problem = example_a(33, material=material, order=order)
    one = semismooth_newton(problem).raise_for_status()
    two = primal_newton(problem).raise_for_status()
    size = np.abs(one.state.u).max()
    assert np.abs(one.state.u - two.state.u).max() < 1e-10 * size
    assert two.primal_energy == pytest.approx(one.primal_energy, rel=1e-12)
    for result in (one, two):
        assert abs(result.primal_energy + result.dual_energy) < 1e-12 * abs(
            one.primal_energy
        )
    assert one.state.at.yields.mean() > 0.3


SOFT = {
    "Voce": Voce(1.5, 1.0, 50.0),
    "Swift": Swift(1.5, 0.01, 0.3),
    "table": Tabulated([0, 0.01, 0.1, 0.5], [1.5, 1.5, 2.5, 2.7]),
}


def test_a_linear_law_is_the_linear_one():
    """As a table, as Swift's with exponent 1, as (2.15): the same solution and about the counts."""
    h, bound = 10.0, 1.25
    start, slope = bound / math.sqrt(2 / 3), 1.5 * h
    base = lshape_problem(lshape.paper_mesh(833))
    linear = semismooth_newton(
        replace(base, material=replace(base.material, hardening=h))
    )
    for law in (
        Tabulated([0, 9.0], [start, start + 9 * slope]),
        Swift(start, start / slope, 1.0),
    ):
        material = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=law)
        result = semismooth_newton(replace(base, material=material)).raise_for_status()
        assert abs(result.iterations - linear.iterations) <= 1
        assert result.primal_energy == pytest.approx(linear.primal_energy, rel=1e-14)
        assert result.dual_energy == pytest.approx(linear.dual_energy, rel=1e-13)
        size = np.abs(linear.state.u).max()
        assert np.abs(result.state.u - linear.state.u).max() < 1e-13 * size


LINEAR = Tabulated([0], [1.5])


@cache
def counts_of(law):
    """Steps on 417 and 1601 nodes."""
    material = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=law, hardening=1.0)
    problems = (example_a(nodes, material=material) for nodes in (417, 1601))
    return [
        semismooth_newton(problem).raise_for_status().iterations for problem in problems
    ]


@every_law
def test_counts_are_those_of_linear_hardening(name):
    """At most as many steps as with the last slope from the start, on 417 and 1601 nodes."""
    assert max(counts_of(SOFT[name])) <= max(counts_of(LINEAR))


def test_data_of_laws_are_coefficients():
    """Coefficients are taken at the points, in both methods; constant ones are numbers."""
    half = IfPos(y - 0.5, 80.0, 120.0)
    problem = bar(Voce(250.0, half, 40.0), 300.0)
    one, two = semismooth_newton(problem), primal_newton(problem)
    there = one.discrete.points.at(y) > 0.5
    isotropic = one.discrete.law.resistance.isotropic
    assert (isotropic.saturation == np.where(there, 80.0, 120.0)).all()
    assert np.abs(one.state.u - two.state.u).max() < 1e-10 * np.abs(one.state.u).max()
    number = semismooth_newton(bar(Voce(250.0, 80.0, 40.0), 300.0))
    constant = semismooth_newton(bar(Voce(CF(250.0), CF(80.0), CF(40.0)), 300.0))
    assert (number.state.u == constant.state.u).all()


@dataclass(frozen=True, eq=False)
class Softening(HardeningLaw):
    """What is not convex."""

    def energy(self, x):
        return x - x**2

    def stress(self, x):
        return 1 - 2 * x

    def slope(self, x):
        return -2.0 + 0 * x


BAD = {
    "falls": (lambda: Tabulated([0, 1], [250.0, 200.0]), "do not fall"),
    "own": (lambda: bar(Softening(), 1.0), "softening"),
    "first": (lambda: Tabulated([0.1, 1], [1.0, 2.0]), "increasing numbers from 0"),
    "lengths": (lambda: Tabulated([0, 1], [1.0]), "2 values are needed"),
    "rate": (lambda: Voce(250.0, 1.0, 0.0), "rate=0"),
    "offset": (lambda: Swift(250.0, -1.0, 0.2), "offset=-1"),
    "gamma": (
        lambda: semismooth_newton(example_voce(), gamma=1e3),
        "material.law=Voce",
    ),
}


def example_voce():
    material = Material.with_law(
        lame_lambda=1e3, lame_mu=1e3, law=SOFT["Voce"], hardening=1.0
    )
    return example_a(33, material=material)


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_covered_is_refused(name):
    call, message = BAD[name]
    with pytest.raises((ValueError, TypeError), match=message):
        call()


# Limit loads of perfect plasticity: one row of a table


def hill(pressure):
    """Hill's cylinder, a = 100, b = 200, perfectly plastic, plane strain, order 2."""
    mesh = block.structured_mesh(20, 1, size=(100.0, 10.0))
    for point in mesh.ngmesh.Points():
        point[0] += 100.0
    lame_lambda, lame_mu = lame_parameters(210.0, 0.3)
    material = Material.with_law(
        lame_lambda=lame_lambda, lame_mu=lame_mu, law=Tabulated([0], [0.24])
    )
    return Problem(
        type(mesh)(mesh.ngmesh),
        material,
        clamped=None,
        traction={"left": (pressure, 0.0)},
        prescribed={"clamped|contact": (None, 0)},
        kinematics="axisymmetric",
        order=2,
    )


def footing(pressure):
    """Prandtl's load as a uniform pressure on a half space, shear yield stress 1, order 2."""
    law = Tabulated([0], [math.sqrt(3)])
    return Problem(
        punch.mesh(maxh=0.8, fine=0.1),
        Material.with_law(lame_lambda=4000.0, lame_mu=1000.0, law=law),
        traction={"contact": (0, -pressure)},
        order=2,
    )


def limit_load(problem_at, low, high, rounds=6):
    """The load between two where it no longer converges; beyond, every status says why."""
    options = NewtonOptions(tolerance=1e-8)
    for _ in range(rounds):
        middle = 0.5 * (low + high)
        result = semismooth_newton(problem_at(middle), options=options)
        if result.status is Status.CONVERGED:
            low = middle
        else:
            assert result.status is Status.LIMIT_LOAD, result.message
            high = middle
    return 0.5 * (low + high)


@pytest.mark.parametrize(
    ("problem_at", "exact"),
    [(hill, 0.48 / math.sqrt(3) * math.log(2)), (footing, 2 + math.pi)],
)
def test_limit_loads(problem_at, exact):
    """Hill's and Prandtl's limit loads by load control, within two percent."""
    assert limit_load(problem_at, 0.8 * exact, 1.2 * exact) == pytest.approx(
        exact, rel=0.02
    )


def test_a_history_stops_at_the_limit_load():
    """The steps before are kept, and the status says what happened."""
    limit = 0.48 / math.sqrt(3) * math.log(2)
    steps = Schedule(
        np.linspace(0.2, 1.2, 6), lambda t: {"traction": {"left": (t * limit, 0.0)}}
    )
    history = evolve(hill(0.0), steps, cuts=2)
    assert history.status is Status.LIMIT_LOAD
    assert 0.9 <= history.times[-1] < 1.02
    assert "limit load" in history.message
