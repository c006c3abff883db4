"""Displacements on a bisected copy of their mesh, by barycentric coordinates in the parents."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.bounds.contact import EDGES_OF_NGSOLVE
from ngepc.bounds.coverage import BUBBLE
from ngepc.discretisation.points import Points
from ngepc.model.elements import inverses, vertex_coordinates


class Shares(NamedTuple):
    """The ``cells`` that differ from their parents, and barycentric coordinates of their vertices.

    ``values`` have the shape (cells, ends, ends): the coordinates in the parents.
    """

    cells: np.ndarray
    values: np.ndarray


def carried_displacements(
    u: np.ndarray, shares: Shares, before: Points, after: Points, parents: np.ndarray
) -> np.ndarray:
    """The same displacements (nodes, N) on a bisected mesh, from the points of both meshes.

    Affine functions are interpolated by barycentric coordinates in the parents, the quadratic parts
    of displacements of order two by products of these.
    """
    N = before.mesh.dim
    ends = N + 1
    found = on_whole_cells(u, before, after, parents)
    nodes = after.blocks[0].nodes[shares.cells]
    there = before.blocks[0].nodes[parents[shares.cells]]
    share = shares.values
    corners = np.matmul(share, u[there[:, :ends]])
    if before.order == 2:
        a, b = np.transpose(EDGES_OF_NGSOLVE[N])
        bubbles = u[there[:, ends:]]
        along = share[:, a] - share[:, b]
        corners += BUBBLE * np.matmul(share[:, :, a] * share[:, :, b], bubbles)
        found[nodes[:, ends:]] = -np.matmul(along[:, :, a] * along[:, :, b], bubbles)
    found[nodes[:, :ends]] = corners
    return found


def on_whole_cells(
    values: np.ndarray, before: Points, after: Points, parents: np.ndarray
) -> np.ndarray:
    """Nodal values (nodes, .) on a bisected mesh, right on cells that are not cut.

    Vertices that are not moved keep their numbers.
    """
    count = before.mesh.nv
    ends = before.mesh.dim + 1
    found = np.empty((after.scalar.ndof, values.shape[1]))
    found[:count] = values[:count]
    edges = after.blocks[0].nodes[:, ends:]
    found[edges] = values[before.blocks[0].nodes[parents, ends:]]
    return found


def shares_in_parents(before: Points, after: Points, parents: np.ndarray) -> Shares:
    """Where the vertices of cells that are cut lie in their parents."""
    ends = before.mesh.dim + 1
    known = before.blocks[0].nodes[parents, :ends]
    wanted = after.blocks[0].nodes[:, :ends]
    x = vertex_coordinates(before.mesh)
    y = vertex_coordinates(after.mesh)
    moved = (x != y[: len(x)]).any(axis=1)
    other = np.flatnonzero(((known != wanted) | moved[known]).any(axis=1))
    corners = x[known[other]]
    origin = corners[:, :1]
    share = np.matmul(y[wanted[other]] - origin, inverses(corners[:, 1:] - origin))
    first = 1.0 - share.sum(axis=2, keepdims=True)
    return Shares(other, np.concatenate([first, share], axis=2))
