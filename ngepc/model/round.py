"""What straight sides cut off bodies whose geometry is round."""

from ngsolve import CF, Integrate, Mesh

from ngepc.checks.sentences import in_percent
from ngepc.model.data import ProblemData
from ngepc.model.elements import is_straight
from ngepc.model.processes import processes_of

CUT = 0.01
"""A larger part of the volume, or of a boundary, is said in messages."""

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
    curved = Mesh(mesh.ngmesh.Copy())
    curved.Curve(2)
    parts = {"": 1 - Integrate(CF(1), mesh) / Integrate(CF(1), curved)}
    for name in sorted(set(mesh.GetBoundaries())):
        straight, round_ = (
            Integrate(CF(1), m, definedon=m.Boundaries(name)) for m in (mesh, curved)
        )
        parts[name] = 1 - straight / round_ if round_ else 0.0
    return parts


def round_note(problem: ProblemData, least: float = CUT) -> str:
    """A note on the largest part that is missing; empty where it is less than ``least``."""
    parts = cut_off(problem.mesh)
    name = max(parts, key=lambda name: abs(parts[name]), default="")
    part = parts.get(name, 0.0)
    if abs(part) < least:
        return ""
    volume = "volume" if problem.N == 3 else "area"
    area = "area" if problem.N == 3 else "length"
    what = f"the {area} of {name!r}" if name else f"the {volume} of the body"
    size = "small" if part > 0 else "large"
    return (
        f"Straight sides of a round body: {what} is {in_percent(abs(part))} too {size}. A finer "
        "mesh or mesh.Curve(2) mends that."
    )
