"""A round ring: two radii around the origin, whole, a quarter of it, and an eighth of a shell.

Boundaries: ``inner`` and ``outer`` are the circles (spheres).  The parts also have symmetry
edges: ``left`` is x = 0, ``bottom`` is y = 0; for the shell ``left`` is x = 0, ``front`` is
y = 0 and ``bottom`` is z = 0.  The meshes know their geometry: ``mesh.Curve(k)`` bends the
elements, without it the circles are polygons.
"""

from netgen.csg import Plane, Pnt, Sphere, Vec
from netgen.geom2d import Circle, Solid2d
from ngsolve import Mesh

from ngepc.checks.arguments import require_number

from .outlines import meshed, polygon, require_mesh_width


def mesh(maxh: float = 0.25, inner: float = 1.0, outer: float = 2.0) -> Mesh:
    """The closed ring inner < r < outer as triangles of width at most ``maxh``.

    Parameters
    ----------
    maxh
        Mesh width (length), at least 1/1000 of the diameter.
    inner, outer
        The radii (length), 0 < inner < outer.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    return _meshed(maxh, outer, _ring(inner, outer))


def quarter_mesh(maxh: float = 0.2, inner: float = 1.0, outer: float = 2.0) -> Mesh:
    """The quarter x, y > 0 of the ring; parameters as for ``mesh``."""
    ring = _ring(inner, outer)
    a = 2 * outer
    corners = {"bottom": (0, 0), "beyond": (a, 0), "above": (a, a), "left": (0, a)}
    return _meshed(
        maxh, outer, ring * polygon((at, name) for name, at in corners.items())
    )


def shell_octant_mesh(
    maxh: float = 0.5, inner: float = 1.0, outer: float = 2.0
) -> Mesh:
    """The eighth x, y, z > 0 of the spherical shell inner < r < outer, as tetrahedra.

    Parameters
    ----------
    maxh
        Mesh width (length), at least 1/100 of the diameter.
    inner, outer
        The radii (length), 0 < inner < outer.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    _check_radii(inner, outer)
    require_mesh_width(maxh, 2 * outer, 3)
    body = Sphere(Pnt(0, 0, 0), outer).bc("outer") - Sphere(Pnt(0, 0, 0), inner).bc(
        "inner"
    )
    for name, n in {
        "left": (-1, 0, 0),
        "front": (0, -1, 0),
        "bottom": (0, 0, -1),
    }.items():
        body = body * Plane(Pnt(0, 0, 0), Vec(*n)).bc(name)
    return meshed(body, maxh)


def _ring(inner: float, outer: float) -> Solid2d:
    _check_radii(inner, outer)
    return Circle((0, 0), outer, bc="outer") - Circle((0, 0), inner, bc="inner")


def _check_radii(inner: float, outer: float) -> None:
    require_number("inner", inner, 0, strict=True)
    require_number("outer", outer, inner, strict=True)


def _meshed(maxh: float, outer: float, body: Solid2d) -> Mesh:
    require_mesh_width(maxh, 2 * outer, 2)
    return meshed(body, maxh)
