"""A rectangular plate with a round hole in its middle, whole or a quarter of it.

The origin is the centre of the hole.  Boundaries: ``left``, ``right``, ``bottom``, ``top`` and
``hole``; of the quarter x, y > 0, ``left`` (x = 0) and ``bottom`` (y = 0) are symmetry edges.
"""

from collections.abc import Sequence

from netgen.geom2d import Circle, Solid2d
from ngsolve import Mesh

from ngepc.checks.arguments import require_number, require_vector

from .outlines import meshed, polygon, require_mesh_width


def mesh(maxh: float = 0.1, size: Sequence[float] = (2.0, 2.0), radius: float = 0.25) -> Mesh:
    """The whole plate as triangles of width at most ``maxh``.

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
    a, b = _sizes(maxh, size, radius)
    return _meshed(maxh, _rectangle(-a / 2, -b / 2, a / 2, b / 2), radius)


def quarter_mesh(
    maxh: float = 0.05, size: Sequence[float] = (2.0, 2.0), radius: float = 0.25
) -> Mesh:
    """The quarter x, y > 0 of the plate; ``size`` is that of the whole plate as for ``mesh``."""
    a, b = _sizes(maxh, size, radius)
    return _meshed(maxh, _rectangle(0, 0, a / 2, b / 2), radius)


def _sizes(maxh: float, size: Sequence[float], radius: float) -> tuple[float, ...]:
    sides = require_vector("size", size, (2,))
    for side in sides:
        require_number("size", side, 0, strict=True)
    require_mesh_width(maxh, max(sides), 2)
    require_number("radius", radius, 0, strict=True)
    if radius >= min(sides) / 2:
        raise ValueError(
            f"radius={radius!r}: a number < {min(sides) / 2:g} is needed, half of the plate"
        )
    return sides


def _rectangle(left: float, bottom: float, right: float, top: float) -> Solid2d:
    corners = {
        "bottom": (left, bottom),
        "right": (right, bottom),
        "top": (right, top),
        "left": (left, top),
    }
    return polygon((at, name) for name, at in corners.items())


def _meshed(maxh: float, rectangle: Solid2d, radius: float) -> Mesh:
    return meshed(rectangle - Circle((0, 0), radius, bc="hole"), maxh)
