"""Phi and its means over pieces: beside a search, exact where they should be, and their rates."""

import numpy as np
import pytest

from ngepc.bounds.polynomials import POWERS, tetrahedron_rule
from ngepc.goals.cutting import potential_integrals
from ngepc.goals.pieces import (
    MEANS,
    RULE,
    SPLIT,
    WEIGHTS,
    applied,
    child_coefficients,
    dots,
    mean_squares,
    pieces_last,
)
from ngepc.goals.supremum import ScaledLaw

COUNT = 40
FACTOR = 1.7
CORNERS = {3: 3, 4: 4, 6: 6, 9: 3, 16: 4, 18: 6}
"""Coefficients on a part, by those on a piece."""
FINE = {3: POWERS[4, 3], 4: tetrahedron_rule(6), 6: POWERS[4, 6]}


def in_cells(k):
    """A fine rule for pieces with k coefficients: values from coefficients, and weights."""
    own, weights = FINE[CORNERS[k]]
    parts = k // CORNERS[k]
    return np.kron(np.eye(parts), own), np.tile(weights, parts) / parts


class Drawn:
    """Pieces around trial stresses between two multiples of the yield bound."""

    def __init__(self, k, d, variation, least=0.2, most=3.0):
        rng = np.random.default_rng(k + d)
        self.k = k
        self.two_mu = rng.uniform(1.0, 3.0, COUNT)
        self.hardening = self.two_mu * 10 ** rng.uniform(-1, 0, COUNT)
        self.beta = rng.uniform(0.5, 2.0, COUNT)
        trial = rng.normal(size=(COUNT, 1, d))
        size = self.beta * rng.uniform(least, most, COUNT)
        trial *= (size / np.linalg.norm(trial[:, 0], axis=1))[:, None, None]
        share = np.minimum(self.beta / size, 1.0)
        kept = self.hardening + self.two_mu * share
        kept /= self.two_mu + self.hardening
        c = (FACTOR / self.two_mu)[:, None, None]
        spread = variation * c * self.beta[:, None, None]
        self.w = c * trial + spread * rng.normal(size=(COUNT, k, d))
        self.pulled = c * kept[:, None, None] * trial
        self.pulled = self.pulled + spread * rng.normal(size=(COUNT, k, d))
        self.law = ScaledLaw.of(self.two_mu, self.hardening, self.beta, FACTOR)

    def means(self):
        return self.law.means(self.pulled, self.w)

    def quadrature(self):
        places, weights = in_cells(self.k)
        return searched(self, places @ self.pulled, places @ self.w) @ weights


def searched(drawn, pulled, w):
    """Phi at points of each piece (n, k, d), from below: the largest of many plastic strains.

    The best direction of the stress is that of rho p + r w.
    """
    k = (FACTOR / drawn.two_mu)[:, None]
    beta = drawn.beta[:, None]
    kept = (drawn.hardening / (drawn.two_mu + drawn.hardening))[:, None]
    p_square, both, w_square = dots(pulled, pulled), dots(pulled, w), dots(w, w)
    y = np.sqrt(p_square + 2 * both + w_square)
    best = np.where(y <= 2 * k * beta, y**2 / (4 * k), beta * (y - k * beta))
    v = np.linalg.norm(pulled + kept[..., None] * w, axis=2)
    for part in np.linspace(0, 1, 200):
        x = part * v / (2 * k * kept)
        rho = beta + x
        r = beta + kept * x
        square = rho**2 * p_square + 2 * rho * r * both + r**2 * w_square
        best = np.maximum(best, np.sqrt(square) - k * rho * r)
    return best


@pytest.mark.parametrize("d", [2, 3, 5])
def test_the_potential_is_a_supremum_of_affine_functions(d):
    """Phi(q, w) = sup over t of q : t/(2 mu_2) + w : S(t) - lambda t : S(t)/(2 mu_2)."""
    random = np.random.default_rng(d)
    n = 100
    two_mu = random.uniform(1.0, 3.0, n)
    hardening = two_mu * 10 ** random.uniform(-2, 0, n)
    beta = random.uniform(0.5, 2.0, n)
    law = ScaledLaw.of(two_mu, hardening, beta, FACTOR)
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
        value -= FACTOR / two_mu[:, None] * (t * stress).sum(axis=2)
        best = np.maximum(best, value)
    assert (best <= found + 1e-12 * size).all()
    assert np.median(best / found) > 0.7


@pytest.mark.parametrize("along", [0.2, 0.8, 1.5, 4.0])
def test_it_is_attained_where_both_arguments_have_one_direction(along):
    """There r does not matter, and A + r v is as long as its parts."""
    drawn = Drawn(3, 3, 0.0)
    n = np.array([0.6, -0.8, 0.0])
    drawn.pulled = np.broadcast_to(along * n, (COUNT, 3, 3))
    drawn.w = 0.3 * drawn.pulled
    bound, estimate = drawn.means()
    p = FACTOR / drawn.two_mu
    y = 1.3 * along
    v = along + drawn.hardening / drawn.two_mu * y
    H = drawn.hardening / drawn.two_mu
    beyond = np.maximum(v - p * drawn.beta * (1 + 2 * H), 0.0)
    yields = drawn.beta * y - p * drawn.beta**2 + beyond**2 / (4 * p * H * (1 + H))
    exact = np.where(y <= 2 * p * drawn.beta, y**2 / (4 * p), 0.0)
    exact = np.maximum(exact, yields)
    np.testing.assert_allclose(bound, exact, rtol=1e-12)
    np.testing.assert_allclose(estimate, exact, rtol=1e-12)
    found = drawn.law.potential(drawn.pulled, drawn.w)
    np.testing.assert_allclose(found, np.repeat(exact[:, None], 3, axis=1), rtol=1e-12)


