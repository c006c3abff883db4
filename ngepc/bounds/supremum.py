"""The supremum of the integrand of a goal over the unknown strain, point by point.

With the law s(.) of the step, the strain eps_h of the result and stresses tau and sigma^,

    sup over e of  tau : e - eps(z) : (s(eps_h + e) - s(eps_h))
                   - lambda e : (s(eps_h + e) - sigma^).

The mean part is a quadratic.  For the deviator the trial stress t = s + 2 mu_2 e replaces e:

* where |t| <= beta the function is a quadratic with the Hessian -lambda/mu_2, so that the best t is
  the point of the ball that is nearest to its stationary point;
* where |t| = rho >= beta it is a quadratic in rho for each direction n of t.  For the best rho the
  rest depends on n through two numbers, n . v and n . w.  It is convex in n, so that the best n
  lies in the plane of v and w, at an angle between them: one angle is searched in all dimensions.

Where the function of the angle is concave, Newton's method finds its maximum, and the second
derivative bounds the remaining error.  Elsewhere the interval of angles is cut into ``ANGLES``
parts; the values at their ends and the largest second derivative bound the function between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.parts import portions
from ngepc.bounds.simplices import sliced

ANGLES = 12
"""Parts of the interval of angles; the error of the bound falls with the square of their number."""
FLAT = 1e-6
"""Second derivatives below this fraction of ``slope`` count as zero."""
TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class PointData:
    """Data of the supremum at points, arrays of shape (n,) and (n, d).

    ``bulk``, ``two_mu``, ``hardening`` and ``beta`` are the law's; ``volume`` tr eps_h, ``trial``
    s, ``back`` dev alpha_0 and ``stress`` the deviatoric stress s(eps_h).
    """

    bulk: np.ndarray
    two_mu: np.ndarray
    hardening: np.ndarray
    beta: np.ndarray
    volume: np.ndarray
    trial: np.ndarray
    back: np.ndarray
    stress: np.ndarray

    def of(self, chosen: slice | np.ndarray) -> PointData:
        """The data at some of the points."""
        return PointData(*(value[chosen] for value in vars(self).values()))


def kept_part(
    trial: np.ndarray, two_mu: np.ndarray, hardening: np.ndarray, beta: np.ndarray
) -> np.ndarray:
    """Ratio of the stress after radial return to the trial stress, (n,)."""
    size = np.sqrt(dots(trial, trial))
    share = np.minimum(beta / np.maximum(size, TINY), 1.0)
    return (hardening + two_mu * share) / (two_mu + hardening)


@dataclass(frozen=True, eq=False)
class Stresses:
    """Stresses and strains at points: means (n,) and deviators (n, d)."""

    mean: np.ndarray
    deviator: np.ndarray

    def of(self, chosen: slice | np.ndarray) -> Stresses:
        """Those at some of the points."""
        return Stresses(self.mean[chosen], self.deviator[chosen])

    def __neg__(self) -> Stresses:
        return Stresses(-self.mean, -self.deviator)


def suprema(
    at: PointData, tau: Stresses, sigma: Stresses, strain: Stresses, factor: float
) -> np.ndarray:
    """Upper bound of the supremum at each point, and where it is a quadratic, (n,).

    Parameters
    ----------
    at
        Law and state at the points.
    tau, sigma
        The goal's stress and that of the error bound.
    strain
        eps(z): its trace, and the coordinates of its deviator.
    factor
        lambda > 0.
    """
    result = np.empty(len(at.bulk))
    smooth = np.empty(len(at.bulk), dtype=bool)
    for part in portions(len(result), 20_000):
        result[part], smooth[part] = _suprema(
            at.of(part), tau.of(part), sigma.of(part), strain.of(part), factor
        )
    return result, smooth


def _suprema(
    at: PointData, tau: Stresses, sigma: Stresses, strain: Stresses, factor: float
) -> tuple[np.ndarray, np.ndarray]:
    mean = mean_part(at, tau, sigma, strain, factor)
    best, smooth = deviatoric_part(at, tau, sigma, strain, factor)
    return best + mean, smooth


def mean_part(
    at: PointData, tau: Stresses, sigma: Stresses, strain: Stresses, factor: float
) -> np.ndarray:
    """The supremum over tr e, a quadratic function of the data, (n,)."""
    own = at.bulk * at.volume
    pulled = tau.mean - at.bulk * strain.mean + factor * (sigma.mean - own)
    return pulled**2 / (4 * factor * at.bulk)


def deviatoric_part(
    at: PointData, tau: Stresses, sigma: Stresses, strain: Stresses, factor: float
) -> tuple[np.ndarray, np.ndarray]:
    """The supremum over dev e, and where it is the quadratic function of the elastic law."""
    B = tau.deviator + factor * (sigma.deviator - at.stress)
    best, inside = elastic(at, B, strain.deviator, factor)
    plastic = Plastic(at, B, strain.deviator, factor)
    there = np.flatnonzero(plastic.possible)
    if len(there):
        best[there] = np.maximum(best[there], plastic.bound(there))
    return best, inside & ~plastic.possible


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors, (n, d) and (n, d) to (n,)."""
    return np.einsum("nd,nd->n", a, b)


