"""Cook's membrane: the tapered panel with corners (0, 0), (48, 44), (48, 60), (0, 44).

Boundaries: ``clamped`` is the left edge, ``load`` the right one (length 16), the rest is
``free``.
"""

from ngsolve import Mesh

from .bisection import refined_to, triangulated
from .outlines import meshed, polygon, require_mesh_width

_CORNERS = (
    ((0.0, 0.0), "free"),
    ((48.0, 44.0), "load"),
    ((48.0, 60.0), "free"),
    ((0.0, 44.0), "clamped"),
)


def _boundary_name(a: tuple[float, float], b: tuple[float, float]) -> str:
    return {(0.0, 0.0): "clamped", (48.0, 48.0): "load"}.get((a[0], b[0]), "free")


def bisected_mesh(nodes: int = 289) -> Mesh:
    """Two triangles, bisected uniformly until there are ``nodes`` vertices: 13, 25, ..., 289, ...

    Raises
    ------
    TypeError, ValueError
        If no mesh of the family has ``nodes`` nodes.
    """
    corners = tuple(x for x, _ in _CORNERS)
    return refined_to(triangulated([corners], _boundary_name), nodes, smallest=4)


def mesh(maxh: float = 4.0) -> Mesh:
    """An unstructured mesh of the CSG geometry with mesh width at most ``maxh`` >= 0.06."""
    require_mesh_width(maxh, 60.0, 2)
    return meshed(polygon(_CORNERS), maxh)
