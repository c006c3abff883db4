"""Self-equilibrated stresses of a triangulation: Airy functions, and the least dual energy on them.

Unknowns are the value and the gradient of the Airy function at each vertex and, on each edge, by
how much its normal derivative in the middle exceeds the mean of those at the ends.  Where
tractions are given the function and its gradient vanish, so that tractions stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import TO_PLANE
from ngepc.bounds.element import AIRY_MAP, CORNERS, NORMALS, rows_at
from ngepc.bounds.held import Held
from ngepc.bounds.parts import RULE, portions
from ngepc.bounds.simplices import sliced
from ngepc.bounds.triangles import PAIRS, Triangles

VOIGT = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
class Rule:
    """The points of a triangle at which stresses are known, and those of Airy functions there.

    ``shares`` (q, 3) are barycentric coordinates of the points of each of the three parts,
    ``weights`` (3 q,) of all points add up to one, ``rows`` (9 q, n) give stresses times det J from
    the n unknowns of a triangle, ``nodal`` (q, q) values at the nodes of a part from those at its
    points.
    """

    shares: np.ndarray
    weights: np.ndarray
    rows: np.ndarray
    nodal: np.ndarray

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Stiffness of a triangle from the six compliances at the points, (6, 3 q, n^2)."""
        points, n = len(self.weights), self.rows.shape[1]
        result = np.empty((6, points, n, n))
        for q, rows in enumerate(self.rows.reshape(points, 3, n)):
            for c, (i, j) in enumerate(VOIGT):
                product = self.weights[q] * np.outer(rows[i], rows[j])
                result[c, q] = product if i == j else product + product.T
        return result.reshape(6, points, n * n)

    @cached_property
    def forces(self) -> np.ndarray:
        """The transpose of ``rows`` with the weights, shape (9 q, n)."""
        return np.repeat(self.weights, 3)[:, None] * self.rows


CUBIC = Rule(RULE[3], np.full(9, 1 / 9), rows_at(RULE[3], AIRY_MAP), np.linalg.inv(RULE[3]))
"""Affine stresses, known at the edge midpoints."""


def _edge_rows() -> np.ndarray:
    """How far the tangential derivative in the middle exceeds the mean, times L, (3, 9)."""
    rows = np.zeros((3, 9))
    for k, (i, j) in enumerate(PAIRS):
        rows[k, 3 * j], rows[k, 3 * i] = 1.5, -1.5
        for v in (i, j):
            rows[k, 3 * v + 1 : 3 * v + 3] = -0.75 * (CORNERS[j] - CORNERS[i])
    return rows


_BLOCKS, _THREE = np.array(np.tril_indices(3))[:, :, None, None], np.arange(3)
CORNER_ROWS = np.broadcast_to(3 * _BLOCKS[0] + _THREE[:, None], (6, 3, 3)).ravel()
CORNER_COLUMNS = np.broadcast_to(3 * _BLOCKS[1] + _THREE, (6, 3, 3)).ravel()
"""The entries of a matrix that ``TriangleBlocks.corners`` has."""

GRADIENTS = [slice(3 * v + 1, 3 * v + 3) for v in range(3)]
EDGE_ROWS = _edge_rows()


class TriangleBlocks(NamedTuple):
    """Stiffness matrices of triangles, nine unknowns of the vertices first.

    ``corners`` (nt, 54) has the blocks (3, 3) of the pairs of vertices ``np.tril_indices(3)``,
    ``cross`` and ``rest`` the rows of the n - 9 others: their first nine columns, then the rest.
    """

    corners: np.ndarray
    cross: np.ndarray
    rest: np.ndarray