def elastic(
    at: PointData, B: np.ndarray, strain: np.ndarray, factor: float
) -> tuple[np.ndarray, np.ndarray]:
    """The supremum over trial stresses with |t| <= beta, and where it is attained inside."""
    two_mu = at.two_mu[:, None]
    shift = at.trial + at.back - at.stress
    e = (B - two_mu * strain - factor * shift) / (2 * factor * two_mu)
    t = at.trial + two_mu * e
    size = np.sqrt(dots(t, t))
    t = t * np.minimum(at.beta / np.maximum(size, TINY), 1.0)[:, None]
    e = (t - at.trial) / two_mu
    value = dots(B, e) - dots(strain + factor * e, t + at.back - at.stress)
    return value, size <= at.beta


class Plastic:
    """The supremum over trial stresses t = rho n with rho >= beta.

    With M = 2 mu_2 + h, k = 2 mu_2 beta/M and w = lambda s/(2 mu_2) - eps(z) it is

        K + k n . w + lin rho - q rho^2,
        lin = n . v - lambda k/(2 mu_2),   q = lambda h/(2 mu_2 M).
    """

    def __init__(
        self, at: PointData, B: np.ndarray, strain: np.ndarray, factor: float
    ) -> None:
        M = at.two_mu + at.hardening
        two_mu = at.two_mu[:, None]
        fixed = at.back - at.stress
        w = factor * at.trial / two_mu - strain
        v = B / two_mu + (at.hardening / M)[:, None] * w - factor / two_mu * fixed
        self.k = at.two_mu * at.beta / M
        self.square = factor * at.hardening / (at.two_mu * M)
        self.start = factor * self.k / at.two_mu
        self.constant = dots(w, fixed) - dots(B, at.trial) / at.two_mu
        self.v = np.sqrt(dots(v, v))
        self.w = np.sqrt(dots(w, w))
        cosine = dots(v, w) / np.maximum(self.v * self.w, TINY)
        self.cosine = np.clip(cosine, -1.0, 1.0)
        self.least = self.start + 2 * self.square * at.beta
        self.possible = self.v > self.least

    def bound(self, there: np.ndarray) -> np.ndarray:
        """No less than the supremum at some of the points, where it is ``possible``.

        The angle is measured from v.  The first part decreases with it, the second part increases
        up to the direction of w, so that the best angle lies between 0 and the end: that of w, or
        the one with rho = beta.
        """
        arc = Arc(
            self.v[there],
            self.start[there],
            self.least[there],
            4 * self.square[there],
            self.k[there] * self.w[there],
            self.cosine[there],
        )
        return self.constant[there] + arc.largest()


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

        Two Newton steps; with the value f and the derivative d there, f + d^2/(2 bend) is a bound.
        """
        one = np.ones_like(self.v)
        far = np.sqrt(1 - self.end**2)
        angle = np.zeros_like(self.v)
        c = one
        s = angle
        for _ in range(2):
            _, first, local = self._parts(c, s)
            angle = np.maximum(angle + first / np.maximum(local, bend), 0.0)
            angle = np.minimum(angle, np.pi)
            c = np.cos(angle)
            s = np.sin(angle)
            beyond = c < self.end
            c = np.where(beyond, self.end, c)
            s = np.where(beyond, far, s)
            angle = np.where(beyond, np.arccos(self.end), angle)
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
