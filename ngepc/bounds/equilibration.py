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
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.simplices import FACETS

BALANCED = 1e-8  # tolerance of equilibrium relative to the largest corner force
ROUNDING = 1e-13
"""Residual, relative to the largest moment, above which another pass is made."""

PASSES = 2
ENCODED = 8
"""Largest number of corners at a vertex whose Laplacian is encoded in one exact number."""


def laplacian_inverses(blocks: np.ndarray) -> np.ndarray:
    """The inverses (n, k^2) of graph Laplacians (n, k, k), for k up to 8 each different one once.

    Off the diagonal there are zeros and minus ones, on it at most three.
    """
    n, k, _ = blocks.shape
    if k > ENCODED:
        return np.linalg.inv(blocks).reshape(n, -1)
    digits = np.zeros((k, k))
    below = np.tril_indices(k, -1)
    digits[below] = -(2.0 ** np.arange(len(below[0])))
    digits[np.diag_indices(k)] = 2.0 ** len(below[0]) * 4.0 ** np.arange(k)
    numbers = blocks.reshape(n, -1) @ digits.ravel()
    _, first, same = np.unique(numbers, return_index=True, return_inverse=True)
    return np.linalg.inv(blocks[first]).reshape(len(first), -1)[same]


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
        moment = c.slot.ravel()
        signs = np.repeat(c.sign.ravel(), c.N)
        self._order = np.argsort(c.nodes.ravel(), kind="stable")
        number = np.empty_like(self._order)
        number[self._order] = np.arange(len(number))
        corner = number.reshape(c.nodes.shape)[:, np.array(FACETS[N])].ravel()
        self._jump = csr_matrix((signs, (moment, corner)), (c.facets.size, len(number)))
        self._sum = self._jump.T.tocsr()
        sides = np.full((2, c.facets.size), -1)
        sides[np.where(signs > 0, 0, 1), moment] = corner
        outer = np.repeat(c.outer, N)
        self._outside = np.where(outer, sides[0], -1)
        self._pairs = sides[:, ~outer]
        vertex = c.nodes.ravel()[self._order]
        self._first = np.flatnonzero(np.diff(vertex, prepend=-1))
        graph = csr_matrix(
            (np.ones(self._pairs.shape[1]), self._pairs), 2 * (len(number),)
        )
        if connected_components(graph, directed=False)[0] > len(self._first):
            by = {2: "edges", 3: "faces"}[N]
            raise ValueError(f"mesh: bounds need elements that are connected by {by}")
        self._free = np.repeat(~boundary.given, N, axis=0).astype(float)
        self._inverses: list[csr_matrix] = []
        for k, free in enumerate(self._free.T):
            same = [j for j in range(k) if (self._free[:, j] == free).all()]
            self._inverses.append(
                self._inverses[same[0]] if same else self._inverse(free > 0)
            )
        self._slanted = (
            SlantedPatches(self, boundary) if len(boundary.slanted) else None
        )

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

    def _inverse(self, free: np.ndarray) -> csr_matrix:
        """The inverse Laplacians; if no outer moment is free at a vertex, one corner is held."""
        size = np.diff(self._first, append=len(self._order))
        first = np.repeat(self._first, size)
        width = np.repeat(size, size)
        rows = np.append(0, np.cumsum(width))
        place = np.arange(len(width)) - first
        outside = self._outside[free & (self._outside >= 0)]
        degree = np.bincount(
            np.append(self._pairs.ravel(), outside), minlength=len(width)
        )
        opened = np.zeros(len(width), dtype=bool)
        opened[first[outside]] = True
        degree[self._first[~opened[self._first]]] += 1
        a, b = self._pairs
        entries = np.zeros(rows[-1])
        entries[rows[:-1] + place] = degree
        entries[rows[a] + place[b]] = entries[rows[b] + place[a]] = -1.0
        for k in np.unique(size):
            block = rows[self._first[size == k]][:, None] + np.arange(k * k)
            entries[block] = laplacian_inverses(entries[block].reshape(-1, k, k))
        columns = np.arange(rows[-1]) - np.repeat(rows[:-1] - first, width)
        return csr_matrix((entries, columns, rows), 2 * (len(width),))

    def free_parts(self) -> np.ndarray:
        """Projections (moments, N, N) on the components of moments that are free."""
        return self._free[:, :, None] * np.eye(self.cells.N)

    def clear(self, corners: np.ndarray) -> None:
        """Leave out some corners when components are solved for one by one."""
        keep = np.ones(self._jump.shape[1])
        keep[corners] = 0.0
        self._inverses = [diags(keep) @ inverse for inverse in self._inverses]

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
        needed = needed.reshape(-1, N)[self._order]
        wished = wished.reshape(-1, N)
        mu = np.where(self._free > 0, wished, given.reshape(-1, N))
        if self._slanted is not None:
            self._slanted.take(wished, mu)
        size = max(np.abs(needed).max(), np.abs(mu).max(), self.smallest)
        missing = needed - self._sum @ mu
        for _ in range(PASSES):
            for k, inverse in enumerate(self._inverses):
                mu[:, k] += self._free[:, k] * (self._jump @ (inverse @ missing[:, k]))
            if self._slanted is not None:
                mu += self._slanted.changes(missing)
            missing = needed - self._sum @ mu
            left = np.abs(missing).max()
            if left <= ROUNDING * size:
                break
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
