"""Polynomials between which a gap that is no polynomial lies, on boundary facets.

Let q be the quadratic function with the values of psi at the vertices and at the middles of the
edges of a facet.  The facet is cut into parts.  On each of them Taylor's formula (``linalg.jets``)
limits d = psi - q by its values at the corners and its second derivatives, which are small where
psi is smooth, since those of q are subtracted.  With the least limit on all parts and the integral
of the largest ones

    q + min d <= psi,   int psi l_i <= int q l_i + sum over the parts of max d int l_i.

Where nothing limits the second derivatives, as at a jump, psi itself lies between constants on
each part, and q is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from ngepc.bounds.coverage import BUBBLE, FACET_RULES, lowest_of_quadratics
from ngepc.bounds.simplices import EDGES
from ngepc.discretisation.formulas import formula_on
from ngepc.discretisation.lattices import parts_of_simplex
from ngepc.discretisation.operations import FacetCorners, Operation
from ngepc.linalg.intervals import Intervals
from ngepc.linalg.jets import Jet

SMOOTH_PARTS = {2: 8, 3: 4}
"""Parts of an edge of a facet, by dimension; even numbers, as corners lie in the middle."""
PARTS = {2: 32, 3: 8}
"""The same where the derivatives of a gap have no limit."""
SLOPES = (1.0, 0.25, 0.0625, 0.015625, 0.0)
"""Parts of the differences of a gap at the vertices that affine functions below it can have."""
ROUNDING = 1e-14
"""Part of the size of their terms by which polynomials are moved apart, for rounding errors."""


@dataclass(frozen=True, eq=False)
class GapEnclosure:
    """A polynomial below a gap, and means of what is left, on facets.

    The polynomial has the values ``below`` (facets, N) at the vertices and the coefficients
    ``bent`` (facets, 0 or 3) of NGSolve's edge functions.  ``excess`` (facets, N) are at least the
    means of the gap less the polynomial, times the hat functions.  Where no number is known, they
    are nan or infinite.
    """

    below: np.ndarray
    bent: np.ndarray
    excess: np.ndarray

    @classmethod
    def zero(cls, count: int, N: int, quadratic: bool) -> GapEnclosure:
        """Those of a gap that is zero."""
        zeros = np.zeros((count, N))
        return cls(zeros, np.zeros((count, 3 if quadratic else 0)), zeros)

    @property
    def finite(self) -> np.ndarray:
        """On which facets the gap is enclosed."""
        parts = (self.below, self.bent, self.excess)
        return np.isfinite(np.column_stack(parts)).all(axis=1)

    def values(self) -> np.ndarray:
        """The polynomials at the points of the rule of facets, (facets, points)."""
        rule = FACET_RULES[self.below.shape[1]]
        return self.below @ rule.shares.T + rule.bent(self.bent)

    def rows(self, rows: np.ndarray) -> GapEnclosure:
        """Some of the facets."""
        return GapEnclosure(*(part[rows] for part in vars(self).values()))

    def with_rows(self, rows: np.ndarray, other: GapEnclosure) -> GapEnclosure:
        """The same with the rows of another one."""
        found = {name: part.copy() for name, part in vars(self).items()}
        for name, part in found.items():
            part[rows] = getattr(other, name)
        return GapEnclosure(**found)


def enclosed_gap(
    formula: Operation, facets: FacetCorners, quadratic: bool
) -> GapEnclosure:
    """Enclosures of a gap on facets; the polynomials are affine unless ``quadratic``."""
    N = facets.places.shape[1]
    cut = CutFacets.of(facets, SMOOTH_PARTS[N])
    jet = formula_on(formula, cut.facets)
    smooth = cut.by_facets(jet.is_smooth).all(axis=1)
    with np.errstate(invalid="ignore"):
        found = _smooth_gap(cut, jet, quadratic)
    rows = np.flatnonzero(~smooth)
    if not len(rows):
        return found
    finer = CutFacets.of(facets.chosen(rows), PARTS[N])
    on_parts = _rough_gap(finer, formula_on(formula, finer.facets), quadratic)
    return found.with_rows(rows, on_parts)


@dataclass(frozen=True, eq=False)
class CutFacets:
    """The parts of facets, one facet after the other, themselves as ``facets``.

    ``corners`` (parts, N, N) are barycentric.
    """

    facets: FacetCorners
    corners: np.ndarray

    @classmethod
    def of(cls, facets: FacetCorners, count: int) -> CutFacets:
        """Those with so many parts of an edge."""
        N = facets.places.shape[1]
        corners = parts_of_simplex(N - 1, count)
        given = facets.places
        places = np.einsum("pcv,fvk->fpck", corners, given.low)
        error = (ROUNDING * given.size + given.width).max(axis=1)
        owner = np.repeat(np.arange(len(facets)), len(corners))
        parts = Intervals.around(
            places.reshape(-1, *places.shape[2:]), error[owner][:, None]
        )
        return cls(FacetCorners(parts, lambda one: facets.values(one)[owner]), corners)

    def by_facets(self, values: np.ndarray) -> np.ndarray:
        """Values of the parts (facets, parts, ...)."""
        return values.reshape(-1, len(self.corners), *values.shape[1:])

    def quadratic(self, ends: np.ndarray, bends: np.ndarray) -> Jet:
        """Enclosures on the parts of quadratic functions on the facets.

        They have the values ``ends`` (facets, N) at the vertices and the coefficients ``bends``
        (facets, edges) of the products of the barycentric coordinates of the ends of the edges.
        """
        count = len(ends)
        shares = [
            Jet.affine(Intervals.exactly(np.tile(self.corners[:, :, v], (count, 1))))
            for v in range(ends.shape[1])
        ]
        terms = [self._multiple(ends[:, v], share) for v, share in enumerate(shares)]
        for number, (i, j) in enumerate(EDGES[len(shares)]):
            product = shares[i] * shares[j]
            terms.append(self._multiple(bends[:, number], product))
        return reduce(add, terms)

    def _multiple(self, numbers: np.ndarray, jet: Jet) -> Jet:
        """A function on the parts times numbers of the facets."""
        repeated = np.repeat(numbers, len(self.corners))
        return self.facets.constant(Intervals.exactly(repeated)) * jet

    @property
    def hats(self) -> np.ndarray:
        """Integrals of the hat functions over the parts, (parts, N), over the size of the facet."""
        return self.corners.mean(axis=1) / len(self.corners)

    def at(self, values: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Values (facets, parts, corners) at a corner with these barycentric coordinates."""
        distance = np.abs(self.corners - shares).max(axis=2)
        part, corner = np.unravel_index(distance.argmin(), distance.shape)
        return values[:, part, corner]


