"""Interval arithmetic on arrays: every result contains the exact values, rounding included.

Sums, products, quotients and square roots are correctly rounded, so that one floating point number
further out is enough; ``sin``, ``cos``, ``exp``, ``log`` and powers are widened by ``LIBRARY``.
Where nothing is known an interval is (-inf, inf).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LIBRARY = 1e-14
"""More than the relative error of the functions of numpy, 50 times their largest known one."""
NEAR_TURN = 1e-9
"""Turning points of sine and cosine so near to an interval count as inside."""
MANY_TURNS = 1e5
"""Arguments beyond this size give (-1, 1)."""
LARGEST = np.finfo(float).max
HIGHEST_POWER = 64
"""Integer exponents up to this one are products."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals between the arrays ``low`` and ``high``, of the same shape."""

    low: np.ndarray
    high: np.ndarray

    @classmethod
    def exactly(cls, values: np.ndarray | float) -> Intervals:
        """Intervals of one number each."""
        values = np.asarray(values, dtype=float)
        return cls(values, values)

    @classmethod
    def around(cls, values: np.ndarray, error: np.ndarray | float) -> Intervals:
        """The intervals values +- error."""
        return cls.exactly(values) + enclosing(-np.abs(error), np.abs(error))

    @classmethod
    def unknown(cls, shape: tuple[int, ...]) -> Intervals:
        """The intervals (-inf, inf)."""
        return cls(np.full(shape, -np.inf), np.full(shape, np.inf))

    def __getitem__(self, key: object) -> Intervals:
        return Intervals(self.low[key], self.high[key])

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of both arrays."""
        return self.low.shape

    @property
    def finite(self) -> np.ndarray:
        """Where both ends are finite, as booleans."""
        return np.isfinite(self.low) & np.isfinite(self.high)

    @property
    def size(self) -> np.ndarray:
        """The largest absolute value in each interval."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    @property
    def width(self) -> np.ndarray:
        """``high`` less ``low``, rounded up."""
        return (self - self).high

    def __neg__(self) -> Intervals:
        return Intervals(-self.high, -self.low)

    def __add__(self, other: Intervals) -> Intervals:
        low, low_error = exact_sum(self.low, other.low)
        high, high_error = exact_sum(self.high, other.high)
        low = np.where(low_error < 0, np.nextafter(low, -np.inf), low)
        high = np.where(high_error > 0, np.nextafter(high, np.inf), high)
        return enclosing(low, high)

    def __sub__(self, other: Intervals) -> Intervals:
        return self + -other

    def __mul__(self, other: Intervals) -> Intervals:
        ends = np.broadcast_arrays(self.low, self.high, other.low, other.high)
        first = np.stack([ends[0], ends[0], ends[1], ends[1]])
        second = np.stack([ends[2], ends[3], ends[2], ends[3]])
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            products = first * second
        unknown = np.isnan(products).any(axis=0)
        low = np.where(unknown, -np.inf, products.min(axis=0))
        high = np.where(unknown, np.inf, products.max(axis=0))
        # a product with zero is exact
        zero = ((products != 0) | (first == 0) | (second == 0)).all(axis=0)
        found = one_further(low, high)
        return Intervals(
            np.where(zero & (low == 0), 0.0, found.low),
            np.where(zero & (high == 0), 0.0, found.high),
        )

    def squared(self) -> Intervals:
        """The squares."""
        least = np.where((self.low <= 0) & (self.high >= 0), 0.0, self.nearest_to_zero)
        with np.errstate(over="ignore"):
            found = one_further(least**2, self.size**2)
        return Intervals(np.maximum(found.low, 0.0), found.high)

    @property
    def nearest_to_zero(self) -> np.ndarray:
        """The smallest absolute value of the two ends."""
        return np.minimum(np.abs(self.low), np.abs(self.high))

    def reciprocal(self) -> Intervals:
        """One over the values; unknown where zero is inside."""
        inside = (self.low <= 0) & (self.high >= 0)
        with np.errstate(divide="ignore", over="ignore"):
            found = one_further(1 / self.high, 1 / self.low)
        return found.where(~inside, Intervals.unknown(self.shape))

    def where(self, mask: np.ndarray, other: Intervals) -> Intervals:
        """These intervals where the mask is True, the others elsewhere."""
        return Intervals(
            np.where(mask, self.low, other.low), np.where(mask, self.high, other.high)
        )

    def hull(self, other: Intervals) -> Intervals:
        """The least intervals that contain both."""
        return Intervals(
            np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        )

    def hull_along(self, axis: int) -> Intervals:
        """The least intervals that contain all of those along an axis."""
        return Intervals(self.low.min(axis=axis), self.high.max(axis=axis))

    def within(self, other: Intervals) -> Intervals:
        """The intersection; the intervals themselves where it is empty."""
        low = np.maximum(self.low, other.low)
        high = np.minimum(self.high, other.high)
        return Intervals(low, high).where(low <= high, self)

    def root(self) -> Intervals:
        """The square roots of what is not negative; unknown where all is negative."""
        low = np.sqrt(np.maximum(self.low, 0.0))
        high = np.sqrt(np.maximum(self.high, 0.0))
        found = one_further(low, high)
        found = Intervals(np.maximum(found.low, 0.0), found.high)
        return found.where(self.high >= 0, Intervals.unknown(self.shape))

    def exponential(self) -> Intervals:
        """The exponential function."""
        with np.errstate(over="ignore"):
            found = with_errors_of_numpy(np.exp(self.low), np.exp(self.high))
        return Intervals(np.maximum(found.low, 0.0), found.high)

    def logarithm(self) -> Intervals:
        """The natural logarithm; unknown where an interval reaches zero."""
        positive = self.low > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            found = with_errors_of_numpy(np.log(self.low), np.log(self.high))
        return found.where(positive, Intervals.unknown(self.shape))

    def sine(self) -> Intervals:
        """The sine."""
        return self._wave(np.sin, 0.25)

    def cosine(self) -> Intervals:
        """The cosine."""
        return self._wave(np.cos, 0.0)

    def _wave(self, function: np.ufunc, top: float) -> Intervals:
        """Sine or cosine, whose value is one at ``top`` turns."""
        with np.errstate(invalid="ignore"):
            ends = function(self.low), function(self.high)
            found = with_errors_of_numpy(np.minimum(*ends), np.maximum(*ends))
        low = np.where(self._has_turn(top + 0.5), -1.0, np.maximum(found.low, -1.0))
        high = np.where(self._has_turn(top), 1.0, np.minimum(found.high, 1.0))
        known = self.size < MANY_TURNS
        return Intervals(np.where(known, low, -1.0), np.where(known, high, 1.0))

    def _has_turn(self, place: float) -> np.ndarray:
        """Whether a point ``place`` plus whole turns may lie inside."""
        with np.errstate(invalid="ignore"):
            first = np.ceil(self.low / (2 * math.pi) - place - NEAR_TURN)
            return first <= self.high / (2 * math.pi) - place + NEAR_TURN

    def power(self, exponent: float) -> Intervals:
        """The powers with a fixed exponent; unknown where they may not be real or finite."""
        if exponent == int(exponent) and abs(exponent) <= HIGHEST_POWER:
            whole = self._whole_power(abs(int(exponent)))
            return whole if exponent >= 0 else whole.reciprocal()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ends = self.low**exponent, self.high**exponent
            found = with_errors_of_numpy(np.minimum(*ends), np.maximum(*ends))
        return found.where(self.low > 0, Intervals.unknown(self.shape))

    def _whole_power(self, exponent: int) -> Intervals:
        """Powers with an exponent >= 0; odd ones grow, even ones are those of the square."""
        if exponent == 0:
            return Intervals.exactly(np.ones(self.shape))
        if exponent % 2 == 0:
            half = self._whole_power(exponent // 2)
            return half.squared()
        if exponent == 1:
            return self
        low = Intervals.exactly(self.low)
        high = Intervals.exactly(self.high)
        rest = exponent - 1
        return Intervals(
            (low * low._whole_power(rest)).low, (high * high._whole_power(rest)).high
        )


def exact_sum(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rounded sum and its error, exact sum less rounded one (Knuth's TwoSum)."""
    with np.errstate(invalid="ignore", over="ignore"):
        total = a + b
        part = total - a
        return total, (a - (total - part)) + (b - part)


def enclosing(low: np.ndarray, high: np.ndarray) -> Intervals:
    """Intervals between these ends; unknown ends are infinite."""
    low = np.where(np.isnan(low), -np.inf, np.minimum(low, LARGEST))
    high = np.where(np.isnan(high), np.inf, np.maximum(high, -LARGEST))
    return Intervals(low, high)


def one_further(low: np.ndarray, high: np.ndarray) -> Intervals:
    """Intervals whose ends are one floating point number further out."""
    return enclosing(np.nextafter(low, -np.inf), np.nextafter(high, np.inf))


def with_errors_of_numpy(low: np.ndarray, high: np.ndarray) -> Intervals:
    """Intervals that are wider by the errors of numpy's functions."""
    return one_further(low - LIBRARY * np.abs(low), high + LIBRARY * np.abs(high))
