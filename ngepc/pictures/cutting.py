"""Parts of a body for pictures: one of several bodies, some boundaries, or behind a plane.

A plane removes the part on the side of its normal.  Of a solid the section itself is drawn,
too: elements are cut into tetrahedra, and each that the plane crosses adds one or two triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from ngsolve import CF, ET, CoefficientFunction, Mesh

from ngepc.checks.arguments import boundary_names, require_direction, require_vector
from ngepc.checks.kinds import require_text
from ngepc.checks.sentences import in_words
from ngepc.model.elements import cells_of, elements_by_type, vertex_coordinates
from ngepc.pictures.sampling import Corners, at_corners, corners_of, is_curved
from ngepc.results.fields import Fields

Plane = tuple[Sequence[float], Sequence[float]]
"""A point of the plane and its normal, N numbers each; the side of the normal is removed."""
REGULAR = np.array([(0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0)])
"""Edges of a regular tetrahedron from one of its vertices."""


@dataclass(frozen=True)
class Part:
    """The part of a body that is drawn; all of it by default.

    Parameters
    ----------
    body
        Name of a material: that body alone.
    boundary
        Names of boundaries of a solid, 'a' or 'a|b': these alone.
    cut
        A plane, see ``Plane``, in the undeformed configuration.

    Raises
    ------
    TypeError, ValueError
        By ``of``, if the mesh has no such part.
    """

    body: str | None = None
    boundary: str | None = None
    cut: Plane | None = None

    @property
    def whole(self) -> bool:
        """Whether everything is drawn."""
        return self == Part()

    def checked(self, mesh: Mesh) -> Part:
        """The part with a plane as numbers; errors if the mesh has no such part."""
        known = sorted(set(mesh.GetMaterials()))
        if self.body is not None:
            require_text("body", self.body)
            if self.body not in known:
                legal = ", ".join(map(repr, known))
                raise ValueError(f"body={self.body!r}: one of {legal} is needed")
        if self.boundary is not None:
            boundary_names("boundary", self.boundary, mesh)
            if mesh.dim == 2:
                raise ValueError(
                    f"boundary={self.boundary!r}: boundaries of a solid are drawn; those of a "
                    "plane body are curves: plot_contact_pressure"
                )
        if self.cut is None:
            return self
        if not isinstance(self.cut, Sequence) or len(self.cut) != 2:
            raise TypeError(
                f"cut={in_words(self.cut)}: a pair of a point and a normal is needed, "
                "((0.5, 0, 0), (1, 0, 0))"
            )
        point = require_vector("cut[0]", self.cut[0], (mesh.dim,))
        normal = require_direction("cut[1]", self.cut[1], (mesh.dim,))
        return replace(self, cut=(point, normal))


def part_of(
    fields: Fields,
    on_surface: CoefficientFunction,
    inside: CoefficientFunction | None,
    part: Part,
) -> Corners:
    """Triangles of the drawn part: of the body in 2D, of the surface and the section in 3D.

    ``on_surface`` is the coefficient there, ``inside`` that of the body, zero for None.
    """
    mesh = fields.problem.mesh
    part = part.checked(mesh)
    where = part.boundary
    keep = None
    if part.body is not None:
        keep = elements_of(mesh, part.body, where)
    corners = corners_of(fields, on_surface, where, keep=keep)
    if part.cut is None:
        return corners
    cut = clipped(corners, part.cut)
    if mesh.dim == 3 and part.boundary is None:
        cut = side_by_side([cut, section(fields, inside, part)])
    if not len(cut.points):
        raise ValueError(f"cut={in_words(part.cut)}: nothing is left behind this plane")
    return cut


def elements_of(mesh: Mesh, body: str, where: str | None) -> np.ndarray:
    """Which elements of a picture belong to a body: those of the plane, or of the surface."""
    if mesh.dim == 2:
        return np.array([e.mat == body for e in mesh.Materials(".*").Elements()])
    nodes, region = cells_of(mesh, 3)
    names = np.array(mesh.GetMaterials())
    own = np.unique(nodes[names[region] == body])
    mine = np.zeros(mesh.nv + 1, dtype=bool)
    mine[own[(own >= 0) & (own < mesh.nv)]] = True
    facets = mesh.Boundaries(where or ".*").Elements()
    return np.array([all(mine[v.nr] for v in facet.vertices) for facet in facets])


def stacked(corners: Corners) -> np.ndarray:
    """Positions, displacements and values side by side, (pieces, corners, 2 N + 1)."""
    values = corners.values[..., None]
    return np.concatenate([corners.points, corners.displacement, values], axis=2)


def unstacked(data: np.ndarray) -> Corners:
    """The opposite."""
    n = (data.shape[2] - 1) // 2
    return Corners(data[..., :n], data[..., n : 2 * n], data[..., -1])


def side_by_side(parts: Sequence[Corners]) -> Corners:
    """Several lists of triangles as one."""
    return unstacked(np.concatenate([stacked(part) for part in parts]))


def heights(points: np.ndarray, cut: Plane) -> np.ndarray:
    """Signed distances from the plane."""
    point, normal = cut
    return (points - np.array(point)) @ np.array(normal)


def between(
    data: np.ndarray, level: np.ndarray, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    """Where the plane crosses the edges from corner ``a`` to ``b`` of each piece."""
    row = np.arange(len(data))
    part = level[row, a] / (level[row, a] - level[row, b])
    return data[row, a] + part[:, None] * (data[row, b] - data[row, a])


def clipped(corners: Corners, cut: Plane) -> Corners:
    """Triangles behind a plane; those that it crosses are cut."""
    data = stacked(corners)
    level = heights(corners.points, cut)
    gone = level > 0
    count = gone.sum(axis=1)
    found = [data[count == 0]]
    for lost in (1, 2):
        some = count == lost
        own = data[some]
        at = level[some]
        alone = np.argmax(gone[some] == (lost == 1), axis=1)
        second = (alone + 1) % 3
        third = (alone + 2) % 3
        row = np.arange(len(own))
        p = between(own, at, alone, second)
        q = between(own, at, alone, third)
        if lost == 2:
            found.append(np.stack([own[row, alone], p, q], axis=1))
            continue
        found.append(np.stack([p, own[row, second], own[row, third]], axis=1))
        found.append(np.stack([p, own[row, third], q], axis=1))
    return unstacked(np.concatenate(found))


def section(fields: Fields, inside: CoefficientFunction | None, part: Part) -> Corners:
    """Triangles of the section of a solid with a plane."""
    mesh = fields.problem.mesh
    region = mesh.Materials(part.body or ".*")
    types = elements_by_type(mesh, 3, region.Mask())
    near = near_plane(mesh, part.cut)[np.array(region.Mask())[cells_of(mesh, 3)[1]]]
    crossing = {shape: alike & near for shape, alike in types.items()}
    cuts = 2 if is_curved(fields) else 1
    parts = {shape: tetrahedra(shape, cuts) for shape in types}
    inside = CF(0.0) if inside is None else inside
    each = at_corners(fields, inside, region, parts, types, crossing)
    data = np.concatenate(each, axis=2)
    level = heights(data[..., :3], part.cut)
    triangles = crossed(data, level)
    return unstacked(facing(triangles, np.array(part.cut[1])))


def near_plane(mesh: Mesh, cut: Plane) -> np.ndarray:
    """Which elements a plane may cross: curved ones reach beyond their vertices."""
    nodes, _ = cells_of(mesh, 3)
    corners = nodes[:, :8]
    level = heights(vertex_coordinates(mesh), cut)
    there = (corners >= 0) & (corners < mesh.nv)
    at = np.where(there, level[np.where(there, corners, 0)], np.nan)
    low = np.nanmin(at, axis=1)
    high = np.nanmax(at, axis=1)
    reach = (high - low) / 2
    return (low - reach <= 0) & (high + reach >= 0)


def facing(data: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Triangles in space with their corners counterclockwise around a direction."""
    a, b, c = (data[:, k, :3] for k in range(3))
    turned = np.cross(b - a, c - a) @ normal < 0
    data[turned] = data[turned][:, [0, 2, 1]]
    return data


