"""Means of the Phi of ``supremum`` over parts of cells that yield everywhere, from above.

With x = rho - beta >= 0, y = q/(2 mu_2) + w, k = lambda/(2 mu_2) and the v of ``supremum``,

    Phi = sup over x >= 0 of |beta y + x v| - k P(x),   P(x) = (beta + x) (beta + kept x),

where kept = h/M, if |y| >= 2 k beta.  y and v are polynomials on the part.  Let x_0 >= 0 be a
number and n a unit vector, such as the best ones for the means of y and v.  With y_n = n : y,
v_n = n : v, and across n

    e = beta y + x_0 v - n (beta y_n + x_0 v_n),   c = v - n v_n,

let y_n >= Y >= 2 k beta and v_n >= V >= 0 on the part, first = beta Y, least = beta Y + x_0 V.
With t = x - x_0

    |beta y + x v| <= beta y_n + x v_n + |e + t c|^2/(2 D),   D = first + x V.

1/D is at most 1/first, and it is 1/least - V t/(least D).  Hence at every point

    Phi <= beta y_n + x_0 v_n - k P(x_0) + |e|^2/(2 least) + sup over t of
               t X + |t| (Y_1 + Y_2) - bend t^2,
    X = v_n - k P'(x_0) + e : c_0/least,
    Y_1 = |e| |c - c_0|/least,   Y_2 = V |e|^2/(2 least first),
    bend = k kept - |c|^2/(2 first) - V |e| |c|/(least first),

for any c_0.  The supremum is at most (|X| + Y_1 + Y_2)^2/(4 bend), with [X]_+ for |X| if x_0 = 0,
as then t >= 0.  For the means over the part |e|, |c| and |c - c_0| are replaced by their largest
values where they stand in bend, and one of two factors of Y_1 and Y_2; the rest is integrated
exactly, and norms are added.  For the best x_0 and n the bound exceeds the mean by the third power
of the variations of y and v.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from ngepc.bounds.polynomials import RULE, WEIGHTS

STEPS = 1
"""Newton steps for x_0; a second one changes 1e-9 of the width."""
LEAST_BEND = 0.5
"""The bound applies where bend is at least this part of its value without errors."""
TINY = np.finfo(float).tiny


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors, (..., d) and (..., d) to (...)."""
    return np.einsum("...d,...d->...", a, b)


