"""Shapes of elements: their vertices, facets and outer normal, the points of their plastic strain.

One rule serves all terms of an element, so that the material law acts point by point.  Each rule
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
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import (
    CF,
    ET,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    HCurl,
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

PARALLEL = 1e-12
"""Defect of a parallelogram, relative to a diagonal, that counts as rounding."""

TYPES = {(1, 2): ET.SEGM} | {key: shape for key, (shape, _) in SHAPES.items()}
"""(dimension, number of vertices) -> type."""


def elements_in(netgen_mesh: NetgenMesh, dimension: int) -> np.ndarray:
    """View of Netgen's elements of a dimension, with node numbers that begin at one."""
    return getattr(netgen_mesh, f"Elements{dimension}D")().NumPy()


def cells_of(mesh: Mesh, dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Node numbers (-1 for none) of the elements of a dimension, and their region numbers.

    The first 2^dimension nodes are vertices, those of edges follow.
    """
    elements = elements_in(mesh.ngmesh, dimension)
    numbers = elements["nodes"]
    count, given = numbers.shape
    nodes = np.full((count, max(given, 2**dimension)), -1)
    nodes[:, :given] += numbers
    return nodes, regions_of(mesh, dimension)


def regions_of(mesh: Mesh, dimension: int) -> np.ndarray:
    """The region numbers of the elements of a dimension."""
    return elements_in(mesh.ngmesh, dimension)["index"].astype(int) - 1


def elements_by_type(mesh: Mesh, dimension: int, chosen: list) -> dict[ET, np.ndarray]:
    """Type -> which of the elements of a dimension in the ``chosen`` regions are of this type.

    The elements are numbered as ``Region.Elements()`` yields them.
    """
    nodes, region = cells_of(mesh, dimension)
    mask = np.array(chosen, dtype=bool)
    corners = (nodes[mask[region], : 2**dimension] >= 0).sum(axis=1)
    counts = np.unique(corners)
    return {TYPES[dimension, count]: corners == count for count in counts.tolist()}


def element_nodes(mesh: Mesh) -> np.ndarray:
    """Node numbers of the elements of the body, see ``cells_of``."""
    return cells_of(mesh, mesh.dim)[0]


def elements_by_shape(mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """Numbers (k,) and vertices (k, vertices) of the elements of each shape."""
    if not has_more_corners(mesh):
        nodes = elements_in(mesh.ngmesh, mesh.dim)["nodes"][:, : mesh.dim + 1]
        return [(np.arange(len(nodes)), nodes.astype(int) - 1)]
    nodes = element_nodes(mesh)[:, : 2**mesh.dim]
    corners = (nodes >= 0).sum(axis=1)
    alike = [np.flatnonzero(corners == count) for count in np.unique(corners)]
    return [(numbers, nodes[numbers][:, nodes[numbers[0]] >= 0]) for numbers in alike]


def vertex_coordinates(mesh: Mesh) -> np.ndarray:
    """The coordinates of the vertices, shape (vertices, N)."""
    return np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]


def largest_slenderness(mesh: Mesh) -> float:
    """How many times as long as thick the most slender element is, about 1 for a regular one."""
    places = vertex_coordinates(mesh)
    found = 1.0
    for _, vertices in elements_by_shape(mesh):
        corners = places[vertices]
        centred = corners - corners.mean(axis=1, keepdims=True)
        sizes = np.linalg.svd(centred, compute_uv=False)
        found = max(found, float((sizes[:, 0] / sizes[:, -1]).max(initial=1.0)))
    return found


def determinants(matrices: np.ndarray) -> np.ndarray:
    """The determinants (n,) of matrices (n, N, N); for N = 2 without calls for each matrix."""
    if matrices.shape[1] != 2:
        return np.linalg.det(matrices)
    (a, b), (c, d) = np.moveaxis(matrices, 0, 2)
    return a * d - b * c


def inverses(matrices: np.ndarray) -> np.ndarray:
    """The inverses (n, N, N) of matrices, for N = 2, 3 without calls for each matrix."""
    N = matrices.shape[1]
    if N == 2:
        (a, b), (c, d) = np.moveaxis(matrices, 0, 2)
        adjugate = np.array([[d, -b], [-c, a]])
        return np.moveaxis(adjugate / (a * d - b * c), 2, 0)
    if N == 3:
        rows = np.moveaxis(matrices, 0, 2)
        pairs = ((1, 2), (2, 0), (0, 1))
        adjugate = np.array([_cross(rows[i], rows[j]) for i, j in pairs])
        det = np.einsum("in,in->n", rows[0], adjugate[0])
        return np.moveaxis(adjugate / det, (2, 1), (0, 1))
    return np.linalg.inv(matrices)


def solutions(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x (..., n) of positive definite matrices (..., n, n) times x = ``right``, for all at once."""
    n = right.shape[-1]
    rows = [[matrices[..., i, j] for j in range(n)] for i in range(n)]
    left = [right[..., i] for i in range(n)]
    for k, i in combinations(range(n), 2):
        share = rows[i][k] / rows[k][k]
        left[i] = left[i] - share * left[k]
        for j in range(k + 1, n):
            rows[i][j] = rows[i][j] - share * rows[k][j]
    x = np.empty_like(right)
    for i in reversed(range(n)):
        known = sum(rows[i][j] * x[..., j] for j in range(i + 1, n))
        x[..., i] = (left[i] - known) / rows[i][i]
    return x


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The products of vectors, (3, n) and (3, n) to (3, n)."""
    return np.array([a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))])


def edge_ends(mesh: Mesh) -> np.ndarray:
    """The vertices at the ends of the edges, in NGSolve's order of edges, shape (edges, 2)."""
    gradient, _ = HCurl(mesh, order=0).CreateGradient()
    _, ends, _ = gradient.CSR()
    return np.array(ends, dtype=int).reshape(-1, 2)


def boundary_corners(mesh: Mesh, names: Sequence[str]) -> np.ndarray:
    """Vertex numbers of the elements of some boundaries, (elements, 2^(N-1)), -1 for none."""
    nodes, region = cells_of(mesh, mesh.dim - 1)
    chosen = np.array(mesh.Boundaries("|".join(names)).Mask(), dtype=bool)
    return nodes[chosen[region], : 2 ** (mesh.dim - 1)]


def corner_vertices(mesh: Mesh, names: Sequence[str]) -> np.ndarray:
    """Numbers of the vertices at the corners of all boundary elements, one after the other."""
    corners = boundary_corners(mesh, names)
    return corners[corners >= 0]


def element_facets(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """``facet_keys`` of all facets of all elements, sorted, and the numbers of their elements."""
    keys = []
    owners = []
    for numbers, nodes in elements_by_shape(mesh):
        for facet in SHAPES[mesh.dim, nodes.shape[1]][1].split():
            keys.append(facet_keys(nodes[:, [int(corner) for corner in facet]], mesh))
            owners.append(numbers)
    order = np.argsort(np.concatenate(keys), kind="stable")
    return np.concatenate(keys)[order], np.concatenate(owners)[order]


def facet_keys(corners: np.ndarray, mesh: Mesh) -> np.ndarray:
    """An integer key for each facet, from its N lowest vertex numbers (-1 for none)."""
    lowest = np.sort(np.where(corners < 0, mesh.nv, corners), axis=1)[:, : mesh.dim]
    return lowest.astype(np.int64) @ mesh.nv ** np.arange(mesh.dim)[::-1]


def outward_normal(mesh: Mesh) -> CoefficientFunction:
    """The outer unit normal n of the body on its boundary, however its elements are oriented.

    ``specialcf.normal`` follows the boundary elements, which Netgen's CSG turns inward on some
    edges, on half of a hole and on a subtracted sphere.  Here the adjacent element decides the
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
    return OUTWARD[mesh.dim]


def _outward(N: int) -> CoefficientFunction:
    """``outward_normal`` of all meshes of a dimension."""
    n = specialcf.normal(N)
    interior = CF((1 / (N + 1),) * N)
    v = BoundaryFromVolumeCF(
        specialcf.JacobianMatrix(N) * (interior - specialcf.xref(N))
    )
    return IfPos(InnerProduct(n, v), -1.0, 1.0) * n


OUTWARD = {N: _outward(N) for N in (2, 3)}


def has_more_corners(mesh: Mesh) -> bool:
    """Whether an element has more corners than a triangle or a tetrahedron."""
    numbers = elements_in(mesh.ngmesh, mesh.dim)["nodes"]  # they begin at one
    return bool((numbers[:, mesh.dim + 1 : 2**mesh.dim] > 0).any())


def has_elements_with(mesh: Mesh, corners: int) -> bool:
    """Whether an element has this number of corners."""
    nodes = element_nodes(mesh)[:, : 2**mesh.dim]
    return bool(((nodes >= 0).sum(axis=1) == corners).any())


def are_parallelograms(mesh: Mesh) -> bool:
    """Whether all quadrilaterals of a plane mesh are parallelograms."""
    nodes = element_nodes(mesh)[:, :4]
    p = vertex_coordinates(mesh)[nodes[nodes[:, 3] >= 0]]
    diagonal = np.abs(p[:, 2] - p[:, 0]).max(axis=1)
    defect = np.abs(p[:, 0] - p[:, 1] + p[:, 2] - p[:, 3]).max(axis=1)
    return bool((defect <= PARALLEL * diagonal).all())


def is_straight(mesh: Mesh) -> bool:
    """Whether no element is curved."""
    return mesh.GetCurveOrder() <= 1 and mesh.deformation is None


def has_straight_simplices(mesh: Mesh) -> bool:
    """Whether all elements are triangles or tetrahedra with constant Jacobian."""
    return is_straight(mesh) and not has_more_corners(mesh)


def plastic_order(mesh: Mesh, order: int) -> int:
    """Degree of the discontinuous polynomials that carry plastic strain."""
    return order - 1 if has_straight_simplices(mesh) else order


def plastic_points(mesh: Mesh, order: int) -> dict[ET, IntegrationRule]:
    """The rule of each shape for displacements of this order, see the table above."""
    degree = plastic_order(mesh, order)
    return {shape: plastic_rule(shape, degree) for shape in ELEMENT_TYPES[mesh.dim]}


def plastic_rule(shape: ET, degree: int) -> IntegrationRule:
    """The rule with as many points as polynomials of this degree have dimensions.

    Ten inner points of degree three for curved tetrahedra: P. Keast, 1986.
    """
    # inside: on an edge may be an axis of revolution
    if shape is ET.TRIG and degree == 1:
        return IntegrationRule(
            [(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)], [1 / 6] * 3
        )
    if shape is not ET.TET or degree < 2:
        exact = (1, 3, 5) if shape in (ET.QUAD, ET.HEX) else (1, 2, 4)
        return IntegrationRule(shape, exact[degree])
    a = 0.7784952948213300
    b = 0.0738349017262234
    c = 0.4062443438840510
    d = 0.0937556561159491
    corners = [tuple(a if i == k else b for i in range(3)) for k in range(4)]
    middles = [
        tuple(c if i in pair else d for i in range(3))
        for pair in combinations(range(4), 2)
    ]
    weights = [0.0476331348432089 / 6] * 4 + [0.1349112434378610 / 6] * 6
    return IntegrationRule(corners + middles, weights)
