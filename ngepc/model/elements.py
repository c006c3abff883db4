"""Vertex numbers of elements and their facets, as arrays, and the outer normal of a mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import (
    CF,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IfPos,
    InnerProduct,
    Mesh,
    specialcf,
)

from ngepc.checks.kinds import require_mesh

MOST_NODES = 20
"""Nodes of Netgen's largest element."""

_FACETS = {
    (2, 3): "01 12 20",
    (2, 4): "01 12 23 30",
    (3, 4): "012 013 023 123",
    (3, 5): "0123 014 124 234 304",
    (3, 6): "012 345 0143 1254 2035",
    (3, 8): "0123 4567 0154 1265 2376 3047",
}
"""Corners of the facets of Netgen's elements by (dimension, number of vertices)."""


def element_nodes(mesh: Mesh) -> np.ndarray:
    """Node numbers of the elements, shape (elements, MOST_NODES), -1 for none."""
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    nodes = elements.NumPy()["nodes"].astype(int) - 1
    wide = np.full((len(nodes), MOST_NODES), -1)
    wide[:, : nodes.shape[1]] = nodes
    return wide


def element_vertices(mesh: Mesh) -> list[np.ndarray]:
    """Vertex numbers of the elements, (elements, vertices) for each shape."""
    return _by_shape(element_nodes(mesh)[:, : 2**mesh.dim])


def element_numbers(mesh: Mesh) -> list[np.ndarray]:
    """Element numbers, one array for each shape, matching ``element_vertices``."""
    count = (element_nodes(mesh)[:, : 2**mesh.dim] >= 0).sum(axis=1)
    return [np.flatnonzero(count == k) for k in np.unique(count)]


def vertex_coordinates(mesh: Mesh) -> np.ndarray:
    """The coordinates of the vertices, shape (vertices, N)."""
    return np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]


def _by_shape(nodes: np.ndarray) -> list[np.ndarray]:
    count = (nodes >= 0).sum(axis=1)
    return [nodes[count == k][:, :k] for k in np.unique(count)]


def facets_of(mesh: Mesh, name: str) -> np.ndarray:
    """The N lowest vertex numbers of each element of a boundary, sorted, shape (elements, N)."""
    elements = mesh.Boundaries(name).Elements()
    lowest = [sorted(v.nr for v in el.vertices)[: mesh.dim] for el in elements]
    return np.array(lowest, dtype=np.int64).reshape(-1, mesh.dim)


def corner_vertices(mesh: Mesh, names: Sequence[str]) -> np.ndarray:
    """Numbers of the vertices at the corners of all boundary elements, one after the other."""
    region = mesh.Boundaries("|".join(names))
    return np.array([v.nr for el in region.Elements() for v in el.vertices], dtype=int)


def vertices_of(mesh: Mesh, names: Sequence[str]) -> set[int]:
    """Numbers of the vertices on the named boundaries, ends included."""
    return set(corner_vertices(mesh, names).tolist())


def element_facets(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """An integer for each facet of each element, and the number of the element.

    Elements are counted in the order of ``element_vertices``.  The N lowest vertex numbers of a
    facet identify it.
    """
    keys, owners, start = [], [], 0
    for nodes in element_vertices(mesh):
        numbers = np.arange(start, start + len(nodes))
        for facet in _FACETS[mesh.dim, nodes.shape[1]].split():
            corners = np.sort(nodes[:, [int(corner) for corner in facet]], axis=1)
            keys.append(combine(corners[:, : mesh.dim], mesh))
            owners.append(numbers)
        start += len(nodes)
    return np.concatenate(keys), np.concatenate(owners)


def combine(vertices: np.ndarray, mesh: Mesh) -> np.ndarray:
    """One integer for each row of sorted vertex numbers."""
    keys = vertices[:, 0].astype(np.int64)
    for column in vertices.T[1:]:
        keys = keys * mesh.nv + column
    return keys


def outward_normal(mesh: Mesh) -> CoefficientFunction:
    """The outer unit normal n of the body on its boundary, however its elements are oriented.

    ``specialcf.normal`` follows the boundary elements, which Netgen's CSG turns inward on some
    edges, on half of a hole and on a subtracted sphere.  Here the element beside it settles the
    sign: a vector v from the boundary to an inner point of it has n . v < 0.

    Returns
    -------
    CoefficientFunction
        N components, to be evaluated on boundary elements (``ds``); NGSolve keeps it valid when
        the mesh is refined or curved.

    Raises
    ------
    TypeError, ValueError
        If ``mesh`` is no mesh in two or three dimensions.
    """
    require_mesh("mesh", mesh)
    N = mesh.dim
    n = specialcf.normal(N)
    interior = CF((1 / (N + 1),) * N)
    v = BoundaryFromVolumeCF(specialcf.JacobianMatrix(N) * (interior - specialcf.xref(N)))
    return IfPos(InnerProduct(n, v), -1.0, 1.0) * n
