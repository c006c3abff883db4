"""The supremum of the integrand of a goal over the unknown strain, point by point.

With the law s(.) of the step, the strain eps_h of the result and stresses tau and sigma^,

    sup over e of  tau : e - eps(z) : (s(eps_h + e) - s(eps_h))
                   - lambda e : (s(eps_h + e) - sigma^).

The mean part is a quadratic.  For the deviator let s be the trial stress at eps_h, t = s + 2 mu_2 e
that at eps_h + e, M = 2 mu_2 + h, and

    q = tau + lambda (sigma^ - dev alpha_0),   w = lambda s/(2 mu_2) - eps(z).

Then the part by dev e is

    Phi(q, w) - q : s/(2 mu_2) + (s(eps_h) - dev alpha_0) : eps(z),

where Phi is the supremum over t of

    y : t - lambda |t|^2/(2 mu_2)                      for |t| <= beta,  y = q/(2 mu_2) + w,
    k n : w + (n : v - start) rho - square rho^2       for t = rho n, rho >= beta,

    v = q/(2 mu_2) + h/M w,  k = 2 mu_2 beta/M,  start = lambda beta/M,
    square = lambda h/(2 mu_2 M).

It is affine in q and w for each t, hence Phi is convex in both.  It depends on |v|, |w| and v : w
only:

* the first supremum is at the point of the ball that is nearest to y 2 mu_2/(2 lambda);
* in the second one the best rho is known for each n; the rest depends on n through n : v and n : w
  and is convex in n, so that the best n lies in the plane of v and w, at an angle between them: a
  search over one angle in all dimensions.

Where the function of the angle is concave, Newton's method finds its maximum, and the second
derivative bounds the remaining error.  Elsewhere the interval of angles is cut into ``ANGLES``
parts; the values at their ends and the largest second derivative bound the function between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.polynomials import portions, square_integrals
from ngepc.bounds.simplices import sliced
from ngepc.goals.yielding import YieldLaw, dots, largest_of, products, yielding_means

ANGLES = 12
"""Parts of the interval of angles; the error of the bound falls with the square of their number."""
FLAT = 1e-6
"""Second derivatives below this fraction of ``slope`` count as zero."""
TINY = np.finfo(float).tiny


def kept_part(
    size: np.ndarray, two_mu: np.ndarray, hardening: np.ndarray, beta: np.ndarray
) -> np.ndarray:
    """Ratio of the stress after radial return to a trial stress of this size, same shape."""
    share = np.minimum(beta / np.maximum(size, TINY), 1.0)
    return (hardening + two_mu * share) / (two_mu + hardening)


@dataclass(frozen=True, eq=False)
class ScaledLaw:
    """The numbers of the law and of lambda on which Phi depends, arrays (n,).

    ``inner`` is lambda/(2 mu_2), ``share`` 2 mu_2/M; the others are those of the module.
    """

    beta: np.ndarray
    inner: np.ndarray
    share: np.ndarray
    k: np.ndarray
    start: np.ndarray
    square: np.ndarray

    @classmethod
    def of(
        cls, two_mu: np.ndarray, hardening: np.ndarray, beta: np.ndarray, factor: float
    ) -> ScaledLaw:
        """Those of a law with linear hardening."""
        M = two_mu + hardening
        inner = factor / two_mu
        share = two_mu / M
        square = inner * hardening / M
        return cls(beta, inner, share, share * beta, factor * beta / M, square)

    def of_points(self, chosen: slice | np.ndarray) -> ScaledLaw:
        """Those at some of the points."""
        return ScaledLaw(*(value[chosen] for value in vars(self).values()))

    def repeated(self, count: int) -> ScaledLaw:
        """Those of each point so many times."""
        return ScaledLaw(*(np.repeat(value, count) for value in vars(self).values()))

    def elastic(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Where nothing may yield, for coefficients on parts (d, k, n) and (d, ., n), (n,)."""
        y = pulled + w
        v = y - self.share * w
        inside = largest_of(products(y, y)) <= (2 * self.inner * self.beta) ** 2
        least = self.start + 2 * self.square * self.beta
        return inside & (largest_of(products(v, v)) <= least**2)

    def yielding_means(
        self, pulled: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Means of Phi over parts that yield: bounds and estimates, see ``yielding``, (n,)."""
        y = pulled + w
        v = y - self.share * w
        return yielding_means(YieldLaw(self.beta, self.inner, 1 - self.share), y, v)

    def potential(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """No less than Phi for q/(2 mu_2) and w at points of parts, (n, k, d) or (n, 1, d).

        The numbers of the law are those of the parts.
        """
        count, k = pulled.shape[:2]
        found = np.empty((count, k))
        for part in portions(count, 10_000 // k):
            own = w[part]
            share = self.share[part, None, None]
            v = pulled[part] + (1 - share) * own
            v_square = dots(v, v)
            both = dots(v, own)
            w_square = np.broadcast_to(dots(own, own), both.shape)
            law = self.of_points(part).repeated(k)
            products = (values.ravel() for values in (v_square, both, w_square))
            found[part] = law.of_products(*products).reshape(-1, k)
        return found

    def quadratic(
        self, pulled: np.ndarray, w: np.ndarray, volume: np.ndarray
    ) -> np.ndarray:
        """Integrals of Phi where nothing may yield, from coefficients on parts, (n,)."""
        return square_integrals(pulled + w, volume) / (4 * self.inner)

    def of_products(
        self, v_square: np.ndarray, both: np.ndarray, w_square: np.ndarray
    ) -> np.ndarray:
        """The same for |v|^2, v : w and |w|^2, (n,)."""
        share = self.share
        y_square = v_square + share * (2 * both + share * w_square)
        best = self._in_the_ball(np.maximum(y_square, 0.0))
        least = self.start + 2 * self.square * self.beta
        size = np.sqrt(v_square)
        there = np.flatnonzero(size > least)
        if len(there):
            v = size[there]
            length = np.sqrt(w_square[there])
            cosine = both[there] / np.maximum(v * length, TINY)
            arc = Arc(
                v,
                self.start[there],
                least[there],
                4 * self.square[there],
                self.k[there] * length,
                np.clip(cosine, -1.0, 1.0),
            )
            best[there] = np.maximum(best[there], arc.largest())
        return best

    def _in_the_ball(self, y_square: np.ndarray) -> np.ndarray:
        """The supremum over |t| <= beta for |y|^2."""
        size = np.sqrt(y_square)
        inside = size <= 2 * self.inner * self.beta
        free = y_square / (4 * self.inner)
        kept = self.beta * (size - self.inner * self.beta)
        return np.where(inside, free, kept)


class Arc:
    """The largest value of lin(a)^2/quarter + slope cos(b - a), lin(a) = v cos(a) - start.

    The angle a lies between 0 and the smaller one of b and that where v cos(a) = least; all are
    arrays (n,), b is given by its ``cosine``.
    """

    def __init__(
        self,
        v: np.ndarray,
        start: np.ndarray,
        least: np.ndarray,
        quarter: np.ndarray,
        slope: np.ndarray,
        cosine: np.ndarray,
    ) -> None:
        self.v = v
        self.start = start
        self.quarter = quarter
        self.slope = slope
        self.cosine = cosine
        self.sine = np.sqrt(1 - cosine**2)
        self.end = np.clip(np.maximum(least / v, cosine), -1.0, 1.0)

    def of(self, chosen: np.ndarray) -> Arc:
        """Some of the arcs."""
        return sliced(self, chosen, tuple(vars(self)))

    def largest(self) -> np.ndarray:
        """No less than the largest value, (n,)."""
        bend = self._least_bend()
        curved = bend > FLAT * self.slope
        result = self._concave(np.where(curved, bend, self.slope + 1.0))
        rest = np.flatnonzero(~curved)
        if len(rest):
            result[rest] = self.of(rest)._on_grid()
        return result

    def _least_bend(self) -> np.ndarray:
        """Lower bound of minus the second derivative on the arc."""
        lin = self.v * self.end - self.start
        square = 1 - self.end**2
        bend = 2 * self.v * (lin * self.end - self.v * square) / self.quarter
        return bend + self.slope * self.cosine

    def _parts(self, c: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, ...]:
        """Value, derivative and minus the second derivative at angles by cosine and sine."""
        lin = self.v * c - self.start
        along = self.cosine * c + self.sine * s
        across = self.sine * c - self.cosine * s
        value = lin**2 / self.quarter + self.slope * along
        first = -2 * self.v * lin * s / self.quarter + self.slope * across
        bend = 2 * self.v * (lin * c - self.v * s**2) / self.quarter
        return value, first, bend + self.slope * along

    def _concave(self, bend: np.ndarray) -> np.ndarray:
        """Upper bound of the maximum where minus the second derivative is at least ``bend`` > 0.

        One Newton step; with the value f and the derivative d there, f + d^2/(2 bend) is a bound.
        A second step gained less than a thousandth of the width of intervals.
        """
        first = self.slope * self.sine
        local = 2 * self.v * (self.v - self.start) / self.quarter
        local = local + self.slope * self.cosine
        step = np.minimum(first / np.maximum(local, bend), 1.0)
        c = np.sqrt(1 - step**2)
        beyond = c < self.end
        c = np.where(beyond, self.end, c)
        s = np.where(beyond, np.sqrt(1 - c**2), step)
        value, first, _ = self._parts(c, s)
        at_end = beyond & (first >= 0)
        return value + np.where(at_end, 0.0, first**2 / (2 * bend))

    def _on_grid(self) -> np.ndarray:
        """Upper bound of the maximum by values on a grid and the largest second derivative."""
        step = np.arccos(self.end) / ANGLES
        bend = self.slope + 2 * self.v**2 / self.quarter
        best = np.full(len(step), -np.inf)
        for count in range(ANGLES + 1):
            value, *_ = self._parts(np.cos(count * step), np.sin(count * step))
            best = np.maximum(best, value)
        return best + bend * step**2 / 8
