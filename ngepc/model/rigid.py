"""Rigid motions that the supports of a body leave free.

On a conforming P1 mesh eps(u) = 0 leaves rigid motions of each part of the mesh whose elements hang
together by facets.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from ngsolve import Mesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.model.elements import element_vertices, outward_normal, vertex_coordinates
from ngepc.model.given import Given
from ngepc.model.places import Place, values_at, vertices_at
from ngepc.model.processes import processes_of


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
        stiff = [d for d, one in k if values_at(one, mesh, place)[1].max(initial=0.0) > 0]
        found += [directed(mesh, place, direction) for direction in stiff]
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
    """Free rigid motions of each part that has any, (vertices of the mesh, N, k), and its vertices.

    ``held`` says which components of the vertices are, ``pairs`` are those of ``part_vertices``.
    Each part is looked at alone, also one that shares a vertex or an edge with others.
    """
    if problem.kinematics.hoop:  # u_r / r is a strain: only the motion along the axis is free
        held = held | np.array([True, False])
    x, processes = vertex_coordinates(problem.mesh), problem.processes
    (vertices, axes), (also, directions) = np.nonzero(held), oblique(problem)
    vertices = np.append(vertices, also)
    directions = np.vstack([np.eye(problem.N)[axes], directions])
    scaled = x / processes.most(np.ptp(x[pairs[:, 1]], axis=0))
    rows = rigid_rows(scaled[vertices], directions)
    for part in range(pairs[-1, 0] + 1):
        own = pairs[pairs[:, 0] == part, 1]
        free = kernel(processes.all(rows[np.isin(vertices, own)]))
        if len(free):
            motions = np.zeros((*x.shape, len(free)))
            motions[own] = rigid_motions(scaled[own]) @ free.T
            yield motions, own


def kernel(equations: list[np.ndarray]) -> np.ndarray:
    """An orthonormal basis of what solves all homogeneous equations, (k, unknowns)."""
    columns = equations[0].shape[1]
    R = np.linalg.qr(np.vstack([*equations, np.zeros((columns, columns))]), mode="r")
    _, size, motion = np.linalg.svd(R)
    return motion[size <= 1e-8]


def rigid_motions(x: np.ndarray) -> np.ndarray:
    """All rigid motions at points (n, N): (n, N, N(N+1)/2), translations first."""
    n, N = x.shape
    planes = [(a, b) for a in range(N) for b in range(a + 1, N)]
    motions = np.zeros((n, N, N + len(planes)))
    motions[:, :, :N] = np.eye(N)
    for k, (a, b) in enumerate(planes, start=N):
        motions[:, a, k], motions[:, b, k] = x[:, b], -x[:, a]
    return motions


def rigid_rows(x: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Rigid motions at points ``x`` (n, N) along directions ``d`` (n, N): (n, N(N+1)/2)."""
    return np.einsum("nj,njk->nk", d, rigid_motions(x))


def part_vertices(mesh: Mesh, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sorted pairs (part, vertex): the vertices of each part that hangs together by facets.

    ``a`` and ``b`` are the pairs of elements that share a facet, as ``element_facets`` counts.
    """
    if processes_of(mesh).size > 1:  # one part: distribute() sees to that
        return np.column_stack([np.zeros(mesh.nv, dtype=int), np.arange(mesh.nv)])
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
