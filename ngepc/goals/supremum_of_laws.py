"""The Phi of ``supremum`` for nonlinear hardening laws, from above.

With p = q/(2 mu_2), c = lambda/(2 mu_2), and the trial stress rho and the stress r of a plastic
strain g,

    rho = beta(g) + M g,   r = beta(g) + h g,   M = 2 mu_2 + h,

the supremum over t = rho n outside the ball is that over g >= 0 of

    N(g) = |rho p + r w| - c rho r,

as the best n is the direction of rho p + r w.  Between two values of g the curve (rho, r) is near
its chord.  On the chord the norm is at most its linear interpolant, and - rho r exceeds its own by
a parabola.  The slope dr/drho = (beta' + h)/(beta' + M) lies between two values s_0 and s_1.  So r
differs from the chord by (s_1 - s_0)/4 times the change of rho at most, and N by this times the
largest of |n : w - c rho|.  Intervals of g are halved where this bound is largest.  Beyond a g
with c r >= |p| and c rho >= |w|

    N <= rho |p| + r |w| - c rho r.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ngepc.bounds.polynomials import NODES, portions
from ngepc.discretisation.resistance import Resistance
from ngepc.goals.pieces import dots, largest_of, mean_squares, pieces_last, products

ROUNDS = 40
"""Most intervals that are halved at a point."""
CLOSE = 0.02
"""Halving ends where the bound exceeds the largest value by this part of what it is beyond p : w/c.

