"""Pressures and tractions at the vertices of contact facets, from forces of the contact rows."""

from __future__ import annotations

import numpy as np
import scipy
from scipy.sparse import csr_matrix, diags

from ngepc.bounds.coverage import BUBBLE
from ngepc.discretisation.rows import ContactRows
from ngepc.local.system import DiscreteProblem

MIDDLE = BUBBLE / 4  # the function of an edge at its middle
WEAK = 0.1  # weight of the mean pressure beside the nodal forces where a pressure is fitted


def gathered(rows: ContactRows, of_vertices: csr_matrix) -> csr_matrix:
    """The matrix that moves forces of edge rows to the rows of the vertices, (m, m).

    The two ends of an edge take half of its force each.  If a vertex has several rows, the one with
    the nearest normal takes it.  ``of_vertices`` are the rows of each vertex.
    """
    m = len(rows)
    columns = np.repeat(np.arange(m), 4)
    pairs = of_vertices[rows.corners.ravel()].tocoo()
    column = columns[pairs.row]
    cosine = np.einsum("ic,ic->i", rows.normals[pairs.col], rows.normals[column])
    order = np.lexsort((-cosine, pairs.row))
    first = np.flatnonzero(np.diff(pairs.row[order], prepend=-1))
    chosen = order[first]
    shares = np.full(len(chosen), 0.25)
    own = csr_matrix((shares, (pairs.col[chosen], column[chosen])), shape=(m, m))
    between = np.ones(m)
    between[np.unique(of_vertices.indices)] = 0.0
    return (own + diags(between)).tocsr()


