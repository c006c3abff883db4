"""Names for boundaries of any mesh: facets chosen by place, on a plane, or by their normal."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from netgen.meshing import FaceDescriptor
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.checks.arguments import PATTERN, require_number
from ngepc.checks.declared import Along, Check, Declared, Vector
from ngepc.checks.kinds import require_mesh, require_text

ON = 1e-6
"""How far from a plane a corner on it may be, as a part of the extent of the mesh."""


@dataclass(frozen=True)
class OnPlane(Declared):
    """Facets all of whose corners lie on a plane.

    Parameters
    ----------
    point
        A point of the plane, N coordinates (length).
    normal
        A vector across the plane, other than zero.

    Raises
    ------
    TypeError, ValueError
        If one is no vector of two or three numbers.
    """

    point: Vector
    normal: Along


@dataclass(frozen=True)
class Facing(Declared):
    """Facets whose outer normal has a direction.

    Parameters
    ----------
    direction
        A vector other than zero, N components.
    within
        The largest angle between the normal and the direction, in degrees, >= 0 and < 180.

    Raises
    ------
    TypeError, ValueError
        If one is out of its range.
    """

    direction: Along
    within: Annotated[float, Check(require_number, least=0, below=180)] = 1.0


Where = Callable[..., np.ndarray] | OnPlane | Facing


def name(mesh: Mesh, name: str, where: Where) -> Mesh:
    """A copy of a mesh in which the chosen facets of the outer boundary have a name.

    Parameters
    ----------
    mesh
        Any mesh in two or three dimensions, which stays as it is.
    name
        The name; facets that have it already keep it.
    where
        ``OnPlane(point, normal)``, ``Facing(direction)``, or a function of the coordinates of the
        corners, arrays x, y and in space z, that is True at those of the facets that are meant:
        ``lambda x, y: y > 0.99``.

    Returns
    -------
    Mesh
        It knows the geometry of ``mesh``, and is curved as that is.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or no facet is chosen.
    """
    require_mesh("mesh", mesh)
    if not require_text("name", name) or legal_name(name) != name:
        signs = "".join(sorted(PATTERN))
        raise ValueError(f"name={name!r}: a name without the signs {signs} is needed")
    N = mesh.dim
    copy = mesh.ngmesh.Copy()
    points = np.asarray(copy.Coordinates())[:, :N]
    corners = _corners(copy, N - 1)
    cells = _corners(copy, N)
    beside, count = _beside(corners, cells)
    outer = np.flatnonzero(count == 1)
    chosen = outer[_selected(where, points, corners[outer], cells[beside[outer]])]
    if not len(chosen):
        raise ValueError(
            f"where={where!r}: no facet of the outer boundary is there, name={name!r}"
        )
    (_rename_edges if N == 2 else _rename_faces)(copy, name, chosen)
    copy.Update()
    renamed = Mesh(copy)
    if mesh.GetCurveOrder() > 1:
        renamed.Curve(mesh.GetCurveOrder())
    return renamed


def legal_name(name: str) -> str:
    """A name with '_' in place of signs that are patterns to NGSolve."""
    return "".join("_" if sign in PATTERN else sign for sign in name)


def _corners(mesh: NetgenMesh, dimension: int) -> np.ndarray:
    """Corners of the elements of a dimension, -1 for none."""
    nodes = getattr(mesh, f"Elements{dimension}D")().NumPy()["nodes"].astype(int) - 1
    return nodes[:, : 2**dimension]


def _beside(corners: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An element that has all corners of each facet, and the number of such elements."""
    element, place = np.nonzero(cells >= 0)
    order = np.argsort(cells[element, place], kind="stable")
    vertex = cells[element, place][order]
    elements = element[order]
    beside = np.zeros(len(corners), dtype=int)
    count = np.zeros(len(corners), dtype=int)
    for number, facet in enumerate(corners):
        facet = facet[facet >= 0]
        ends = np.searchsorted(vertex, [facet, facet + 1])
        around = [elements[a:b] for a, b in ends.T]
        met, times = np.unique(np.concatenate(around), return_counts=True)
        whole = met[times == len(facet)]
        count[number] = len(whole)
        if len(whole):
            beside[number] = whole[0]
    return beside, count


def _selected(
    where: Where, points: np.ndarray, corners: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Which facets are meant; ``cells`` are the elements beside them."""
    N = points.shape[1]
    if isinstance(where, OnPlane | Facing):
        vector = where.normal if isinstance(where, OnPlane) else where.direction
        if len(vector) != N or len(getattr(where, "point", vector)) != N:
            raise ValueError(f"where={where!r}: {N} numbers are needed on this mesh")
    elif not callable(where):
        raise TypeError(
            f"where={where!r}: a function of coordinates, OnPlane(...) or Facing(...) "
            "is needed"
        )
    if isinstance(where, Facing):
        cosine = _outer_normals(points, corners, cells) @ np.array(where.direction)
        return cosine >= np.cos(np.radians(where.within)) - 1e-12
    if isinstance(where, OnPlane):
        away = (points - np.array(where.point)) @ np.array(where.normal)
        at = np.abs(away) <= ON * np.ptp(points, axis=0).max()
    else:
        at = np.asarray(where(*points.T))
        if at.shape != (len(points),) or at.dtype != bool:
            raise ValueError(
                f"where={where!r}: one True or False for each of {len(points)} points is "
                f"needed, it gives {at.dtype} of shape {at.shape}"
            )
    return (at[corners] | (corners < 0)).all(axis=1)


def _outer_normals(
    points: np.ndarray, corners: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Unit normals of facets, at their first corner, away from the elements beside them."""
    x = points[corners]
    if points.shape[1] == 2:
        along = x[:, 1] - x[:, 0]
        normals = np.column_stack([along[:, 1], -along[:, 0]])
    else:
        normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    there = (cells >= 0)[:, :, None]
    middle = np.where(there, points[cells], 0.0).sum(axis=1) / there.sum(axis=1)
    inward = np.einsum("ki,ki->k", middle - x[:, 0], normals) > 0
    return np.where(inward[:, None], -normals, normals)


def _rename_edges(mesh: NetgenMesh, name: str, chosen: np.ndarray) -> None:
    """Give edges of a plane mesh a region of their own."""
    region = mesh.AddRegion(name, dim=1)
    mesh.Elements1D().NumPy()["index"][chosen] = region


def _rename_faces(mesh: NetgenMesh, name: str, chosen: np.ndarray) -> None:
    """Give faces of a solid regions of their own, one for each surface of the geometry."""
    index = mesh.Elements2D().NumPy()["index"]
    for old in np.unique(index[chosen]).tolist():
        surface = mesh.FaceDescriptor(old)
        new = FaceDescriptor(
            surfnr=surface.surfnr,
            domin=surface.domin,
            domout=surface.domout,
            bc=surface.bc,
        )
        number = mesh.Add(new)
        mesh.FaceDescriptor(number).bcname = name
        index = mesh.Elements2D().NumPy()["index"]
        index[chosen[index[chosen] == old]] = number
