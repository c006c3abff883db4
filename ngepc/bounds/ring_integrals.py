"""Integrals of squares over the radius, from above.

On a triangle let q be a quadratic form of polynomials Y, and Y = 0 where r = 0.  With r between
c (1 - tau) and c (1 + tau), t = r/c - 1 and an even m

    1/r  <=  1/c [1 - t + t^2 - ... - t^(m-1) + t^m/(1 - tau)],

as 1/(1 + t) is the sum of the powers with t^m/(1 + t) in place of the last term.  So q/r is at most
a polynomial, which a rule integrates exactly.  Triangles are cut until tau <= 1/3.

- With an edge on the axis Y is r times a polynomial, and q/r is a polynomial itself.
- With one vertex on the axis, at the share t of the way from there to a point of the opposite edge,
  r is t rho with the radius rho of that point, and Y is t times a polynomial in t.  So q/r times
  the Jacobian t has no quotient but 1/rho, and the opposite edge is cut.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve import ET, IntegrationRule

from ngepc.bounds.polynomials import SPLIT, triangle_rule

WIDE = 1 / 3
"""Largest tau of a part."""
REMAINDER = 1e-11
"""Relative size of the last term that is good enough."""
MOST_TERMS = 30
CUTS = 60
"""How often a triangle is cut at most; what is left is integrated with a larger tau."""
ON_AXIS = 1e-12
"""Radii below this fraction of the largest one are zero."""

Base = Callable[[np.ndarray], np.ndarray]
"""The polynomials whose coefficients are given, at points (..., 3)."""
Form = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""The form q at values (n, q, c) of some triangles (n,)."""


