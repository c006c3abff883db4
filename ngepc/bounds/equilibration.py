"""Facet moments in equilibrium on each cell, from a stress in equilibrium against hat functions.

After Ladeveze: the moments mu of a facet with the hat functions of its vertices are sought such
that, for each cell T and vertex i,

    sum over the facets of T   +- mu_i = what the cell needs there,

that is int_T sigma grad phi_i - int_T f phi_i.  The equations of a vertex hold only its own
moments: a graph Laplacian on the cells around it.  Their sum is the equilibrium of the nodal
forces, so that they can be solved; the deviation from the moments that are wished is kept small.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.simplices import FACETS, Simplices

BALANCED = 1e-8
"""Part of the largest corner force that may be out of balance."""

PASSES = 2
"""How often the Laplacians are solved for what is left, against rounding."""


class Patches:
    """The tetrahedra around each vertex and the Laplacians of their corners; in 2D ``Fans``.

    Corners are numbered vertex by vertex: the Laplacians are small blocks that factorise at once.
    ValueError for a body whose parts meet in a single vertex or edge.
    """

    def __init__(self, boundary: Boundary) -> None:
        self.boundary, self.cells = boundary, boundary.cells
        c, N = self.cells, self.cells.N
        local = np.array(FACETS[N])
        self._order = np.argsort(c.nodes.ravel(), kind="stable")  # corners vertex by vertex
        number = np.empty_like(self._order)
        number[self._order] = np.arange(len(number))
        corner = number.reshape(c.nodes.shape)[:, local].ravel()
        moment = (N * c.facet_of[:, :, None] + c.place).ravel()
        signs = np.repeat(c.sign.ravel(), N)
        shape = (N * len(c.facets), c.nodes.size)
        self._jump = csr_matrix((signs, (moment, corner)), shape)
        self._sum = self._jump.T.tocsr()
        sides = np.full((2, shape[0]), -1)
        sides[np.where(signs > 0, 0, 1), moment] = corner
        self._outside, ends = sides[0], sides[:, np.repeat(~c.outer, N)]
        graph = csr_matrix((np.ones(ends.shape[1]), ends), (c.nodes.size, c.nodes.size))
        self._graph = graph + graph.T
        if connected_components(self._graph)[0] > len(np.unique(c.nodes)):
            raise ValueError("mesh: bounds need parts that hang together by faces")
        self._free = np.repeat(~boundary.given, N, axis=0).astype(float)
        self._laplacians: list[SuperLU] = []
        for k in range(N):
            same = [j for j in range(k) if (self._free[:, j] == self._free[:, k]).all()]
            L = self._laplacians[same[0]] if same else self._laplacian(self._free[:, k] > 0)
            self._laplacians.append(L)

    def _laplacian(self, free: np.ndarray) -> SuperLU:
        """Factors of the graph Laplacians; where no moment is open outside, a corner is held."""
        c, graph = self.cells, self._graph
        outside = np.repeat(c.outer, c.N) & free
        degree = np.bincount(self._outside[outside], minlength=c.nodes.size)
        closed = np.ones(len(c.points), dtype=bool)
        closed[c.facets.ravel()[outside]] = False
        vertex, corner = np.unique(c.nodes.ravel()[self._order], return_index=True)
        degree[corner] += closed[vertex]
        L = (diags(degree + graph.sum(axis=1).A1) - graph).tocsc()
        return splu(L, "NATURAL", diag_pivot_thresh=0, options={"SymmetricMode": True})

    def repaired(self, wished: np.ndarray, needed: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The facet moments, outward of the first cell, shape (nf, N vertices, N).

        They are near the ``wished`` ones (nf, N, N), those of tractions on the outer boundary are
        the ``given`` ones (nf, N, N), and their sums at the corners of the cells are ``needed``
        (nt, N + 1, N), in equilibrium at each vertex.
        """
        N = self.cells.N
        needed = needed.reshape(-1, N)[self._order]
        mu = np.where(self._free > 0, wished.reshape(-1, N), given.reshape(-1, N))
        size = max(np.abs(needed).max(), np.abs(mu).max())
        for _ in range(PASSES):
            missing = needed - self._sum @ mu
            for k, L in enumerate(self._laplacians):
                mu[:, k] += self._free[:, k] * (self._jump @ L.solve(missing[:, k]))
        require_balanced(np.abs(needed - self._sum @ mu).max(), size)
        return mu.reshape(-1, N, N)


def require_balanced(left: float, size: float) -> None:
    """Refuse (RuntimeError) stresses that rounding leaves out of equilibrium: no bound then."""
    if left > BALANCED * size:
        raise RuntimeError(f"the stress is out of equilibrium by {left / size:.1e} of its size")


def corner_forces(cells: Simplices, stress: np.ndarray) -> np.ndarray:
    """int_T sigma grad phi_i for constant sigma, shape (nt, N + 1, N)."""
    return np.matmul(cells.gradients, stress) * cells.volume[:, None, None]


def mean_moments(cells: Simplices, stress: np.ndarray) -> np.ndarray:
    """Moments of the mean tractions of both cells for constant sigma, shape (nf, N, N)."""
    first, second = (
        np.einsum("eij,ej->ei", stress[cells.owners[:, k]], cells.normal) for k in (0, 1)
    )
    mean = np.where(cells.outer[:, None], first, (first + second) / 2)
    return np.repeat((mean * (cells.measure / cells.N)[:, None])[:, None], cells.N, axis=1)


def moments_of(values: np.ndarray, measure: np.ndarray) -> np.ndarray:
    """Moments with the hat functions of affine functions, from vertex values (n, N, ...)."""
    N = values.shape[1]
    size = measure.reshape(-1, *[1] * (values.ndim - 1)) / (N * (N + 1))
    return size * (values + values.sum(axis=1, keepdims=True))


def values_of(moments: np.ndarray, measure: np.ndarray) -> np.ndarray:
    """Values at the vertices of affine functions from their moments, both (n, N)."""
    N = moments.shape[1]
    less = moments.sum(axis=1, keepdims=True) / (N + 1)
    return N * (N + 1) / measure[:, None] * (moments - less)
