"""Bernstein polynomials on facets: a partition of unity with positive integrals, and bounds."""

import numpy as np
import pytest
from ngsolve import ET, IntegrationRule

from ngepc.discretisation.facets import facet_lattice, facet_nodes, hats

SHAPES = [ET.SEGM, ET.TRIG, ET.QUAD]
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.name)
both_degrees = pytest.mark.parametrize("degree", [1, 2])


def inside(shape, order=6):
    """Points of a rule in the reference facet, and their weights."""
    rule = IntegrationRule(shape, order)
    dimension = 1 if shape is ET.SEGM else 2
    return np.array([p[:dimension] for p in rule.points]), np.array(rule.weights)


def polynomial(shape, degree, points, draw):
    """A random polynomial of the space: products of two affine or bilinear functions."""
    corners = hats(shape, points)
    number = np.random.default_rng(draw)
    if shape is ET.QUAD and degree == 2:
        x, y = points.T
        powers = [x**i * y**j for i in range(3) for j in range(3)]
        return number.normal(size=9) @ powers
    factors = number.normal(size=(degree, corners.shape[1])) @ corners.T
    return factors.prod(axis=0)


@every_shape
@both_degrees
def test_polynomials_are_reproduced_and_lie_between_their_coefficients(shape, degree):
    nodes = facet_nodes(shape, degree)
    points, _ = inside(shape)
    basis = nodes.basis(points)
    assert basis.sum(axis=1) == pytest.approx(np.ones(len(points)))
    assert basis.min() >= -1e-15
    for draw in range(5):
        at_nodes = polynomial(shape, degree, nodes.places, draw)
        values = polynomial(shape, degree, points, draw)
        coefficients = nodes.coefficients @ at_nodes
        assert basis @ coefficients == pytest.approx(values, abs=1e-13)
        assert coefficients.min() - 1e-13 <= values.min()
        assert values.max() <= coefficients.max() + 1e-13


@every_shape
def test_integrals_are_equal_parts_of_the_area(shape):
    """L/3 on a segment, A/6 on a triangle, A/9 on a quadrilateral."""
    nodes = facet_nodes(shape, 2)
    points, weights = inside(shape)
    parts = weights @ nodes.basis(points)
    assert parts == pytest.approx(np.full(len(parts), weights.sum() / len(parts)))


@every_shape
@both_degrees
def test_a_node_is_the_mean_of_its_corners(shape, degree):
    nodes = facet_nodes(shape, degree)
    corner = nodes.places[: hats(shape, nodes.places).shape[1]]
    assert corner[nodes.corners].mean(axis=1) == pytest.approx(nodes.places)


@every_shape
def test_the_lattice_has_the_corners(shape):
    points = {p[: 1 if shape is ET.SEGM else 2] for p in facet_lattice(shape).points}
    assert {tuple(p) for p in facet_nodes(shape, 1).places.tolist()} <= points
