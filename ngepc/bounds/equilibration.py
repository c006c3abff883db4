"""Facet moments in equilibrium on each cell, from a stress in equilibrium against hat functions.

After Ladeveze: find the moments mu of each facet with the hat functions of its vertices such that,
for each cell T and vertex i,

    sum over the facets of T   +- mu_i = int_T sigma grad phi_i - int_T f phi_i.

The equations of a vertex contain only the moments of this vertex: a graph Laplacian on the cells
around it.  The sum of the equations is the equilibrium of the nodal forces, so that they have a
solution; the one nearest to given moments is taken.  Components are independent, but for vertices
of slanted facets, where only the parts of moments along one direction are free.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.simplices import FACETS, stable_order

BALANCED = 1e-8  # tolerance of equilibrium relative to the largest corner force
ROUNDING = 1e-13
"""Residual, relative to the largest moment, above which another pass is made.

What nodal forces miss does not count, as no pass mends it.
"""

PASSES = 2
ENCODED = 8
"""Largest number of corners at a vertex whose Laplacian is encoded in one exact number."""


AT_VERTEX = {
    N: np.array(
        [
            [(k, facet.index(i)) for k, facet in enumerate(facets) if i in facet]
            for i in range(N + 1)
        ]
    ).transpose(2, 0, 1)
    for N, facets in FACETS.items()
}
"""The facets at each vertex of a cell, and its place among their vertices, (N + 1, N)."""


def laplacian_inverses(blocks: np.ndarray) -> np.ndarray:
    """The inverses (k, k, n) of graph Laplacians (k, k, n), for k up to 8 each different one once.

    Off the diagonal there are zeros and minus ones, on it at most three.
    """
    k, _, n = blocks.shape
    same: np.ndarray | slice = slice(None)
    first = same
    if k <= ENCODED:
        digits = np.zeros((k, k))
        below = np.tril_indices(k, -1)
        digits[below] = -(2.0 ** np.arange(len(below[0])))
        digits[np.diag_indices(k)] = 2.0 ** len(below[0]) * 4.0 ** np.arange(k)
        numbers = digits.ravel() @ blocks.reshape(-1, n)
        _, first, same = np.unique(numbers, return_index=True, return_inverse=True)
    inverses = np.linalg.inv(np.moveaxis(blocks[..., first], 2, 0))
    return inverses.reshape(-1, k * k).T.copy()[:, same].reshape(k, k, n)


class Patches:
    """The cells around each vertex and the inverse graph Laplacians of their corners.

    A corner is a cell with one of its vertices; corners are numbered vertex by vertex.
    ``smallest`` is a force that counts as zero: without loads the stresses are rounding errors,
    which have no equilibrium.  ValueError for a body whose parts meet in a single vertex or edge.
    """

    def __init__(self, boundary: Boundary, smallest: float = 0.0) -> None:
        self.smallest = smallest
        c = self.cells = boundary.cells
        N = c.N
        self._order = stable_order(c.nodes.ravel())
        vertex = c.nodes.ravel()[self._order]
        begins = np.diff(vertex, prepend=-1) > 0
        self._first = np.flatnonzero(begins)
        self._vertex = np.cumsum(begins) - 1
        facets, places = AT_VERTEX[N]
        moments = c.slot[:, facets, places].reshape(-1, N).take(self._order, axis=0)
        signs = c.sign[:, facets].reshape(-1, N).take(self._order, axis=0)
        count = len(vertex)
        rows = signs.ravel(), moments.ravel(), N * np.arange(count + 1)
        self._sum = csr_matrix(rows, (count, c.facets.size))
        self._jump = self._sum.T
        sides = np.full((2, c.facets.size), -1)
        sides[np.where(signs > 0, 0, 1), moments] = np.arange(count)[:, None]
        outer = np.repeat(c.outer, N)
        self._outside = np.where(outer, sides[0], -1)
        self._pairs = sides[:, ~outer]
        self._check_joined(vertex)
        self._free = np.repeat(~boundary.given, N, axis=0).astype(float)
        self._inverses: list[list[tuple[np.ndarray, np.ndarray]]] = []
        for k, free in enumerate(self._free.T):
            same = [j for j in range(k) if (self._free[:, j] == free).all()]
            self._inverses.append(
                self._inverses[same[0]] if same else self._inverse(free > 0)
            )
        self._slanted = (
            SlantedPatches(self, boundary) if len(boundary.slanted) else None
        )

    def _check_joined(self, vertex: np.ndarray) -> None:
        """Refuse vertices with several parts; ``vertex`` (corners,) are those of the corners.

        They lie on the boundary: cells that surround a vertex hang together.
        """
        c = self.cells
        there = np.zeros(len(c.points), dtype=bool)
        there[c.facets[c.outer]] = True
        corners = there[vertex]
        number = np.cumsum(corners) - 1
        pairs = number[self._pairs[:, corners[self._pairs[0]]]]
        count = np.count_nonzero(corners)
        graph = csr_matrix((np.ones(pairs.shape[1]), pairs), 2 * (count,))
        parts = connected_components(graph, directed=False)[0]
        if parts > len(np.unique(vertex[corners])):
            by = {2: "edges", 3: "faces"}[c.N]
            raise ValueError(f"mesh: bounds need elements that are connected by {by}")

    def corners_of(self, vertices: np.ndarray) -> list[np.ndarray]:
        """The numbers of the corners at each of some vertices of the mesh."""
        at = self.cells.nodes.ravel()[self._order]
        first = np.searchsorted(at, vertices)
        last = np.searchsorted(at, vertices, side="right")
        return [np.arange(a, b) for a, b in zip(first, last, strict=True)]

    def jump_at(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Moments (numbers) that act on some corners, and their signs there, (moments, corners)."""
        part = self._sum[corners].toarray()
        moments = np.flatnonzero(part.any(axis=0))
        return moments, part[:, moments].T

    def _inverse(self, free: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each number k of corners: those of the vertices with so many, and the inverses.

        The former have the shape (k, n), the inverse Laplacians (k, k, n).  If no outer moment is
        free at a vertex, one corner is held.
        """
        outside = self._outside[free & (self._outside >= 0)]
        ends = np.append(self._pairs.ravel(), outside)
        degree = np.bincount(ends, minlength=len(self._order))
        closed = np.ones(len(self._first), dtype=bool)
        closed[self._vertex[outside]] = False
        degree[self._first[closed]] += 1
        place = np.arange(len(self._order)) - self._first[self._vertex]
        size = np.diff(self._first, append=len(self._order))
        at = self._vertex[self._pairs[0]]
        size_there = size[at]
        result = []
        for k in np.unique(size):
            alike = size == k
            corners = self._first[alike] + np.arange(k)[:, None]
            pairs = np.flatnonzero(size_there == k)
            a, b = self._pairs[:, pairs]
            number = (np.cumsum(alike) - 1)[at[pairs]]
            blocks = np.zeros((k, *corners.shape))
            blocks[np.diag_indices(k)] = degree[corners]
            blocks[place[a], place[b], number] = -1.0
            blocks[place[b], place[a], number] = -1.0
            result.append((corners, laplacian_inverses(blocks)))
        return result

    def _answers(self, component: int, missing: np.ndarray) -> np.ndarray:
        """The inverse Laplacians of a component times what is missing at the corners."""
        result = np.empty_like(missing)
        for corners, inverse in self._inverses[component]:
            result[corners] = np.einsum("ijn,jn->in", inverse, missing[corners])
        return result

    def _mendable(self, missing: np.ndarray) -> float:
        """The largest residual at corners (., N) less what nodal forces miss.

        The latter, the sum at a vertex, is left at the corner that is held.
        """
        rest = missing.copy()
        rest[self._first] -= np.add.reduceat(missing, self._first)
        return float(np.abs(rest).max())

    def free_parts(self) -> np.ndarray:
        """Projections (moments, N, N) on the components of moments that are free."""
        return self._free[:, :, None] * np.eye(self.cells.N)

    def clear(self, corners: np.ndarray) -> None:
        """Leave out some corners when components are solved for one by one."""
        keep = np.ones(self._jump.shape[1])
        keep[corners] = 0.0
        self._inverses = [
            [(own, keep[own][:, None] * inverse) for own, inverse in groups]
            for groups in self._inverses
        ]

    def repaired(
        self, wished: np.ndarray, needed: np.ndarray, given: np.ndarray
    ) -> np.ndarray:
        """The facet moments, outward of the first cell, shape (nf, N vertices, N).

        They are the nearest to ``wished`` (nf, N, N) that equal ``given`` (nf, N, N) on the
        traction boundary and whose sums at the corners of the cells are ``needed`` (nt, N + 1, N).
        The latter must be in equilibrium at each vertex.  RuntimeError if rounding leaves residuals
        that are too large for a bound.
        """
        N = self.cells.N
        needed = needed.reshape(-1, N).take(self._order, axis=0)
        wished = wished.reshape(-1, N)
        mu = np.where(self._free > 0, wished, given.reshape(-1, N))
        if self._slanted is not None:
            self._slanted.take(wished, mu)
        size = max(np.abs(needed).max(), np.abs(mu).max(), self.smallest)
        missing = needed - self._sum @ mu
        for _ in range(PASSES):
            for k in range(N):
                change = self._jump @ self._answers(k, missing[:, k])
                mu[:, k] += self._free[:, k] * change
            if self._slanted is not None:
                mu += self._slanted.changes(missing)
            missing = needed - self._sum @ mu
            if self._mendable(missing) <= ROUNDING * size:
                break
        left = np.abs(missing).max()
        if left > BALANCED * size:
            raise RuntimeError(
                f"the stress could not be equilibrated: relative residual {left / size:.1e}"
            )
        return mu.reshape(-1, N, N)


class SlantedPatches:
    """Changes of the moments at the vertices of slanted facets.

    There the free part of each moment is P mu with a projector P: the identity, some components, or
    the part along a direction.  With the signs J of the moments at the corners, the change P J' x
    with (J P J') x = missing is the smallest one.  The inverses of the components are cleared at
    these vertices.
    """

    def __init__(self, patches: Patches, boundary: Boundary) -> None:
        N = patches.cells.N
        facets = boundary.slanted
        self._moments = (N * facets[:, None] + np.arange(N)).ravel()
        self._directions = np.repeat(boundary.directions, N, axis=0)
        free = patches.free_parts()
        free[self._moments] = self._directions[:, :, None] * self._directions[:, None]
        entries, rows, columns = [], [], []
        corners = patches.corners_of(np.unique(patches.cells.facets[facets]))
        for own in corners:
            moments, signs = patches.jump_at(own)
            parts = free[moments]
            block = np.einsum("ma,mij,mb->aibj", signs, parts, signs)
            inverse = np.linalg.pinv(block.reshape(2 * (N * len(own),)), hermitian=True)
            change = np.einsum("mij,ma->miaj", parts, signs)
            change = change.reshape(N * len(moments), -1) @ inverse
            row = (N * moments[:, None] + np.arange(N)).ravel()
            column = (N * own[:, None] + np.arange(N)).ravel()
            entries.append(change.ravel())
            rows.append(np.repeat(row, len(column)))
            columns.append(np.tile(column, len(row)))
        places = np.concatenate(rows), np.concatenate(columns)
        shape = (N * len(free), N * patches.cells.nodes.size)
        self._changes = csr_matrix((np.concatenate(entries), places), shape=shape)
        patches.clear(np.concatenate(corners))

    def take(self, wished: np.ndarray, mu: np.ndarray) -> None:
        """Enter the free parts of ``wished`` moments on slanted facets into ``mu``, (., N)."""
        d = self._directions
        more = wished[self._moments] - mu[self._moments]
        mu[self._moments] += np.einsum("mi,mi->m", more, d)[:, None] * d

    def changes(self, missing: np.ndarray) -> np.ndarray:
        """Changes of all moments (., N) for what is missing at the corners (., N)."""
        return (self._changes @ missing.ravel()).reshape(-1, missing.shape[1])
