"""Bisection of few triangles of a mesh by their newest vertices, in arrays.

A triangle is cut from one vertex, its peak, to the middle of the opposite side; the new vertex is
the peak of both halves.  At first the peak is opposite to the longest side.  Neighbours are cut
until no vertex lies inside a side (Mitchell, ACM Trans. Math. Softw. 15, 1989).

Netgen does the same, but each of its passes numbers the whole mesh anew, which takes three times as
long as making it once.
"""

from __future__ import annotations

import numpy as np
from netgen.meshing import Mesh as NetgenMesh
from netgen.meshing import NetgenGeometry
from ngsolve import Mesh

from ngepc.model.elements import (
    cells_of,
    determinants,
    elements_by_shape,
    elements_in,
    regions_of,
    vertex_coordinates,
)


class Bisection:
    """The triangles of a mesh, and those that they are cut into.

    ``points`` (vertices, 2) are the vertices: old ones keep their numbers.  ``nodes`` (nt, 3) are
    those of each triangle in the mesh's direction, of parts with the peak first; ``parents`` (nt,)
    the triangles of the mesh that they lie in.  ``ends`` (cuts, 2) are the ends of all sides that
    are cut, ascending; the middles have the numbers that follow those of the mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.points = vertex_coordinates(mesh).copy()
        self.nodes = elements_by_shape(mesh)[0][1]
        self.parents = np.arange(len(self.nodes))
        self._whole = np.ones(len(self.nodes), dtype=bool)
        self.ends = np.empty((0, 2), dtype=int)
        self._count = len(self.points)

    def sizes(self, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
        """The areas of some triangles."""
        x = self.points[self.nodes[chosen]]
        return np.abs(determinants(x[:, 1:] - x[:, :1])) / 2

    def slenderness(self) -> np.ndarray:
        """The longest side of each triangle over its height, 1.15 for a regular one."""
        x = self.points[self.nodes]
        sides = x - np.roll(x, 1, axis=1)
        squares = np.einsum("tkc,tkc->tk", sides, sides)
        return squares.max(axis=1) / (2 * self.sizes())

    def cut(self, chosen: np.ndarray) -> None:
        """Cut all sides of the chosen triangles (numbers), and neighbours to conform."""
        halves = self._halved(chosen)
        self._halved(np.append(chosen, halves))
        hanging = self._hanging()
        while len(hanging):
            self._halved(hanging)
            hanging = self._hanging()

    def _halved(self, chosen: np.ndarray) -> np.ndarray:
        """Cut the chosen triangles; the numbers of their second halves, the first keep theirs."""
        self._turn(chosen[self._whole[chosen]])
        peak, start, end = self.nodes[chosen].T
        middle = self._middles(np.sort(self.nodes[chosen, 1:], axis=1))
        new = len(self.nodes) + np.arange(len(chosen))
        self.nodes[chosen] = np.column_stack([middle, peak, start])
        second = np.column_stack([middle, end, peak])
        self.nodes = np.concatenate([self.nodes, second])
        self.parents = np.append(self.parents, self.parents[chosen])
        self._whole[chosen] = False
        self._whole = np.append(self._whole, np.zeros(len(chosen), dtype=bool))
        return new

    def _turn(self, chosen: np.ndarray) -> None:
        """Begin the nodes of triangles that are still whole with their peak."""
        nodes = self.nodes[chosen]
        x = self.points[nodes]
        sides = np.roll(x, -1, axis=1) - np.roll(x, -2, axis=1)  # opposite to the nodes
        peak = np.einsum("tkc,tkc->tk", sides, sides).argmax(axis=1)
        order = (peak[:, None] + np.arange(3)) % 3
        self.nodes[chosen] = np.take_along_axis(nodes, order, axis=1)

    def _keys(self, ends: np.ndarray) -> np.ndarray:
        """A number for each side, from its ascending ends (., 2)."""
        return (ends[..., 0].astype(np.int64) << 32) + ends[..., 1]

    def _middles(self, ends: np.ndarray) -> np.ndarray:
        """The vertices in the middle of sides, new ones where there are none."""
        fresh = np.setdiff1d(self._keys(ends), self._keys(self.ends))
        more = np.column_stack([fresh >> 32, fresh & 0xFFFFFFFF])
        self.ends = np.concatenate([self.ends, more])
        self.points = np.concatenate([self.points, self.points[more].mean(axis=1)])
        return self._middles_of(ends)

    def _middles_of(self, ends: np.ndarray) -> np.ndarray:
        """The vertices in the middle of sides that are cut."""
        known = self._keys(self.ends)
        order = np.argsort(known)
        return self._count + order[np.searchsorted(known[order], self._keys(ends))]

    def _hanging(self) -> np.ndarray:
        """The triangles with a side that is cut."""
        at_ends = np.zeros(len(self.points), dtype=bool)
        at_ends[self.ends] = True
        a, b, c = at_ends[self.nodes.T]
        near = np.flatnonzero((a & b) | (b & c) | (c & a))
        around = self.nodes[near]
        sides = np.sort(np.stack([around, np.roll(around, 1, axis=1)], axis=2), axis=2)
        return near[self._is_cut(sides).any(axis=1)]

    def _is_cut(self, ends: np.ndarray) -> np.ndarray:
        """Whether sides with ascending ends (., 2) are cut."""
        return np.isin(self._keys(ends), self._keys(self.ends))

    def built(self) -> tuple[Mesh, np.ndarray]:
        """The mesh of the triangles with regions and boundaries of the old one, and the parents.

        New vertices are not moved to curved boundaries: the body stays the polygon of the mesh.
        """
        made = self.mesh.ngmesh.Copy()
        made.SetGeometry(NetgenGeometry())
        more = self.points[self._count :]
        made.AddPoints(np.column_stack([more, np.zeros(len(more))]))
        regions = regions_of(self.mesh, 2)[self.parents]
        order = self._enter(made, 2, self.nodes, regions)
        ends, names = cells_of(self.mesh, 1)
        self._enter(made, 1, *self._segments(ends[:, :2].copy(), names))
        return Mesh(made), self.parents[order]

    def _enter(
        self, made: NetgenMesh, dimension: int, nodes: np.ndarray, regions: np.ndarray
    ) -> np.ndarray:
        """Change the elements with new vertices, and add new ones; the order of all of them."""
        elements = elements_in(made, dimension)
        count = len(elements)
        changed = np.flatnonzero((nodes[:count] >= self._count).any(axis=1))
        elements["nodes"][changed, : nodes.shape[1]] = 1 + nodes[changed]
        added = count + np.argsort(regions[count:], kind="stable")
        for region in np.unique(regions[added]).tolist():
            chosen = added[regions[added] == region]
            more = np.ascontiguousarray(nodes[chosen], dtype=np.int32)
            made.AddElements(dimension, 1 + region, more)
        return np.append(np.arange(count), added)

    def _segments(
        self, ends: np.ndarray, names: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The parts of segments (., 2) and their names; the first parts keep their places."""
        while True:
            cut = np.flatnonzero(self._is_cut(np.sort(ends, axis=1)))
            if not len(cut):
                return ends, names
            middle = self._middles_of(np.sort(ends[cut], axis=1))
            second = np.column_stack([middle, ends[cut, 1]])
            ends[cut, 1] = middle
            ends = np.concatenate([ends, second])
            names = np.append(names, names[cut])
