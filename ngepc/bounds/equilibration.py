"""Facet moments in equilibrium on each cell, from a stress in equilibrium against hat functions.

After Ladeveze: find the moments mu of each facet with the hat functions of its vertices such that,
for each cell T and vertex i,

    sum over the facets of T   +- mu_i = int_T sigma grad phi_i - int_T f phi_i.

The equations of a vertex contain only the moments of this vertex: a graph Laplacian on the cells
around it.  The sum of the equations is the equilibrium of the nodal forces, so that they have a
solution; the one nearest to given moments is taken.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
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
        mu = np.where(self._free > 0, wished.reshape(-1, N), given.reshape(-1, N))
        size = max(np.abs(needed).max(), np.abs(mu).max(), self.smallest)
        missing = needed - self._sum @ mu
        for _ in range(PASSES):
            for k, inverse in enumerate(self._inverses):
                mu[:, k] += self._free[:, k] * (self._jump @ (inverse @ missing[:, k]))
            missing = needed - self._sum @ mu
            left = np.abs(missing).max()
            if left <= ROUNDING * size:
                break
        if left > BALANCED * size:
            raise RuntimeError(
                f"the stress could not be equilibrated: relative residual {left / size:.1e}"
            )
        return mu.reshape(-1, N, N)
