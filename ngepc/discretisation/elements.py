"""Vertex numbers of elements and their facets, as arrays.

On a mesh that is distributed over processes there are two kinds: the elements of this process with
its own vertex numbers, and those of the whole body with numbers that all processes agree upon.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import Mesh

from ngepc.parallel import gathered, is_distributed, vertex_numbers

MOST_NODES = 20
"""Nodes of Netgen's largest element."""

_FACETS = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    (3, 5): ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    (3, 6): ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    (3, 8): (
        (0, 1, 2, 3),
        (4, 5, 6, 7),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
    ),
}
"""Facets of Netgen's elements by (dimension, number of vertices)."""


def element_nodes(mesh: Mesh) -> np.ndarray:
    """Node numbers of the elements of this process, shape (elements, MOST_NODES), -1 for none."""
    elements = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    nodes = elements.NumPy()["nodes"].astype(int) - 1
    wide = np.full((len(nodes), MOST_NODES), -1)
    wide[:, : nodes.shape[1]] = nodes
    return wide


def element_vertices(mesh: Mesh) -> list[np.ndarray]:
    """Vertex numbers of the elements of this process, (elements, vertices) for each shape."""
    return _by_shape(element_nodes(mesh)[:, : 2**mesh.dim])


def element_numbers(mesh: Mesh) -> list[np.ndarray]:
    """Element numbers, one array for each shape, matching ``element_vertices``."""
    count = (element_nodes(mesh)[:, : 2**mesh.dim] >= 0).sum(axis=1)
    return [np.flatnonzero(count == k) for k in np.unique(count)]


def body_elements(mesh: Mesh) -> list[np.ndarray]:
    """Vertex numbers of all elements of the body, (elements, vertices) for each shape.

    The vertices are numbered as ``vertex_numbers`` says.
    """
    nodes = element_nodes(mesh)[:, : 2**mesh.dim]
    if is_distributed(mesh):
        numbers, _ = vertex_numbers(mesh)
        nodes = gathered(np.append(numbers, -1)[nodes], mesh)
    return _by_shape(nodes)


def _by_shape(nodes: np.ndarray) -> list[np.ndarray]:
    count = (nodes >= 0).sum(axis=1)
    return [nodes[count == k][:, :k] for k in np.unique(count)]


def facets_of(mesh: Mesh, name: str) -> np.ndarray:
    """The N lowest vertex numbers of each element of a boundary, sorted, shape (elements, N)."""
    numbers = vertex_numbers(mesh)[0].tolist()
    elements = mesh.Boundaries(name).Elements()
    own = [sorted(numbers[v.nr] for v in el.vertices)[: mesh.dim] for el in elements]
    return gathered(np.array(own, dtype=np.int64).reshape(-1, mesh.dim), mesh)


def corner_vertices(mesh: Mesh, names: Sequence[str]) -> np.ndarray:
    """Numbers of the vertices at the corners of all boundary elements, one after the other."""
    region = mesh.Boundaries("|".join(names))
    own = np.array([v.nr for el in region.Elements() for v in el.vertices], dtype=int)
    return gathered(vertex_numbers(mesh)[0][own], mesh)


def vertices_of(mesh: Mesh, names: Sequence[str]) -> set[int]:
    """Numbers of the vertices on the named boundaries, ends included."""
    return set(corner_vertices(mesh, names).tolist())


def element_facets(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """An integer for each facet of each element, and the number of the element.

    Elements are counted in the order of ``body_elements``.  The N lowest vertex numbers of a
    facet identify it.
    """
    keys, owners, start = [], [], 0
    for nodes in body_elements(mesh):
        numbers = np.arange(start, start + len(nodes))
        for facet in _FACETS[mesh.dim, nodes.shape[1]]:
            keys.append(combine(np.sort(nodes[:, facet], axis=1)[:, : mesh.dim], mesh))
            owners.append(numbers)
        start += len(nodes)
    return np.concatenate(keys), np.concatenate(owners)


def combine(vertices: np.ndarray, mesh: Mesh) -> np.ndarray:
    """One integer for each row of sorted vertex numbers."""
    keys, (_, count) = vertices[:, 0].astype(np.int64), vertex_numbers(mesh)
    for column in vertices.T[1:]:
        keys = keys * count + column
    return keys
