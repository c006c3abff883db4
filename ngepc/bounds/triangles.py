"""The triangles and edges of a mesh as arrays.

Edge k of a triangle lies opposite its vertex k and runs from PAIRS[k][0] to PAIRS[k][1],
counterclockwise.  The ends of an edge are its vertices in ascending order; its normal points out of
the triangle that is found first.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import Mesh

from ngepc.model.elements import element_vertices

PAIRS = ((1, 2), (2, 0), (0, 1))
"""Local vertices of edge k."""


class Triangles:
    """Geometry and neighbours of the triangles of a mesh with straight edges.

    Parameters
    ----------
    mesh
        A mesh of triangles.

    Attributes
    ----------
    points
        Vertices, shape (nv, 2).
    nodes
        Vertices of each triangle, counterclockwise, shape (nt, 3).
    jacobian, det, area
        x_1 - x_0 and x_2 - x_0 as columns, shape (nt, 2, 2); its determinant > 0; det/2.
    edges
        Vertices of each edge, ascending, shape (ne, 2).
    edge_of, sign
        Edge k of each triangle and +1 for the first of its triangles, -1 for the other one.
    owners
        The triangles of each edge, shape (ne, 2); -1 where the second one is missing.
    outer
        Boolean, shape (ne,): edges on the boundary of the body.
    length, normal
        Of the edges, shapes (ne,) and (ne, 2).
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.points = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, :2].copy()
        self.nodes = self._counterclockwise(element_vertices(mesh)[0])
        x = self.points[self.nodes]
        self.jacobian = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=2)
        self.det = determinant(self.jacobian)
        self.area = self.det / 2
        self._number_edges()
        along = np.diff(self.points[self.edges], axis=1)[:, 0]
        self.length = np.hypot(along[:, 0], along[:, 1])
        self.normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / self.length[:, None]
        self.normal[~self._first_runs_forward] *= -1

    def _counterclockwise(self, nodes: np.ndarray) -> np.ndarray:
        x = self.points[nodes]
        turned = determinant(x[:, 1:] - x[:, :1]) < 0
        nodes = nodes.copy()
        nodes[turned, 1:] = nodes[turned, :0:-1]
        return nodes

    def _number_edges(self) -> None:
        ends = np.stack([self.nodes[:, pair] for pair in PAIRS], axis=1)
        ascending = ends[:, :, 0] < ends[:, :, 1]
        keys = self.key(ends.reshape(-1, 2))
        self._keys, first, numbers = np.unique(keys, return_index=True, return_inverse=True)
        count, corner = len(first), np.arange(len(keys))
        self.edges = np.sort(ends.reshape(-1, 2)[first], axis=1)
        self.edge_of = numbers.reshape(-1, 3)
        is_first = first[numbers] == corner
        self.sign = np.where(is_first, 1.0, -1.0).reshape(-1, 3)
        self.owners = np.full((count, 2), -1)
        self.owners[numbers, np.where(is_first, 0, 1)] = corner // 3
        self.outer = self.owners[:, 1] < 0
        self.forward = ascending
        self._first_runs_forward = ascending.ravel()[first]

    def key(self, vertices: np.ndarray) -> np.ndarray:
        """One integer for each pair of vertices, whatever their order."""
        low, high = vertices.min(axis=1).astype(np.int64), vertices.max(axis=1)
        return low * len(self.points) + high

    def edges_between(self, vertices: np.ndarray) -> np.ndarray:
        """Numbers of the edges with these pairs of vertices."""
        return np.searchsorted(self._keys, self.key(vertices))

    @cached_property
    def inverse(self) -> np.ndarray:
        """Inverses of the Jacobians, shape (nt, 2, 2)."""
        J = self.jacobian
        rows = np.array([[J[:, 1, 1], -J[:, 0, 1]], [-J[:, 1, 0], J[:, 0, 0]]])
        return np.moveaxis(rows, 2, 0) / self.det[:, None, None]

    @cached_property
    def gradients(self) -> np.ndarray:
        """Gradients of the hat functions of the three vertices, shape (nt, 3, 2)."""
        inner = self.inverse
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    def per_triangle(self, of_edges: np.ndarray) -> np.ndarray:
        """Vectors at the edge ends (ne, 2, 2), outward and counterclockwise, (nt, 3, 2, 2)."""
        values = of_edges[self.edge_of] * self.sign[:, :, None, None]
        return np.where(self.forward[:, :, None, None], values, values[:, :, ::-1])


def determinant(matrices: np.ndarray) -> np.ndarray:
    """Determinants of 2 x 2 matrices."""
    return matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0]