def across(normal: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """The tangential parts of vectors (facets, ., N), for the normals of the facets."""
    n = normal[:, None]
    return vectors - (vectors * n).sum(axis=2, keepdims=True) * n


class RowStresses:
    """Stresses on the contact facets of a discrete problem by forces of its rows.

    ``nodes`` (facets, .) are the vertices of the facets, followed by the edges for order two;
    ``row_of`` (facets, N) is the contact row of each vertex, -1 where a support holds it; if a
    vertex has several rows, the one whose normal is nearest to that of the facet.  ``normal`` and
    ``measure`` belong to the facets, ``hats`` (N, .) are the means of products of hat functions
    and the functions of the nodes.
    """

    def __init__(
        self,
        discrete: DiscreteProblem,
        nodes: np.ndarray,
        normal: np.ndarray,
        measure: np.ndarray,
        hats: np.ndarray,
    ) -> None:
        self.discrete = discrete
        self.problem = discrete.problem
        self.N = normal.shape[1]
        self.nodes = nodes
        self.normal = normal
        self.measure = measure
        self._hats = hats
        rows = discrete.rows
        count = self.problem.mesh.nv
        numbers = np.flatnonzero(rows.nodes < count)
        at = rows.nodes[numbers], numbers
        of_vertices = csr_matrix((np.ones(len(numbers)), at), (count, len(rows)))
        self._gathered = gathered(rows, of_vertices)
        self.row_of = self._rows_at(nodes[:, : self.N])

    def _rows_at(self, nodes: np.ndarray) -> np.ndarray:
        """The contact rows of some nodes of the facets (facets, .), as in ``row_of``."""
        rows = self.discrete.rows
        count = 1 + max(nodes.max(initial=0), rows.nodes.max(initial=0))
        at = rows.nodes, np.arange(len(rows))
        of_nodes = csr_matrix((np.ones(len(rows)), at), shape=(count, len(rows)))
        place, row = of_nodes[nodes.ravel()].nonzero()
        normal = np.repeat(self.normal, nodes.shape[1], axis=0)[place]
        cosine = np.einsum("ic,ic->i", rows.normals[row], normal)
        # comes last, so that it overwrites the others
        nearest = np.argsort(-cosine, kind="stable")[::-1]
        found = np.full(nodes.size, -1)
        found[place[nearest]] = row[nearest]
        return found.reshape(nodes.shape)

    def resultants(self, forces: np.ndarray) -> np.ndarray:
        """The part of each facet, (facets,), in forces of the rows, which act on equal areas."""
        values = np.append(forces / self.discrete.rows.weights, 0.0)
        return self.measure * values[self._rows_at(self.nodes)].mean(axis=1)

    def pressure(self, multipliers: np.ndarray) -> np.ndarray:
        """P >= 0 at the vertices from forces of the rows (stress), (facets, N).

        For order one the nodal forces of P are those of the rows.  For order two in the plane they
        are the nearest ones that a pressure affine on each facet can have.  Pressures with other
        forces make the bound less sharp.
        """
        forces = np.maximum(multipliers, 0.0)
        if self.problem.order == 2 and self.N == 3:
            pressed = np.append(forces > 0, True)[self.row_of]
            return np.where(pressed, self._means(forces), 0.0)
        P = self._means(forces)
        if self.problem.order == 1 or not P.any():
            return P
        # the tolerance of SciPy is absolute
        length = self.measure.max()
        size = P.max()
        matrix, right = self._fit(forces, P)
        positive = scipy.optimize.lsq_linear(
            matrix / length, right / (length * size), (0.0, np.inf), method="bvls"
        )
        return size * positive.x.reshape(P.shape)

    def stresses(self, forces: np.ndarray) -> np.ndarray:
        """The same for forces of any sign."""
        P = self._means(forces)
        if self.problem.order == 1 or self.N == 3 or not P.any():
            return P
        return np.linalg.lstsq(*self._fit(forces, P), rcond=None)[0].reshape(P.shape)

    def _fit(self, forces: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least squares: affine pressures near P whose nodal forces are those of the rows."""
        N = self.N
        supports = self.discrete.supports
        moments = self.measure[:, None, None] * self._hats.T
        entries = np.einsum("eka,ec->ekca", moments, self.normal)
        unknowns = np.arange(P.size).reshape(-1, 1, 1, N)
        components = N * self.nodes[:, :, None, None] + np.arange(N)[:, None]
        rows, columns = np.broadcast_arrays(components, unknowns)
        shape = (supports.free.size, P.size)
        matrix = csr_matrix((entries.ravel(), (rows.ravel(), columns.ravel())), shape)

        # Forces of an edge count with its middle, as those of a vertex with the vertex.
        scale = np.ones(supports.free.shape)
        scale[self.problem.mesh.nv :] /= abs(MIDDLE)
        free = supports.basis(np.ones(len(scale), dtype=bool))
        scaled = free @ free.T @ diags(scale.ravel())
        nodal = self.discrete.rows.normal.T @ forces
        chosen = np.unique(rows)
        known = (scaled @ nodal)[chosen]
        matrix = (scaled @ matrix)[chosen].toarray()
        weak = WEAK * np.abs(moments).max()
        system = np.vstack([matrix, weak * np.eye(P.size)])
        return system, np.append(known, weak * P.ravel())

    def _means(self, forces: np.ndarray) -> np.ndarray:
        """Forces of the rows over their areas at the vertices, (facets, N).

        A vertex that a support holds gets the mean of the other vertices of its facet.
        """
        values = np.append(self._stress(forces), 0.0)
        P = values[self.row_of]
        there = self.row_of >= 0
        mean = P.sum(axis=1) / np.maximum(there.sum(axis=1), 1)
        return np.where(there, P, mean[:, None])

    def _stress(self, forces: np.ndarray) -> np.ndarray:
        """Forces of the rows (m, ...), with edge rows distributed, over their areas, same shape."""
        area = self._gathered @ self.discrete.rows.weights
        return (self._gathered @ forces) / area.reshape(-1, *[1] * (forces.ndim - 1))

    def drag(self, forces: np.ndarray, most: np.ndarray) -> np.ndarray:
        """Tangential tractions of at most a size (facets, N), from forces of the rows (m, N)."""
        stress = np.append(self._stress(forces), np.zeros((1, self.N)), axis=0)
        T = across(self.normal, stress[self.row_of])
        size = np.linalg.norm(T, axis=2)
        return (np.minimum(size, most) / np.where(size > 0, size, 1.0))[:, :, None] * T
