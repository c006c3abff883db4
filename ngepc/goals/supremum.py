"""The supremum of the integrand of a goal over the unknown strain, for linear hardening.

With the law s(.) of the step, the strain eps_h of the result and stresses tau and sigma^,

    sup over e of  tau : e - eps(z) : (s(eps_h + e) - s(eps_h))
                   - lambda e : (s(eps_h + e) - sigma^).

The mean part is a quadratic.  For the deviator let s be the trial stress at eps_h, t = s + 2 mu_2 e
that at eps_h + e, S(t) its stress less dev alpha_0, and

    q = tau + lambda (sigma^ - dev alpha_0),   w = lambda s/(2 mu_2) - eps(z).

Then the part by dev e is Phi(q, w) - q : s/(2 mu_2) + S(s) : eps(z) with k = lambda/(2 mu_2) and

    Phi(q, w) = sup over t of  q : t/(2 mu_2) + w : S(t) - k t : S(t).

It is affine in q and w for each t, hence convex in both.  With H = h/(2 mu_2) and

    y = q/(2 mu_2) + w,   v = q/(2 mu_2) + H y,   V = k beta (1 + 2 H),   b = k H (1 + H),

and for any D, with A = beta D,

    Phi <= |y - D|^2/(4 k) + sup F,   F(g) = |A + g v| - V g - b g^2,   g >= 0,

and Phi <= sup F - k beta^2 with D = y where |y| >= 2 k beta.  For any r > 0 and unit vector n

    sup F <= F(r) + (|v_n - V - 2 b r| + max(|v| - v_n, (|A| - A_n)/r))^2/(4 b),
    sup F <= F(0) + ([|v| - V]_+)^2/(4 b),

and with the slope (|A + G v| - |A|)/G of a chord for |v|, for any G >= (|v| - V)/(2 b);
``docs/goal_bound.md`` has the proof.  On a piece of a cell y and v are polynomials; one r and one
n, those for their means, serve for all of it.  The mean of a norm |x| is at most

    mean x_n + mean |x across n|^2/(2 min x_n),

and a convex function has at most the mean of the values at the coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ngepc.bounds.polynomials import portions
from ngepc.bounds.simplices import of_cells
from ngepc.goals.pieces import (
    largest_of,
    mean_of,
    mean_squares,
    pieces_last,
    products,
    smallest_of,
)

AT_ONCE = 36_000
"""Coefficients that are treated at once."""
MOST = 0.7
"""Arguments are copied where fewer than this part of them are needed."""
LEAST = 0.3
"""r is zero where it would be below this part of beta: (|A| - A_n)/r is large there."""
INSIDE = {1: 1.0, 3: 1 / 4, 4: 1 / 5, 6: 2 / 5, 9: 1 / 4, 16: 1 / 5, 18: 2 / 5}
"""Variance of an affine function on a piece over that of its coefficients, for estimates."""
MIXED = 0.3
"""The same where a piece may yield in part."""
TINY = np.finfo(float).tiny


def kept_part(
    size: np.ndarray, two_mu: np.ndarray, hardening: np.ndarray, beta: np.ndarray
) -> np.ndarray:
    """Ratio of the stress after radial return to a trial stress of this size, same shape."""
    share = np.minimum(beta / np.maximum(size, TINY), 1.0)
    return (hardening + two_mu * share) / (two_mu + hardening)


@dataclass(frozen=True, eq=False)
class ScaledLaw:
    """The numbers ``beta``, ``k`` and ``H`` of the law and of lambda, arrays (n,)."""

    beta: np.ndarray
    k: np.ndarray
    H: np.ndarray

    @classmethod
    def of(
        cls, two_mu: np.ndarray, hardening: np.ndarray, beta: np.ndarray, factor: float
    ) -> ScaledLaw:
        """Those of a law with linear hardening."""
        return cls(beta, factor / two_mu, hardening / two_mu)

    @cached_property
    def start(self) -> np.ndarray:
        """V, (n,)."""
        return self.k * self.beta * (1 + 2 * self.H)

    @cached_property
    def bend(self) -> np.ndarray:
        """b, (n,)."""
        return self.k * self.H * (1 + self.H)

    def of_points(self, chosen: slice | np.ndarray) -> ScaledLaw:
        """Those at some of the points."""
        numbers = self.beta, self.k, self.H
        return ScaledLaw(*(value[chosen] for value in numbers))

    def means(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Means of Phi over pieces: upper bounds and estimates, (2, n).

        ``pulled`` (n, k, d) are coefficients of q/(2 mu_2), ``w`` (n, k or 1, d) those of w.
        """
        found = np.empty((2, len(pulled)))
        for part in portions(len(pulled), AT_ONCE // pulled.shape[1]):
            found[:, part] = smooth_means(*self.pieces(pulled, w, part))
        mixed = np.flatnonzero(np.isnan(found[0]))
        for part in portions(len(mixed), AT_ONCE // pulled.shape[1]):
            at = mixed[part]
            found[:, at] = mixed_means(*self.pieces(pulled, w, at))
        return found

    def pieces(
        self, pulled: np.ndarray, w: np.ndarray, chosen: slice | np.ndarray
    ) -> tuple[ScaledLaw, Arguments]:
        """The law and y and v on some of the pieces."""
        law = self.of_points(chosen)
        p = pieces_last(of_cells(pulled, chosen))
        y = p + pieces_last(of_cells(w, chosen))
        return law, Arguments.of(y, p + law.H * y)

    def potential(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """No less than Phi at points of pieces, (n, k), from q/(2 mu_2) and w there."""
        count, k = pulled.shape[:2]
        found = np.empty((k, count))
        for part in portions(count, AT_ONCE // k):
            found[:, part] = values(*self.pieces(pulled, w, part))
        return found.T


@dataclass(frozen=True, eq=False)
class Arguments:
    """Coefficients (k, d, n) of y and v on pieces, and their norms (k, n)."""

    y: np.ndarray
    v: np.ndarray
    of_y: np.ndarray
    of_v: np.ndarray

    @classmethod
    def of(cls, y: np.ndarray, v: np.ndarray) -> Arguments:
        """The same from y and v."""
        return cls(y, v, np.sqrt(products(y, y)), np.sqrt(products(v, v)))

    def at(self, chosen: np.ndarray) -> Arguments:
        """Some of the pieces."""
        return Arguments(
            *(value.take(chosen, axis=-1) for value in vars(self).values())
        )

    def points(self) -> Arguments:
        """The values at all coefficients, as constants on pieces: first those of the first ones."""
        vectors = (
            x.swapaxes(0, 1).reshape(1, x.shape[1], -1) for x in (self.y, self.v)
        )
        return Arguments(*vectors, self.of_y.reshape(1, -1), self.of_v.reshape(1, -1))

    def centres(self) -> Arguments:
        """Their means, as constants."""
        return Arguments.of(mean_of(self.y)[None], mean_of(self.v)[None])


class Field(NamedTuple):
    """Coefficients of a field: vectors (k, d, n), norms and components along n, (k, n)."""

    vectors: np.ndarray
    norms: np.ndarray
    along: np.ndarray


def smooth_means(law: ScaledLaw, pieces: Arguments) -> np.ndarray:
    """Means of Phi over pieces: upper bounds and estimates, (2, n).

    They are NaN for pieces that may yield in part, see ``mixed_means``.
    """
    limit = 2 * law.k * law.beta
    elastic = largest_of(pieces.of_y) <= limit
    elastic &= largest_of(pieces.of_v) <= law.start
    found = np.full((2, len(limit)), np.nan)
    if elastic.any():
        squares = mean_squares(pieces.y.compress(elastic, axis=-1))
        found[:, elastic] = squares / (4 * law.k[elastic])
    rest = np.flatnonzero(~elastic)
    if not len(rest):
        return found
    if len(rest) < MOST * len(limit):  # the others are not worth a copy
        law, pieces, limit = law.of_points(rest), pieces.at(rest), limit[rest]
    else:
        rest = slice(None)
    r, n = tangents(law, pieces.centres())
    y_n = products(pieces.y, n)
    yields = (smallest_of(y_n) >= limit) & ~elastic[rest]
    if yields.any():
        means = yielding_means(law, pieces, r, n, y_n)
        found[:, rest] = np.where(yields, means, found[:, rest])
    return found


def tangents(law: ScaledLaw, centres: Arguments) -> tuple[np.ndarray, np.ndarray]:
    """About the best r for D = y, (n,), and the direction of beta y + r v, (d, n)."""
    y, v = centres.y[0], centres.v[0]
    size = centres.of_v[0]
    bend = 2 * np.where(law.H > 0, law.bend, 1.0)
    r = np.maximum(size - law.start, 0.0) / bend
    n, length = unit_and_size(law.beta * y + r * v)  # one Newton step is enough
    along = products(n, v)
    across = np.maximum(size**2 - along**2, 0.0)
    soft = np.maximum(bend - across / length, bend / 2)
    r = np.maximum(r + (along - law.start - bend * r) / soft, 0.0)
    r = np.where((r >= LEAST * law.beta) & (law.H > 0), r, 0.0)
    _, length = unit_and_size(law.beta * y + r * v)
    rise = length - law.beta * centres.of_y[0] - r * (law.start + law.bend * r)
    r = np.where(rise > 0, r, 0.0)  # there may be two maxima
    return r, unit_and_size(law.beta * y + r * v)[0]


def unit_and_size(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions and sizes of vectors (d, n)."""
    size = np.maximum(np.sqrt(products(vectors, vectors)), TINY)
    return vectors / size, size


def yielding_means(
    law: ScaledLaw, pieces: Arguments, r: np.ndarray, n: np.ndarray, y_n: np.ndarray
) -> np.ndarray:
    """Means of sup F - k beta^2 for D = y: upper bounds and estimates, (2, n)."""
    A = Field(law.beta * pieces.y, law.beta * pieces.of_y, law.beta * y_n)
    v = Field(pieces.v, pieces.of_v, products(pieces.v, n))
    return np.stack(largest_means(law, A, v, r)) - law.k * law.beta**2


def mixed_means(law: ScaledLaw, pieces: Arguments) -> np.ndarray:
    """Means of Phi over pieces: upper bounds and estimates, (2, n).

    D is what of the coefficients of y exceeds 2 k beta, or the mean of values is taken.
    """
    r, _ = tangents(law, pieces.centres())
    beyond = np.maximum(pieces.of_y - 2 * law.k * law.beta, 0.0)
    D = pieces.y * (beyond / np.maximum(pieces.of_y, TINY))[:, None]
    n, _ = unit_and_size(law.beta * mean_of(D) + r * mean_of(pieces.v))
    A = Field(law.beta * D, law.beta * beyond, law.beta * products(D, n))
    v = Field(pieces.v, pieces.of_v, products(pieces.v, n))
    bound, _ = largest_means(law, A, v, r)
    bound += mean_squares(pieces.y - D) / (4 * law.k)
    bound = np.minimum(bound, mean_of(values(law, pieces)))
    least = values(law, pieces.centres())[0]
    finite = np.isfinite(bound)
    estimate = bound.copy()
    estimate[finite] = (least + MIXED * (bound - least))[finite]
    return np.stack([bound, estimate])


def values(law: ScaledLaw, pieces: Arguments) -> np.ndarray:
    """No less than Phi at the coefficients of pieces, (k, n)."""
    shape = pieces.of_y.shape
    points = pieces.points()
    law = law.of_points(np.tile(np.arange(shape[1]), shape[0]))
    y = points.of_y[0]
    inside = np.minimum(y, 2 * law.k * law.beta)
    found = (y - inside / 2) * inside / (2 * law.k)
    yields = np.flatnonzero(points.of_v[0] > law.start)
    if len(yields):
        law, points = law.of_points(yields), points.at(yields)
        r, n = tangents(law, points)
        bound, _ = yielding_means(law, points, r, n, products(points.y, n))
        found[yields] = np.maximum(found[yields], bound)
    return found.reshape(shape)


def largest_means(
    law: ScaledLaw, A: Field, v: Field, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of sup F over pieces: upper bounds and estimates, (n,)."""
    upper, near = norm_means(A, v, r)
    beyond, square = excess_means(law, A, v, r)
    rise = r * (law.start + law.bend * r)
    return upper - rise + beyond, near - rise + square


def norm_means(A: Field, v: Field, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of |A + r v| over pieces: upper bounds and estimates, (n,)."""
    along = A.along + r * v.along
    across = mean_squares(A.vectors + r * v.vectors) - mean_squares(along)
    across = np.maximum(across, 0.0)
    size = mean_of(along)
    least = smallest_of(along)
    upper = mean_of(A.norms) + r * mean_of(v.norms)
    positive = least > 0
    sharp = size + across / (2 * np.where(positive, least, 1.0))
    is_sharp = positive & (sharp < upper)
    near = size + across / (2 * np.maximum(size, TINY))
    rough = size + INSIDE[len(along)] * (upper - size)
    return np.where(is_sharp, sharp, upper), np.where(is_sharp, near, rough)


def from_zero(law: ScaledLaw, A: Field, v: Field, chosen: np.ndarray) -> np.ndarray:
    """Coefficients of what slopes of |A + g v| from zero on exceed V by, (k, n)."""
    found = np.maximum(v.norms.take(chosen, axis=-1) - law.start[chosen], 0.0)
    rises = np.flatnonzero((law.H[chosen] > 0) & (largest_of(found) > 0))
    if len(rises):
        found[:, rises] = chords(law, A, v, chosen[rises])
    return found


def chords(law: ScaledLaw, A: Field, v: Field, chosen: np.ndarray) -> np.ndarray:
    """The same by the slopes of chords, where these are flatter in the mean."""
    law = law.of_points(chosen)
    A = Field(*(part.take(chosen, axis=-1) for part in A))
    v = Field(*(part.take(chosen, axis=-1) for part in v))
    end = (largest_of(v.norms) - law.start) / (2 * law.bend)
    there = A.vectors + end * v.vectors
    size_there = np.sqrt(products(there, there))
    chord = (size_there - A.along) / end
    flatter = mean_of(chord) < mean_of(v.norms)
    steep = np.where(flatter, chord, v.norms)
    return np.maximum(steep - law.start, 0.0)


def excess_means(
    law: ScaledLaw, A: Field, v: Field, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What sup F exceeds F(r) by, in the mean over pieces: upper bounds and estimates, (n,)."""
    bends = law.H > 0
    fourth = 4 * np.where(bends, law.bend, 1.0)
    before = (A.norms - A.along) * np.where(r > 0, 1 / np.maximum(r, TINY), 0.0)
    after = v.norms - v.along
    X = v.along - (law.start + 2 * law.bend * r)
    rests = np.flatnonzero(r == 0)
    X[:, rests] = np.maximum(X[:, rests], 0.0)
    after[:, rests] = 0.0
    near = mean_squares(X)
    square = near.copy()
    if len(rests):
        square[rests] = mean_squares(from_zero(law, A, v, rests))
    off = mean_squares(np.maximum(after, before))
    upper = (np.sqrt(square) + np.sqrt(off)) ** 2 / fourth
    near /= fourth
    if bends.all():
        return upper, near
    perfect = np.where(largest_of(v.norms) > law.start, np.inf, 0.0)
    return np.where(bends, upper, perfect), np.where(bends, near, perfect)
