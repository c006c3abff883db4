"""Which unknowns of an Airy function are held so that given tractions stay what they are.

On a connected part of the boundary whose tractions are given the function is affine.  The first
such part fixes what no stress sees; on each further one the three coefficients are unknown: the
resultants of the tractions between the parts.  Where one component c is given, on rollers, the
derivative of the function with respect to the other coordinate is constant.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.bounds.boundary import Boundary

LEVEL = 1e-9
"""A smaller component of a unit normal is none."""

MOST_MODES = 30
"""Bodies with more do without: their bounds are a little larger."""


class Held:
    """The unknowns that are held.

    ``free`` (3 nv + ne,) are those that are not; along the edges ``even`` (ne,) the function is
    free for given values at the ends.
    """

    def __init__(self, boundary: Boundary) -> None:
        self.triangles = t = boundary.triangles
        given, row = boundary.given, np.arange(len(t.facets))
        both = t.outer & given.all(axis=1)
        single = t.outer & given.any(axis=1) & ~both
        component = np.where(given[:, 0], 0, 1)
        level = np.abs(t.normal) < LEVEL
        across = single & level[row, component]
        along = single & level[row, 1 - component]
        closed = both | (single & ~across & ~along)
        self._closed, self._along = closed, along
        self._constant = [closed | ((component == c) & (across | along)) for c in (0, 1)]
        vertex = np.ones((len(t.points), 3), dtype=bool)
        vertex[t.facets[closed | along].ravel(), 0] = False
        for c, edges in enumerate(self._constant):  # of dPhi/dx_(1 - c)
            vertex[t.facets[edges].ravel(), 2 - c] = False
        first = int(vertex.sum(axis=1).argmin())
        vertex[first] &= ~vertex.all(axis=0)  # what no stress sees
        self.free, self.even = (
            np.concatenate([vertex.ravel(), ~(closed | across)]),
            ~(closed | along),
        )

    def modes(self) -> list[np.ndarray]:
        """Unknowns that move together where they are held; none for more than MOST_MODES."""
        found = [] if self._along.any() else [*self._values(), *self._derivatives()]
        rest = np.zeros(len(self.free) - 3 * len(self.triangles.points))
        few = found if len(found) <= MOST_MODES else []
        return [np.concatenate([vertex.ravel(), rest]) for vertex in few]

    def _values(self) -> Iterator[np.ndarray]:
        """One for each part but the first: the value of the function."""
        for part in self._parts(self._closed)[1:]:
            mode = np.zeros((len(self.triangles.points), 3))
            mode[part, 0] = 1.0
            yield mode

    def _derivatives(self) -> Iterator[np.ndarray]:
        """One for each part but that of the first value: a derivative, values that follow."""
        t, values = self.triangles, self._parts(self._closed)
        first = values[0][0] if values else -1
        followed = np.zeros(len(t.points), dtype=bool)
        followed[t.facets[self._closed].ravel()] = True
        for c, edges in enumerate(self._constant):
            parts = self._parts(edges)
            fixed = next((k for k, part in enumerate(parts) if first in part), 0)
            for k, part in enumerate(parts):
                if k != fixed:
                    mode = np.zeros((len(self.triangles.points), 3))
                    mode[part, 2 - c] = 1.0
                    there = part[followed[part]]
                    mode[there, 0] = t.points[there, 1 - c] - t.points[part, 1 - c].mean()
                    yield mode

    def _parts(self, edges: np.ndarray) -> list[np.ndarray]:
        """The vertices of each connected part of some edges."""
        ends, nv = self.triangles.facets[edges], len(self.triangles.points)
        graph = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(nv, nv))
        _, label = connected_components(graph, directed=False)
        vertices = np.unique(ends)
        return [vertices[label[vertices] == k] for k in np.unique(label[vertices])]
