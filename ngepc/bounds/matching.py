"""Two bodies that meet on a straight line: meshes that match there.

All facets of the first boundary of a pair have the same normal n.  Each of its points x faces at
most one point y(x) of the second boundary, on the line through x along n.  Contact means

    n . (u_1(x) - u_2(y(x)))  <=  n . (y(x) - x)

at every x.  A facet of one side is cut where a node of the other side faces it.  After that facets
face each other as a whole, and functions that are affine on the one are affine on the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from netgen.meshing import Element1D, Element2D, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.bounds.simplices import Simplices
from ngepc.checks.arguments import boundary_names
from ngepc.checks.sentences import in_words
from ngepc.model.elements import boundary_corners, cells_of
from ngepc.model.places import Contact

ALIGNED = 1e-9
"""Largest difference of the unit normals of a straight boundary."""
FACING = 1e-6
"""Facets whose normal has a smaller part against that of the first boundary do not face it."""
SAME = 1e-10
"""Nodes closer to each other than this part of a facet coincide."""
NEAR = 3e-5
"""Shorter parts of facets are refused: rounding errors are too large in elements that flat."""


class Cut(NamedTuple):
    """A facet by its two vertices, and the points (k, 2) that cut it, in this order."""

    ends: tuple[int, int]
    points: np.ndarray


@dataclass(frozen=True, eq=False)
class FacingSide:
    """The facets of one boundary of a pair, in ascending order along the line.

    ``vertices`` (facets, 2) are their ends, ``places`` (facets, 2) the coordinates of these along
    the line, ascending in each facet.
    """

    vertices: np.ndarray
    places: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, places: np.ndarray) -> FacingSide:
        """The facets with these ends, sorted; ``places`` are those of all vertices of the mesh."""
        ascending = np.argsort(places[vertices], axis=1)
        vertices = np.take_along_axis(vertices, ascending, axis=1)
        order = np.argsort(places[vertices[:, 0]], kind="stable")
        vertices = vertices[order]
        return cls(vertices, places[vertices])

    @property
    def tolerance(self) -> float:
        """Places closer to each other than this are the same (length)."""
        return SAME * float(np.diff(self.places, axis=1).max(initial=0.0))

    @property
    def folded(self) -> bool:
        """Whether two facets lie above each other."""
        overlap = self.places[:-1, 1] - self.places[1:, 0]
        return bool((overlap > self.tolerance).any())

    def cuts(self, other: FacingSide, x: np.ndarray) -> list[Cut]:
        """The cuts at the ends of the facets of the other side; ``x`` (nv, 2) are the vertices."""
        tolerance = min(self.tolerance, other.tolerance)
        ends = np.sort(other.places.ravel())
        ends = ends[np.diff(ends, prepend=-np.inf) > tolerance]
        first = np.searchsorted(ends, self.places[:, 0] + tolerance, side="right")
        last = np.searchsorted(ends, self.places[:, 1] - tolerance, side="left")
        found = []
        for facet in np.flatnonzero(last > first):
            start, end = self.places[facet]
            share = (ends[first[facet] : last[facet]] - start) / (end - start)
            if np.diff(share, prepend=0.0, append=1.0).min() < NEAR:
                raise RuntimeError(
                    "the meshes of two bodies have nodes that nearly coincide where they meet, "
                    f"at {x[self.vertices[facet]].mean(axis=0).tolist()}: a bound needs nodes that "
                    f"coincide, or parts of facets that are longer than {NEAR:g} of these"
                )
            a, b = self.vertices[facet]
            points = (1 - share[:, None]) * x[a] + share[:, None] * x[b]
            found.append(Cut((int(a), int(b)), points))
        return found


@dataclass(frozen=True, eq=False)
class FacingFacets:
    """Facets that face each other as a whole: their vertices (facets, 2), in the same order.

    ``gap`` (facets, 2) is the distance at the vertices along ``normal`` (2,).
    """

    first: np.ndarray
    second: np.ndarray
    gap: np.ndarray


class Interface:
    """A contact pair whose first boundary is straight; ValueError for others."""

    def __init__(self, cells: Simplices, pair: Contact) -> None:
        self._pair = f"contact={in_words(pair)}"
        first = self._facets(cells, pair.first)
        second = self._facets(cells, pair.second)
        n = cells.normal[first[0]]
        if np.abs(cells.normal[first] - n).max() > ALIGNED:
            raise ValueError(
                f"{self._pair}: a bound needs a straight first boundary; around an edge give "
                "one pair for each side"
            )
        facing = second[cells.normal[second] @ n < -FACING]
        tangent = np.array([-n[1], n[0]])
        places = cells.points @ tangent
        self.normal = n
        self._points = cells.points
        self.first = FacingSide.of(cells.facets[first], places)
        self.second = FacingSide.of(cells.facets[facing], places)
        if self.first.folded or self.second.folded:
            raise ValueError(
                f"{self._pair}: a bound needs boundaries that face each other once, along the "
                "normal of the first one"
            )

    def _facets(self, cells: Simplices, names: str) -> np.ndarray:
        """The numbers of the facets of boundaries."""
        names = boundary_names("contact", names, cells.mesh)
        found = cells.facets_between(boundary_corners(cells.mesh, names))
        if not cells.outer[found].all():
            raise ValueError(
                f"{self._pair}: bounds need it on the outer boundary of the body"
            )
        return found

    @property
    def cuts(self) -> list[Cut]:
        """The cuts after which facets face each other as a whole."""
        x = self._points
        return self.first.cuts(self.second, x) + self.second.cuts(self.first, x)

    def facing(self) -> FacingFacets:
        """The facets that face each other; RuntimeError if the mesh does not match."""
        one = self.first
        two = self.second
        middle = one.places.mean(axis=1)
        place = np.searchsorted(two.places[:, 0], middle) - 1
        there = np.flatnonzero((place >= 0) & (middle < two.places[place, 1]))
        place = place[there]
        apart = np.abs(one.places[there] - two.places[place]).max(initial=0.0)
        if apart > 2 * max(one.tolerance, two.tolerance):
            raise RuntimeError(f"{self._pair}: the meshes of the bodies do not match")
        first = one.vertices[there]
        second = two.vertices[place]
        gap = (self._points[second] - self._points[first]) @ self.normal
        return FacingFacets(first, second, gap)


def check_interfaces(mesh: Mesh, pairs: Sequence[Contact]) -> None:
    """Refuse pairs whose first boundary is not straight, or faces the second one several times."""
    if pairs:
        cells = Simplices.of(mesh)
        for pair in pairs:
            Interface(cells, pair)


def matched(mesh: Mesh, pairs: Sequence[Contact]) -> tuple[Mesh, np.ndarray] | None:
    """A copy of a mesh of triangles that matches at all pairs, and the parents of its elements.

    None if the mesh matches already.
    """
    cells = Simplices.of(mesh)
    cuts: dict[tuple[int, int], list[np.ndarray]] = {}
    for pair in pairs:
        for cut in Interface(cells, pair).cuts:
            a, b = cut.ends
            points = cut.points if a < b else cut.points[::-1]
            cuts.setdefault((min(a, b), max(a, b)), []).append(points)
    if not cuts:
        return None
    joined = [
        Cut(ends, _in_order(cells.points[ends[0]], points))
        for ends, points in cuts.items()
    ]
    return with_cut_facets(mesh, joined)


def _in_order(start: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """Points on a facet, by their distance from its start, without repetitions."""
    points = np.concatenate(parts)
    distance = np.linalg.norm(points - start, axis=1)
    order = np.argsort(distance)
    points = points[order]
    distance = distance[order]
    return points[np.diff(distance, prepend=-np.inf) > SAME * distance.max()]


def with_cut_facets(mesh: Mesh, cuts: Sequence[Cut]) -> tuple[Mesh, np.ndarray]:
    """A mesh of triangles with outer facets cut at points, and the parents of its elements.

    The triangle of such a facet is cut by segments from its third vertex.  Old vertices keep their
    numbers.
    """
    triangles = Triangles(mesh)
    for cut in cuts:
        triangles.cut(*cut)
    return triangles.built(), np.array(triangles.parents)


class Triangles:
    """The triangles and boundary segments of a mesh, as lists that can be extended."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._points = np.asarray(mesh.ngmesh.Coordinates())[:, :2].tolist()
        corners, self._regions = cells_of(mesh, 2)
        ends, names = cells_of(mesh, 1)
        self._corners = corners[:, :3].tolist()
        self._regions = self._regions.tolist()
        self._segments = {
            frozenset(pair): (*pair, region)
            for pair, region in zip(ends[:, :2].tolist(), names.tolist(), strict=True)
        }
        self.parents = list(range(len(self._corners)))
        self._owner: dict[frozenset, int] = {}
        for number, nodes in enumerate(self._corners):
            self._note(number, nodes)

    def _note(self, number: int, nodes: list[int]) -> None:
        """Remember the triangle of each of its sides; of an inner side only the last."""
        for k in range(3):
            self._owner[frozenset((nodes[k], nodes[k - 1]))] = number

    def cut(self, ends: tuple[int, int], points: np.ndarray) -> None:
        """Cut an outer facet at points, from its first end to the second."""
        a, b = ends
        new = len(self._points) + np.arange(len(points))
        self._points += points.tolist()
        chain = [a, *new.tolist(), b]
        number = self._owner[frozenset(ends)]
        nodes = self._corners[number]
        for k, (start, end) in enumerate(pairwise(chain)):
            child = [{a: start, b: end}.get(node, node) for node in nodes]
            if k == 0:
                self._corners[number] = child
            else:
                self._corners.append(child)
                self._regions.append(self._regions[number])
                self.parents.append(self.parents[number])
            self._note(number if k == 0 else len(self._corners) - 1, child)
        *_, region = self._segments.pop(frozenset(ends))
        for pair in pairwise(chain):
            self._segments[frozenset(pair)] = (*pair, region)

    def built(self) -> Mesh:
        """The mesh, with the names of regions and boundaries."""
        new = NetgenMesh(dim=2)
        numbers = [new.Add(MeshPoint(Pnt(*point, 0))) for point in self._points]
        bodies = [new.AddRegion(name, dim=2) for name in self._mesh.GetMaterials()]
        names = [new.AddRegion(name, dim=1) for name in self._mesh.GetBoundaries()]
        for nodes, region in zip(self._corners, self._regions, strict=True):
            vertices = [numbers[k] for k in nodes]
            new.Add(Element2D(bodies[region], vertices))
        for start, end, region in self._segments.values():
            vertices = [numbers[start], numbers[end]]
            new.Add(Element1D(vertices, index=names[region]))
        return Mesh(new)
