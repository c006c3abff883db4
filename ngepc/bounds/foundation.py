"""Elastic foundations in error bounds.

Springs with the matrix K >= 0 add int 1/2 u . K u to J.  An admissible stress has the traction
g - K w on their facets, where w is any displacement.  Then

    int 1/2 u . K u + 1/2 w . K w - u . K w  =  int 1/2 (u - w) . K (u - w)  >=  0

is added to the bound.  Here w is affine on each facet, and need not be continuous.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import nodes_of_facets
from ngepc.bounds.coverage import BUBBLE
from ngepc.bounds.simplices import EDGES
from ngepc.local.system import DiscreteProblem


class Foundation:
    """The facets with springs.

    ``facets`` are their numbers, ``stiffness`` (facets, N, N) is K, ``nodes`` (facets, .) are the
    vertices, followed by the edges for order two, ``owner`` the cells.
    """

    def __init__(self, discrete: DiscreteProblem, boundary: Boundary) -> None:
        c = boundary.cells
        self.N = c.N
        self.facets = boundary.elastic
        self.stiffness = boundary.stiffness
        self.measure = c.measure[self.facets]
        self.owner = c.owners[self.facets, 0]
        self.nodes = nodes_of_facets(discrete, c, c.facets[self.facets])
        functions = boundary.rule.shares
        if discrete.problem.order == 2:
            ends = np.array(EDGES[c.N])
            edges = BUBBLE * functions[:, ends].prod(axis=2)
            functions = np.concatenate([functions, edges], axis=1)
        self._gram = functions.T @ (boundary.rule.weights[:, None] * functions)

    def __len__(self) -> int:
        return len(self.facets)

    def affine(self, u: np.ndarray) -> np.ndarray:
        """The affine functions with the moments of u (nodes, N), at vertices, (facets, N, N)."""
        N = self.N
        own = self._gram[:N, :N]
        return np.matmul(np.linalg.solve(own, self._gram[:N]), u[self.nodes])

    def moments(self, w: np.ndarray) -> np.ndarray:
        """Moments of the tractions -K w with the hat functions (force), (facets, N, N)."""
        N = self.N
        pulled = np.matmul(w, self.stiffness) * self.measure[:, None, None]
        return -np.matmul(self._gram[:N, :N], pulled)

    def pulled(self, delta: np.ndarray) -> np.ndarray:
        """Minus the moments for displacements delta (N nf, N) of all facets, same shape."""
        result = np.zeros_like(delta).reshape(-1, self.N, self.N)
        own = delta.reshape(result.shape)[self.facets]
        result[self.facets] = -self.moments(own)
        return result.reshape(delta.shape)

    @cached_property
    def blocks(self) -> np.ndarray:
        """The stiffness between the components at the vertices, (facets, N^2, N^2)."""
        N = self.N
        mass = self.measure[:, None, None] * self._gram[:N, :N]
        return np.einsum("fab,fij->faibj", mass, self.stiffness).reshape(-1, N**2, N**2)

    def added(self, moments: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Facet moments (nf, N, N) together with those of the tractions -K w."""
        moments = moments.copy()
        moments[self.facets] += self.moments(w)
        return moments

    def apart(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """u - w at ``nodes``, (facets, nodes, N)."""
        result = u[self.nodes]
        result[:, : self.N] -= w
        return result

    def works(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """int a . K b over each facet for values at ``nodes`` (facets, nodes, N)."""
        pulled = np.matmul(np.matmul(self._gram, b), self.stiffness)
        return self.measure * np.einsum("fai,fai->f", a, pulled)

    def gaps(self, u: np.ndarray, w: np.ndarray) -> np.ndarray:
        """int 1/2 (u - w) . K (u - w) over each facet."""
        apart = self.apart(u, w)
        return self.works(apart, apart) / 2
