"""Cook's membrane: the tapered panel with corners (0, 0), (48, 44), (48, 60), (0, 44).

Boundaries: ``clamped`` is the left edge, ``load`` the right one (length 16), the rest is ``free``.
"""

from ngsolve import Mesh

from .bisection import refined_to, triangulated

_CORNERS = ((0.0, 0.0), (48.0, 44.0), (48.0, 60.0), (0.0, 44.0))


def _boundary_name(a: tuple[float, float], b: tuple[float, float]) -> str:
    return {(0.0, 0.0): "clamped", (48.0, 48.0): "load"}.get((a[0], b[0]), "free")


def bisected_mesh(nodes: int = 289) -> Mesh:
    """Two triangles, bisected uniformly until there are ``nodes`` vertices: 13, 25, ..., 289, ...

    Raises
    ------
    TypeError, ValueError
        If no mesh of the family has ``nodes`` nodes.
    """
    return refined_to(triangulated([_CORNERS], _boundary_name), nodes, smallest=4)
