"""Self-equilibrated stresses of a triangulation: Airy functions, and the least dual energy on them.

Unknowns are the value and the gradient of the Airy function at each vertex and, on each edge, by
how much its normal derivative in the middle exceeds the mean of those at the ends.  Where
tractions are given the function and its gradient vanish, so that tractions stay as they are.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import TO_PLANE
from ngepc.bounds.element import AIRY_MAP, CORNERS, NORMALS, midpoint_rows
from ngepc.bounds.held import Held
from ngepc.bounds.simplices import sliced
from ngepc.bounds.triangles import PAIRS, Triangles

AIRY_POINTS = midpoint_rows(AIRY_MAP)
"""Stresses times det J at the nine midpoints from the unknowns of a triangle, (27, 12)."""

VOIGT = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _stiffness_map() -> np.ndarray:
    """Stiffness of a triangle from the six compliances at the nine points, (6, 9, 144)."""
    result = np.empty((6, 9, 12, 12))
    for q, rows in enumerate(AIRY_POINTS.reshape(9, 3, 12)):
        for c, (i, j) in enumerate(VOIGT):
            product = np.outer(rows[i], rows[j])
            result[c, q] = product if i == j else product + product.T
    return result.reshape(6, 9, 144)


STIFFNESS_MAP = _stiffness_map()


def _edge_rows() -> np.ndarray:
    """How far the tangential derivative in the middle exceeds the mean, times L, (3, 9)."""
    rows = np.zeros((3, 9))
    for k, (i, j) in enumerate(PAIRS):
        rows[k, 3 * j], rows[k, 3 * i] = 1.5, -1.5
        for v in (i, j):
            rows[k, 3 * v + 1 : 3 * v + 3] = -0.75 * (CORNERS[j] - CORNERS[i])
    return rows


GRADIENTS = [slice(3 * v + 1, 3 * v + 3) for v in range(3)]
EDGE_ROWS = _edge_rows()


OF_TRIANGLES = ("jacobian", "det", "area", "unknowns", "to_plane", "_across", "_along")


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
    """

    def __init__(self, boundary: Boundary) -> None:
        t = boundary.triangles
        self.jacobian, self.det, self.area = t.jacobian, t.det, t.area
        self.to_plane = np.matmul(TO_PLANE, piola(t.jacobian) / t.det[:, None, None])
        self._edge_map(t)
        self.held, self.vertices = Held(boundary), 3 * len(t.points)
        corners = (3 * t.nodes[:, :, None] + np.arange(3)).reshape(-1, 9)
        self.unknowns = np.concatenate([corners, self.vertices + t.edge_of], axis=1)

    def of(self, chosen: np.ndarray | slice) -> AirySpace:
        """The same unknowns, some of the triangles."""
        return sliced(self, chosen, OF_TRIANGLES)

    def _edge_map(self, t: Triangles) -> None:
        """The edge unknowns of the reference triangle: across * unknown + along * EDGE_ROWS."""
        directions = np.matmul(t.jacobian, NORMALS.T).transpose(0, 2, 1)  # images of the normals
        tangents = np.matmul(t.jacobian, (CORNERS[[2, 0, 1]] - CORNERS[[1, 2, 0]]).T)
        tangents = tangents.transpose(0, 2, 1)
        square = np.einsum("tki,tki->tk", tangents, tangents)
        self._across = np.einsum("tki,tki->tk", directions, t.normal[t.edge_of])
        self._along = np.einsum("tki,tki->tk", directions, tangents) / square

    def gathered(self, local: np.ndarray) -> np.ndarray:
        """Sums over the triangles of what each says about its unknowns (nt, 12)."""
        return np.bincount(self.unknowns.ravel(), local.ravel(), minlength=len(self.held.free))

    def reference(self, local: np.ndarray) -> np.ndarray:
        """Unknowns of the reference triangle, shape (nt, 12)."""
        result, J = local.copy(), self.jacobian
        for pair in GRADIENTS:
            turn(result[:, pair], J.swapaxes(1, 2))
        result[:, 9:] *= self._across
        result[:, 9:] += self._along * (result[:, :9] @ EDGE_ROWS.T)
        return result

    def _transposed(self, reference: np.ndarray) -> np.ndarray:
        """The transpose of ``reference``."""
        result = reference.copy()
        result[:, :9] += (self._along * reference[:, 9:]) @ EDGE_ROWS
        result[:, 9:] *= self._across
        for pair in GRADIENTS:
            turn(result[:, pair], self.jacobian)
        return result

    def stiffness(self, H: np.ndarray) -> np.ndarray:
        """Stiffness matrices (nt, 12, 12) from d2 phi*/dz2 at one point or nine (nt, ., 3, 3)."""
        scale = np.sqrt(self.area / 9) / self.det
        M = (self.to_plane * scale[:, None, None]).transpose(1, 2, 0)
        six = congruent(H.transpose(2, 3, 1, 0), M).reshape(6 * H.shape[1], -1)
        table = STIFFNESS_MAP if H.shape[1] == 9 else STIFFNESS_MAP.sum(axis=1)
        K = (table.reshape(-1, 144).T @ six).reshape(12, 12, -1)
        self._in_unknowns(K)
        return np.ascontiguousarray(K.reshape(144, -1).T).reshape(-1, 12, 12)

    def _in_unknowns(self, K: np.ndarray) -> None:
        """From unknowns of the reference triangle to those of the mesh, (12, 12, nt) in place."""
        along, across = self._along.T.copy(), self._across.T.copy()
        (a, b), (c, d) = self.jacobian.transpose(1, 2, 0).copy()
        rows = EDGE_ROWS.T[:, :, None]
        for k in range(3):  # first the rows, then the columns of the vertices
            K[:9] += rows[:, k, None] * (along[k] * K[9 + k])
        for k in range(3):
            K[:, :9] += rows[:, k] * (along[k] * K[:, 9 + k])[:, None]
        K[9:] *= across[:, None]
        K[:, 9:] *= across
        for v in (1, 4, 7):
            x, y = K[v].copy(), K[v + 1]
            K[v], K[v + 1] = a * x + b * y, c * x + d * y
        for v in (1, 4, 7):
            x, y = K[:, v].copy(), K[:, v + 1]
            K[:, v], K[:, v + 1] = a * x + b * y, c * x + d * y

    def stress(self, x: np.ndarray) -> np.ndarray:
        """In-plane stress coordinates at the midpoints, shape (nt, 9, 3), of all unknowns x."""
        reference = self.reference(x[self.unknowns]) / self.det[:, None]
        return self.in_plane(reference @ AIRY_POINTS.T)

    def in_plane(self, reference: np.ndarray) -> np.ndarray:
        """In-plane coordinates (nt, 9, 3) of stresses on the reference triangle (nt, 27)."""
        return np.matmul(reference.reshape(-1, 9, 3), self.to_plane.transpose(0, 2, 1))

    def forces(self, strain: np.ndarray) -> np.ndarray:
        """The transpose of ``stress`` with the weights of the points, shape (3 nv + ne,)."""
        M = self.to_plane * (self.area / 9 / self.det)[:, None, None]
        local = self._transposed(np.matmul(strain, M).reshape(-1, 27) @ AIRY_POINTS)
        return self.gathered(local)

    def product(self, z: np.ndarray, strain: np.ndarray) -> float:
        """The integral of stress times strain, both (nt, 9, 3)."""
        return float(self.area @ np.einsum("tqc,tqc->t", z, strain)) / 9


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
