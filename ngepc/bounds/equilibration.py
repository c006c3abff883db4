"""Edge moments in equilibrium on each triangle, from a stress in equilibrium against hat functions.

After Ladeveze: the moments mu of an edge with the hat functions of its ends are sought such that,
for each triangle T and vertex i,

    sum over the edges of T   +- mu_i = int_T sigma grad phi_i - int_T f phi_i.

The equations of a vertex hold only its own moments.  Their sum is the equilibrium of the nodal
forces, so that they can be solved; the deviation from the mean of both triangles' tractions is
kept small.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.triangles import PAIRS, Triangles

BALANCED = 1e-8
"""Part of the largest corner force that may be out of balance."""


class Patches:
    """The triangles around each vertex and the pseudo-inverses of their equations.

    Parameters
    ----------
    boundary
        Which tractions are given.

    Raises
    ------
    ValueError
        For a body whose parts meet in a single vertex.
    """

    def __init__(self, boundary: Boundary) -> None:
        self.boundary = boundary
        self.triangles = t = boundary.triangles
        if np.bincount(t.edges[t.outer].ravel()).max() > 2:
            raise ValueError("mesh: bounds need parts that hang together by edges")
        self._number_corners()
        corners = self._edge_corners()
        self._first, self._second = corners[:, :, 0], corners[:, :, 1]
        open_ = [t.outer & ~boundary.given[:, c] for c in (0, 1)]
        first = self._inverse(open_[0])
        same = (open_[0] == open_[1]).all()
        self.inverses = [first, first if same else self._inverse(open_[1])]

    def _number_corners(self) -> None:
        """The place of each corner (triangle, vertex) among those of its vertex."""
        vertex, nv = self.triangles.nodes.ravel(), len(self.triangles.points)
        order = np.argsort(vertex, kind="stable")
        self.count = np.bincount(vertex, minlength=nv)
        before = np.concatenate([[0], np.cumsum(self.count)[:-1]])
        self.place = np.empty(len(vertex), dtype=int)
        self.place[order] = np.arange(len(vertex)) - np.repeat(before, self.count)
        self.most = int(self.count.max())

    def _edge_corners(self) -> np.ndarray:
        """Corners of both triangles at the ends of each edge, shape (ne, end, owner), or -1."""
        t = self.triangles
        corners, numbers = np.full((len(t.edges), 2, 2), -1), 3 * np.arange(len(t.nodes))
        for k, pair in enumerate(PAIRS):
            owner = np.where(t.sign[:, k] > 0, 0, 1)
            for local, vertex in enumerate(pair):
                end = np.where(t.forward[:, k], local, 1 - local)
                corners[t.edge_of[:, k], end, owner] = numbers + vertex
        return corners

    def _inverse(self, open_: np.ndarray) -> np.ndarray:
        """Pseudo-inverses of the vertices' Laplacians, (nv, most, most); open edges ground them."""
        t, nv, most = self.triangles, len(self.triangles.points), self.most
        inner, places, values = ~t.outer, [], []
        grounded = np.zeros(nv, dtype=bool)
        grounded[t.edges[open_]] = True
        for end in (0, 1):
            base = t.edges[:, end] * most
            i, j = (self.place[c[:, end]] for c in (self._first, self._second))
            for a, b, value in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
                places.append(((base + a) * most + b)[inner])
                values.append(np.full(len(places[-1]), value))
            places.append(((base + i) * most + i)[open_])
            values.append(np.ones(len(places[-1])))
        where, what = np.concatenate(places), np.concatenate(values)
        laplacian = np.bincount(where, what, minlength=nv * most * most)
        laplacian = laplacian.reshape(nv, most, most)
        there = np.arange(most) < self.count[:, None]
        mean = np.where(grounded, 0.0, 1 / self.count)[:, None, None]
        laplacian += mean * (there[:, :, None] & there[:, None, :])
        laplacian[:, np.arange(most), np.arange(most)] += ~there
        return np.linalg.inv(laplacian)

    def moments(self, stress: np.ndarray, body_force: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The edge moments, outward of the first triangle, shape (ne, 2 ends, 2).

        Parameters
        ----------
        stress
            On each triangle, shape (nt, 2, 2), in equilibrium against the hat functions.
        body_force
            Shape (nt, 2).
        given
            Moments of the tractions on the outer boundary, shape (ne, 2, 2).

        Raises
        ------
        RuntimeError
            If rounding leaves triangles out of equilibrium: there is no bound then.
        """
        t, inner = self.triangles, ~self.triangles.outer
        known = self.boundary.given[:, None, :]
        mu = np.where(known, given, self._mean_moments(stress)[:, None])
        internal = corner_forces(t, stress, body_force).reshape(-1, 2)
        forces = np.zeros((len(t.points), self.most, 2))
        forces[t.nodes.ravel(), self.place] = self._defect(internal, mu)
        y = np.stack(
            [np.matmul(M, forces[:, :, c, None])[:, :, 0] for c, M in enumerate(self.inverses)],
            axis=2,
        )
        for end in (0, 1):
            here = y[t.edges[:, end], self.place[self._first[:, end]]]
            there = y[t.edges[:, end], self.place[self._second[:, end]]]
            mu[:, end] += np.where(known[:, 0], 0.0, here - np.where(inner[:, None], there, 0.0))
        left, size = np.abs(self._defect(internal, mu)).max(), np.abs(internal).max()
        if left > BALANCED * max(size, np.abs(mu).max()):
            raise RuntimeError(f"the stress is out of equilibrium by {left / size:.1e} of its size")
        return mu

    def _defect(self, internal: np.ndarray, mu: np.ndarray) -> np.ndarray:
        """What the moments lack at the corners, shape (3 nt, 2)."""
        defect, inner = internal.copy(), ~self.triangles.outer
        for end in (0, 1):
            gather(defect, self._first[:, end], -mu[:, end])
            gather(defect, self._second[inner, end], mu[inner, end])
        return defect

    def _mean_moments(self, stress: np.ndarray) -> np.ndarray:
        t = self.triangles
        first, second = (np.einsum("eij,ej->ei", stress[t.owners[:, k]], t.normal) for k in (0, 1))
        mean = np.where(t.outer[:, None], first, (first + second) / 2)
        return mean * (t.length / 2)[:, None]


def corner_forces(t: Triangles, stress: np.ndarray, body_force: np.ndarray) -> np.ndarray:
    """int_T sigma grad phi_i - int_T f phi_i, shape (nt, 3, 2)."""
    forces = np.matmul(t.gradients, stress) * t.area[:, None, None]
    return forces - (body_force * (t.area / 3)[:, None])[:, None]


def gather(target: np.ndarray, places: np.ndarray, values: np.ndarray) -> None:
    """Add rows of values (n, 2) to rows of the target."""
    for c in (0, 1):
        target[:, c] += np.bincount(places, values[:, c], minlength=len(target))


def end_moments(ends: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Moments with the hat functions of affine functions given at the ends (n, 2, ...)."""
    size = length.reshape(-1, *[1] * (ends.ndim - 1)) / 6
    return size * (2 * ends + ends[:, ::-1])
