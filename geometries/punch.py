"""A wide block (-a/2, a/2) x (-b, 0) to be indented from above, with a fine mesh under the punch.

Boundaries: ``contact`` is the patch |x| < patch/2 of the top y = 0, ``top`` the rest of it,
``clamped`` the bottom, ``left`` and ``right`` the sides.
"""

from collections.abc import Sequence

from netgen.geom2d import EdgeInfo, Solid2d
from ngsolve import Mesh

from ngepc.checks.arguments import require_number

from .outlines import meshed, require_mesh_width, require_sides


def mesh(
    maxh: float = 0.8,
    fine: float = 0.05,
    size: Sequence[float] = (8.0, 4.0),
    patch: float = 1.0,
) -> Mesh:
    """Triangles of width at most ``fine`` on the patch, growing to ``maxh`` away from it.

    Parameters
    ----------
    maxh, fine
        Mesh widths (length), at least 1/1000 of the longer side; fine <= maxh.
    size
        Width a and depth b of the block (length), > 0.
    patch
        Width of the possible contact boundary (length), 0 < patch < a.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    a, b = require_sides(size)
    require_mesh_width(maxh, max(a, b), 2)
    require_number("fine", fine, max(a, b) / 1000, most=maxh)
    require_number("patch", patch, 0, strict=True, below=a)
    corners = [
        (-a / 2, -b),
        (a / 2, -b),
        (a / 2, 0),
        (patch / 2, 0),
        (-patch / 2, 0),
        (-a / 2, 0),
    ]
    edges = [
        EdgeInfo(bc=name)
        for name in ("clamped", "right", "top", "contact", "top", "left")
    ]
    edges[3] = EdgeInfo(bc="contact", maxh=fine)
    outline = [item for pair in zip(corners, edges, strict=True) for item in pair]
    return meshed(Solid2d(outline), maxh)
