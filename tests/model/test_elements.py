"""Shapes of elements: exact rules, facets, outer normals, and meshes that are no meshes."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from netgen.meshing import Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import BND, ET, GridFunction, Integrate, Mesh, VectorH1, x

from ngepc.geometries import block, ring
from ngepc.model.elements import (
    boundary_corners,
    corner_vertices,
    element_facets,
    elements_by_shape,
    elements_by_type,
    has_straight_simplices,
    outward_normal,
    plastic_order,
    plastic_points,
    plastic_rule,
    vertex_coordinates,
)
from ngepc.model.mesh_checks import check_mesh


def of_box(*powers):
    """The integral of a monomial over the unit square or cube."""
    return math.prod(1 / (p + 1) for p in powers)


def of_simplex(*powers):
    """The same over the reference triangle or tetrahedron."""
    factorials = math.prod(map(math.factorial, powers))
    return factorials / math.factorial(sum(powers) + len(powers))


SHAPES = {
    ET.TRIG: (2, of_simplex),
    ET.TET: (3, of_simplex),
    ET.QUAD: (2, of_box),
    ET.HEX: (3, of_box),
}


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_rules_of_plastic_strain(shape, degree):
    """As many points as polynomials, which they tell apart, inside, weights > 0, and exact."""
    N, integral = SHAPES[shape]
    rule = plastic_rule(shape, degree)
    points = np.array([p[:N] for p in rule.points])
    weights = np.array(rule.weights)
    powers = list(itertools.product(range(degree + 1), repeat=N))
    if shape in (ET.TRIG, ET.TET):
        powers = [p for p in powers if sum(p) <= degree]
        assert (points.sum(axis=1) < 1).all()
    table = np.array([[np.prod(q ** np.array(p)) for p in powers] for q in points])
    assert len(points) == len(powers)
    assert np.linalg.matrix_rank(table) == len(powers)
    assert (points > 0).all()
    assert (points < 1).all()
    assert (weights > 0).all()
    expected = [integral(*p) for p in powers]
    np.testing.assert_allclose(weights @ table, expected, rtol=1e-12)


MESHES = {
    "triangles": block.structured_mesh(2, 3, simplices=True),
    "rectangles": block.structured_mesh(2, 3),
    "tetrahedra": block.structured_mesh(2, 1, 2, simplices=True),
    "hexahedra": block.structured_mesh(2, 1, 2),
    "Netgen's triangles": block.mesh(0.6, size=(1.0, 1.0)),
}


@pytest.fixture(params=MESHES, ids=str)
def mesh(request):
    return MESHES[request.param]


def test_facets_are_inside_or_on_the_boundary(mesh):
    """Each inner facet twice, of two elements, each one of the boundary once."""
    keys, owners = element_facets(mesh)
    assert (np.diff(keys) >= 0).all()
    _, counts = np.unique(keys, return_counts=True)
    assert set(counts) == {1, 2}
    assert (counts == 1).sum() == mesh.GetNE(BND)
    assert len(counts) == mesh.nfacet
    assert sorted(set(owners)) == list(range(mesh.ne))


def test_vertices_of_elements_and_boundaries(mesh):
    found = np.zeros(mesh.ne, dtype=int)
    for numbers, vertices in elements_by_shape(mesh):
        for number, corners in zip(numbers, vertices, strict=True):
            expected = {v.nr for v in list(mesh.Elements())[number].vertices}
            assert set(corners.tolist()) == expected
            found[number] += 1
    assert (found == 1).all()
    at = vertex_coordinates(mesh)
    assert at.shape == (mesh.nv, mesh.dim)
    assert (at[corner_vertices(mesh, ["right"])][:, 0] == 1).all()
    count = sum(element.mat in ("left", "right") for element in mesh.Elements(BND))
    assert len(boundary_corners(mesh, ["left", "right"])) == count


def test_outer_normals_enclose_the_body(mesh):
    """Gauss: the normals cancel, and int x . n is N times the volume."""
    n = outward_normal(mesh)
    closed = Integrate(n, mesh, BND)
    assert max(map(abs, closed)) < 1e-13
    assert Integrate(x * n[0], mesh, BND) == pytest.approx(1.0, rel=1e-12)


def test_outer_normals_of_holes_point_into_the_hole():
    holed = block.with_hole(0.4, size=(1.0, 1.0))
    n = outward_normal(holed)
    volume = Integrate(1.0, holed)
    assert Integrate(x * n[0], holed, BND) == pytest.approx(volume, rel=1e-6)


def test_straight_simplices():
    """Other shapes, curved and deformed elements are none: they carry one degree more."""
    triangles = block.structured_mesh(2, 2, simplices=True)
    assert has_straight_simplices(triangles)
    assert not has_straight_simplices(MESHES["rectangles"])
    assert plastic_order(triangles, 2) == 1
    assert plastic_order(MESHES["rectangles"], 2) == 2
    deformation = GridFunction(VectorH1(triangles, order=2))
    triangles.SetDeformation(deformation)
    assert not has_straight_simplices(triangles)
    assert len(plastic_points(triangles, 1)[ET.TRIG].points) == 3
    triangles.UnsetDeformation()
    curved = ring.quarter_mesh(0.8)
    curved.Curve(2)
    assert not has_straight_simplices(curved)


def triangles_of(points, corners):
    """A mesh of triangles."""
    mesh = NetgenMesh(dim=2)
    mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    numbers = [mesh.Add(MeshPoint(Pnt(*point, 0.0))) for point in points]
    for triangle in corners:
        mesh.Add(Element2D(1, [numbers[k] for k in triangle]))
    return Mesh(mesh)


def test_moved_vertices_of_parallelograms_are_refused():
    """NGSolve would go on with parallelograms, which leave gaps and overlap."""
    mesh = block.structured_mesh(3, 3)
    inner = next(
        p for p in mesh.ngmesh.Points() if 0.2 < p[0] < 0.4 and 0.2 < p[1] < 0.4
    )
    inner[0] += 0.05
    with pytest.raises(ValueError, match="marked as parallelograms"):
        check_mesh(Mesh(mesh.ngmesh))
    for element in mesh.ngmesh.Elements2D():
        element.curved = True
    check_mesh(Mesh(mesh.ngmesh))


def test_quadrilaterals_may_have_a_flat_corner():
    """Its determinant is zero but for rounding, of either sign; the others say which way round."""
    random = np.random.default_rng(0)
    for _ in range(20):
        t = random.uniform(0.2, 0.8)
        points = np.array([(0.0, 0.0), (1.0, 0.1), (0.0, 0.0), (0.2, 1.0)])
        points[2] = t * points[1] + (1 - t) * points[3]
        for order in ((0, 1, 2, 3), (0, 3, 2, 1)):
            check_mesh(triangles_of(points.tolist(), [order]))


def test_degenerate_and_inverted_elements_are_refused():
    """An element of zero area, one of rounding's area, two that are oriented differently."""
    points = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.0), (0.5, 1e-16), (1.0, 1.0)]
    check_mesh(triangles_of(points, [(0, 1, 2), (1, 5, 2)]))
    for flat in ((0, 3, 1), (0, 1, 4)):
        with pytest.raises(ValueError, match="degenerate elements"):
            check_mesh(triangles_of(points, [(0, 1, 2), flat]))
    with pytest.raises(ValueError, match="inverted elements"):
        check_mesh(triangles_of(points, [(0, 1, 2), (1, 2, 5)]))
    # all of them may be clockwise
    check_mesh(triangles_of(points, [(0, 2, 1), (1, 2, 5)]))
    for flat in ((0, 1, 3), (0, 4, 1)):
        with pytest.raises(ValueError, match="degenerate elements"):
            check_mesh(triangles_of(points, [(0, 2, 1), flat]))
    with pytest.raises(ValueError, match="has no elements"):
        check_mesh(triangles_of(points, []))


@pytest.mark.parametrize("kind", ["body", "left"])
def test_types_are_in_the_order_of_the_elements(mesh, kind):
    body = kind == "body"
    region = mesh.Materials(".*") if body else mesh.Boundaries(kind)
    found = elements_by_type(mesh, mesh.dim - (not body), region.Mask())
    types = [element.type for element in region.Elements()]
    assert set(types) == set(found)
    for shape, alike in found.items():
        assert [one == shape for one in types] == alike.tolist()


def test_a_mesh_that_ngsolve_has_distributed_is_refused():
    class Shared(Mesh):
        comm = SimpleNamespace(size=2)

    with pytest.raises(ValueError, match=r"on 2 processes: .*model\.parts\.distribute"):
        check_mesh(Shared(block.structured_mesh(1, 1).ngmesh))
