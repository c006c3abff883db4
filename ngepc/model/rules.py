"""The integration points that carry plastic strain, and the polynomials that take values there.

One rule serves all terms of an element, so that what is local is local point by point.  Each rule
has as many points as its polynomial space has dimensions: values at the points and piecewise
polynomials are the same thing, for pictures and for the next time step.

    displacements of order   1                    2
    triangle, tetrahedron    1 point, degree 0    3 / 4 points, degree 1
      curved, or with others 3 / 4 points, 1      6 / 10 points, degree 2
    quadrilateral, hexahedron 2 x 2 (x 2), 1      3 x 3 (x 3), degree 2
    prism                    6 points, degree 1   18 points, degree 2
    pyramid                  5 points, degree 1   -
"""

import math
from itertools import combinations

from ngsolve import ET, IntegrationRule, Mesh

from ngepc.checks.arguments import ELEMENT_TYPES
from ngepc.model.elements import element_vertices

SHAPE_OF = {
    (2, 3): ET.TRIG,
    (2, 4): ET.QUAD,
    (3, 4): ET.TET,
    (3, 5): ET.PYRAMID,
    (3, 6): ET.PRISM,
    (3, 8): ET.HEX,
}
"""Shape of an element by (dimension, number of vertices)."""


def shapes_of(mesh: Mesh) -> set[ET]:
    """The shapes of the elements of a mesh."""
    return {SHAPE_OF[mesh.dim, vertices.shape[1]] for vertices in element_vertices(mesh)}


def has_straight_simplices(mesh: Mesh) -> bool:
    """Whether all elements are triangles or tetrahedra with constant Jacobian."""
    straight = mesh.GetCurveOrder() <= 1 and mesh.deformation is None
    return straight and shapes_of(mesh) <= {ET.TRIG, ET.TET}


def plastic_order(mesh: Mesh, order: int) -> int:
    """Degree of the discontinuous polynomials that carry plastic strain."""
    return order - 1 if has_straight_simplices(mesh) else order


def plastic_points(mesh: Mesh, order: int) -> dict[ET, IntegrationRule]:
    """The rule of each shape for displacements of this order, see the table above."""
    if order == 2 and ET.PYRAMID in shapes_of(mesh):
        raise ValueError("order=2: the mesh has pyramids, for which order=1 is needed")
    degree = plastic_order(mesh, order)
    return {shape: plastic_rule(shape, degree) for shape in ELEMENT_TYPES[mesh.dim]}


def plastic_rule(shape: ET, degree: int) -> IntegrationRule:
    """Points in number and position for polynomials of this degree on the shape."""
    if shape is ET.PYRAMID:
        return pyramid_rule()
    if shape is ET.TRIG and degree == 1:  # inside: on an edge may be an axis of revolution
        return IntegrationRule([(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)], [1 / 6] * 3)
    if shape is ET.TET and degree == 2:
        return ten_point_rule()
    exact = (1, 3, 5) if shape in (ET.QUAD, ET.HEX) else (1, 2, 4)
    return IntegrationRule(shape, exact[degree])


def ten_point_rule() -> IntegrationRule:
    """Ten inner points of degree three on the tetrahedron, for curved ones (P. Keast, 1986)."""
    a, b = 0.7784952948213300, 0.0738349017262234
    c, d = 0.4062443438840510, 0.0937556561159491
    corners = [[a if i == k else b for i in range(3)] for k in range(4)]
    middles = [[c if i in pair else d for i in range(3)] for pair in combinations(range(4), 2)]
    weights = [0.0476331348432089 / 6] * 4 + [0.1349112434378610 / 6] * 6
    return IntegrationRule([tuple(point) for point in corners + middles], weights)


def pyramid_rule() -> IntegrationRule:
    """Five points of degree two on the pyramid with base (0, 1)^2 and apex (0, 0, 1).

    The section at z has the area (1 - z)^2, whose Gauss points are c, d = 1/3 -+ (2/45)^(1/2).  The
    weight at c is shared by the corners of a square that has the second moments of x and y,
    1/60 about the middle of the sections; the other one stays on the axis.
    """
    c, d = (1 / 3 + sign * math.sqrt(2 / 45) for sign in (-1, 1))
    upper = (1 / 12 - c / 3) / (d - c)
    lower = 1 / 3 - upper
    half, middle = 1 / math.sqrt(60 * lower), (1 - c) / 2
    square = [(middle + i * half, middle + j * half, c) for i in (-1, 1) for j in (-1, 1)]
    axis = ((1 - d) / 2, (1 - d) / 2, d)
    return IntegrationRule([*square, axis], [lower / 4] * 4 + [upper])
