"""A preconditioner for Airy functions: vertices by a direct solver, edges by their diagonal."""

from __future__ import annotations

import numpy as np
from ngsolve import H1

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.held import Pair
from ngepc.discretisation.blocks import lower_pattern, pattern_matrix


class TwoLevels:
    """A preconditioner: factors of the vertex unknowns, the diagonal of the edge unknowns.

    Parameters
    ----------
    space
        The Airy functions.
    """

    def __init__(self, space: AirySpace) -> None:
        self.space, t = space, space.triangles
        self.matrix = pattern_matrix(H1(t.mesh, order=1, dim=3))
        rows, columns = lower_pattern(self.matrix)
        self._keys = rows * np.int64(len(t.points)) + columns
        a, b = np.tril_indices(3)
        i, j = t.nodes[:, a], t.nodes[:, b]
        keys = np.maximum(i, j) * np.int64(len(t.points)) + np.minimum(i, j)
        self._local, self._turned = (a, b), i < j
        self._places = np.searchsorted(self._keys, keys)
        free = space.held.free_vertex
        self._free = free[rows][:, :, None] & free[columns][:, None, :]
        self._diagonal = np.flatnonzero(rows == columns)
        self._right, self._left = (self.matrix.CreateColVector() for _ in range(2))

    def update(self, K: np.ndarray) -> None:
        """Factorise for a stiffness of the reference unknowns."""
        corner = K[:, :9, :9].reshape(-1, 3, 3, 3, 3)
        values = corner[:, self._local[0], :, self._local[1]]
        values = np.where(self._turned.T[..., None, None], values.swapaxes(2, 3), values)
        where, count = self._places.T.ravel(), len(self._keys)
        entries = np.stack(
            [np.bincount(where, v, minlength=count) for v in values.reshape(-1, 9).T], axis=1
        ).reshape(-1, 3, 3)
        entries = np.where(self._free, entries, 0.0)
        rows, c = self._diagonal, np.arange(3)
        entries[rows[:, None], c, c] += ~self.space.held.free_vertex
        self.matrix.AsVector().FV().NumPy()[:] = entries.ravel()
        self._inverse = self.matrix.Inverse(inverse="sparsecholesky")
        self.smooth(K)
        self._relax_modes(K)

    def smooth(self, K: np.ndarray) -> None:
        """Take the diagonal of the edge unknowns from these matrices."""
        t = self.space.triangles
        diagonal = np.einsum("tkk->tk", K[:, 9:, 9:]).ravel()
        edge = np.bincount(t.edge_of.ravel(), diagonal, minlength=len(t.edges))
        self._edge = np.where(self.space.held.free_edge, 1 / np.where(edge > 0, edge, 1.0), 0.0)

    def __call__(self, K: np.ndarray, r: Pair) -> Pair:
        """What nearly solves K x = r: edges, vertices, and edges that follow them.

        It is symmetric and positive definite whatever K the factors are from.
        """
        product, edge = self.space.product, self._edge * r[1]
        vertex = self._vertices(r[0] - product(K, (np.zeros_like(r[0]), edge))[0])
        edge = edge - self._edge * product(K, (vertex, np.zeros_like(edge)))[1]
        return self._with_modes(r, vertex, edge)

    def _with_modes(self, r: Pair, vertex: np.ndarray, edge: np.ndarray) -> Pair:
        """Add what the modes of held unknowns answer."""
        if not self._modes:
            return vertex, edge
        share = np.linalg.solve(self._gram, [inner(mode, r) for mode in self._modes])
        for y, mode in zip(share, self._modes, strict=True):
            vertex, edge = vertex + y * mode[0], edge + y * mode[1]
        return vertex, edge

    def _relax_modes(self, K: np.ndarray) -> None:
        """Modes with free unknowns that follow them, and their stiffness."""
        self._modes = []
        relaxed = []
        for mode in self.space.held.modes(len(self._edge)):
            follow = self(K, self.space.product(K, mode))
            relaxed.append(tuple(a - b for a, b in zip(mode, follow, strict=True)))
        self._modes = relaxed
        images = [self.space.product(K, mode) for mode in relaxed]
        self._gram = np.array([[inner(a, b) for b in images] for a in relaxed])

    def _vertices(self, forces: np.ndarray) -> np.ndarray:
        self._right.FV().NumPy()[:] = forces.ravel()
        self._left.data = self._inverse * self._right
        return self._left.FV().NumPy().reshape(-1, 3) * self.space.held.free_vertex


def inner(a: Pair, b: Pair) -> float:
    """The product of two vectors of vertex and edge unknowns."""
    return float(sum(np.vdot(u, v) for u, v in zip(a, b, strict=True)))
