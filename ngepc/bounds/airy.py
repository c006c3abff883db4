"""Self-equilibrated stresses of a triangulation: Airy functions of degree three or four.

The unknowns are the value and the gradient of the function at each vertex and, on each edge, the
normal derivative at the midpoint less the mean of those at the ends.  Degree four has two more
unknowns on each edge and three on each triangle, see ``element``.

The stresses must not change given tractions: on a connected part of the traction boundary the
function is affine.  On one part it is set to zero with its gradient; on the others the three
coefficients of the affine function are unknowns, called ``modes``: the resultants of the tractions
between the parts.  On rollers, where one component c of the traction is given, the derivative with
respect to the other coordinate is constant.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.element import LEGS, NORMALS, PAIRS, airy_stresses
from ngepc.bounds.polynomials import AT_NODES, RULE, SIX, WEIGHTS, portions
from ngepc.bounds.simplices import Simplices, sliced

# entries of a symmetric matrix that are kept
FIRST, SECOND = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]).T
LEVEL = 1e-9
"""Smaller components of a unit normal and smaller eigenvalues count as zero."""


class Rule:
    """The points of a triangle at which stresses are stored, and the Airy stresses there.

    Affine stresses are stored at the edge midpoints of the three parts, quadratic ones at six
    points of each part.  ``shares`` (q, 3) are their barycentric coordinates; ``weights`` (3 q,)
    add up to one; ``nodal`` (q, q) gives values at the nodes of a part, ``rows`` (9 q, n) stresses
    times det J from the n unknowns of a triangle, ``forces`` is the same with the weights,
    ``stiffness`` (3 q, 6, n^2) the stiffness of a triangle from six compliances at each point.
    """

    def __init__(self, degree: int) -> None:
        k = {3: 3, 4: 6}[degree]
        self.shares = {3: RULE[3], 6: SIX}[k]
        self.weights = np.tile(WEIGHTS[k] / 3, 3)
        self.nodal = {3: np.eye(3), 6: AT_NODES}[k] @ np.linalg.inv(RULE[k])
        rows = airy_stresses(3, self.shares)
        if degree == 4:
            more = airy_stresses(4, self.shares)[:, :, 12:]
            rows = np.concatenate([rows, more], axis=2)
        products = np.einsum("q,qim,qjn->qijmn", self.weights, rows, rows)
        products += (1 - np.eye(3))[:, :, None, None] * products.swapaxes(1, 2)
        self.stiffness = products[:, FIRST, SECOND].reshape(len(rows), 6, -1)
        self.rows = rows.reshape(3 * len(rows), -1)
        self.forces = np.repeat(self.weights, 3)[:, None] * self.rows


RULES = {degree: Rule(degree) for degree in (3, 4)}

EDGE_ROWS = np.zeros((3, 9))
"""The tangential derivative in the middle of an edge less the mean, times its length."""
for _k, (_i, _j) in enumerate(PAIRS):
    EDGE_ROWS[_k, [3 * _j, 3 * _i]] = 1.5, -1.5
    for _v in (_i, _j):
        EDGE_ROWS[_k, 3 * _v + 1 : 3 * _v + 3] = -0.75 * LEGS[_k]

_FIRST, _SECOND = (3 * a[:, None] for a in np.tril_indices(3))
CORNER_ROWS = (_FIRST + np.repeat(np.arange(3), 3)).ravel()
# the entries of a matrix in the blocks (3, 3) of the pairs of vertices ``np.tril_indices(3)``
CORNER_COLUMNS = (_SECOND + np.tile(np.arange(3), 3)).ravel()


def bodies_of(cells: Simplices) -> list[np.ndarray]:
    """The vertices of each connected part of a triangulation."""
    count = len(cells.points)
    start, end = cells.facets.T
    sides = csr_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    number = connected_components(sides, directed=False)[1]
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


class AirySpace:
    """The Airy functions of a triangulation.

    ``unknowns`` (nt, n) are the numbers of the unknowns of each triangle: first ``vertices``
    unknowns of vertices, three each, then those of edges.  The unknowns that are ``free`` do not
    change given tractions.  ``area`` (nt,) are the areas of the triangles.
    """

    of_triangles = ("det", "area", "unknowns", "piola", "_turned", "_along", "_others")

    def __init__(self, boundary: Boundary, degree: int, piola: np.ndarray) -> None:
        self._boundary = boundary
        self.rule = RULES[degree]
        self.piola = piola
        c = self._cells = boundary.cells
        self.det = c.det
        self.area = c.volume
        self.vertices = 3 * len(c.points)
        nt = len(c.nodes)
        ne = len(c.facets)
        corners = (3 * c.nodes[:, :, None] + np.arange(3)).reshape(-1, 9)
        unknowns = [corners, self.vertices + c.facet_of]
        self._bodies = bodies_of(c)
        held, bend, even = self._held()
        free = [~held, bend]
        if degree == 4:
            unknowns += [unknowns[1] + ne, unknowns[1] + 2 * ne]
            unknowns += [self.vertices + 3 * ne + np.arange(3 * nt).reshape(-1, 3)]
            free += [even, bend, np.ones(3 * nt, dtype=bool)]
        self.unknowns = np.concatenate(unknowns, axis=1)
        self.free = np.concatenate(free)
        self._set_maps(self.unknowns.shape[1])

    def _held(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fixed unknowns of vertices; edges whose unknowns ``bend`` and ``even`` are free."""
        c = self._cells
        given = self._boundary.given
        row = np.arange(len(self._cells.facets))
        both = c.outer & given.all(axis=1)
        single = c.outer & given.any(axis=1) & ~both
        component = np.where(given[:, 0], 0, 1)
        level = np.abs(c.normal) < LEVEL
        across = single & level[row, component]
        along = single & level[row, 1 - component]
        closed = both | (single & ~across & ~along)
        # edges along which the function is affine:
        self._affine = closed | along
        self._constant = [
            closed | ((component == k) & (across | along)) for k in (0, 1)
        ]
        vertex = np.zeros((len(c.points), 3), dtype=bool)
        vertex[c.facets[self._affine].ravel(), 0] = True
        for k, edges in enumerate(self._constant):  # of dPhi/dx_(1 - k)
            vertex[c.facets[edges].ravel(), 2 - k] = True
        for body in self._bodies:  # what no stress sees
            most = body[vertex[body].sum(axis=1).argmax()]
            vertex[most] |= ~vertex[body].any(axis=0)
        return vertex.ravel(), ~(closed | across), ~self._affine

    def modes(self) -> np.ndarray:
        """Changes of the fixed unknowns that keep the tractions, shape (modes, unknowns)."""
        c = self._cells
        free = self.free[: self.vertices]
        held = np.flatnonzero(~free)
        length = c.measure.mean()
        count = ~free.reshape(-1, 3) * (~free.reshape(-1, 3)).sum(axis=1, keepdims=True)
        rows = []
        for body in self._bodies:  # what no stress sees
            pinned = 3 * body[count[body].argmax(axis=0)] + np.arange(3)
            row = np.zeros((3, self.vertices))
            row[np.arange(3), pinned] = 1.0
            rows.append(row)
        for k, edges in enumerate(self._constant):
            row = np.zeros((edges.sum(), self.vertices))
            for end, sign in zip(c.facets[edges].T, (-1.0, 1.0), strict=True):
                row[np.arange(len(row)), 3 * end + 2 - k] = sign
            rows.append(row)
        start, end = c.facets[self._affine].T
        row = np.zeros((len(start), self.vertices))
        there = np.arange(len(start))
        row[there, 3 * end], row[there, 3 * start] = 1.0, -1.0
        for k in (0, 1):
            row[there, 3 * start + 1 + k] = (
                c.points[start, k] - c.points[end, k]
            ) / length
        equations = np.concatenate([*rows, row])[:, held]
        squares = equations.T @ equations
        _, vectors = eigh(squares, subset_by_value=(-np.inf, LEVEL * squares.max()))
        result = np.zeros((vectors.shape[1], len(self.free)))
        result[:, held] = vectors.T / np.where(held % 3, length, 1.0)
        return result

    def of(self, chosen: np.ndarray | slice) -> AirySpace:
        """The space on some of the triangles, with the same unknowns."""
        return sliced(self, chosen, self.of_triangles)

    def gathered(self, local: np.ndarray) -> np.ndarray:
        """Sums over the triangles of values for their unknowns (nt, n)."""
        return np.bincount(
            self.unknowns.ravel(), local.ravel(), minlength=len(self.free)
        )

    def _set_maps(self, n: int) -> None:
        """The parts of the map from the unknowns of a triangle to those of the reference.

        ``_turned`` (nt, 3, 3) maps value and gradient at a vertex.  The first three of the n - 9
        others have ``_along`` (nt, 3) times the products of ``EDGE_ROWS`` with these, in addition
        to the product of all others with ``_others`` (nt, n - 9, n - 9).
        """
        c = self._cells
        k = np.arange(3)
        J = c.jacobian.swapaxes(1, 2)
        directions = np.matmul(NORMALS, J)
        tangents = np.matmul(LEGS, J)  # images of the normals
        across = np.einsum("tki,tki->tk", directions, c.normal[c.facet_of])
        size = np.einsum("tki,tki->tk", tangents, tangents)
        along = np.einsum("tki,tki->tk", directions, tangents) / size
        self._along = along
        self._turned = np.zeros((len(J), 3, 3))
        self._turned[:, 0, 0] = 1.0
        self._turned[:, 1:, 1:] = J
        others = self._others = np.zeros((len(J), n - 9, n - 9))
        others[:, k, k] = across
        if n > 12:
            others[:, 6 + k, 6 + k] = across * np.where(
                c.place[:, :, 0] == 0, 1.0, -1.0
            )
            others[:, 6 + k, 3 + k] = along
            rest = np.r_[3:6, 9:12]
            others[:, rest, rest] = 1.0

    def _on_reference(self, local: np.ndarray) -> np.ndarray:
        """Unknowns of the reference triangle from those of the mesh, both (nt, n)."""
        at_vertices = local[:, :9].reshape(-1, 3, 3)
        corners = np.matmul(at_vertices, self._turned.swapaxes(1, 2)).reshape(-1, 9)
        others = np.einsum("tij,tj->ti", self._others, local[:, 9:])
        others[:, :3] += self._along * (corners @ EDGE_ROWS.T)
        return np.concatenate([corners, others], axis=1)

    def _from_reference(self, forces: np.ndarray) -> np.ndarray:
        """The transpose of this map."""
        corners = forces[:, :9] + (self._along * forces[:, 9:12]) @ EDGE_ROWS
        corners = np.matmul(corners.reshape(-1, 3, 3), self._turned).reshape(-1, 9)
        others = np.einsum("tij,ti->tj", self._others, forces[:, 9:])
        return np.concatenate([corners, others], axis=1)

    def _blocks(self, K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The blocks of T' K T for stiffness matrices K (nt, n, n) on the reference triangle.

        T is the map to the reference triangle; the blocks are those of the vertices (nt, 9, 9), of
        the others with these, and of the others.
        """
        others = K[:, 9:, 9:]
        bent = (others[:, :, :3] * self._along[:, None]).reshape(-1, 3) @ EDGE_ROWS
        bent = bent.reshape(len(K), -1, 9)
        cross = K[:, 9:, :9] + bent
        both = (K[:, 9:12, :9] + bent[:, :3] / 2).swapaxes(1, 2) * self._along[:, None]
        both = (both.reshape(-1, 3) @ EDGE_ROWS).reshape(-1, 9, 9)
        corners = K[:, :9, :9] + both + both.swapaxes(1, 2)
        for _ in range(2):  # the matrix is symmetric
            turned = np.matmul(corners.reshape(-1, 27, 3), self._turned)
            corners = turned.reshape(-1, 9, 9).swapaxes(1, 2)
        turned = np.matmul(cross.reshape(len(K), -1, 3), self._turned)
        R = self._others.swapaxes(1, 2)
        cross = np.matmul(R, turned.reshape(cross.shape))
        return corners, cross, np.matmul(np.matmul(R, others), self._others)

    def stiffness(self, H: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Stiffness of the triangles from d2 phi*/dz2 at one point or all, (nt, ., 3, 3).

        The entries of the vertices, (nt, 54), and the rows of the n - 9 other unknowns: their first
        nine columns, then the rest.
        """
        nt, n = self.unknowns.shape
        table = self.rule.stiffness
        table = (table if H.shape[1] > 1 else table.sum(axis=0)).reshape(-1, n * n)
        corners, cross, rest = (
            np.empty((nt, *k)) for k in ((54,), (n - 9, 9), (n - 9, n - 9))
        )
        for cells in portions(nt):
            part = self.of(cells)
            M = part.piola * (np.sqrt(part.area) / part.det)[:, None, None]
            # six entries of M H M'
            products = M[:, FIRST, :, None] * M[:, SECOND, None]
            six = np.matmul(
                H[cells].reshape(len(M), -1, 9),
                products.reshape(-1, 6, 9).swapaxes(1, 2),
            )
            K = (six.reshape(len(M), -1) @ table).reshape(-1, n, n)
            of_vertices, cross[cells], rest[cells] = part._blocks(K)
            corners[cells] = of_vertices[:, CORNER_ROWS, CORNER_COLUMNS]
        return corners, cross, rest

    def stress(self, x: np.ndarray) -> np.ndarray:
        """In-plane stress coordinates at the points, (nt, points, 3), of all unknowns x."""
        result = np.empty((len(self.det), len(self.rule.weights), 3))
        for cells in portions(len(result)):
            part = self.of(cells)
            local = x[part.unknowns] / part.det[:, None]
            reference = part._on_reference(local) @ self.rule.rows.T
            result[cells] = np.matmul(reference.reshape(len(local), -1, 3), part.piola)
        return result

    def at_nodes(self, z: np.ndarray) -> np.ndarray:
        """Values at the nodes of the parts from values (nt, points, c) at the points."""
        parts = z.reshape(len(z), 3, -1, z.shape[2])
        return np.matmul(self.rule.nodal, parts).reshape(z.shape)

    def forces(self, strain: np.ndarray) -> np.ndarray:
        """The transpose of ``stress`` with the weights of the points, by triangle, (nt, n)."""
        M = self.piola * (self.area / self.det)[:, None, None]
        pulled = np.matmul(strain, M.swapaxes(1, 2)).reshape(len(M), -1)
        return self._from_reference(pulled @ self.rule.forces)
