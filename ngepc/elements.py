"""Vertex numbers of elements, as arrays.

On a mesh that is distributed over processes there are two kinds: the elements of this process with
its own vertex numbers, and those of the whole body with numbers that all processes agree upon.
"""

from __future__ import annotations

import numpy as np
from ngsolve import Mesh

from ngepc.parallel import gathered, is_distributed, vertex_numbers

MOST_NODES = 20
"""Nodes of Netgen's largest element."""


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
