"""Means of Phi over parts that yield: above fine quadrature, closer with less variation."""

import numpy as np
import pytest

from ngepc.bounds.polynomials import POWERS, tetrahedron_rule
from ngepc.goals.cutting import coefficient_means
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.yielding import by_components

PARTS = 40
FACTOR = 1.7
RULES = {3: POWERS[4, 3], 4: tetrahedron_rule(6), 6: POWERS[4, 6]}


class Parts:
    """Parts around trial stresses of 0.8 to 2.5 times the yield bound."""

    def __init__(self, k, d, variation):
        rng = np.random.default_rng(k)
        self.two_mu = rng.uniform(1.0, 3.0, PARTS)
        self.hardening = self.two_mu * 10 ** rng.uniform(-1, 0, PARTS)
        self.beta = rng.uniform(0.5, 2.0, PARTS)
        trial = rng.normal(size=(PARTS, 1, d))
        size = self.beta * rng.uniform(0.8, 2.5, PARTS)
        trial *= (size / np.linalg.norm(trial[:, 0], axis=1))[:, None, None]
        share = np.minimum(self.beta / size, 1.0)
        stress = self.hardening + self.two_mu * share
        stress = (stress / (self.two_mu + self.hardening))[:, None, None] * trial

        c = (FACTOR / self.two_mu)[:, None, None]
        spread = variation * (FACTOR / self.two_mu * self.beta)[:, None, None]
        self.w = c * trial + spread * rng.normal(size=(PARTS, k, d))
        self.pulled = c * stress + spread * rng.normal(size=(PARTS, k, d))
        self.law = ScaledLaw.of(self.two_mu, self.hardening, self.beta, FACTOR)

    def searched(self, pulled, w):
        """Phi at a point of each part, from below: the largest value for many rho."""
        y = np.linalg.norm(pulled + w, axis=1)
        c = FACTOR / self.two_mu
        inside = y**2 / (4 * c)
        best = np.where(y <= 2 * c * self.beta, inside, self.beta * (y - c * self.beta))
        M = self.two_mu + self.hardening
        for x in np.linspace(0, 12, 1500):
            rho = self.beta + x
            r = self.beta + self.hardening / M * x
            size = np.linalg.norm(rho[:, None] * pulled + r[:, None] * w, axis=1)
            best = np.maximum(best, size - c * rho * r)
        return best

    def quadrature(self):
        places, weights = RULES[self.w.shape[1]]
        values = [self.searched(p @ self.pulled, p @ self.w) for p in places]
        return weights @ np.array(values)

    def means(self):
        return self.law.yielding_means(*map(by_components, (self.pulled, self.w)))


@pytest.mark.parametrize(("k", "d"), [(3, 2), (4, 5)])
def test_bounds_lie_above_quadrature_and_below_the_mean_of_coefficients(k, d):
    for variation in (0.2, 0.05):
        parts = Parts(k, d, variation)
        bound, estimate = parts.means()
        applies = np.isfinite(bound)
        exact = parts.quadrature()
        other, _ = coefficient_means(parts.law, parts.pulled, parts.w)
        size = np.abs(exact)
        assert applies.sum() > 5
        assert (bound - exact >= -1e-5 * size)[applies].all()
        assert (estimate <= bound)[applies].all()
        part = ((bound - exact) / (other - exact))[applies]
        assert np.median(part) < 2 * variation + 0.02


def test_the_excess_is_of_third_order():
    """Half the variation of y and v leaves an eighth of it, and a quarter of other bounds."""
    first, second = (Parts(3, 2, variation) for variation in (0.08, 0.04))
    excess = []
    for parts in (first, second):
        bound, _ = parts.means()
        excess.append(bound - parts.quadrature())
    yields = np.isfinite(excess[0]) & (excess[0] > 1e-4)
    assert yields.sum() > 3
    rate = np.log2(excess[0][yields] / excess[1][yields])
    assert np.median(rate) > 2.6