That is the value of Phi without errors, so that the rest is a square of errors.
"""
ROUNDING = 1e-12
INSIDE = {3: 1 / 4, 4: 1 / 5, 6: 2 / 5}
"""Variance of an affine function on a part over that of its coefficients, for estimates."""
BEYOND = 1.5
"""Factor between the first largest g and the smallest one for which the last bound holds."""
TINY = np.finfo(float).tiny
Own = TypeVar("Own", bound="SearchedLaw")


class SearchedLaw(ABC):
    """What laws have in common whose Phi is found by a search, point by point."""

    two_mu: np.ndarray
    factor: float

    @abstractmethod
    def of_points(self: Own, chosen: slice | np.ndarray) -> Own:
        """That at some of the points."""

    def repeated(self: Own, count: int) -> Own:
        """That of each point so many times."""
        return self.of_points(np.repeat(np.arange(len(self.two_mu)), count))

    @abstractmethod
    def elastic(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Where nothing may yield, (n,), for coefficients (k, d, n) and (k or 1, d, n)."""

    @abstractmethod
    def potential(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """No less than Phi at points of pieces, see ``ScaledLaw.potential``."""

    def means(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Means of Phi over pieces: upper bounds and estimates, see ``ScaledLaw.means``.

        Where nothing may yield Phi is a quadratic.  Elsewhere the bound is the mean of its values
        at the coefficients; for whole cells there is none.
        """
        k = pulled.shape[1]
        p_last = pieces_last(pulled)
        w_last = pieces_last(w)
        elastic = self.elastic(p_last, w_last)
        exact = mean_squares(p_last + w_last) * self.two_mu / (4 * self.factor)
        found = np.where(elastic, exact, [[np.inf], [0.0]])
        if k in NODES or elastic.all():
            return found
        other = np.flatnonzero(~elastic)
        law, pulled, w = self.of_points(other), pulled[other], w[other]
        bound = law.potential(pulled, w).mean(axis=1)
        centres = (values.mean(axis=1, keepdims=True) for values in (pulled, w))
        least = law.potential(*centres)[:, 0]
        finite = np.isfinite(least)
        estimate = np.full(len(least), np.inf)
        least, above = least[finite], bound[finite]
        estimate[finite] = least + INSIDE[k] * (above - least)
        found[:, other] = bound, estimate
        return found


@dataclass(frozen=True, eq=False)
class NonlinearLaw(SearchedLaw):
    """``ScaledLaw`` for a nonlinear hardening law; ``two_mu`` and ``hardening`` are arrays (n,)."""

    resistance: Resistance
    two_mu: np.ndarray
    hardening: np.ndarray
    factor: float

    def of_points(self, chosen: slice | np.ndarray) -> NonlinearLaw:
        """That at some of the points."""
        parts = (v[chosen] for v in (self.two_mu, self.hardening))
        return NonlinearLaw(self.resistance.of(chosen), *parts, self.factor)

    def elastic(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Where nothing may yield, see ``SearchedLaw.elastic``."""
        y = pulled + w
        reached = self.factor / self.two_mu * self.resistance.beta
        inside = largest_of(products(y, y)) <= (2 * reached) ** 2
        # beyond the ball N falls with rho for every direction
        p_square = largest_of(products(pulled, pulled))
        w_square = largest_of(products(w, w))
        return inside & (np.maximum(p_square, w_square) <= reached**2)

    def potential(self, pulled: np.ndarray, w: np.ndarray) -> np.ndarray:
        """No less than Phi for p and w at points of parts, see ``ScaledLaw.potential``."""
        count, k = pulled.shape[:2]
        found = np.empty((count, k))
        for part in portions(count, 10_000 // k):
            p = pulled[part]
            products = [dots(p, p), dots(p, w[part]), dots(w[part], w[part])]
            products = [np.broadcast_to(v, p.shape[:2]).ravel() for v in products]
            law = self.of_points(part).repeated(k)
            found[part] = law.of_products(*products).reshape(-1, k)
        return found

    def of_products(
        self, p_square: np.ndarray, both: np.ndarray, w_square: np.ndarray
    ) -> np.ndarray:
        """The same for |p|^2, p : w and |w|^2, (n,)."""
        beta = np.broadcast_to(self.resistance.beta, p_square.shape)
        c = self.factor / self.two_mu
        y = np.sqrt(np.maximum(p_square + 2 * both + w_square, 0.0))
        inside = y <= 2 * c * beta
        best = np.where(inside, y**2 / (4 * c), beta * (y - c * beta))
        there = np.flatnonzero(np.maximum(p_square, w_square) > (c * beta) ** 2)
        if len(there):
            products = (v[there] for v in (p_square, both, w_square))
            search = CurveSearch(self.of_points(there), *products)
            best[there] = search.largest(best[there])
        return best


@dataclass(frozen=True, eq=False)
class Nodes:
    """Ascending plastic strains g at each point, and rho, r and N there, (n, nodes) each."""

    g: np.ndarray
    rho: np.ndarray
    r: np.ndarray
    value: np.ndarray

    def of(self, chosen: np.ndarray) -> Nodes:
        """Those at some of the points."""
        return Nodes(*(value[chosen] for value in vars(self).values()))

    def added(self, other: Nodes) -> Nodes:
        """These and other ones."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        both = [np.column_stack(pair) for pair in pairs]
        order = np.argsort(both[0], axis=1, kind="stable")
        return Nodes(*(np.take_along_axis(v, order, axis=1) for v in both))


class CurveSearch:
    """The largest N(g) over g >= 0 from above, for |p|^2, p : w and |w|^2 at points (n,)."""

    def __init__(
        self,
        law: NonlinearLaw,
        p_square: np.ndarray,
        both: np.ndarray,
        w_square: np.ndarray,
    ) -> None:
        self.law = law
        self.c = law.factor / law.two_mu
        self.p_square = p_square
        self.both = both
        self.w_square = w_square
        self.p = np.sqrt(p_square)
        self.w = np.sqrt(w_square)

    def of(self, chosen: np.ndarray) -> CurveSearch:
        """The search at some of the points."""
        products = (v[chosen] for v in (self.p_square, self.both, self.w_square))
        return CurveSearch(self.law.of_points(chosen), *products)

    def largest(self, known: np.ndarray) -> np.ndarray:
        """No less than the largest of all N(g) and of ``known`` values, (n,)."""
        law = self.law
        M = law.two_mu + law.hardening
        last = law.resistance.gained_at(self.p / self.c, law.hardening)
        last = np.maximum(last, law.resistance.gained_at(self.w / self.c, M))
        result = np.full(len(last), np.inf)
        left = np.flatnonzero(np.isfinite(last))
        search = self.of(left)
        last = BEYOND * last[left] + TINY
        g = np.stack([np.zeros(len(last)), last / 2, last], axis=1)
        nodes = Nodes(g, *search._at(g))
        known = known[left]
        for _ in range(ROUNDS):
            bounds = search.bounds(nodes)
            best = np.maximum(nodes.value.max(axis=1), known)
            most = np.maximum(bounds.max(axis=1), best)
            result[left] = most
            allowed = CLOSE * np.maximum(best - search.both / search.c, 0.0)
            open_ = np.flatnonzero(most - best > allowed + ROUNDING * np.abs(best))
            if not len(open_):
                break
            left = left[open_]
            known = known[open_]
            search = search.of(open_)
            worst = bounds[open_].argmax(axis=1)
            nodes = search.halved(nodes.of(open_), worst)
        return result

    def bounds(self, nodes: Nodes) -> np.ndarray:
        """Bounds of N between neighbouring nodes and beyond the last one, (n, nodes)."""
        beyond = self._after(nodes.rho[:, -1], nodes.r[:, -1])
        return np.column_stack([self._between(nodes), beyond])

    def halved(self, nodes: Nodes, worst: np.ndarray) -> Nodes:
        """The nodes and another one in the worst interval, (n,); the last one is doubled."""
        rows = np.arange(len(worst))
        following = np.minimum(worst + 1, nodes.g.shape[1] - 1)
        here = nodes.g[rows, worst]
        new = (here + nodes.g[rows, following]) / 2
        new = np.where(worst == following, 2 * here, new)[:, None]
        return nodes.added(Nodes(new, *self._at(new)))

    def _at(self, g: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """rho, r and N at plastic strains g, (n, k) each."""
        k = g.shape[1]
        every = self.law.repeated(k)
        beta = every.resistance.bound(g.ravel()).reshape(-1, k)
        r = beta + self.law.hardening[:, None] * g
        rho = r + self.law.two_mu[:, None] * g
        square = rho**2 * self.p_square[:, None]
        square = square + 2 * rho * r * self.both[:, None]
        square = square + r**2 * self.w_square[:, None]
        size = np.sqrt(np.maximum(square, 0.0))
        return rho, r, size - self.c[:, None] * rho * r

    def _between(self, nodes: Nodes) -> np.ndarray:
        """Bounds of N between neighbouring nodes, (n, nodes - 1)."""
        wider = np.diff(nodes.rho, axis=1)
        higher = np.diff(nodes.r, axis=1)
        first = nodes.value[:, :-1]
        second = nodes.value[:, 1:]

        # the largest of a parabola over the chord
        bend = self.c[:, None] * wider * higher
        apart = np.abs(second - first)
        curved = bend > apart
        top = (first + second) / 2 + bend / 4
        top = top + apart**2 / (4 * np.where(curved, bend, 1.0))
        chord = np.where(curved, top, np.maximum(first, second))
        off = wider * self._slopes_apart(nodes.g) / 4
        return chord + off * self._steepest(nodes.rho, nodes.r)

    def _slopes_apart(self, g: np.ndarray) -> np.ndarray:
        """What dr/drho can differ by between neighbouring nodes."""
        law = self.law
        count = g.shape[1] - 1
        every = law.repeated(count)
        low, high = every.resistance.slopes(g[:, :-1].ravel(), g[:, 1:].ravel())
        M = every.two_mu + every.hardening
        flattest = (low + every.hardening) / (low + M)
        finite = np.isfinite(high)
        high = np.where(finite, high, 0.0)
        steepest = np.where(finite, (high + every.hardening) / (high + M), 1.0)
        return (steepest - flattest).reshape(-1, count)

    def _steepest(self, rho: np.ndarray, r: np.ndarray) -> np.ndarray:
        """No less than |n : w - c rho| for directions n of rho p + r w between nodes."""
        c, p, w = (size[:, None] for size in (self.c, self.p, self.w))
        both = self.both[:, None]
        w_square = self.w_square[:, None]
        first_rho = rho[:, :-1]
        last_rho = rho[:, 1:]

        # the least w : (rho p + r w), and the least n : w with it
        along = np.where(both > 0, first_rho, last_rho) * both
        along = along + r[:, :-1] * w_square
        longest = last_rho * p + r[:, 1:] * w
        least = np.where(along > 0, along / np.maximum(longest, TINY), -w)

        up = w - c * first_rho
        down = c * last_rho - least
        return np.maximum(np.maximum(up, down), 0.0)

    def _after(self, rho: np.ndarray, r: np.ndarray) -> np.ndarray:
        """The bound of N beyond the last node, (n,)."""
        return rho * self.p + r * self.w - self.c * rho * r