def _smooth_gap(cut: CutFacets, jet: Jet, quadratic: bool) -> GapEnclosure:
    """Enclosures by the quadratic function that interpolates, and what is left on the parts."""
    N = cut.corners.shape[1]
    ends, bends = _interpolant(cut, jet)
    left = (jet - cut.quadratic(ends, bends)).whole
    low = cut.by_facets(left.low)
    high = cut.by_facets(left.high)

    lowest = low.min(axis=1)
    if not quadratic:
        lowest = lowest + lowest_between(bends)
    lowest = lowest - ROUNDING * np.abs(ends).max(axis=1)
    below = ends + lowest[:, None]
    bent = bends / BUBBLE if quadratic else np.zeros((len(ends), 0))

    rule = FACET_RULES[N]
    more = -np.repeat(lowest[:, None], len(rule.shares), axis=1)
    if not quadratic:
        products = [rule.shares[:, i] * rule.shares[:, j] for i, j in EDGES[N]]
        more = more + bends @ np.stack(products, axis=1).T
    hats = rule.weights[:, None] * rule.shares
    excess = more @ hats + high @ cut.hats
    return GapEnclosure(below, bent, excess)


def _interpolant(cut: CutFacets, jet: Jet) -> tuple[np.ndarray, np.ndarray]:
    """The quadratic function with the gaps at vertices and middles of edges.

    Its values at the vertices (facets, N), and the coefficients (facets, edges) of the products of
    the barycentric coordinates of the ends of edges.
    """
    N = cut.corners.shape[1]
    middle = (jet.value.low + jet.value.high) / 2
    values = cut.by_facets(middle[:, 1:])
    vertices = np.eye(N)
    ends = np.stack([cut.at(values, vertex) for vertex in vertices], axis=1)
    bends = []
    for i, j in EDGES[N]:
        between = cut.at(values, (vertices[i] + vertices[j]) / 2)
        bends.append(4 * between - 2 * (ends[:, i] + ends[:, j]))
    return ends, np.stack(bends, axis=1)


def lowest_between(bends: np.ndarray) -> np.ndarray:
    """The least values on facets of quadratics that are zero at the vertices.

    ``bends`` (facets, edges) are the coefficients of the products of the barycentric coordinates of
    the ends of the edges.
    """
    lowest = np.minimum(bends.min(axis=1), 0.0) / 4
    if bends.shape[1] == 1:
        return lowest
    return np.minimum(lowest, lowest_of_quadratics(bends / 4))


def _rough_gap(cut: CutFacets, jet: Jet, quadratic: bool) -> GapEnclosure:
    """Enclosures by constants on the parts."""
    N = cut.corners.shape[1]
    low = cut.by_facets(jet.whole.low)
    high = cut.by_facets(jet.whole.high)
    with np.errstate(invalid="ignore"):
        # what a gap without jumps changes by on a facet
        change = PARTS[N] * np.median(high - low, axis=1)
        below = affine_below(cut.corners, low, change)
        means = (1 + np.eye(N)) / (N * (N + 1))
        return GapEnclosure(
            below,
            np.zeros((len(low), 3 if quadratic else 0)),
            high @ cut.hats - below @ means,
        )


def affine_below(
    corners: np.ndarray, low: np.ndarray, change: np.ndarray
) -> np.ndarray:
    """Vertex values (facets, N) of affine functions below constants on the parts of facets.

    ``corners`` (parts, N, N) are barycentric, ``low`` (facets, parts) the constants.  Affine
    functions with a part of the differences between the constants next to the vertices are moved
    below all constants, and the highest one is taken; heights over the least constant count up to
    ``change`` (facets,) at each vertex, since far above nothing touches.
    """
    at_vertices = low[:, corners.max(axis=1).argmax(axis=0)]
    least = low.min(axis=1, keepdims=True)
    size = np.abs(at_vertices).max(axis=1) + np.abs(low).max(axis=1)
    found = []
    for slope in SLOPES:
        with np.errstate(invalid="ignore"):
            start = least + slope * (at_vertices - least)
            highest = (corners @ start.T).max(axis=1).T
            moved = (low - highest).min(axis=1) - ROUNDING * size
        found.append(start + moved[:, None])
    heights = np.minimum(np.array(found) - least, change[:, None])
    best = heights.sum(axis=2).argmax(axis=0)
    return np.array(found)[best, np.arange(len(low))]
