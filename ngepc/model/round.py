"""What straight sides cut off bodies whose geometry is round."""

import numpy as np
from ngsolve import BND, CF, ET, Integrate, IntegrationRule, Mesh, x, y, z

from ngepc.checks.sentences import in_percent
from ngepc.model.data import ProblemData
from ngepc.model.elements import is_straight
from ngepc.model.processes import processes_of

CUT = 0.01
"""A larger part of the volume, or of a boundary, is said in messages."""

HALF_CIRCLE = 0.4
"""More of its length is not missing from an arc: 1 - 2/pi from a half circle with one side."""

QUARTER = (0.2, 0.45)
"""The largest sagitta after halving the sides, relative to before: 1/4 for short sides.

On geometries that the mesh has left it is larger in the plane, and lies anywhere in space.
"""

MIDDLES = {
    ET.SEGM: IntegrationRule([(0.5,)], [1.0]),
    ET.TRIG: IntegrationRule([(0.5, 0.5), (0.5, 0.0), (0.0, 0.5)], [1.0] * 3),
    ET.QUAD: IntegrationRule([(0.5, 0.5), (0.5, 0.0), (0.0, 0.5)], [1.0] * 3),
}
"""Points of boundary elements whose distance to the geometry is taken."""

MOST_ELEMENTS = 100_000
"""Meshes with more are not curved to see what is missing: they are fine, or it takes seconds."""


def cut_off(mesh: Mesh) -> dict[str, float]:
    """Part of the volume (area for N = 2), and of the boundary of each name, that is missing.

    The volume has the name "".  Parts are relative to elements of order two on the geometry that
    the mesh was made from, and negative where straight sides add something.  Empty for curved and
    shared meshes, and zero where the geometry is not known.
    """
    shared = max(processes_of(mesh).size, mesh.comm.size) > 1
    if shared or not is_straight(mesh) or mesh.ne > MOST_ELEMENTS:
        return {}
    straight, curved = _sizes(mesh, 1), _sizes(mesh, 2)
    return {
        name: 1 - size / curved[name] if curved[name] else 0.0
        for name, size in straight.items()
    }


def on_geometry(mesh: Mesh) -> bool:
    """Whether sides are nearer to the geometry when they are shorter, as if their ends are on it.

    Netgen keeps the geometry of a mesh where it was when the mesh is scaled or moved.
    """
    if any(abs(part) > HALF_CIRCLE for name, part in cut_off(mesh).items() if name):
        return False
    least, most = QUARTER
    before = _sagitta(mesh)
    halved = mesh.ngmesh.Copy()
    halved.Refine()
    after = _sagitta(Mesh(halved))
    return least * before <= after <= most * before


def _sagitta(mesh: Mesh) -> float:
    """The largest distance (length) of sides from elements of order two on the geometry."""
    straight, curved = _middles(mesh, 1), _middles(mesh, 2)
    return float(np.linalg.norm(curved - straight, axis=1).max())


def _middles(mesh: Mesh, order: int) -> np.ndarray:
    """Points (n, N) of boundary elements of an order on the geometry."""
    curved = _curved(mesh, order)
    points = curved.MapToAllElements(MIDDLES, BND)
    return CF((x, y, z)[: mesh.dim])(points)


def _curved(mesh: Mesh, order: int) -> Mesh:
    """A copy of the mesh with elements of an order on the geometry."""
    curved = Mesh(mesh.ngmesh.Copy())
    curved.Curve(order)
    return curved


def _sizes(mesh: Mesh, order: int) -> dict[str, float]:
    """The volume, "", and the size of each boundary, of elements of an order on the geometry."""
    curved = _curved(mesh, order)
    sizes = {"": Integrate(CF(1), curved)}
    for name in sorted(set(curved.GetBoundaries())):
        sizes[name] = Integrate(CF(1), curved, definedon=curved.Boundaries(name))
    return sizes


def round_note(problem: ProblemData, least: float = CUT) -> str:
    """A note on the largest part that is missing; empty where it is less than ``least``.

    Empty, too, where the geometry is not that of the mesh, which was moved or scaled.
    """
    parts = cut_off(problem.mesh)
    name = max(parts, key=lambda name: abs(parts[name]), default="")
    part = parts.get(name, 0.0)
    if abs(part) < least or not on_geometry(problem.mesh):
        return ""
    volume = "volume" if problem.N == 3 else "area"
    area = "area" if problem.N == 3 else "length"
    what = f"the {area} of {name!r}" if name else f"the {volume} of the body"
    size = "small" if part > 0 else "large"
    return (
        f"Straight sides of a round body: {what} is {in_percent(abs(part))} too {size}. A finer "
        "mesh or mesh.Curve(2) mends that."
    )
