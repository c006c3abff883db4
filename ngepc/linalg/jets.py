"""Enclosures of functions on simplices: values, first and second derivatives as intervals.

On a simplex with vertices v_0, ..., v_d the coordinates are the barycentric ones l_0, ..., l_(d-1).
Taylor's formula at x for the values at the vertices gives, for a function f with the second
derivatives H in these coordinates,

    f(x) = sum_i l_i f(v_i) - 1/2 sum_i l_i (v_i - x) . H_i (v_i - x),

where each H_i is a mean of H on the line from x to v_i, so that it lies in an interval that
contains H on the simplex.  Since sum_i l_i (v_i - x)_k^2 = l_k (1 - l_k) <= 1/4, the last term is
at most sum |H_kl| / 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ngepc.linalg.intervals import Intervals

BEND = (1 + 1e-14) / 8
"""Distance of a function from the affine one, over the sum of its second derivatives."""

Function = Callable[[Intervals], Intervals]


@dataclass(frozen=True, eq=False)
class Jet:
    """Enclosures of a function on simplices.

    ``value`` (simplices, 1 + corners) are those of the values in the whole simplex and at its
    corners; ``first`` (simplices, d) and ``second`` (simplices, d, d) those of the derivatives,
    None where they are zero.
    """

    value: Intervals
    first: Intervals | None = None
    second: Intervals | None = None

    @classmethod
    def affine(cls, corners: Intervals) -> Jet:
        """The affine function with values (simplices, d + 1) at the corners."""
        whole = corners.hull_along(1)
        value = Intervals(
            np.column_stack([whole.low, corners.low]),
            np.column_stack([whole.high, corners.high]),
        )
        return cls(value, corners[:, :-1] - corners[:, -1:])

    @property
    def whole(self) -> Intervals:
        """The values in the whole simplex, (simplices,)."""
        return self.value[:, 0]

    @property
    def dimension(self) -> int:
        """The dimension d of the simplices."""
        return self.value.shape[1] - 2

    @property
    def is_smooth(self) -> np.ndarray:
        """Where both derivatives are known, (simplices,)."""
        known = np.ones(len(self.value.low), dtype=bool)
        for part in (self.first, self.second):
            if part is not None:
                known &= part.finite.reshape(len(known), -1).all(axis=1)
        return known

    @property
    def has_slope(self) -> np.ndarray:
        """Where some first derivative is nowhere zero, (simplices,)."""
        if self.first is None:
            return np.zeros(len(self.value.low), dtype=bool)
        return ((self.first.low > 0) | (self.first.high < 0)).any(axis=1)

    def __neg__(self) -> Jet:
        parts = (
            None if part is None else -part
            for part in (self.value, self.first, self.second)
        )
        return Jet(*parts)

    def __add__(self, other: Jet) -> Jet:
        first = derivative_sum(self.first, other.first)
        second = derivative_sum(self.second, other.second)
        return Jet(self.value + other.value, first, second).narrowed()

    def __sub__(self, other: Jet) -> Jet:
        return self + -other

    def __mul__(self, other: Jet) -> Jet:
        first = derivative_sum(
            derivatives_times(self.first, other.whole),
            derivatives_times(other.first, self.whole),
        )
        second = derivative_sum(
            derivatives_times(self.second, other.whole),
            derivatives_times(other.second, self.whole),
        )
        if self.first is not None and other.first is not None:
            mixed = self.first[:, :, None] * other.first[:, None, :]
            second = derivative_sum(second, mixed + with_rows_for_columns(mixed))
        return Jet(self.value * other.value, first, second).narrowed()

    def of(self, function: Function, slope: Function, bend: Function) -> Jet:
        """A function of the values; its first and second derivatives are ``slope``, ``bend``."""
        value = function(self.value)
        if self.first is None:
            return Jet(value)
        steep = slope(self.whole)
        second = derivative_sum(
            derivatives_times(self.second, steep),
            derivatives_times(squares(self.first), bend(self.whole)),
        )
        return Jet(value, derivatives_times(self.first, steep), second).narrowed()

    def narrowed(self) -> Jet:
        """The same with values in the whole simplex that Taylor's formula limits."""
        if self.first is None:
            return self
        corners = self.value[:, 1:].hull_along(1)
        away = Intervals.exactly(np.zeros(len(corners.low)))
        if self.second is not None:
            farthest = self.second.size.reshape(len(corners.low), -1).sum(axis=1)
            away = Intervals(-farthest, farthest) * Intervals.exactly(BEND)
        limited = self.whole.within(corners + away)
        low = self.value.low.copy()
        high = self.value.high.copy()
        low[:, 0] = limited.low
        high[:, 0] = limited.high
        return Jet(Intervals(low, high), self.first, self.second)

    def limited(self, values: Intervals) -> Jet:
        """The same in the part of each simplex where the values are in intervals (simplices,).

        Nothing is known of derivatives, which Taylor's formula would need on whole simplices.
        """
        whole = self.whole.within(values)
        low = self.value.low.copy()
        high = self.value.high.copy()
        low[:, 0] = whole.low
        high[:, 0] = whole.high
        return Jet(Intervals(low, high), *self.unknown_derivatives())

    def unknown_derivatives(self) -> tuple[Intervals, Intervals]:
        """Infinite first and second derivatives."""
        count = len(self.value.low)
        d = self.dimension
        return Intervals.unknown((count, d)), Intervals.unknown((count, d, d))

    def where(self, mask: np.ndarray, other: Jet) -> Jet:
        """The function itself on the simplices where the mask is True, the other one elsewhere."""
        value = self.value.where(mask[:, None], other.value)
        first = self._part_where(mask, self.first, other.first)
        second = self._part_where(mask, self.second, other.second)
        return Jet(value, first, second)

    def _part_where(
        self, mask: np.ndarray, own: Intervals | None, other: Intervals | None
    ) -> Intervals | None:
        if own is None and other is None:
            return None
        shape = (own or other).shape
        zero = Intervals.exactly(np.zeros(shape))
        mask = mask.reshape(-1, *[1] * (len(shape) - 1))
        return (own or zero).where(mask, other or zero)

    def with_values(self, rows: np.ndarray, values: Intervals) -> Jet:
        """The same with other values (rows, 1 + corners) on some simplices, rough there."""
        low = self.value.low.copy()
        high = self.value.high.copy()
        low[rows] = values.low
        high[rows] = values.high
        known = np.ones(len(low), dtype=bool)
        known[rows] = False
        rough = Jet(Intervals(low, high), *self.unknown_derivatives())
        return Jet(rough.value, self.first, self.second).where(known, rough)


def derivative_sum(a: Intervals | None, b: Intervals | None) -> Intervals | None:
    """The sum, where None is zero."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def derivatives_times(
    derivatives: Intervals | None, factor: Intervals
) -> Intervals | None:
    """Derivatives (simplices, ...) times numbers (simplices,)."""
    if derivatives is None:
        return None
    shape = (-1, *[1] * (len(derivatives.shape) - 1))
    return derivatives * Intervals(
        factor.low.reshape(shape), factor.high.reshape(shape)
    )


def with_rows_for_columns(second: Intervals) -> Intervals:
    """Matrices with rows and columns exchanged."""
    return Intervals(second.low.swapaxes(1, 2), second.high.swapaxes(1, 2))


def squares(first: Intervals) -> Intervals:
    """The matrices of the products of first derivatives, (simplices, d, d)."""
    products = first[:, :, None] * first[:, None, :]
    own = first.squared()
    diagonal = np.eye(first.shape[1], dtype=bool)
    low = np.where(diagonal, own.low[:, :, None], products.low)
    high = np.where(diagonal, own.high[:, :, None], products.high)
    return Intervals(low, high)
