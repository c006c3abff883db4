"""The Phi of ``supremum`` for Hill's ellipsoid with kinematic hardening, from above.

With (s . A s)^(1/2) <= beta, M = 2 mu_2 + h, k = lambda/(2 mu_2), p = q/(2 mu_2), y = p + w and
v = M p + h w, trial stresses t and stresses S outside the ellipsoid are

    t = (beta + M g A) n,   S = (beta + h g A) n,   n . A n = 1,   g >= 0,

and the supremum is that over g and n of

    f(g, n) = (beta y + g A v) . n - k n . (beta^2 + M h g^2 A^2) n - k (M + h) beta g.

For a given g it is a quadratic in n on the ellipsoid.  With a and Q for its coefficients, any nu
with Q + nu A > 0 shows, as n . A n = 1, that

    a . n - n . Q n  <=  nu + a . (Q + nu A)^-1 a / 4,

and the best nu gives the maximum (one quadratic condition).  A and Q have the same eigenvectors.

For a given n it is a concave quadratic in g, whose second derivative is at least -2 k M h alpha,
where alpha is the largest eigenvalue of A.  So on an interval of length 2 d it exceeds its values
at the ends by at most k M h alpha d^2, and so does the maximum over n.  It falls for all n beyond

    g = (|v|_A - k (M + h) beta) / (2 k M h alpha_min),   |v|_A = (v . A v)^(1/2).

Intervals of g are halved until this bound is close to the largest value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.polynomials import portions
from ngepc.goals.supremum_of_laws import SearchedLaw

CLOSE = 0.02
"""Halving ends where the bound exceeds the largest value by this part of what it is beyond p . w/k,
the value of Phi without errors."""
ROUNDING = 1e-12
NEWTON_STEPS = 8
HALVINGS = 60
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class EllipsoidLaw(SearchedLaw):
    """``ScaledLaw`` for Hill's ellipsoid.

    ``two_mu``, ``hardening`` and ``beta`` are arrays (n,), ``sizes`` (n, d) and ``vectors``
    (n, d, d) the eigenvalues and eigenvectors of A.
    """

    two_mu: np.ndarray
    hardening: np.ndarray
    beta: np.ndarray
    sizes: np.ndarray
    vectors: np.ndarray
    factor: float

    def of_points(self, chosen: slice | np.ndarray) -> EllipsoidLaw:
        """That at some of the points."""
        numbers = (self.two_mu, self.hardening, self.beta, self.sizes, self.vectors)
        return EllipsoidLaw(*(values[chosen] for values in numbers), self.factor)

    def elastic(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Where nothing may yield, see ``SearchedLaw.elastic``."""
        k = self.factor / self.two_mu
        M = self.two_mu + self.hardening
        y = self._measure(pulled + w)
        v = self._measure(M * pulled + self.hardening * w)
        inside = y <= 2 * k * self.beta
        return inside & (v <= k * (M + self.hardening) * self.beta)

    def _measure(self, values: np.ndarray) -> np.ndarray:
        """The largest (x . A x)^(1/2) of coefficients (k, d, n), (n,)."""
        turned = np.einsum("nci,kcn->kin", self.vectors, values)
        squares = np.einsum("ni,kin->kn", self.sizes, turned**2)
        return np.sqrt(squares.max(axis=0))

    def potential(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """No less than Phi for p and w at points of parts, see ``ScaledLaw.potential``."""
        count, points = pulled.shape[:2]
        found = np.empty((count, points))
        for part in portions(count, 10_000 // points):
            law = self.of_points(part).repeated(points)
            own = np.broadcast_to(w[part], pulled[part].shape)
            flat = (x.reshape(-1, x.shape[2]) for x in (pulled[part], own))
            turned = (np.einsum("nci,nc->ni", law.vectors, x) for x in flat)
            found[part] = law.of_vectors(*turned).reshape(-1, points)
        return found

    def of_vectors(self, p: np.ndarray, w: np.ndarray) -> np.ndarray:
        """The same for coordinates along the eigenvectors, (n, d)."""
        search = Halving(self, p, w)
        square = (search.y**2).sum(axis=1)
        size = np.sqrt((self.sizes * search.y**2).sum(axis=1))
        inside = size <= 2 * search.k * self.beta
        on_surface = search.largest_of(np.zeros(len(p)), np.arange(len(p)))
        best = np.where(inside, square / (4 * search.k), on_surface)
        yields = np.flatnonzero(search.end > 0)
        if len(yields):
            some = Halving(self.of_points(yields), p[yields], w[yields])
            best[yields] = some.largest(best[yields])
        return best


class Halving:
    """The largest f(g, n) over n and 0 <= g <= ``end``, for p and w along the eigenvectors."""

    def __init__(self, law: EllipsoidLaw, p: np.ndarray, w: np.ndarray) -> None:
        M = law.two_mu + law.hardening
        self.k = law.factor / law.two_mu
        self.y = p + w
        self.known = (p * w).sum(axis=1) / self.k
        self._law = law
        self._v = M[:, None] * p + law.hardening[:, None] * w
        self._both = self.k * M * law.hardening
        self._pull = self.k * (M + law.hardening) * law.beta
        size = np.sqrt((law.sizes * self._v**2).sum(axis=1))
        above = np.maximum(size - self._pull, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            end = above / (2 * self._both * law.sizes.min(axis=1))
        self.end = np.where(above > 0, end, 0.0)

    def largest_of(self, g: np.ndarray, at: np.ndarray) -> np.ndarray:
        """The largest f over n for values of g at the points ``at`` (numbers), both (m,)."""
        law = self._law
        sizes = law.sizes[at]
        bound = law.beta[at, None]
        a = bound * self.y[at] + g[:, None] * sizes * self._v[at]
        own = self.k[at, None] * bound**2 + (self._both[at] * g**2)[:, None] * sizes**2
        return largest_on_ellipsoid(a, own, sizes) - self._pull[at] * g

    def largest(self, best: np.ndarray) -> np.ndarray:
        """No less than f anywhere, and than ``best`` (n,)."""
        best = best.copy()
        bound = np.where(np.isfinite(self.end), -np.inf, np.inf)
        at = np.flatnonzero(np.isfinite(self.end))
        low = np.zeros(len(at))
        high = self.end[at]
        ends = [self.largest_of(g, at) for g in (low, high)]
        steep = self._both * self._law.sizes.max(axis=1)
        for _ in range(HALVINGS):
            np.maximum.at(best, at, np.maximum(*ends))
            beyond = CLOSE * np.maximum(best - self.known, 0.0)
            allowed = best + beyond + ROUNDING * np.abs(best)
            above = np.maximum(*ends) + steep[at] * ((high - low) / 2) ** 2
            done = above <= allowed[at]
            np.maximum.at(bound, at[done], above[done])
            at, low, high, *ends = (x[~done] for x in (at, low, high, *ends))
            if not len(at):
                break
            middle = (low + high) / 2
            value = self.largest_of(middle, at)
            ends = [np.append(ends[0], value), np.append(value, ends[1])]
            low, high = np.append(low, middle), np.append(middle, high)
            at = np.append(at, at)
        else:
            above = np.maximum(*ends) + steep[at] * ((high - low) / 2) ** 2
            np.maximum.at(bound, at, above)
        return np.maximum(best, bound)


def largest_on_ellipsoid(a: np.ndarray, Q: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The largest a . n - n . Q n with n . A n = 1, from above; Q and A diagonal, all (n, d).

    Newton's method for the root of 1/f^(1/2) - 1, f the sum of a^2/(4 A (Q/A + nu)^2); every nu
    that it visits gives a bound.
    """
    ratio = Q / sizes
    squares = a**2 / (4 * sizes)
    least = -ratio.min(axis=1)
    first = np.where(ratio == ratio.min(axis=1, keepdims=True), squares, 0.0)
    spare = 1e-15 * np.abs(least) + TINY
    nu = least + np.maximum(np.sqrt(first.sum(axis=1)), spare)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for _ in range(NEWTON_STEPS):
            apart = ratio + nu[:, None]
            f = (squares / apart**2).sum(axis=1)
            slope = (squares / apart**3).sum(axis=1)
            following = nu + (np.sqrt(f) - 1) * f / slope
            good = np.isfinite(following) & (following > least + spare)
            nu = np.where(good, following, nu)
    return nu + (squares / (ratio + nu[:, None])).sum(axis=1)
