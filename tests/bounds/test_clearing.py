"""A displacement is moved clear of the obstacle on all facets that meet at a node."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc.bounds.contact import ContactFacets
from ngepc.discretisation.supports import Supports

NODES = np.array([0, 0, 1, 0, 2, 2])
EXCESS = np.array([0.3, 1.0, -0.2, 0.7, 0.5, 0.1])


def facets(normal, nodes, free=None, opposite=()):
    """What ``_lower`` needs of contact facets with these normals; the last face ``opposite``."""
    free = np.ones((3, 3), dtype=bool) if free is None else free
    opposite = np.array(opposite, dtype=int).reshape(-1, 1)
    supports = Supports.__new__(Supports)
    supports.free = free
    return SimpleNamespace(
        discrete=SimpleNamespace(supports=supports),
        normal=normal,
        nodes=nodes[:, None],
        opposite=opposite,
        paired=slice(len(nodes) - len(opposite), None),
    )


def lowered(normal, order, free=None):
    """A displacement after one pass over facets in some order, and whether it is stuck."""
    u = np.zeros((3, 3))
    contact = facets(normal[order], NODES[order], free)
    stuck = ContactFacets.shift(contact, u, 0, -np.maximum(EXCESS[order], 0.0), 1.0)
    return u, stuck


@pytest.fixture
def normals():
    """Unit vectors that differ from facet to facet."""
    n = np.array([0.0, 0.0, 1.0]) + 0.3 * np.random.default_rng(1).normal(size=(6, 3))
    return n / np.linalg.norm(n, axis=1)[:, None]


def test_the_facet_with_the_largest_excess_decides_in_any_order(normals):
    first, _ = lowered(normals, np.arange(6))
    assert first[0] == pytest.approx(-1.0 * normals[1])
    assert first[2] == pytest.approx(-0.5 * normals[4])
    assert (first[1] == 0).all()
    for seed in range(20):
        order = np.random.default_rng(seed).permutation(6)
        assert (lowered(normals, order)[0] == first).all()


def test_on_a_flat_boundary_one_pass_keeps_the_gaps_of_all_facets():
    normal = np.tile([0.0, 0.0, 1.0], (6, 1))
    u, stuck = lowered(normal, np.arange(6))
    left = EXCESS + u[NODES, 2]
    assert not stuck
    assert left.max() <= 1e-15


def test_supports_that_hold_a_node_are_told():
    normal = np.tile([0.0, 0.0, 1.0], (6, 1))
    free = np.ones((3, 3), dtype=bool)
    free[0, 2] = False
    assert lowered(normal, np.arange(6), free)[1]


@pytest.mark.parametrize("held", [None, 0, 2])
def test_two_bodies_share_the_way(held):
    """Both nodes of a pair move half of the way, or one all of it; an obstacle does not move."""
    normal = np.tile([0.0, 0.0, 1.0], (2, 1))
    free = np.ones((3, 3), dtype=bool)
    if held is not None:
        free[held, 2] = False
    u = np.zeros((3, 3))
    contact = facets(normal, np.array([1, 0]), free, opposite=[2])
    assert not ContactFacets.shift(
        contact, u, 0, -np.maximum(np.array([0.4, 0.6]), 0.0), 1.0
    )
    moved = {None: (-0.3, 0.3), 0: (0.0, 0.6), 2: (-0.6, 0.0)}[held]
    assert u[:, 2] == pytest.approx([moved[0], -0.4, moved[1]])
    assert (u[:, :2] == 0).all()
