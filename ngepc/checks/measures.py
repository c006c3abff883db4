"""Names in NGSolve's measures, ds("a|b") and dx("a|b"), of which Python cannot read the text.

NGSolve ignores a name that the mesh does not have.  Importing this module makes measures remember
the texts they are made with.  Whether one of these names is in a given measure is found by an
integral over a triangle that has this name.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps

from netgen.meshing import Element1D, Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import CF, Integrate, Mesh, comp

TEXTS: set[str] = set()
"""The texts 'a|b' with which measures have been made."""

STRANGE = "~"
"""A character that is in no name."""


def _remembering(make: Callable) -> Callable:
    """A measure with arguments, ds(...), as NGSolve makes it; its text goes to ``TEXTS``."""

    @wraps(make)
    def made(self: object, *given: object, **how: object) -> object:
        where = given[0] if given else how.get("definedon")
        if isinstance(where, str):
            TEXTS.add(where)
        return make(self, *given, **how)

    return made


comp.DifferentialSymbol.__call__ = _remembering(comp.DifferentialSymbol.__call__)


def misspelt_name(integral: comp.Integral, mesh: Mesh) -> tuple[str, list[str]] | None:
    """A name in the measure of an integral that the mesh does not have, and the legal names.

    None if there is none.
    """
    parts = sorted({part for text in TEXTS for part in text.split("|")})
    for of in ("Boundaries", "Materials"):
        region = getattr(mesh, of)
        for part in parts:
            known = region(part).Mask().NumSet()
            if not known and _has(integral, of, part):
                legal = getattr(mesh, f"Get{of}")()
                return part, sorted(set(legal))
    return None


def _has(integral: comp.Integral, of: str, name: str) -> bool:
    """Whether the measure of an integral has a name itself, not a pattern like "a.*"."""

    def matches(name: str) -> bool:
        mesh = _triangle(**{of: name})
        return Integrate(one, mesh) > 0

    one = CF(1.0) * integral.symbol
    if not matches(name):
        return False
    others = [name + STRANGE, STRANGE + name]
    others += [name[:k] + STRANGE + name[k + 1 :] for k in range(len(name))]
    return not any(map(matches, others))


def _triangle(Boundaries: str = STRANGE, Materials: str = STRANGE) -> Mesh:
    """A mesh of one triangle with one boundary and one material of these names."""
    mesh = NetgenMesh(dim=2)
    places = Pnt(0, 0, 0), Pnt(1, 0, 0), Pnt(0, 1, 0)
    corners = [mesh.Add(MeshPoint(place)) for place in places]
    mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    mesh.SetMaterial(1, Materials)
    mesh.Add(Element2D(1, corners))
    for k in range(3):
        ends = [corners[k - 1], corners[k]]
        mesh.Add(Element1D(ends, index=1))
    mesh.SetBCName(0, Boundaries)
    return Mesh(mesh)
