"""Means of Phi over whole cells: above those of their parts, close where little varies, and what
intervals of goals become with them."""

import numpy as np
import pytest

from ngepc import goal_bound, semismooth_newton
from ngepc.bounds.polynomials import POWERS, square_integrals, tetrahedron_rule
from ngepc.goals import sides
from ngepc.goals.cutting import potential_means
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.whole_cells import WORTH, Spread, whole_means
from ngepc.studies.bounds import bounded_example

CELLS = 60
FACTOR = 1.7
RULES = {3: POWERS[4, 3], 4: tetrahedron_rule(6)}


class Cells:
    """Cells of k parts around trial stresses of 0.2 to 3 times the yield bound."""

    def __init__(self, k, d, variation):
        rng = np.random.default_rng(k)
        self.k = k
        two_mu = rng.uniform(1.0, 3.0, CELLS)
        hardening = two_mu * 10 ** rng.uniform(-1, 0, CELLS)
        beta = rng.uniform(0.5, 2.0, CELLS)
        self.law = ScaledLaw.of(two_mu, hardening, beta, FACTOR)
        trial = rng.normal(size=(CELLS, d))
        size = beta * rng.uniform(0.2, 3.0, CELLS)
        trial *= (size / np.linalg.norm(trial, axis=1))[:, None]
        share = np.minimum(beta / size, 1.0)
        kept = (hardening + two_mu * share) / (two_mu + hardening)
        c = FACTOR / two_mu
        spread = variation * c * beta
        self.w = c[:, None] * trial + spread[:, None] * rng.normal(size=(CELLS, d))
        middle = (c * kept)[:, None] * trial
        noise = rng.normal(size=(CELLS, k, k, d))
        self.pulled = middle[:, None, None] + spread[:, None, None, None] * noise

    def spread(self):
        return Spread(np.ascontiguousarray(self.pulled.transpose(3, 1, 2, 0)))

    def means(self):
        return whole_means(self.law, self.spread(), self.w.T)

    def parts(self):
        """Coefficients on all parts as if each was alone: the law, q and w."""
        k = self.k
        w = np.repeat(self.w[:, None], k, axis=0)
        return self.law.repeated(k), self.pulled.reshape(CELLS * k, k, -1), w

    def by_parts(self):
        """The means of the bounds of the parts."""
        bound, _ = potential_means(*self.parts())
        return bound.reshape(CELLS, self.k).mean(axis=1)

    def quadrature(self):
        """Means by a fine rule."""
        law, pulled, w = self.parts()
        places, weights = RULES[self.k]
        values = law.potential(np.matmul(places, pulled), w) @ weights
        return values.reshape(CELLS, self.k).mean(axis=1)


@pytest.mark.parametrize(("k", "d"), [(3, 2), (3, 3), (4, 5)])
def test_bounds_lie_above_quadrature_and_near_those_of_parts(k, d):
    for variation in (0.1, 0.02):
        cells = Cells(k, d, variation)
        bound, estimate = cells.means()
        known = np.isfinite(bound)
        exact = cells.quadrature()
        assert known.sum() > CELLS // 3
        assert (bound - exact >= -1e-5 * np.abs(exact))[known].all()
        assert (estimate <= bound + 1e-12 * np.abs(bound))[known].all()
        more = (bound - cells.by_parts())[known]
        assert np.median(more) <= variation**2 * np.median(np.abs(exact))


def test_squares_of_deviations():
    """Means of |D|^2 add up from those along the axes, and equal integrals over the parts."""
    cells = Cells(4, 5, 0.3)
    spread = cells.spread()
    along = [
        spread.square_along(np.broadcast_to(axis[:, None], (5, CELLS)))
        for axis in np.eye(5)
    ]
    np.testing.assert_allclose(sum(along), spread.square, rtol=1e-12)
    off = cells.pulled - cells.pulled.mean(axis=(1, 2), keepdims=True)
    exact = square_integrals(off, np.full((CELLS, 4), 1 / 4)).sum(axis=1)
    np.testing.assert_allclose(spread.square, exact, rtol=1e-12)


def test_a_cell_that_does_not_yield_has_the_exact_mean():
    cells = Cells(3, 2, 0.01)
    bound, estimate = cells.means()
    y = cells.pulled + cells.w[:, None, None]
    least = cells.law.inner * cells.law.beta
    elastic = np.linalg.norm(y, axis=3).max(axis=(1, 2)) < 1.8 * least
    assert elastic.sum() > 5
    square = square_integrals(y, np.full((CELLS, 3), 1 / 3)).sum(axis=1)
    exact = square / (4 * cells.law.inner)
    np.testing.assert_allclose(bound[elastic], exact[elastic], rtol=1e-12)
    np.testing.assert_array_equal(bound[elastic], estimate[elastic])


@pytest.mark.parametrize("goal", ["work", "contact_force"])
def test_intervals_contain_those_by_parts_and_are_hardly_wider(goal, monkeypatch):
    result = semismooth_newton(bounded_example("lshape", "uniform", 1601))
    fast = goal_bound(result, goal)

    def none(law, pulled, w, volume):
        return np.full((2, len(pulled)), np.inf)

    monkeypatch.setattr(sides, "whole_integrals", none)
    plain = goal_bound(result, goal)
    rounding = 1e-9 * abs(plain.middle)
    assert fast.factor == pytest.approx(plain.factor, rel=1e-9)
    assert fast.lower <= plain.lower + rounding
    assert fast.upper >= plain.upper - rounding
    assert fast.width <= (1 + WORTH) * plain.width
