"""Rigid motions that the supports of a body leave free.

On a conforming P1 mesh eps(u) = 0 leaves one rigid motion for each part of the mesh whose
elements hang together by facets.  The parts are coupled at the vertices they share, so that two
blocks joined along an edge are found to hinge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from ngsolve import Mesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.model.elements import element_vertices, vertex_coordinates
from ngepc.model.given import Given
from ngepc.model.normals import outward_normal
from ngepc.model.places import Place, values_at, vertices_at


def check_conforming(keys: np.ndarray, owners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of elements that share a facet; at most two do, and at most one facet."""
    order = np.argsort(keys, kind="stable")
    keys, owners = keys[order], owners[order]
    same = keys[1:] == keys[:-1]
    if (same[1:] & same[:-1]).any():
        raise ValueError("mesh has elements that overlap: a facet belongs to more than two")
    shared = np.flatnonzero(same)
    a, b = owners[shared], owners[shared + 1]
    pairs = np.sort(a * (owners.max() + 1) + b)
    if (pairs[1:] == pairs[:-1]).any():
        raise ValueError("mesh has elements that overlap: two of them share several facets")
    return a, b


def oblique(problem: Given) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that rollers or springs hold, (k,), and the directions, (k, N)."""
    mesh, found = problem.mesh, [(np.zeros(0, dtype=int), np.zeros((0, problem.N)))]
    for place, roller in problem.rollers.items():
        found.append(directed(mesh, place, roller.direction))
    for place, k in problem.spring_constants.items():
        if isinstance(k, tuple | list | np.ndarray):
            parts = [(axis, one) for axis, one in zip(np.eye(problem.N), k, strict=True)]
        else:
            parts = [(None, k)]
        for axis, one in parts:
            stiff = values_at(one, mesh, place)
            if stiff[1].max(initial=0.0) > 0:
                found.append(directed(mesh, place, axis))
    vertices, directions = (np.concatenate(part) for part in zip(*found, strict=True))
    return vertices, directions


def directed(
    mesh: Mesh, place: Place, direction: Sequence[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of a place, with one unit vector or the normals of the boundary elements there."""
    if direction is None:
        return values_at(outward_normal(mesh), mesh, place)
    vertices = vertices_at(place, mesh)
    return vertices, np.tile(np.array(direction) / np.linalg.norm(direction), (len(vertices), 1))


def free_motions(
    problem: Given, held: np.ndarray, pairs: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Free rigid motions at the vertices, (vertices, N, k), and the vertices of a part that moves.

    ``pairs`` are those of ``part_vertices``; parts with common vertices are looked at together.
    """
    if problem.kinematics.hoop:  # u_r / r is a strain: only the motion along the axis is free
        held = held | np.array([True, False])
    vertices, axes = np.nonzero(held)
    also, directions = oblique(problem)
    vertices = np.concatenate([vertices, also])
    directions = np.vstack([np.eye(problem.N)[axes], directions])
    x = vertex_coordinates(problem.mesh)
    scaled = x / np.ptp(x[pairs[:, 1]], axis=0).max()
    parts = pairs[-1, 0] + 1
    by_vertex = pairs[np.argsort(pairs[:, 1], kind="stable")]
    again = np.flatnonzero(by_vertex[1:, 1] == by_vertex[:-1, 1])
    joints = np.column_stack([by_vertex[again, 0], by_vertex[again + 1]])
    group = connected(parts, joints[:, 0], joints[:, 1])
    for number in np.unique(group):
        members = np.flatnonzero(group == number)
        equations = [
            _held_rows(pairs, vertices, directions, scaled, members, part) for part in members
        ]
        equations += _joint_rows(joints[np.isin(joints[:, 0], members)], scaled, members)
        free = mechanisms(np.vstack(equations), len(members))
        if len(free):
            motions = np.zeros((*x.shape, len(free)))
            for part, coefficients in zip(members, free.transpose(1, 2, 0), strict=True):
                v = pairs[pairs[:, 0] == part, 1]
                motions[v] = _at(scaled[v]) @ coefficients
            moving = np.linalg.norm(free[-1], axis=1).argmax()
            yield motions, pairs[pairs[:, 0] == members[moving], 1]


def mechanisms(equations: np.ndarray, parts: int) -> np.ndarray:
    """The free rigid motions as coefficients of ``rigid_rows`` part by part, (k, parts, ...)."""
    columns = equations.shape[1]
    R = np.linalg.qr(np.vstack([equations, np.zeros((columns, columns))]), mode="r")
    _, size, motion = np.linalg.svd(R)
    return motion[size <= 1e-8].reshape(-1, parts, columns // parts)


def _at(x: np.ndarray) -> np.ndarray:
    """All rigid motions at points (n, N): (n, N, N(N+1)/2)."""
    axes = np.eye(x.shape[1])
    return np.stack([rigid_rows(x, np.tile(axis, (len(x), 1))) for axis in axes], axis=1)


def _held_rows(
    pairs: np.ndarray,
    vertices: np.ndarray,
    directions: np.ndarray,
    x: np.ndarray,
    members: np.ndarray,
    part: int,
) -> np.ndarray:
    """Equations for the held directions of one part, reduced to as many as it has motions."""
    here = np.isin(vertices, pairs[pairs[:, 0] == part, 1])
    R = np.linalg.qr(rigid_rows(x[vertices[here]], directions[here]), mode="r")
    return _placed(R, members, part)


def _joint_rows(joints: np.ndarray, x: np.ndarray, members: np.ndarray) -> list[np.ndarray]:
    """Equations for the equal displacements of parts a, b at a common vertex v."""
    N = x.shape[1]
    equations = []
    for a, b, v in joints:
        rows = rigid_rows(np.repeat(x[v][None], N, axis=0), np.eye(N))
        equations.append(_placed(rows, members, a) - _placed(rows, members, b))
    return equations


def _placed(rows: np.ndarray, members: np.ndarray, part: int) -> np.ndarray:
    """Rows for one part among the columns of all ``members``."""
    wide = np.zeros((len(rows), len(members), rows.shape[1]))
    wide[:, np.searchsorted(members, part)] = rows
    return wide.reshape(len(rows), len(members) * rows.shape[1])


def rigid_rows(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Rigid motions at points ``x`` (n, N) along directions ``d`` (n, N): (n, N(N+1)/2)."""
    N = x.shape[1]
    pairs = [(a, b) for a in range(N) for b in range(a + 1, N)]
    return np.column_stack([d, *(x[:, b] * d[:, a] - x[:, a] * d[:, b] for a, b in pairs)])


def part_vertices(mesh: Mesh, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sorted pairs (part, vertex): the vertices of each part that hangs together by facets.

    ``a`` and ``b`` are the pairs of elements that share a facet, as ``element_facets`` counts.
    """
    elements, count = element_vertices(mesh), mesh.nv
    label = connected(sum(len(nodes) for nodes in elements), a, b)
    _, part = np.unique(label, return_inverse=True)
    pairs, start = [], 0
    for nodes in elements:
        of_corner = np.repeat(part[start : start + len(nodes)], nodes.shape[1])
        pairs.append(of_corner * count + nodes.ravel())
        start += len(nodes)
    return np.column_stack(np.divmod(np.unique(np.concatenate(pairs)), count))


def connected(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """For each of ``count`` items the number of the group that the pairs (a, b) connect it to."""
    pairs = coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
    return connected_components(pairs, directed=False)[1]
