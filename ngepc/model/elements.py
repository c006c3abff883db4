"""Shapes of elements: their vertices, facets and outer normal, the points of their plastic strain.

One rule serves all terms of an element, so that what is local is local point by point.  Each rule
has as many points as its polynomial space has dimensions: values at the points and piecewise
polynomials are the same thing, for pictures and for the next time step.

    displacements of order   1                    2
    triangle, tetrahedron    1 point, degree 0    3 / 4 points, degree 1
      curved, or with others 3 / 4 points, 1      6 / 10 points, degree 2
    quadrilateral, hexahedron 2 x 2 (x 2), 1      3 x 3 (x 3), degree 2
    prism                    6 points, degree 1   18 points, degree 2
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from ngsolve import (
    CF,
    ET,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IfPos,
    InnerProduct,
    IntegrationRule,
    Mesh,
    specialcf,
)

from ngepc.checks.arguments import ELEMENT_TYPES
from ngepc.checks.kinds import require_mesh

SHAPES = {
    (2, 3): (ET.TRIG, "01 12 20"),
    (2, 4): (ET.QUAD, "01 12 23 30"),
    (3, 4): (ET.TET, "012 013 023 123"),
    (3, 6): (ET.PRISM, "012 345 0143 1254 2035"),
    (3, 8): (ET.HEX, "0123 4567 0154 1265 2376 3047"),
}
"""(dimension, number of vertices) -> type and the corners of its facets."""


def element_nodes(mesh: Mesh) -> np.ndarray:
    """Node numbers of the elements, -1 for none: first 2^N for vertices, then those of edges."""
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    nodes = elements.NumPy()["nodes"].astype(int) - 1
    return np.pad(nodes, ((0, 0), (0, 20 - nodes.shape[1])), constant_values=-1)


def element_numbers(mesh: Mesh) -> list[np.ndarray]:
    """Element numbers, one array for each shape, matching ``element_vertices``."""
    count = (element_nodes(mesh)[:, : 2**mesh.dim] >= 0).sum(axis=1)
    return [np.flatnonzero(count == k) for k in np.unique(count)]


def element_vertices(mesh: Mesh) -> list[np.ndarray]:
    """Vertex numbers of the elements, (elements, vertices) for each shape."""
    nodes = element_nodes(mesh)
    return [nodes[of_shape][:, nodes[of_shape[0]] >= 0] for of_shape in element_numbers(mesh)]


def vertex_coordinates(mesh: Mesh) -> np.ndarray:
    """The coordinates of the vertices, shape (vertices, N)."""
    return np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]


def facets_of(mesh: Mesh, name: str) -> np.ndarray:
    """The N lowest vertex numbers of each element of a boundary, as ``combine`` tells them."""
    elements = mesh.Boundaries(name).Elements()
    lowest = [sorted(v.nr for v in el.vertices)[: mesh.dim] for el in elements]
    return combine(np.array(lowest, dtype=np.int64).reshape(-1, mesh.dim), mesh)


def corner_vertices(mesh: Mesh, names: Sequence[str]) -> np.ndarray:
    """Numbers of the vertices at the corners of all boundary elements, one after the other."""
    region = mesh.Boundaries("|".join(names))
    return np.array([v.nr for el in region.Elements() for v in el.vertices], dtype=int)


def vertices_of(mesh: Mesh, names: Sequence[str]) -> set[int]:
    """Numbers of the vertices on the named boundaries, ends included."""
    return set(corner_vertices(mesh, names).tolist())


def element_facets(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """An integer for each facet of each element, and the number of the element.

    Elements are counted in the order of ``element_vertices``.  The N lowest vertex numbers of a
    facet identify it.
    """
    keys, owners, start = [], [], 0
    for nodes in element_vertices(mesh):
        for facet in SHAPES[mesh.dim, nodes.shape[1]][1].split():
            corners = np.sort(nodes[:, [int(corner) for corner in facet]], axis=1)
            keys.append(combine(corners[:, : mesh.dim], mesh))
            owners.append(np.arange(start, start + len(nodes)))
        start += len(nodes)
    return np.concatenate(keys), np.concatenate(owners)


def combine(vertices: np.ndarray, mesh: Mesh) -> np.ndarray:
    """One integer for each row of sorted vertex numbers."""
    return vertices.astype(np.int64) @ mesh.nv ** np.arange(vertices.shape[1])[::-1]


def outward_normal(mesh: Mesh) -> CoefficientFunction:
    """The outer unit normal n of the body on its boundary, however its elements are oriented.

    ``specialcf.normal`` follows the boundary elements, which Netgen's CSG turns inward on some
    edges, on half of a hole and on a subtracted sphere.  Here the element beside it settles the
    sign: a vector v from the boundary to an inner point of it has n . v < 0.

    Returns
    -------
    CoefficientFunction
        N components, to be evaluated on boundary elements (``ds``); NGSolve keeps it valid when
        the mesh is refined or curved.

    Raises
    ------
    TypeError, ValueError
        If ``mesh`` is no mesh in two or three dimensions.
    """
    require_mesh("mesh", mesh)
    N = mesh.dim
    n, interior = specialcf.normal(N), CF((1 / (N + 1),) * N)
    v = BoundaryFromVolumeCF(specialcf.JacobianMatrix(N) * (interior - specialcf.xref(N)))
    return IfPos(InnerProduct(n, v), -1.0, 1.0) * n


def has_straight_simplices(mesh: Mesh) -> bool:
    """Whether all elements are triangles or tetrahedra with constant Jacobian."""
    straight = mesh.GetCurveOrder() <= 1 and mesh.deformation is None
    return straight and all(v.shape[1] == mesh.dim + 1 for v in element_vertices(mesh))


def plastic_order(mesh: Mesh, order: int) -> int:
    """Degree of the discontinuous polynomials that carry plastic strain."""
    return order - 1 if has_straight_simplices(mesh) else order


def plastic_points(mesh: Mesh, order: int) -> dict[ET, IntegrationRule]:
    """The rule of each shape for displacements of this order, see the table above."""
    degree = plastic_order(mesh, order)
    return {shape: plastic_rule(shape, degree) for shape in ELEMENT_TYPES[mesh.dim]}


def plastic_rule(shape: ET, degree: int) -> IntegrationRule:
    """Points in number and position for polynomials of this degree on the shape.

    Ten inner points of degree three for curved tetrahedra: P. Keast, 1986.
    """
    if shape is ET.TRIG and degree == 1:  # inside: on an edge may be an axis of revolution
        return IntegrationRule([(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)], [1 / 6] * 3)
    if shape is not ET.TET or degree < 2:
        exact = (1, 3, 5) if shape in (ET.QUAD, ET.HEX) else (1, 2, 4)
        return IntegrationRule(shape, exact[degree])
    a, b = 0.7784952948213300, 0.0738349017262234
    c, d = 0.4062443438840510, 0.0937556561159491
    corners = [tuple(a if i == k else b for i in range(3)) for k in range(4)]
    middles = [tuple(c if i in pair else d for i in range(3)) for pair in combinations(range(4), 2)]
    weights = [0.0476331348432089 / 6] * 4 + [0.1349112434378610 / 6] * 6
    return IntegrationRule(corners + middles, weights)
