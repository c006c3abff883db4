"""Estimates for the choice of lambda: exact where nothing yields, and means over drawn cells."""

import numpy as np
import pytest

from ngepc.goals.cutting import potential_integrals
from ngepc.goals.integrand import sampled
from ngepc.goals.sides import LawOnCells, ResultOnCells, Sides

COUNT = 20
CELLS = 20_000


def drawn_sides(k, beta):
    """A supremum on cells with random coefficients, and radii ``beta`` of the yield surface."""
    rng = np.random.default_rng(k)
    one = np.ones(COUNT)
    law = LawOnCells(2 * one, 0.1 * one, beta)
    sigma, trial, tau, strain = rng.normal(size=(4, COUNT, k, 3))
    own, mean = rng.normal(size=(2, COUNT, k))
    result = ResultOnCells(sigma, trial, own, law, rng.uniform(1, 2, COUNT))
    return Sides.of_adjoint(result, tau, strain, mean, rng.normal(size=COUNT))


def by_pieces(sides, sign, factor):
    """Integrals of the supremum with Phi on pieces of all cells."""
    potential = sides.pulled(sign, factor), sides.w(sign, factor), sides.result.size
    rest = sides.rest(sign, factor)
    return potential_integrals(
        sides.law(factor), *potential, rest, np.arange(len(rest))
    )


@pytest.mark.parametrize("k", [3, 4, 6, 9, 16, 18])
def test_estimates_are_integrals_where_nothing_yields(k):
    sides = drawn_sides(k, np.full(COUNT, 1e6))
    assert sides.elastic(1.7).all()
    for sign in (1.0, -1.0):
        exact = by_pieces(sides, sign, 1.7)
        size = np.abs(exact).max()
        for found in (sides.estimate(sign, 1.7), sides.integrals(sign, 1.7)):
            np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("k", [3, 9, 18])
def test_phi_is_a_square_where_no_part_may_yield(k):
    """Of cells of all strengths some are elastic; of these the pieces have the same Phi."""
    sides = drawn_sides(k, np.geomspace(1.0, 100.0, COUNT))
    elastic = sides.elastic(1.7)
    assert 0 < np.count_nonzero(elastic) < COUNT
    for sign in (1.0, -1.0):
        found = sides.integrals(sign, 1.7)
        exact = by_pieces(sides, sign, 1.7)
        size = np.abs(exact).max()
        same = dict(rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(found[elastic], exact[elastic], **same)
        assert found.sum() == pytest.approx(exact.sum(), rel=0.03)


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
