"""A quarter of a rectangular plate with a round hole in its middle, the origin.

Boundaries: ``left`` (x = 0) and ``bottom`` (y = 0), symmetry edges; ``right``, ``top``, ``hole``.
The whole plate is ``block.with_hole`` in two dimensions.
"""

from collections.abc import Sequence

from netgen.geom2d import Circle
from ngsolve import Mesh

from ngepc.checks.arguments import require_number

from .outlines import meshed, polygon, require_mesh_width, require_sides


def quarter_mesh(
    maxh: float = 0.05, size: Sequence[float] = (2.0, 2.0), radius: float = 0.25
) -> Mesh:
    """The quarter x, y > 0 as triangles of width at most ``maxh``.

    Parameters
    ----------
    maxh
        Mesh width (length), at least 1/1000 of the longer side.
    size
        Width and height of the whole plate (length), > 0.
    radius
        Radius of the hole (length), > 0 and less than half of both sides.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    a, b = require_sides(size)
    require_mesh_width(maxh, max(a, b), 2)
    require_number("radius", radius, 0, strict=True, below=min(a, b) / 2)
    corners = [((0, 0), "bottom"), ((a / 2, 0), "right"), ((a / 2, b / 2), "top")]
    rectangle = polygon([*corners, ((0, b / 2), "left")])
    return meshed(rectangle - Circle((0, 0), radius, bc="hole"), maxh)