@dataclass(frozen=True, eq=False)
class OverRadius:
    """The integrals of q(Y)/r over triangles: ``bound``, and its three cases."""

    base: Base
    form: Form
    degree: int  # of the polynomials Y
    coefficients: np.ndarray  # of Y, shape (triangles, n, c)
    radii: np.ndarray  # of the corners, shape (triangles, 3)
    area: np.ndarray  # shape (triangles,)

    def bound(self) -> np.ndarray:
        """Upper bounds of the integrals, (triangles,)."""
        touching = (self.radii <= ON_AXIS * self.radii.max()).sum(axis=1)
        result = np.zeros(len(self.area))
        for count, integral in enumerate((self.away, self.at_vertex, self.at_edge)):
            cells = np.flatnonzero(touching == count)
            if len(cells):
                result += integral(cells)
        return result

    def _forms(self, places: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """The form at points (n, q, 3) of some triangles, (n, q)."""
        values = np.matmul(self.base(places), self.coefficients[cell])
        return self.form(values, cell)

    def _summed(self, cell: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.bincount(cell, values, minlength=len(self.area))

    def at_edge(self, cells: np.ndarray) -> np.ndarray:
        """The integrals over triangles with an edge on the axis."""
        shares, weights = triangle_rule(2 * self.degree)
        places = np.broadcast_to(shares, (len(cells), *shares.shape))
        r = self.radii[cells] @ shares.T
        found = (self._forms(places, cells) / r) @ weights
        return self._summed(cells, self.area[cells] * found)

    def away(self, cells: np.ndarray) -> np.ndarray:
        """The integrals over triangles that do not touch the axis."""
        parts = np.broadcast_to(np.eye(3), (len(cells), 3, 3))
        area = self.area[cells]
        result = np.zeros(len(self.area))
        for cut in range(CUTS + 1):
            r = np.einsum("pij,pj->pi", parts, self.radii[cells])
            done = (relative_spread(r) <= WIDE) | (cut == CUTS)
            for m, chosen in by_terms(r, done):
                shares, weights = triangle_rule(2 * self.degree + m)
                places = np.matmul(shares, parts[chosen])
                inverse = inverse_from_above(r[chosen] @ shares.T, r[chosen], m)
                found = (self._forms(places, cells[chosen]) * inverse) @ weights
                result += self._summed(cells[chosen], area[chosen] * found)
            if done.all():
                break
            parts = np.matmul(SPLIT[3], parts[~done][:, None]).reshape(-1, 3, 3)
            area = np.repeat(area[~done] / 4, 4)
            cells = np.repeat(cells[~done], 4)
        return result

    def at_vertex(self, cells: np.ndarray) -> np.ndarray:
        """The integrals over triangles with one vertex on the axis."""
        apex = self.radii[cells].argmin(axis=1)
        top = np.eye(3)[apex]
        edge = np.eye(3)[np.stack([(apex + 1) % 3, (apex + 2) % 3], axis=1)]
        area = self.area[cells]
        result = np.zeros(len(self.area))
        for cut in range(CUTS + 1):
            rho = np.einsum("pij,pj->pi", edge, self.radii[cells])
            done = (relative_spread(rho) <= WIDE) | (cut == CUTS)
            for m, chosen in by_terms(rho, done):
                found = self._in_rays(cells[chosen], edge[chosen], top[chosen], m)
                result += self._summed(cells[chosen], 2 * area[chosen] * found)
            if done.all():
                break
            start, end = edge[~done].swapaxes(0, 1)
            middle = (start + end) / 2
            halves = [
                np.stack(ends, axis=1) for ends in ((start, middle), (middle, end))
            ]
            edge = np.concatenate(halves)
            cells = np.tile(cells[~done], 2)
            top = np.tile(top[~done], (2, 1))
            area = np.tile(area[~done] / 2, 2)
        return result

    def _in_rays(
        self, cells: np.ndarray, edge: np.ndarray, top: np.ndarray, m: int
    ) -> np.ndarray:
        """The mean of form/rho over t and the place on the opposite edge."""
        s, along = segment_rule(2 * self.degree + m)
        t, across = segment_rule(2 * self.degree)
        on_edge = np.stack([1 - s, s], axis=1) @ edge
        places = t[:, None] * on_edge[:, :, None]
        places = places + (1 - t)[:, None] * top[:, None, None]
        ends = np.einsum("pij,pj->pi", edge, self.radii[cells])
        rho = ends @ np.stack([1 - s, s])
        inverse = inverse_from_above(rho, ends, m)
        forms = self._forms(places.reshape(len(cells), -1, 3), cells)
        forms = forms.reshape(len(cells), len(s), len(t)) @ across
        return (forms * inverse) @ along


def segment_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points in [0, 1] and weights of Gauss's rule."""
    rule = IntegrationRule(ET.SEGM, degree)
    return np.array(rule.points)[:, 0], np.array(rule.weights)


def relative_spread(radii: np.ndarray) -> np.ndarray:
    """tau for radii (n, corners), (n,)."""
    least = radii.min(axis=1)
    most = radii.max(axis=1)
    return (most - least) / (most + least)


def by_terms(radii: np.ndarray, chosen: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """The least even m with a small remainder, and the chosen parts that it belongs to."""
    tau = np.minimum(relative_spread(radii), 1 - 1e-15)
    terms = np.full(len(tau), MOST_TERMS)
    for m in range(MOST_TERMS, 0, -2):
        terms[tau**m / (1 - tau) <= REMAINDER] = m
    there = np.flatnonzero(chosen)
    return [(m, there[terms[there] == m]) for m in np.unique(terms[there]).tolist()]


def inverse_from_above(r: np.ndarray, ends: np.ndarray, m: int) -> np.ndarray:
    """A polynomial of degree m above 1/r, for r (n, q) within the range of ``ends`` (n, .)."""
    c = ((ends.min(axis=1) + ends.max(axis=1)) / 2)[:, None]
    t = 1 - r / c
    result = 1 / np.broadcast_to(1 - relative_spread(ends)[:, None], r.shape)
    for _ in range(m):
        result = 1 + t * result
    return result / c
