"""Interval arithmetic contains exact values, computed with fractions and many digits."""

from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest

from ngepc.linalg.intervals import Intervals

getcontext().prec = 50
RNG = np.random.default_rng(3)
NUMBERS = np.concatenate(
    [RNG.normal(size=200), 10.0 ** RNG.uniform(-12, 12, 100), [0.0, 1.0, -1.0, 0.1]]
)


def pairs():
    return NUMBERS, RNG.permutation(NUMBERS)


def contains(found, exact):
    return all(
        Fraction(low) <= value <= Fraction(high)
        for low, high, value in zip(found.low, found.high, exact, strict=True)
    )


def test_sums_and_products_contain_exact_ones():
    a, b = pairs()
    exact = [
        (Fraction(p), Fraction(q)) for p, q in zip(a.tolist(), b.tolist(), strict=True)
    ]
    first = Intervals.exactly(a)
    second = Intervals.exactly(b)
    assert contains(first + second, [p + q for p, q in exact])
    assert contains(first - second, [p - q for p, q in exact])
    assert contains(first * second, [p * q for p, q in exact])
    assert contains(first.squared(), [p * p for p, _ in exact])
    assert contains(first.power(5), [p**5 for p, _ in exact])


def test_exact_sums_are_not_widened():
    found = Intervals.exactly(np.array([0.75])) - Intervals.exactly(np.array([0.5]))
    assert found.low == found.high == 0.25


def test_quotients_and_roots_contain_exact_ones():
    a = np.abs(NUMBERS[NUMBERS != 0])
    exact = [Fraction(p) for p in a.tolist()]
    assert contains(Intervals.exactly(a).reciprocal(), [1 / p for p in exact])
    root = Intervals.exactly(a).root()
    assert contains(root.squared(), exact)
    assert (root.width <= 4 * np.spacing(root.high)).all()


@pytest.mark.parametrize(
    ("name", "digits"), [("exponential", Decimal.exp), ("logarithm", Decimal.ln)]
)
def test_functions_contain_their_digits(name, digits):
    a = np.abs(RNG.normal(size=100)) + 1e-3
    found = getattr(Intervals.exactly(a), name)()
    exact = [Fraction(digits(Decimal(p))) for p in a.tolist()]
    assert contains(found, exact)


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("squared", np.square),
        ("root", lambda v: np.sqrt(np.maximum(v, 0))),
        ("reciprocal", np.reciprocal),
        ("exponential", np.exp),
        ("sine", np.sin),
        ("cosine", np.cos),
        ("logarithm", np.log),
    ],
)
def test_images_of_wide_intervals_contain_all_values(name, function):
    low = RNG.uniform(1e-3 if name == "logarithm" else -7, 7, 400)
    wide = Intervals(low, low + 10.0 ** RNG.uniform(-3, 1, 400))
    found = getattr(wide, name)()
    places = np.linspace(wide.low, wide.high, 101)
    values = function(places)
    assert ((values >= found.low) & (values <= found.high)).all()
    sharp = np.isfinite(found.width)
    reached = np.ptp(values, axis=0)
    assert (found.width[sharp] <= 1.3 * reached[sharp] + 0.1).mean() > 0.9


@pytest.mark.parametrize("exponent", [-2, -0.5, 0, 0.3, 1, 2, 2.5, 3])
def test_powers_of_wide_intervals_contain_all_values(exponent):
    low = RNG.uniform(-2, 3, 300)
    wide = Intervals(low, low + RNG.uniform(0, 2, 300))
    found = wide.power(exponent)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.linspace(wide.low, wide.high, 51) ** exponent
    inside = (values >= found.low) & (values <= found.high)
    assert (inside | np.isnan(values)).all()
    assert found.finite.sum() > 100


def test_nothing_is_known_where_a_function_has_a_pole():
    around_zero = Intervals(np.array([-1.0]), np.array([2.0]))
    for found in (around_zero.reciprocal(), around_zero.logarithm()):
        assert found.low == -np.inf
        assert found.high == np.inf
    whole = Intervals.unknown((1,))
    for found in (whole * Intervals.exactly(np.zeros(1)), whole - whole):
        assert not found.finite.any()
