"""The supremum of goals for Hill's ellipsoid: no strain exceeds it, and it is close to it."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import STEEL, pressed_body
from campaigns.crossings import finer
from ngsolve import Integrate, ds

from ngepc import (
    Hill,
    LoadWork,
    Material,
    NewtonOptions,
    Problem,
    Reaction,
    Voce,
    goal_bound,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.goals import supremum_of_ellipsoids
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_ellipsoids import CLOSE, EllipsoidLaw, largest_on_ellipsoid

FACTOR = 0.7
ROLLED = Hill.r_values(1.8, 1.2, 2.3, angle=0.2)
EXACT = NewtonOptions(tolerance=1e-12)


def random_rotations(rng, count, d):
    return np.linalg.qr(rng.normal(size=(count, d, d)))[0]


def drawn(seed, d, round_one=False, hardening=80.0):
    """A law, points that yield by different amounts, and p and w with errors of all sizes."""
    rng = np.random.default_rng(seed)
    count = 200
    sizes = np.ones((count, d)) if round_one else rng.uniform(0.4, 2.5, (count, d))
    two_mu = rng.uniform(1e3, 3e3, count)
    h = np.full(count, hardening)
    beta = rng.uniform(0.5, 2.0, count)
    law = EllipsoidLaw(two_mu, h, beta, sizes, random_rotations(rng, count, d), FACTOR)
    n = on_surface(rng.normal(size=(count, d)), sizes)
    g = 10 ** rng.uniform(-5, -2, count) * (rng.uniform(size=count) < 0.8)
    t, S = stresses(law, n, g)
    error = 10 ** rng.uniform(-4, -1, (count, 1))
    strain = 1e-3 * error * rng.normal(size=(count, d))
    tau = two_mu[:, None] * strain * rng.uniform(0.1, 1.0, (count, 1))
    p = (tau + FACTOR * (S + error * rng.normal(size=(count, d)))) / two_mu[:, None]
    w = FACTOR * t / two_mu[:, None] - strain
    return rng, law, (n, g), p, w


def on_surface(n, sizes):
    return n / np.sqrt((sizes * n**2).sum(axis=1))[:, None]


def stresses(law, n, g):
    """Trial stress and stress of plastic strains g along the eigenvectors, (n, d)."""
    grown = g[:, None] * law.sizes
    M = law.two_mu + law.hardening
    bound = law.beta[:, None]
    return (bound + M[:, None] * grown) * n, (
        bound + law.hardening[:, None] * grown
    ) * n


def value(law, p, w, t, S):
    k = law.factor / law.two_mu
    return ((p - k[:, None] * S) * t + w * S).sum(axis=1)


def along(law, x):
    """Coordinates along the axes from those along the eigenvectors."""
    return np.einsum("nci,ni->nc", law.vectors, x)


@pytest.mark.parametrize("d", [2, 3, 5])
def test_no_strain_exceeds_the_supremum(d):
    rng, law, (n, g), p, w = drawn(d, d)
    found = law.potential(along(law, p)[:, None], along(law, w)[:, None])[:, 0]
    best = np.full(len(found), -np.inf)
    for _ in range(3000):
        far = 10 ** rng.uniform(-4, 1, (len(found), 1))
        near = on_surface(n + far * rng.normal(size=n.shape), law.sizes)
        amount = np.abs(g + 10 ** rng.uniform(-6, -1) * rng.normal(size=len(g)))
        best = np.maximum(best, value(law, p, w, *stresses(law, near, amount)))
        inside = near * rng.uniform(size=(len(g), 1)) * law.beta[:, None]
        best = np.maximum(best, value(law, p, w, inside, inside))
    size = np.abs(p * w).sum(axis=1) / FACTOR * law.two_mu
    assert (found >= best - 1e-13 * size).all()
    if d == 2:  # in more dimensions random strains are not close enough
        known = (p * w).sum(axis=1) * law.two_mu / FACTOR
        assert np.median((found - best) / (found - known)) < CLOSE


def test_searches_that_end_early_lie_above(monkeypatch):
    """What is left of the search after the last halving has a bound, too."""
    _, law, _, p, w = drawn(2, 2)
    strains = along(law, p)[:, None], along(law, w)[:, None]
    found = law.potential(*strains)[:, 0]
    monkeypatch.setattr(supremum_of_ellipsoids, "HALVINGS", 1)
    early = law.potential(*strains)[:, 0]
    known = (p * w).sum(axis=1) * law.two_mu / FACTOR
    assert (early >= found - CLOSE * (found - known)).all()
    assert (early > found + CLOSE * (found - known)).any()


@pytest.mark.parametrize("d", [2, 3, 5])
def test_a_sphere_is_the_law_of_von_mises(d):
    _, law, _, p, w = drawn(10 + d, d, round_one=True)
    numbers = law.two_mu, law.hardening, law.beta
    usual = ScaledLaw.of(*numbers, FACTOR).potential(p[:, None], w[:, None])[:, 0]
    found = law.potential(along(law, p)[:, None], along(law, w)[:, None])[:, 0]
    known = (p * w).sum(axis=1) * law.two_mu / FACTOR
    above = (found - usual) / np.maximum(usual - known, 1e-12 * np.abs(known))
    assert above.max() < 1.001 * CLOSE
    assert np.median(np.abs(above)) < CLOSE


def test_the_maximum_on_an_ellipse():
    """Beside the values at many angles, where a vanishes along an axis, too."""
    rng = np.random.default_rng(3)
    sizes = rng.uniform(0.3, 3, (50, 2))
    Q = rng.uniform(0.0, 3, (50, 2))
    a = rng.normal(size=(50, 2)) * (rng.uniform(size=(50, 2)) < 0.7)
    angles = np.linspace(0, 2 * np.pi, 20_001)
    n = np.stack([np.cos(angles), np.sin(angles)]) / np.sqrt(sizes)[:, :, None]
    values = np.einsum("ni,nia->na", a, n) - np.einsum("ni,nia->na", Q, n**2)
    largest = values.max(axis=1)
    found = largest_on_ellipsoid(a, Q, sizes)
    assert (found >= largest - 1e-14).all()
    assert np.abs(found - largest).max() < 1e-6


def test_without_hardening_some_suprema_are_infinite():
    _, law, _, p, w = drawn(5, 3, hardening=0.0)
    found = law.potential(along(law, p)[:, None], along(law, w)[:, None])[:, 0]
    pull = np.sqrt((law.sizes * p**2).sum(axis=1)) * law.two_mu
    assert np.isinf(found[pull > FACTOR * law.beta]).all()
    assert np.isfinite(found[pull < FACTOR * law.beta]).all()
    assert 0 < np.isinf(found).sum() < len(found)


def test_where_nothing_may_yield_it_is_a_quadratic():
    _, law, _, p, w = drawn(7, 3)
    p, w = 1e-2 * p, 1e-2 * w
    x, v = along(law, p), along(law, w)
    assert law.elastic(x.T[:, None], v.T[:, None]).all()
    found = law.potential(x[:, None], v[:, None])[:, 0]
    k = law.factor / law.two_mu
    assert found == pytest.approx(((p + w) ** 2).sum(axis=1) / (4 * k), rel=1e-12)


def plate(hill, order, kinematics, contact=True):
    pressed = {"contact": "contact", "gap": -1e-3} if contact else {}
    return Problem(
        block.with_hole(0.35, (1.0, 1.0)),
        replace(STEEL, hill=hill),
        traction={"right": (1.5, 0.4)},
        kinematics=kinematics,
        order=order,
        **pressed,
    )


def solved(problem):
    return semismooth_newton(problem, options=EXACT).raise_for_status()


PULLED = LoadWork({"right": (1.0, 0.0)})


@pytest.mark.parametrize(
    ("kinematics", "order"), [("plane strain", 2), ("plane stress", 1)]
)
def test_intervals_hold_fine_values(order, kinematics):
    problem = plate(ROLLED, order, kinematics)
    result = solved(problem)
    fine = solved(finer(problem.changed(order=2), order - 1))
    assert result.state.plastic_measure > 0
    known = float(Integrate(fine.displacement[0] * ds("right"), fine.problem.mesh))
    goals = GoalProblem(result)
    found = goals.bound_of(PULLED)
    assert found.lower < known < found.upper
    pressed = goals.bound_of("contact_force")
    assert pressed.lower < fine.contact_force < pressed.upper
    pulled = goals.bound_of(Reaction("clamped", 0))
    assert pulled.lower < fine.equilibrium.reactions["clamped"][0] < pulled.upper


@pytest.mark.parametrize("order", [1, 2])
def test_intervals_of_a_sphere_are_nearly_those_of_von_mises(order):
    """Where a part yields everywhere, von Mises has a sharper mean."""
    round_one = solved(plate(Hill.r_values(1.0, 1.0, 1.0), order, "plane strain"))
    usual = solved(plate(None, order, "plane strain"))
    found = goal_bound(round_one, PULLED)
    known = goal_bound(usual, PULLED)
    assert found.discrete == pytest.approx(known.discrete, rel=1e-7)
    assert found.width == pytest.approx(known.width, rel=0.1)


def test_a_solid():
    problem = pressed_body("tetrahedra", material=replace(STEEL, hill=ROLLED))
    fine = solved(finer(problem, 1))
    found = goal_bound(solved(problem), "contact_force")
    assert found.lower < fine.contact_force < found.upper


def test_growing_ellipsoids_are_refused_by_name():
    law = Material.with_law(
        lame_lambda=1e3, lame_mu=1e3, law=Voce(1.5, 0.5, 100.0), hardening=50.0
    )
    grows = replace(STEEL, hardening_modulus=0.1, hardening_stiffness=1e3, hill=ROLLED)
    for material in (grows, replace(law, hill=ROLLED)):
        problem = replace(plate(None, 1, "plane strain", False), material=material)
        with pytest.raises(
            ValueError, match="a goal bound with Hill's criterion needs"
        ):
            goal_bound(semismooth_newton(problem), PULLED)
