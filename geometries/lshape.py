"""Example (a) of the paper: the L-shaped body (0, 1/2] x (1/2, 1) + (1/2, 1) x (0, 1).

Boundaries: ``clamped`` is (1/2, 1) x {0}, ``contact`` is (0, 1) x {1}, ``load`` is
(0, 1/2) x {1/2}, the rest is ``free``.
"""

from ngsolve import Mesh

from .bisection import Point, refined_to, triangulated
from .outlines import meshed, outward, polygon, require_mesh_width

PAPER_NODES = (833, 1601, 3201, 6273, 12545, 24833)
COARSE_NODES = 417

_CORNERS = (
    ((0.0, 0.5), "load"),
    ((0.5, 0.5), "free"),
    ((0.5, 0.0), "clamped"),
    ((1.0, 0.0), "free"),
    ((1.0, 1.0), "contact"),
    ((0.0, 1.0), "free"),
)


def _square(x: float, y: float) -> tuple[Point, Point, Point, Point]:
    return (x, y), (x + 0.5, y), (x + 0.5, y + 0.5), (x, y + 0.5)


def _boundary_name(a: Point, b: Point) -> str:
    height = {0.0: "clamped", 0.5: "load", 1.0: "contact"}
    return height[a[1]] if a[1] == b[1] else "free"


def paper_mesh(nodes: int = COARSE_NODES) -> Mesh:
    """The mesh of the paper's Table 1 with so many nodes: 417, 833, 1601, ..., 24833, ...

    Three squares of side 1/2, two triangles each, bisected uniformly.  ``nodes`` may be any
    member of the family from 8 on.

    Raises
    ------
    ValueError
        If no mesh of the family has ``nodes`` nodes.
    """
    squares = [_square(0.0, 0.5), _square(0.5, 0.5), _square(0.5, 0.0)]
    return refined_to(triangulated(squares, _boundary_name), nodes, smallest=8)


def mesh(maxh: float = 0.05) -> Mesh:
    """An unstructured mesh of the CSG geometry with mesh width at most ``maxh`` >= 0.001."""
    require_mesh_width(maxh, 1.0, 2)
    return outward(meshed(polygon(_CORNERS), maxh))
