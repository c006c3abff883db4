"""Rules on parts of simplices, nodes of facets, and values at points: beside closed forms."""

import math

import numpy as np
import pytest
from ngsolve import BND, CF, H1, VOL, ElementId, GridFunction, IfPos, VectorH1, x, y

from ngepc import Material, Problem
from ngepc.discretisation.lattices import (
    GROUPED,
    degree_two,
    groups_of_parts,
    lattice_parts,
    parts_of_simplex,
    with_centres,
)
from ngepc.discretisation.overlap import Surface, pairs_of
from ngepc.discretisation.prolongation import values_at_points
from ngepc.discretisation.sampling import Scan, differences_on, smooth_groups, variation
from ngepc.geometries import block

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=1e2
)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_equal_weights_of_degree_two(dim):
    """Means of products of barycentric coordinates: (1 + delta) / (dim + 1) (dim + 2)."""
    points = degree_two(dim)
    exact = (1 + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    np.testing.assert_allclose(points.T @ points / len(points), exact, rtol=1e-13)
    np.testing.assert_allclose(points.sum(axis=1), 1.0, rtol=1e-14)
    assert (points > 0).all()


@pytest.mark.parametrize(("dim", "count"), [(1, 5), (2, 4), (3, 3)])
def test_parts_of_a_simplex_have_equal_volumes(dim, count):
    parts = parts_of_simplex(dim, count)
    assert len(parts) == count**dim
    np.testing.assert_allclose(np.abs(np.linalg.det(parts)), count**-dim, rtol=1e-12)
    np.testing.assert_allclose(parts.mean(axis=(0, 1)), 1 / (dim + 1), rtol=1e-12)


@pytest.mark.parametrize("kind", [VOL, BND])
@pytest.mark.parametrize("solid", [False, True])
def test_weights_of_a_step_are_the_size_of_the_element(kind, solid):
    """And what is unresolved grows with the square of the step."""
    size = (2.0, 1.0, 0.5) if solid else (2.0, 1.0)
    mesh = block.structured_mesh(*(1 for _ in size), size=size, simplices=True)
    step = IfPos(x + 0.3 * y - 0.55, 1.0, 0.0)
    scan = Scan(mesh, step, kind)
    assert len(scan.hidden) > 0
    for number in scan.hidden[:1].tolist():
        element = mesh[ElementId(kind, number)]
        corners = np.array([mesh[v].point for v in element.vertices])
        sides = corners[1:] - corners[0]
        gram = np.linalg.det(sides @ sides.T)
        exact = np.sqrt(gram) / math.factorial(len(sides))
        rule = scan.rule(number)
        assert rule.weights.sum() == pytest.approx(exact, rel=1e-12)
        assert rule.weights.min() > 0
        triple = Scan(mesh, 3 * step, kind).rule(number)
        np.testing.assert_allclose(triple.unresolved, 9 * rule.unresolved, rtol=1e-12)
        assert 0 < rule.unresolved.max() <= exact


def test_points_outside_of_a_mesh_take_the_value_of_a_nearest_vertex():
    mesh = block.structured_mesh(4, 4, size=(1.0, 1.0), simplices=True)
    function = GridFunction(VectorH1(mesh, order=1))
    function.Set(CF((1 + x, x - 2 * y)))
    points = np.array([[0.3, 0.6], [1.2, 0.52], [0.1, 0.9], [-0.4, -0.1]])
    found = values_at_points(function, points)
    near = np.array([[0.3, 0.6], [1.0, 0.5], [0.1, 0.9], [0.0, 0.0]])
    exact = np.stack([1 + near[:, 0], near[:, 0] - 2 * near[:, 1]], axis=1)
    np.testing.assert_allclose(found, exact, atol=1e-12)


@pytest.mark.parametrize("solid", [False, True])
def test_nodes_of_facets_belong_to_their_corners_and_edges(solid):
    """The function of a node of order two is largest, of all these, at its own corner or edge."""
    counts = (1, 2, 1) if solid else (3, 2)
    mesh = block.structured_mesh(*counts, simplices=True)
    problem = Problem(mesh, METAL, order=2)
    surface = Surface(problem, ("contact", "right"))
    space = H1(mesh, order=2)
    nodes = surface.nodes(space)
    N = mesh.dim
    assert nodes.shape == (len(surface.corners), len(pairs_of(N, 2)))
    function = GridFunction(space)
    for corners, own in zip(surface.corners, nodes, strict=True):
        places = corners[pairs_of(N, 2)].mean(axis=1)
        values = []
        for node in own.tolist():
            function.vec[:] = 0.0
            function.vec[node] = 1.0
            values.append([abs(function(mesh(*place))) for place in places])
        np.testing.assert_array_equal(np.argmax(values, axis=1), np.arange(len(own)))


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("factor", [1e-9, 1.0])
def test_a_group_is_smooth_unless_a_kink_passes_through_it(dim, factor):
    """|s - 0.37|, s the first share: two lines, and groups of parts between them."""
    corners = lattice_parts(dim, 6 * GROUPED[dim])
    share = with_centres(corners)[..., :1]
    values = factor * np.abs(share - 0.37)
    groups = groups_of_parts(dim, 6 * GROUPED[dim])[..., 0]
    crossed = (groups.min(axis=1) < 0.37) & (groups.max(axis=1) > 0.37)
    assert crossed.any()
    assert (smooth_groups(values, dim) == ~crossed).all()
    assert (differences_on(values) == np.ptp(values, axis=1)).all()
    assert variation(values) == np.ptp(values)
