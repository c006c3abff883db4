"""Nodes and Bernstein polynomials on a facet: a segment, a triangle or a quadrilateral.

A polynomial of degree two is the sum of c_i B_i with B_i >= 0 and a sum of all B_i of 1.  Its
values lie between the least and the largest of its coefficients c_i, and the integrals of the B_i
are positive.  The coefficient of a corner is the value there, that of an edge with the ends a, b is

    c = 2 v(middle) - (v(a) + v(b)) / 2,

and on quadrilaterals the polynomials are products of those along both directions.  For degree one
the coefficients are the values at the corners and B_i are the hat functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from ngsolve import ET, IntegrationRule
from ngsolve.fem import ElementTopology, FiniteElement

EDGES = {
    ET.SEGM: [(0, 1)],
    ET.TRIG: [(0, 1), (1, 2), (2, 0)],
    ET.QUAD: [(0, 1), (1, 2), (2, 3), (3, 0)],
}
"""Corners at the ends of the edges of a facet."""

MIDDLE = -0.125
"""Value of NGSolve's function of an edge at its middle, order two."""

LATTICE = 12
"""Parts of an edge between the points where the overlap with an obstacle is evaluated."""


@dataclass(frozen=True, eq=False)
class FacetNodes:
    """The k nodes of a facet, the same for all facets of a shape.

    They are its corners, with degree two the middles of its edges and, on a quadrilateral, its
    centre as well.
    """

    shape: ET
    degree: int
    places: np.ndarray  # in the reference facet, shape (k, dimension)

    def basis(self, points: np.ndarray) -> np.ndarray:
        """The Bernstein polynomials at points (n, dimension), shape (n, k)."""
        if self.degree == 1:
            return hats(self.shape, points)
        if self.shape == ET.QUAD:
            along, across = (_on_interval(x, self.places) for x in points.T)
            return along[:, :, 0] * across[:, :, 1]
        corner = hats(self.shape, points)
        ends = self.corners[:, [0, 3]]
        twice = np.where(ends[:, 0] == ends[:, 1], 1.0, 2.0)
        return twice * corner[:, ends[:, 0]] * corner[:, ends[:, 1]]

    @cached_property
    def coefficients(self) -> np.ndarray:
        """Bernstein coefficients of the values at the nodes, shape (k, k)."""
        found = np.linalg.inv(self.basis(self.places))
        return np.where(np.abs(found) < 1e-12, 0.0, found)

    @cached_property
    def corners(self) -> np.ndarray:
        """Four corners that each node is the mean of, with repetitions, shape (k, 4)."""
        near = [np.flatnonzero(row) for row in hats(self.shape, self.places)]
        return np.array([np.repeat(found, 4 // len(found)) for found in near])

    @property
    def rule(self) -> IntegrationRule:
        """The nodes as points of a rule without weights."""
        return without_weights(self.places)

    def numbers(self, element: FiniteElement) -> np.ndarray:
        """Functions of an element of NGSolve that belong to the nodes, shape (k,)."""
        values = np.abs([np.array(element.CalcShape(*p)) for p in self.places.tolist()])
        count = len(hats(self.shape, self.places)[0])
        result = values[:, :count].argmax(axis=1)
        if self.degree == 1:
            return result
        edges = slice(count, count + len(EDGES[self.shape]))
        result[edges] = count + values[edges, edges].argmax(axis=1)
        result[edges.stop :] = np.arange(edges.stop, len(result))  # the centre
        return result

    @cached_property
    def check_points(self) -> tuple[IntegrationRule, np.ndarray]:
        """Points at which the interpolating polynomial is compared with its data.

        They are at a quarter of the way from one node to another, within what makes a coefficient;
        the second part is the node that each is for, shape (n,).
        """
        points = []
        owners = []
        for node, row in enumerate(self.coefficients):
            others = np.setdiff1d(np.flatnonzero(row), [node])
            for other in others.tolist():
                points.append(0.5 * (self.places[node] + self.places[other]))
                owners.append(node)
        return without_weights(np.array(points)), np.array(owners, dtype=int)


@cache
def facet_nodes(shape: ET, degree: int) -> FacetNodes:
    """The nodes of a facet for polynomials of degree one or two."""
    dimension = 1 if shape == ET.SEGM else 2
    corner = np.array(ElementTopology(shape).vertices)[:, :dimension]
    places = [corner]
    if degree == 2:
        places.append(corner[np.array(EDGES[shape])].mean(axis=1))
    if degree == 2 and shape == ET.QUAD:
        places.append(corner.mean(axis=0, keepdims=True))
    return FacetNodes(shape, degree, np.concatenate(places))


def hats(shape: ET, points: np.ndarray) -> np.ndarray:
    """The hat functions of the corners at points (n, dimension), shape (n, corners)."""
    x = points[:, 0]
    if shape == ET.SEGM:
        return np.column_stack([x, 1 - x])
    y = points[:, 1]
    if shape == ET.TRIG:
        return np.column_stack([x, y, 1 - x - y])
    return np.column_stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y])


def _on_interval(x: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The quadratic Bernstein polynomials of [0, 1] that belong to coordinates 0, 1/2 or 1.

    At points (n,) for the coordinates (k, 2) of nodes, shape (n, k, 2).
    """
    all_three = np.stack([(1 - x) ** 2, 2 * x * (1 - x), x**2], axis=1)
    return all_three[:, np.rint(2 * places).astype(int)]


def without_weights(places: np.ndarray) -> IntegrationRule:
    """Points (n, dimension) as an integration rule whose weights are zero."""
    return IntegrationRule([tuple(p) for p in places.tolist()], [0.0] * len(places))


@cache
def facet_lattice(shape: ET) -> IntegrationRule:
    """Points of a facet, its boundary included, ``LATTICE`` parts along each edge."""
    steps = range(LATTICE + 1)
    if shape == ET.SEGM:
        places = [(i,) for i in steps]
    else:
        most = LATTICE if shape == ET.TRIG else 2 * LATTICE
        places = [(i, j) for i in steps for j in steps if i + j <= most]
    return without_weights(np.array(places) / LATTICE)
