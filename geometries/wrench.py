"""Example (b) of the paper: a screw wrench, a C-shaped jaw of unit squares with a handle.

The paper shows it in Figure 5 only.  Its coarsest mesh (873 nodes, four boundary parts named in
the text) leaves one natural polygon, see docs/reading.md: seven unit squares around the opening
0 < x < 2, 2 < y < 3 and five parallelograms from x = 3 to x = 8 between y = 2.6 - 0.2 x and
y = 3.6 - 0.2 x.

Boundaries: ``clamped`` is (0, 1) x {2} and (0, 1) x {3}, ``contact`` is (0, 1) x {4}, ``load``
is the top edge of the handle from (5, 2.6) to (8, 2), the rest is ``free``.
"""

from ngsolve import Mesh

from .bisection import Point, Quadrilateral, refined_to, triangulated
from .outlines import meshed, outward, polygon, require_mesh_width

PAPER_NODES = (873, 1641, 3281, 6353, 12705, 24993)
COARSE_NODES = 437

_JAW = ((0, 3), (1, 3), (2, 3), (2, 2), (0, 1), (1, 1), (2, 1))

_OUTLINE = (
    ((0.0, 4.0), "free"),
    ((0.0, 3.0), "clamped"),
    ((1.0, 3.0), "free"),
    ((2.0, 3.0), "free"),
    ((2.0, 2.0), "free"),
    ((1.0, 2.0), "clamped"),
    ((0.0, 2.0), "free"),
    ((0.0, 1.0), "free"),
    ((3.0, 1.0), "free"),
    ((3.0, 2.0), "free"),
    ((8.0, 1.0), "free"),
    ((8.0, 2.0), "load"),
    ((5.0, 2.6), "free"),
    ((3.0, 3.0), "free"),
    ((3.0, 4.0), "free"),
    ((1.0, 4.0), "contact"),
)


def _square(x: int, y: int) -> Quadrilateral:
    return (x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)


def _slice(x: int) -> Quadrilateral:
    bottom = {3: 2.0}
    top = {3: 3.0}
    low = [bottom.get(s, round(2.6 - 0.2 * s, 10)) for s in (x, x + 1)]
    high = [top.get(s, round(3.6 - 0.2 * s, 10)) for s in (x, x + 1)]
    return (x, low[0]), (x + 1, low[1]), (x + 1, high[1]), (x, high[0])


def _boundary_name(a: Point, b: Point) -> str:
    (xa, ya), (xb, yb) = sorted((a, b))
    if (xa, xb) == (0, 1) and ya == yb:
        return {2: "clamped", 3: "clamped", 4: "contact"}.get(ya, "free")
    on_top = all(abs(y - (3.6 - 0.2 * x)) < 1e-9 for x, y in (a, b))
    return "load" if on_top and xa >= 5 else "free"


def paper_mesh(nodes: int = PAPER_NODES[0]) -> Mesh:
    """The mesh of the paper's Tables 2 and 3 with so many nodes: 873, 1641, ..., 24993, ...

    Twelve quadrilaterals, two triangles each, bisected uniformly.  ``nodes`` may be any member
    of the family from 26 on.  (The paper prints 24927 for the mesh with 24993 nodes.)

    Raises
    ------
    ValueError
        If no mesh of the family has ``nodes`` nodes.
    """
    quadrilaterals = [_square(*corner) for corner in _JAW] + [
        _slice(x) for x in range(3, 8)
    ]
    return refined_to(triangulated(quadrilaterals, _boundary_name), nodes, smallest=26)


def mesh(maxh: float = 0.25) -> Mesh:
    """An unstructured mesh of the CSG geometry with mesh width at most ``maxh`` >= 0.008."""
    require_mesh_width(maxh, 8.0, 2)
    return outward(meshed(polygon(_OUTLINE), maxh))
