"""Means of the Phi of ``supremum`` over whole cells for displacements of order one, from above.

There w is constant on a cell and q is affine on each of its parts, so that with the letters of
``yielding``

    y = mean y + D,   v = mean v + D,   D = (q - mean q)/(2 mu_2),   mean D = 0.

One x_0 and one n, those for the means of y and v, serve for the whole cell.  With r >= |D| there,
e = (beta + x_0) D_across, because beta y + x_0 v has the mean direction n, and c = mean v_across +
D_across, c_0 = mean v_across.  Hence

    y_n >= mean y_n - r = Y,   v_n >= mean v_n - r = V,
    |e| <= (beta + x_0) r,     |c| <= |c_0| + r,    |c - c_0| <= r,
    X = mean X + g : D,        g = n + (beta + x_0) c_0/least,

and the bound of ``yielding`` needs no more than the means of |D|^2, (n : D)^2 and (g : D)^2.  As
mean D = 0, the mean of X^2 is (mean X)^2 + mean (g : D)^2, and that of [X]_+^2 is at most
[mean X]_+^2 + mean (g : D)^2.  Where nothing yields Phi is the square |y|^2 mu_2/(2 lambda).

A cell costs about as much as one of its parts does by ``yielding``.  Where these means may be too
large by more than a small part of the width, parts take their place.
"""

from __future__ import annotations

from copy import copy
from functools import reduce

import numpy as np

from ngepc.bounds.polynomials import worth_keeping
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.yielding import (
    LEAST_BEND,
    YieldLaw,
    largest_of,
    mean_of,
    products,
    sizes,
)

WORTH = 0.004
"""What these means may exceed the integrals by, as a part of the integral of the supremum."""


class Spread:
    """Functions that are affine on each part of a cell: means and deviations D from these.

    ``values`` are their coefficients (d, parts, k, n).  ``mean`` is (d, n), ``largest`` the largest
    |D| and ``square`` the mean of |D|^2, (n,).
    """

    def __init__(self, values: np.ndarray) -> None:
        rows = values.reshape(len(values), -1, values.shape[3])
        self.mean = mean_of(rows.swapaxes(0, 1))
        self._off = rows - self.mean[:, None]
        self._shape = values.shape[1:]
        self.largest = np.sqrt(largest_of(products(self._off, self._off)))
        self.square = reduce(np.add, [self._mean_square(row) for row in self._off])

    def of(self, chosen: np.ndarray) -> Spread:
        """The same on some of the cells."""
        part = copy(self)
        for name in ("mean", "_off", "largest", "square"):
            setattr(part, name, getattr(self, name).take(chosen, axis=-1))
        part._shape = (*self._shape[:2], len(chosen))
        return part

    def square_along(self, direction: np.ndarray) -> np.ndarray:
        """Means of (direction : D)^2 for vectors (d, n), (n,)."""
        return self._mean_square(products(self._off, direction[:, None]))

    def _mean_square(self, values: np.ndarray) -> np.ndarray:
        """Means of the squares of affine functions with the coefficients (parts k, n), (n,)."""
        parts, k, _ = self._shape
        sums = values.reshape(self._shape).sum(axis=1)
        total = products(values, values) + products(sums, sums)
        return total / (parts * k * (k + 1))


def whole_means(
    law: ScaledLaw, pulled: Spread, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of Phi over cells: upper bounds and estimates, (n,); infinite where none is known.

    ``pulled`` is q/(2 mu_2), ``w`` (d, n).
    """
    y = pulled.mean + w
    v = y - law.share * w
    square = products(y, y)
    least = law.start + 2 * law.square * law.beta
    elastic = np.sqrt(square) + pulled.largest <= 2 * law.inner * law.beta
    elastic &= sizes(v) + pulled.largest <= least
    quadratic = (square + pulled.square) / (4 * law.inner)
    if elastic.all():
        return quadratic, quadratic
    other = np.flatnonzero(~elastic)
    some = law.of_points(other)
    found = yielding_cells(some, pulled.of(other), y[:, other], v[:, other])
    bound, estimate = quadratic, quadratic.copy()
    bound[other], estimate[other] = found
    return bound, estimate


def yielding_cells(
    law: ScaledLaw, pulled: Spread, y: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same where cells yield everywhere, for the means y and v (d, n)."""
    kept = 1 - law.share
    hardens = kept > 0
    own = YieldLaw(law.beta, law.inner, np.where(hardens, kept, 1.0))
    x, n = own.best(y, v)
    r = pulled.largest
    y_n = products(y, n)
    v_n = products(v, n)
    Y = y_n - r
    V = v_n - r
    first = own.beta * Y
    applies = hardens & (2 * own.k * own.beta <= Y) & (V >= 0) & (first > 0)
    first = np.where(applies, first, 1.0)
    V = np.where(applies, V, 0.0)
    least = first + x * V

    reach = own.beta + x
    c_0 = v - v_n * n
    largest_c = sizes(c_0) + r
    curved = V * reach * r / (least * first)
    usual = own.k * own.kept
    bend = usual - largest_c**2 / (2 * first) - curved * largest_c
    applies &= bend >= LEAST_BEND * usual
    bend = np.where(applies, bend, usual)

    across = np.maximum(pulled.square - pulled.square_along(n), 0.0)
    mean_e = reach**2 * across
    X = v_n - own.slope(x)
    X = np.where(x > 0, X, np.maximum(X, 0.0))
    mean_X = X**2 + pulled.square_along(n + reach / least * c_0)
    factor = r / least + curved / 2
    root = np.sqrt(mean_X) + factor * np.sqrt(mean_e)
    size = own.beta * y_n + x * v_n
    centre = size - own.product(x)
    bound = centre + mean_e / (2 * least) + root**2 / (4 * bend)

    size = np.where(applies, size, 1.0)
    soft = np.maximum(usual - products(c_0, c_0) / (2 * size), bend)
    estimate = centre + mean_e / (2 * size) + mean_X / (4 * soft)
    infinite = np.where(applies, 0.0, np.inf)
    return bound + infinite, estimate + infinite


def whole_integrals(
    law: object, pulled: np.ndarray, w: np.ndarray, volume: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of Phi over cells: upper bounds and estimates, (cells,); infinite where none is.

    ``law`` and ``w`` (cells, d) are those of the cells, ``pulled`` (cells, parts, k, d)
    coefficients of q/(2 mu_2).  Laws other than linear hardening of von Mises have none.
    """
    if not isinstance(law, ScaledLaw):
        none = np.full(len(pulled), np.inf)
        return none, none
    values = np.ascontiguousarray(pulled.transpose(3, 1, 2, 0))
    bound, estimate = whole_means(law, Spread(values), w.T)
    return volume * bound, volume * estimate


def close_enough(
    bound: np.ndarray, estimate: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """Whether integrals over whole cells (cells,) are taken, with a ``rest`` added to them.

    Together they exceed the estimates by a small part of the integral of the supremum.
    """
    finite = np.isfinite(bound)
    gain = np.where(finite, bound, np.inf)
    gain[finite] -= estimate[finite]
    total = float((rest + estimate)[finite].sum())
    return finite & worth_keeping(gain, WORTH * total)