def crossed(data: np.ndarray, level: np.ndarray) -> np.ndarray:
    """One or two triangles for each tetrahedron that the plane crosses."""
    above = level > 0
    count = above.sum(axis=1)
    triangles = []
    for lone in (1, 3):  # one vertex is alone on its side: a triangle
        some = count == lone
        own = data[some]
        heights = level[some]
        apex = np.argmax(above[some] == (lone == 1), axis=1)
        ends = [between(own, heights, apex, (apex + k) % 4) for k in (1, 2, 3)]
        triangles.append(np.stack(ends, axis=1))
    some = count == 2  # two on each side: a quadrilateral, cut into two triangles
    order = np.argsort(above[some], axis=1, kind="stable")
    low, lower, high, higher = order.T
    first, second, third, fourth = (
        between(data[some], level[some], i, j)
        for i, j in ((low, high), (low, higher), (lower, higher), (lower, high))
    )
    triangles.append(np.stack([first, second, third], axis=1))
    triangles.append(np.stack([first, third, fourth], axis=1))
    return np.concatenate(triangles)


def tetrahedra(shape: ET, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a reference element whose edges are cut into n parts, and its tetrahedra.

    Those of neighbours fit together, however they are turned: quadrilaterals are cut around their
    centres, and triangles as the regular one, whose middles can be joined in one way only.
    """
    if shape == ET.TET:
        k = np.arange(n + 1)
        cube = np.stack(np.meshgrid(k, k, k, indexing="ij"), axis=-1).reshape(-1, 3)
        points = cube[cube.sum(axis=1) <= n] / n
        return points, scipy.spatial.Delaunay(points @ REGULAR).simplices
    columns = [(base, k) for base in bases_of(shape, n) for k in range(n)]
    pieces = np.concatenate([around_the_centre(*column) for column in columns])
    points, numbers = np.unique(pieces.reshape(-1, 3), axis=0, return_inverse=True)
    return points / n, numbers.reshape(-1, 4)


def bases_of(shape: ET, n: int) -> list[list[tuple[int, int]]]:
    """The parts of the base of a hexahedron or a prism, n times as large, as polygons."""
    found = []
    for i in range(n):
        for j in range(n):
            corner = (i, j)
            right = (i + 1, j)
            above = (i, j + 1)
            opposite = (i + 1, j + 1)
            if shape == ET.HEX:
                found.append([corner, right, opposite, above])
                continue
            if i + j < n:
                found.append([corner, right, above])
            if i + j < n - 1:
                found.append([right, opposite, above])
    return found


def around_the_centre(base: Sequence[tuple[int, int]], height: int) -> np.ndarray:
    """Tetrahedra (k, 4, 3) of a column of height one, from its centre to the parts of its faces."""
    floor = [(*corner, height) for corner in base]
    ceiling = [(*corner, height + 1) for corner in base]
    around = list(zip(floor, floor[1:] + floor[:1], strict=True))
    above = list(zip(ceiling, ceiling[1:] + ceiling[:1], strict=True))
    sides = [(a, b, d, c) for (a, b), (c, d) in zip(around, above, strict=True)]
    centre = np.mean(floor + ceiling, axis=0)
    found = []
    for face in (floor, ceiling, *sides):
        corners = np.array(face, float)
        if len(face) == 3:
            found.append((*corners, centre))
            continue
        middle = corners.mean(axis=0)
        turned = np.roll(corners, -1, axis=0)
        found += [(a, b, middle, centre) for a, b in zip(corners, turned, strict=True)]
    return np.array(found)
