"""Edge moments in equilibrium on each triangle: around a vertex they are sums along its fan.

``Patches`` in two dimensions, where the graph around a vertex is a ring or, at the boundary, a
path: what flows on from triangle to triangle is a cumulative sum, and one constant is left that
keeps the moments nearest to the wished ones.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.equilibration import PASSES, require_balanced

ROUNDING = 1e-13
"""Part of the largest moment that may be missing without one more pass."""

FIRST, LAST = np.array([2, 0, 1]), np.array([1, 2, 0])
"""The edges of a triangle that leave vertex 0, 1, 2 first and last, counterclockwise."""


class Fans:
    """The corners of the triangles, sorted by vertex and counterclockwise around it.

    ValueError for a body whose parts meet in a single vertex.
    """

    def __init__(self, boundary: Boundary) -> None:
        self.cells = t = boundary.triangles
        free = np.repeat(~boundary.given, 2, axis=0).astype(float)
        vertex, outer = t.nodes.ravel(), t.outer[t.facet_of[:, FIRST]].ravel()
        if np.bincount(vertex[outer]).max() > 1:
            raise ValueError("mesh: bounds need parts that hang together by edges")
        self._order = order = self._sorted(vertex, outer)
        self._starts = np.flatnonzero(np.diff(vertex[order], prepend=-1))
        self._count = np.diff(self._starts, append=len(order))
        self._first = (2 * t.facet_of[:, FIRST] + t.place[:, FIRST, 0]).ravel()[order]
        self._last = (2 * t.facet_of[:, LAST] + t.place[:, LAST, 1]).ravel()[order]
        self._first_sign = t.sign[:, FIRST].ravel()[order, None]
        self._last_sign = t.sign[:, LAST].ravel()[order, None]
        self._free, ends = free, self._starts + self._count - 1
        self._path = outer[order][self._starts][:, None]
        self._free_first, self._free_last = free[self._first[self._starts]], free[self._last[ends]]

    def _sorted(self, vertex: np.ndarray, outer: np.ndarray) -> np.ndarray:
        """Corners by vertex and angle; at the boundary the first one has an outer edge."""
        t = self.cells
        along = t.points[np.roll(t.nodes, -1, axis=1)] - t.points[t.nodes]
        angle = np.arctan2(along[:, :, 1], along[:, :, 0]).ravel() / (2 * np.pi)
        start = np.full(len(t.points), -0.5)
        start[vertex[outer]] = angle[outer]
        return np.argsort(vertex + (angle - start[vertex]) % 1.0 * 0.999)

    def repaired(self, wished: np.ndarray, needed: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The edge moments, outward of the first triangle, as ``Patches.repaired``."""
        needed = needed.reshape(-1, 2)[self._order]
        mu = np.where(self._free > 0, wished.reshape(-1, 2), given.reshape(-1, 2))
        size = max(np.abs(needed).max(), np.abs(mu).max())
        missing = needed - self._sums(mu)
        for _ in range(PASSES):
            self._correct(mu, missing)
            missing = needed - self._sums(mu)
            left = np.abs(missing).max()
            if left <= ROUNDING * size:
                break
        require_balanced(left, size)
        return mu.reshape(-1, 2, 2)

    def _sums(self, mu: np.ndarray) -> np.ndarray:
        """What flows out of the corners."""
        return self._first_sign * mu[self._first] + self._last_sign * mu[self._last]

    def _correct(self, mu: np.ndarray, missing: np.ndarray) -> None:
        """Add what is missing at the corners, in place, with the least change around a vertex."""
        starts, count = self._starts, self._count[:, None]
        flow = np.cumsum(missing, axis=0) - missing
        flow -= np.repeat(flow[starts], self._count, axis=0)
        total, sums = np.add.reduceat(missing, starts), np.add.reduceat(flow, starts)
        mean = np.where(self._path, (sums + total) / (count + 1), sums / count)
        shift = np.where(self._path & (self._free_last == 0), total, mean)
        shift *= np.where(self._path, self._free_first, 1.0)
        flow -= np.repeat(shift, self._count, axis=0)
        mu[self._first] -= self._first_sign * flow
        ends = (starts + self._count - 1)[self._path[:, 0]]
        beyond = ((total - shift) * self._free_last)[self._path[:, 0]]
        mu[self._last[ends]] += self._last_sign[ends] * beyond
