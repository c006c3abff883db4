"""Numbers in sentences: no exponents, and what is an upper bound is rounded up."""

import math

import pytest

from ngepc.checks.sentences import at_most_percent, in_percent, outward


@pytest.mark.parametrize(
    ("part", "nearest", "above"),
    [
        (1.94, "190 percent", "200 percent"),
        (0.0342, "3.4 percent", "3.5 percent"),
        (0.5, "50 percent", "50 percent"),
        (0.0, "0 percent", "0 percent"),
        (270.0, "27000 percent", "27000 percent"),
        (math.inf, "inf percent", "inf percent"),
    ],
)
def test_two_digits_without_an_exponent(part, nearest, above):
    assert in_percent(part) == nearest
    assert at_most_percent(part) == above


def test_more_digits():
    assert in_percent(0.012345, 3) == "1.23 percent"
    assert at_most_percent(0.012345, 3) == "1.24 percent"


def test_a_printed_interval_contains_the_interval():
    lower, upper = outward(0.12345678, 5.1234511)
    assert (lower, upper) == ("0.123456", "5.12346")
    lower, upper = outward(-0.12345678, -1e-3)
    assert (lower, upper) == ("-0.123457", "-0.001")
    assert outward(-math.inf, math.inf) == ("-inf", "inf")