@pytest.mark.parametrize("angle", [np.pi, 2.5, 1.9])
def test_it_is_attained_where_the_arguments_are_opposed(angle):
    """F falls from zero on and rises again, to less than F(0): the maximum is F(0)."""
    law = Drawn(3, 3, 0.0).law
    v = 1.4 * law.start
    end = (v - law.start) / (2 * law.bend)
    cosine = -np.cos(angle)
    y = np.maximum(3 * law.k * law.beta, end * v / (1.9 * cosine * law.beta))
    of_y = y[:, None] * np.array([1.0, 0.0, 0.0])
    of_v = v[:, None] * np.array([np.cos(angle), np.sin(angle), 0.0])
    pulled = of_v - law.H[:, None] * of_y
    pulled, w = (np.repeat(x[:, None], 3, axis=1) for x in (pulled, of_y - pulled))
    exact = law.beta * y - law.k * law.beta**2
    np.testing.assert_allclose(law.means(pulled, w)[0], exact, rtol=1e-12)
    values = np.repeat(exact[:, None], 3, axis=1)
    np.testing.assert_allclose(law.potential(pulled, w), values, rtol=1e-12)


@pytest.mark.parametrize(("k", "d"), [(3, 2), (4, 5), (6, 3), (9, 2), (16, 5), (18, 3)])
@pytest.mark.parametrize("variation", [0.4, 0.1])
def test_means_lie_above_quadrature(k, d, variation):
    """Closer than the means of the values at the coefficients, in the median."""
    drawn = Drawn(k, d, variation)
    bound, _ = drawn.means()
    exact = drawn.quadrature()
    assert (bound - exact >= -1e-12 * np.abs(exact)).all()
    coefficients = drawn.law.potential(drawn.pulled, drawn.w).mean(axis=1)
    assert np.median((bound - exact) / (coefficients - exact)) < 1.5 * variation


def test_the_excess_is_of_third_order():
    """Half the variation of y and v leaves an eighth of it, and a quarter of other bounds."""
    excess = []
    for variation in (0.08, 0.04):
        drawn = Drawn(3, 2, variation, 1.3, 2.5)
        excess.append(drawn.means()[0] - drawn.quadrature())
    large = excess[0] > 1e-4
    assert large.sum() > 3
    assert np.median(np.log2(excess[0][large] / excess[1][large])) > 2.6


@pytest.mark.parametrize("k", [3, 4, 6, 9, 16, 18])
def test_it_is_exact_where_nothing_may_yield(k):
    drawn = Drawn(k, 3, 0.05, 0.2, 0.6)
    y = drawn.pulled + drawn.w
    square = mean_squares(pieces_last(y)) * drawn.two_mu / (4 * FACTOR)
    for found in drawn.means():
        np.testing.assert_allclose(found, square, rtol=1e-12)


def test_means_without_hardening():
    """beta |y| - k beta^2 beside values at many points; infinite where |v| exceeds k beta."""
    rng = np.random.default_rng(4)
    beta, k = 2.0, 0.5
    law = ScaledLaw(np.full(6, beta), np.full(6, k), np.zeros(6))
    y = 0.3 * rng.normal(size=(6, 3, 3)) + np.array([4.0, 0, 0])
    v = 0.2 * rng.normal(size=(6, 3, 3))
    v[0, 0, 0] = 2.0
    bound, estimate = law.means(v, y - v)
    shares = rng.dirichlet(np.ones(3), 20_000)
    inside = np.linalg.norm(np.einsum("qk,nkd->nqd", shares, y), axis=2).mean(axis=1)
    value = beta * inside - k * beta**2
    assert np.isinf(bound[0])
    assert np.isinf(estimate[0])
    assert (bound[1:] > value[1:] - 5e-3).all()
    assert bound[1:] == pytest.approx(value[1:], rel=0.01)
    assert estimate[1:] == pytest.approx(value[1:], rel=0.01)


@pytest.mark.parametrize(("k", "d"), [(9, 2), (16, 5), (18, 3)])
def test_integrals_lie_above_quadrature_and_near_it(k, d):
    drawn = Drawn(k, d, 0.3)
    volume = np.random.default_rng(1).uniform(0.5, 2.0, COUNT)
    rest = np.zeros(COUNT)
    parts = drawn.law, drawn.pulled, drawn.w, volume
    found = potential_integrals(*parts, rest, np.arange(COUNT))
    exact = volume * drawn.quadrature()
    assert (found >= exact * (1 - 1e-12)).all()
    assert found.sum() < 1.05 * exact.sum()


@pytest.mark.parametrize("k", [3, 4, 6, 9, 16, 18])
def test_children_have_the_means_of_their_parents(k):
    """Of squares: the mean over the children is that over the piece, by table and by rule."""
    rng = np.random.default_rng(k)
    values = rng.normal(size=(7, k, 2))
    whole = mean_squares(pieces_last(values))
    children = child_coefficients(values)
    of_children = mean_squares(pieces_last(children))
    count = len(SPLIT[k])
    np.testing.assert_allclose(of_children.reshape(count, 7).mean(axis=0), whole)
    at = applied(RULE[k], values)
    np.testing.assert_allclose((at**2).sum(axis=2) @ WEIGHTS[k], whole)
    assert MEANS[k].sum() == pytest.approx(1.0)
