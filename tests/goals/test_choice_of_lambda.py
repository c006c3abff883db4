"""Estimates for the choice of lambda: exact where nothing yields, and means over drawn cells."""

import numpy as np
import pytest

from ngepc.goals.integrand import sampled
from ngepc.goals.sides import LawOnCells, ResultOnCells, Sides

COUNT = 20
CELLS = 20_000


@pytest.mark.parametrize("k", [3, 4, 6, 9, 16, 18])
def test_estimates_are_integrals_where_nothing_yields(k):
    rng = np.random.default_rng(k)
    one = np.ones(COUNT)
    law = LawOnCells(2 * one, 0.1 * one, 1e6 * one)
    sigma, trial, tau, strain = rng.normal(size=(4, COUNT, k, 3))
    own, mean = rng.normal(size=(2, COUNT, k))
    result = ResultOnCells(sigma, trial, own, law, rng.uniform(1, 2, COUNT))
    sides = Sides.of_adjoint(result, tau, strain, mean, rng.normal(size=COUNT))
    for sign in (1.0, -1.0):
        estimate = sides.estimate(sign, 1.7)
        integrals = sides.integrals(sign, 1.7)
        size = np.abs(integrals).max()
        np.testing.assert_allclose(estimate, integrals, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("count", [500, 2000])
def test_drawn_cells_stand_for_all(count):
    """Sums of what is about a share or evenly spread are kept, with shares of all sizes."""
    rng = np.random.default_rng(count)
    shares = np.exp(3 * rng.normal(size=CELLS))
    cells, weights = sampled(shares, count)
    assert len(cells) <= count + 1
    assert len(np.unique(cells)) == len(cells)
    for part in (0.0, 0.5, 1.0):
        even = (1 - part) * shares.mean() + part * shares
        values = even * rng.uniform(0.5, 1.5, CELLS)
        near = float(weights @ values[cells])
        assert near == pytest.approx(values.sum(), rel=3 / count**0.5)
    every, ones = sampled(shares, CELLS)
    np.testing.assert_array_equal(every, np.arange(CELLS))
    assert (ones == 1).all()
