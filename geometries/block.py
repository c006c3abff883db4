"""A block (0, a) x (0, b) or (0, a) x (0, b) x (0, c), whole or with a hole across.

Boundaries: ``clamped`` is the bottom, ``contact`` the top, ``left`` and ``right`` are x = 0 and
x = a, in three dimensions ``front`` and ``back`` are y = 0 and y = b, and ``hole`` is the
surface of the hole.  Nothing is clamped by its name alone: a Problem may hold or load any of them.
"""

from collections.abc import Sequence

from netgen.csg import Cylinder, Plane, Pnt, Solid, Vec
from netgen.geom2d import Circle, Solid2d
from ngsolve import Mesh
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_flag

from .outlines import meshed, polygon, require_mesh_width, require_sides

_NAMES = {"bottom": "clamped", "top": "contact"}
_NAMES_3D = {
    "back": "left",
    "front": "right",
    "left": "front",
    "right": "back",
    **_NAMES,
}


def mesh(maxh: float = 0.25, size: Sequence[float] = (1.0, 1.0, 1.0)) -> Mesh:
    """Triangles or tetrahedra of mesh width at most ``maxh`` > 0, by Netgen CSG.

    Parameters
    ----------
    maxh
        Mesh width (length), at least 1/1000 of the largest side, in three dimensions 1/100.
    size
        The two or three sides of the block (length), > 0.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    size = require_sides(size, (2, 3))
    require_mesh_width(maxh, max(size), len(size))
    return meshed(_brick(size), maxh)


def with_hole(
    maxh: float = 0.2, size: Sequence[float] = (1.0, 1.0, 1.0), radius: float = 0.25
) -> Mesh:
    """The block with a round hole through its centre, along y in three dimensions.

    Parameters
    ----------
    maxh, size
        As for ``mesh``.
    radius
        Radius of the hole (length), > 0 and less than half of the width and of the height.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    size = require_sides(size, (2, 3))
    require_mesh_width(maxh, max(size), len(size))
    require_number("radius", radius, 0, strict=True, below=min(size[0], size[-1]) / 2)
    return meshed(_brick(size) - _hole(size, radius), maxh)


def structured_mesh(
    nx: int,
    ny: int,
    nz: int | None = None,
    *,
    size: Sequence[float] | None = None,
    simplices: bool = False,
) -> Mesh:
    """Nx x ny (x nz) equal cells: rectangles or hexahedra, or each cut into simplices.

    Parameters
    ----------
    nx, ny, nz
        Numbers of cells, >= 1; without ``nz`` the block has two dimensions.
    size
        The sides of the block (length), > 0; None for the unit square or cube.
    simplices
        Whether each cell is cut into 2 triangles or 6 tetrahedra.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    cells = {"nx": nx, "ny": ny} if nz is None else {"nx": nx, "ny": ny, "nz": nz}
    for name, n in cells.items():
        require_integer(name, n, 1, 10_000 if nz is None else 500)
    require_flag("simplices", simplices)
    size = require_sides((1.0,) * len(cells) if size is None else size, (2, 3))
    if len(size) != len(cells):
        raise ValueError(
            f"size={size!r}: {len(cells)} sides are needed for {len(cells)} counts"
        )
    if nz is None:
        unit = MakeStructured2DMesh(quads=not simplices, **cells)
    else:
        unit = MakeStructured3DMesh(hexes=not simplices, **cells)
    return _stretched(unit, size)


def _stretched(unit: Mesh, size: Sequence[float]) -> Mesh:
    """The unit square or cube with the boundary names of this module, stretched to ``size``."""
    netgen_mesh = unit.ngmesh
    names = _NAMES if unit.dim == 2 else _NAMES_3D
    for number, name in enumerate(unit.GetBoundaries()):
        netgen_mesh.SetBCName(number, names.get(name, name))
    netgen_mesh.SetMaterial(1, "body")
    for point in netgen_mesh.Points():
        for i, side in enumerate(size):
            point[i] = side * point.p[i]
    return Mesh(netgen_mesh)


def _brick(size: Sequence[float]) -> Solid | Solid2d:
    if len(size) == 2:
        a, b = size
        corners = {
            "clamped": (0, 0),
            "right": (a, 0),
            "contact": (a, b),
            "left": (0, b),
        }
        return polygon((at, name) for name, at in corners.items())
    low = (
        Pnt(0, 0, 0),
        {"left": Vec(-1, 0, 0), "front": Vec(0, -1, 0), "clamped": Vec(0, 0, -1)},
    )
    high = (
        Pnt(*size),
        {"right": Vec(1, 0, 0), "back": Vec(0, 1, 0), "contact": Vec(0, 0, 1)},
    )
    planes = [
        Plane(corner, n).bc(name)
        for corner, sides in (low, high)
        for name, n in sides.items()
    ]
    brick = planes[0]
    for plane in planes[1:]:
        brick = brick * plane
    return brick


def _hole(size: Sequence[float], radius: float) -> Solid | Solid2d:
    if len(size) == 2:
        return Circle((size[0] / 2, size[1] / 2), radius=radius, bc="hole")
    a, b, c = size
    return Cylinder(Pnt(a / 2, 0, c / 2), Pnt(a / 2, b, c / 2), radius).bc("hole")