class AirySpace:
    """The Airy functions of a triangulation; unknowns are those of the vertices, then the edges.

    Parameters
    ----------
    boundary
        Which tractions are given.

    Attributes
    ----------
    jacobian, det, area
        Of the triangles.
    unknowns
        Those of each triangle, shape (nt, 12).
    vertices, held
        How many of the unknowns are those of vertices; which ones are held.
    to_plane
        In-plane stress coordinates of reference stresses, shape (nt, 3, 3).
    rule
        The points at which stresses are known.
    """

    rule = CUBIC
    of_triangles = ("jacobian", "det", "area", "unknowns", "to_plane", "_across", "_along")

    def __init__(self, boundary: Boundary) -> None:
        t = boundary.triangles
        self.jacobian, self.det, self.area = t.jacobian, t.det, t.volume
        self.to_plane = np.matmul(TO_PLANE, piola(t.jacobian) / t.det[:, None, None])
        self._edge_map(t)
        self.held, self.vertices = Held(boundary), 3 * len(t.points)
        corners = (3 * t.nodes[:, :, None] + np.arange(3)).reshape(-1, 9)
        self.unknowns = np.concatenate([corners, self.vertices + t.facet_of], axis=1)

    @property
    def weights(self) -> np.ndarray:
        """Of the points, shape (points,)."""
        return self.rule.weights

    def of(self, chosen: np.ndarray | slice) -> AirySpace:
        """The same unknowns, some of the triangles."""
        return sliced(self, chosen, self.of_triangles)

    def _edge_map(self, t: Triangles) -> None:
        """The edge unknowns of the reference triangle: across * unknown + along * EDGE_ROWS."""
        directions = np.matmul(t.jacobian, NORMALS.T).transpose(0, 2, 1)  # images of the normals
        tangents = np.matmul(t.jacobian, (CORNERS[[2, 0, 1]] - CORNERS[[1, 2, 0]]).T)
        tangents = tangents.transpose(0, 2, 1)
        square = np.einsum("tki,tki->tk", tangents, tangents)
        self._across = np.einsum("tki,tki->tk", directions, t.normal[t.facet_of])
        self._along = np.einsum("tki,tki->tk", directions, tangents) / square

    def gathered(self, local: np.ndarray) -> np.ndarray:
        """Sums over the triangles of what each says about its unknowns (nt, n)."""
        return np.bincount(self.unknowns.ravel(), local.ravel(), minlength=len(self.held.free))

    def reference(self, local: np.ndarray) -> np.ndarray:
        """Unknowns of the reference triangle, shape (nt, n)."""
        result, J = local.copy(), self.jacobian
        for pair in GRADIENTS:
            turn(result[:, pair], J.swapaxes(1, 2))
        result[:, 9:12] *= self._across
        result[:, 9:12] += self._along * (result[:, :9] @ EDGE_ROWS.T)
        return result

    def _transposed(self, reference: np.ndarray) -> np.ndarray:
        """The transpose of ``reference``."""
        result = reference.copy()
        result[:, :9] += (self._along * reference[:, 9:12]) @ EDGE_ROWS
        result[:, 9:12] *= self._across
        for pair in GRADIENTS:
            turn(result[:, pair], self.jacobian)
        return result

    def stiffness(self, H: np.ndarray) -> TriangleBlocks:
        """The stiffness from d2 phi*/dz2 at one point or all, (nt, ., 3, 3)."""
        nt, n = self.unknowns.shape
        blocks = TriangleBlocks(
            np.empty((nt, 54)), np.empty((nt, n - 9, 9)), np.empty((nt, n - 9, n - 9))
        )
        corners = n * CORNER_ROWS + CORNER_COLUMNS
        for part in portions(nt):
            K = self.of(part)._matrices(H[part])
            blocks.corners[part] = K.reshape(n * n, -1)[corners].T
            blocks.cross[part], blocks.rest[part] = (
                K[9:, own].transpose(2, 0, 1) for own in (slice(9), slice(9, n))
            )
        return blocks

    def _matrices(self, H: np.ndarray) -> np.ndarray:
        """Stiffness matrices (n, n, nt)."""
        scale = np.sqrt(self.area) / self.det
        M = (self.to_plane * scale[:, None, None]).transpose(1, 2, 0)
        six = congruent(H.transpose(2, 3, 1, 0), M).reshape(6 * H.shape[1], -1)
        table, n = self.rule.stiffness, self.rule.rows.shape[1]
        table = table if H.shape[1] == table.shape[1] else table.sum(axis=1)
        K = (table.reshape(-1, n * n).T @ six).reshape(n, n, -1)
        self._in_unknowns(K)
        return K

    def _in_unknowns(self, K: np.ndarray) -> None:
        """From unknowns of the reference triangle to those of the mesh, (n, n, nt) in place.

        What stands above the diagonal, beside the blocks of the corners, is not needed.
        """
        along, across = self._along.T.copy(), self._across.T.copy()
        (a, b), (c, d) = self.jacobian.transpose(1, 2, 0).copy()
        ends = [(k, slice(3 * v, 3 * v + 3)) for k in range(3) for v in PAIRS[k]]
        for k, own in ends:  # first the rows, then the columns of the vertices
            K[own] += EDGE_ROWS[k, own, None, None] * (along[k] * K[9 + k])
        for k, own in ends:
            K[:, own] += EDGE_ROWS[k, own, None] * (along[k] * K[:, 9 + k])[:, None]
        K[9:12] *= across[:, None]
        K[9:, 9:12] *= across
        corners = K[:9, :9]
        for v in (1, 4, 7):
            x, y = corners[v].copy(), corners[v + 1]
            corners[v], corners[v + 1] = a * x + b * y, c * x + d * y
        for v in (1, 4, 7):
            x, y = K[:, v].copy(), K[:, v + 1]
            K[:, v], K[:, v + 1] = a * x + b * y, c * x + d * y

    def stress(self, x: np.ndarray) -> np.ndarray:
        """In-plane stress coordinates at the points, (nt, points, 3), of all unknowns x."""
        result = np.empty((len(self.det), len(self.weights), 3))
        for cells in portions(len(result)):
            part = self.of(cells)
            reference = part.reference(x[part.unknowns]) / part.det[:, None]
            result[cells] = part.in_plane(reference @ self.rule.rows.T)
        return result

    def in_plane(self, reference: np.ndarray) -> np.ndarray:
        """In-plane coordinates (nt, points, 3) of stresses on the reference triangle (nt, .)."""
        points = reference.reshape(len(reference), -1, 3)
        return np.matmul(points, self.to_plane.transpose(0, 2, 1))

    def at_nodes(self, z: np.ndarray) -> np.ndarray:
        """Values (nt, points, c) at the points as those at the nodes of the parts."""
        parts = z.reshape(len(z), 3, -1, z.shape[2])
        return np.matmul(self.rule.nodal, parts).reshape(z.shape)

    def forces(self, strain: np.ndarray) -> np.ndarray:
        """The transpose of ``stress`` with the weights of the points, by triangle, (nt, n)."""
        M = self.to_plane * (self.area / self.det)[:, None, None]
        strain = np.matmul(strain, M).reshape(len(M), -1)
        return self._transposed(strain @ self.rule.forces)


def turn(pairs: np.ndarray, J: np.ndarray) -> None:
    """Replace pairs g (..., 2) by J g, in place."""
    first = J[..., 0, 0] * pairs[..., 0] + J[..., 0, 1] * pairs[..., 1]
    pairs[..., 1] = J[..., 1, 0] * pairs[..., 0] + J[..., 1, 1] * pairs[..., 1]
    pairs[..., 0] = first


def congruent(H: np.ndarray, M: np.ndarray) -> np.ndarray:
    """The entries VOIGT of M' H M for H (3, 3, points, n) and M (3, 3, n), (6, points, n)."""
    HM = [[sum(H[i, k] * M[k, j] for k in range(3)) for j in range(3)] for i in range(3)]
    return np.stack([sum(M[k, i] * HM[k][j] for k in range(3)) for i, j in VOIGT])


def piola(J: np.ndarray) -> np.ndarray:
    """J s J' for symmetric s as a matrix on (xx, yy, xy), shape (n, 3, 3)."""
    a, b, c, d = J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1]
    rows = [[a * a, b * b, 2 * a * b], [c * c, d * d, 2 * c * d], [a * c, b * d, a * d + b * c]]
    return np.moveaxis(np.array(rows), 2, 0)