def by_components(values: np.ndarray) -> np.ndarray:
    """Coefficients on parts (n, k, d) in the order of this module, (d, k, n)."""
    return np.ascontiguousarray(values.transpose(2, 1, 0))


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products of vectors, (d, ..., n) and (d, ..., n) to (..., n)."""
    return np.einsum("d...,d...->...", a, b)


def sizes(a: np.ndarray) -> np.ndarray:
    """Norms of vectors, (d, ..., n) to (..., n)."""
    return np.sqrt(products(a, a))


def mean_of(a: np.ndarray) -> np.ndarray:
    """Means over the few rows of an array (k, ...), faster than those of numpy."""
    return reduce(np.add, a) / len(a)


def largest_of(a: np.ndarray) -> np.ndarray:
    """The largest of the few rows of an array (k, ...), faster than those of numpy."""
    return reduce(np.maximum, a)


def smallest_of(a: np.ndarray) -> np.ndarray:
    """The smallest of the few rows of an array (k, ...)."""
    return reduce(np.minimum, a)


def largest_size(a: np.ndarray) -> np.ndarray:
    """The largest norms of coefficients (d, k, n) on parts, (n,)."""
    return np.sqrt(largest_of(products(a, a)))


def mean_square(a: np.ndarray) -> np.ndarray:
    """Means of |a|^2 over parts for coefficients (d, k, n), (n,)."""
    k = a.shape[1]
    at_points = np.matmul(RULE[k], a)
    return WEIGHTS[k] @ products(at_points, at_points)


def positive_square(a: np.ndarray) -> np.ndarray:
    """No less than the means of [a]_+^2, a convex function of a with coefficients (k, n), (n,)."""
    return mean_of(np.maximum(a, 0.0) ** 2)


@dataclass(frozen=True, eq=False)
class YieldLaw:
    """The numbers ``beta``, ``k`` and ``kept`` of the law on parts, (n,)."""

    beta: np.ndarray
    k: np.ndarray
    kept: np.ndarray

    def of(self, chosen: np.ndarray) -> YieldLaw:
        """Those of some of the parts."""
        return YieldLaw(self.beta[chosen], self.k[chosen], self.kept[chosen])

    def product(self, x: np.ndarray) -> np.ndarray:
        """k P(x), (n,)."""
        return self.k * (self.beta + x) * (self.beta + self.kept * x)

    def slope(self, x: np.ndarray) -> np.ndarray:
        """k P'(x), (n,)."""
        return self.k * (self.beta * (1 + self.kept) + 2 * self.kept * x)

    def best(self, y: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """About the best x, (n,), and the direction of beta y + x v for y and v (d, n)."""
        twice = 2 * self.k * self.kept
        v_square = products(v, v)
        x = np.sqrt(v_square) - self.k * self.beta * (1 + self.kept)
        x = np.maximum(x, 0.0) / twice
        for _ in range(STEPS):
            n, size = self._direction(y, v, x)
            along = products(n, v)
            across = np.maximum(v_square - along**2, 0.0)
            bend = np.maximum(twice - across / size, twice / 2)
            x = np.maximum(x + (along - self.slope(x)) / bend, 0.0)
        return x, self._direction(y, v, x)[0]

    def _direction(
        self, y: np.ndarray, v: np.ndarray, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Direction and size of beta y + x v, (d, n) and (n,)."""
        total = self.beta * y + x * v
        size = np.maximum(sizes(total), TINY)
        return total / size, size


def yielding_means(
    law: YieldLaw, y: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Means of Phi over parts from coefficients (d, k, n): upper bounds and estimates, (n,).

    Both are infinite where the part may not yield everywhere, or varies too much.
    """
    perfect = law.kept == 0
    if not perfect.any():
        return hardening_means(law, y, v)
    found = np.empty((2, len(perfect)))
    found[:, perfect] = perfect_means(law.of(perfect), y[..., perfect], v[..., perfect])
    if not perfect.all():
        other = ~perfect
        means = hardening_means(law.of(other), y[..., other], v[..., other])
        found[:, other] = means
    return found[0], found[1]


def perfect_means(
    law: YieldLaw, y: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same without hardening, where x = 0 is the best: Phi = beta |y| - k beta^2.

    Infinite where |v| may exceed k beta: there Phi is.
    """
    mean = y.mean(axis=1)
    n = mean / np.maximum(sizes(mean), TINY)
    y_n = products(y, n[:, None])
    least = y_n.min(axis=0)
    most = law.k * law.beta
    applies = (2 * most <= least) & (largest_size(v) <= most)
    across = mean_square(y - y_n * n[:, None])
    size = y_n.mean(axis=0)
    found = []
    for smallest in (least, size):
        smallest = np.where(applies, smallest, 1.0)
        mean_size = size + across / (2 * smallest)
        found.append(np.where(applies, law.beta * (mean_size - most), np.inf))
    return found[0], found[1]


def hardening_means(
    law: YieldLaw, y: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same with hardening."""
    x, n = law.best(mean_of(y.swapaxes(0, 1)), mean_of(v.swapaxes(0, 1)))
    n = n[:, None]
    y_n = products(y, n)
    v_n = products(v, n)
    along = law.beta * y_n + x * v_n
    e = law.beta * y + x * v - along * n
    c = v - v_n * n
    c_0 = mean_of(c.swapaxes(0, 1))[:, None]

    Y = smallest_of(y_n)
    V = smallest_of(v_n)
    first = law.beta * Y
    applies = (2 * law.k * law.beta <= Y) & (V >= 0) & (first > 0)
    first = np.where(applies, first, 1.0)
    V = np.where(applies, V, 0.0)
    least = first + x * V

    X = v_n - law.slope(x) + products(e, c_0) / least
    mean_e = mean_square(e)
    mean_X = np.where(x > 0, mean_square(X[None]), positive_square(X))
    largest_e = largest_size(e)
    largest_c = largest_size(c)
    curved = V * largest_e / (least * first)
    usual = law.k * law.kept
    bend = usual - largest_c**2 / (2 * first) - curved * largest_c
    applies &= bend >= LEAST_BEND * usual
    bend = np.where(applies, bend, usual)

    factor = largest_size(c - c_0) / least + curved / 2
    root = np.sqrt(mean_X) + factor * np.sqrt(mean_e)
    size = mean_of(along)
    centre = size - law.product(x)
    bound = centre + mean_e / (2 * least) + root**2 / (4 * bend)

    size = np.where(applies, size, 1.0)
    mean_c = products(c_0, c_0)[0]
    soft = np.maximum(usual - mean_c / (2 * size), bend)
    estimate = centre + mean_e / (2 * size) + mean_X / (4 * soft)
    infinite = np.where(applies, 0.0, np.inf)
    return bound + infinite, estimate + infinite
