"""The largest value along an arc: derivatives against differences, never below any sample."""

import numpy as np
import pytest

from ngepc.goals.supremum import Arc, ScaledLaw
from ngepc.goals.yielding import by_components


@pytest.fixture
def arc():
    """Many arcs of different lengths, bent up or down."""
    random = np.random.default_rng(3)
    n = 300
    v = random.uniform(0.2, 3.0, n)
    least = v * random.uniform(0.0, 0.95, n)  # beta is not negative
    return Arc(
        v,
        least * random.uniform(0.0, 1.0, n),
        least,
        random.uniform(0.5, 4.0, n),
        10 ** random.uniform(-2, 1, n),
        np.cos(random.uniform(0.1, np.pi, n)),
    )


def test_derivatives_by_the_angle(arc):
    h = 1e-4
    angle = 0.7 * np.arccos(arc.end)
    here = arc._parts(np.cos(angle), np.sin(angle))
    ahead = arc._parts(np.cos(angle + h), np.sin(angle + h))
    behind = arc._parts(np.cos(angle - h), np.sin(angle - h))
    first = (ahead[0] - behind[0]) / (2 * h)
    second = (ahead[0] - 2 * here[0] + behind[0]) / h**2
    np.testing.assert_allclose(here[1], first, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(-here[2], second, rtol=1e-5, atol=1e-5)


def test_nothing_on_the_arc_is_larger(arc):
    """And the bound is close: within a few percent of the range of the values."""
    largest = arc.largest()
    angles = np.linspace(0, 1, 400)[:, None] * np.arccos(arc.end)
    values = arc._parts(np.cos(angles), np.sin(angles))[0]
    assert (largest >= values.max(axis=0) - 1e-12).all()
    size = 1 + np.abs(values).max(axis=0)
    assert np.median((largest - values.max(axis=0)) / size) < 1e-3
    assert ((largest - values.max(axis=0)) / size).max() < 0.2


def test_nowhere_on_the_arc_it_bends_less(arc):
    """And at the end of the arc only the slope's part of the bound is not attained."""
    angles = np.linspace(0, 1, 400)[:, None] * np.arccos(arc.end)
    bends = arc._parts(np.cos(angles), np.sin(angles))[2]
    least = arc._least_bend()
    assert (least <= bends.min(axis=0) + 1e-12 * np.abs(bends).max(axis=0)).all()
    assert (least >= bends[-1] - 2 * arc.slope - 1e-12 * np.abs(bends[-1])).all()


@pytest.mark.parametrize("d", [2, 3, 5])
def test_the_potential_is_a_supremum_of_affine_functions(d):
    """Phi(q, w) = sup over t of q : t/(2 mu_2) + w : S(t) - lambda t : S(t)/(2 mu_2)."""
    random = np.random.default_rng(d)
    n = 100
    two_mu = random.uniform(1.0, 3.0, n)
    hardening = two_mu * 10 ** random.uniform(-2, 0, n)
    beta = random.uniform(0.5, 2.0, n)
    factor = 1.7
    law = ScaledLaw.of(two_mu, hardening, beta, factor)
    pulled, w = random.normal(size=(2, n, 3, d))
    found = law.potential(pulled, w)
    size = np.sqrt((pulled**2).sum(axis=2)) + np.sqrt((w**2).sum(axis=2))

    best = np.full((n, 3), -np.inf)
    modulus = two_mu + hardening
    for _ in range(4000):
        t = random.normal(size=(n, 3, d)) * 10 ** random.uniform(-1, 2, (n, 3, 1))
        length = np.sqrt((t**2).sum(axis=2))
        share = np.minimum(beta[:, None] / length, 1.0)
        kept = (hardening[:, None] + two_mu[:, None] * share) / modulus[:, None]
        stress = kept[..., None] * t
        value = (pulled * t + w * stress).sum(axis=2)
        value -= factor / two_mu[:, None] * (t * stress).sum(axis=2)
        best = np.maximum(best, value)
    assert (best <= found + 1e-12 * size).all()
    assert np.median(best / found) > 0.7

    middle = law.potential(pulled.mean(axis=1)[:, None], w.mean(axis=1)[:, None])
    assert (middle[:, 0] <= found.mean(axis=1) * (1 + 1e-4)).all()

    points = pulled.reshape(-1, 1, d), w.reshape(-1, 1, d)
    law = law.repeated(3)
    elastic = law.elastic(*map(by_components, points))
    exact = law.quadratic(*points, 1.0)
    np.testing.assert_allclose(found.ravel()[elastic], exact[elastic])
    assert 0.0 < elastic.mean() < 1.0
