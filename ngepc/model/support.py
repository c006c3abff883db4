"""What holds a body: boundary values that agree, a contact normal that is free, no rigid motion.

On a conforming P1 mesh eps(u) = 0 leaves one rigid motion for each part of the mesh whose
elements hang together by facets.  The parts are coupled at the vertices they share, so that two
blocks joined along an edge are found to hinge.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngepc.checks.arguments import Coefficient, boundary_names, is_number, sample
from ngepc.model.elements import (
    combine,
    corner_vertices,
    element_facets,
    element_vertices,
    facets_of,
    vertex_coordinates,
    vertices_of,
)
from ngepc.model.given import Given
from ngepc.model.normals import outward_normal

FREE_NORMAL = 0.1
"""Least length of the free part of the unit normal where a held boundary meets contact."""


def check_support(problem: Given) -> None:
    """A conforming mesh, boundary values that agree, a free normal on contact, no rigid motion."""
    keys, owners = element_facets(problem.mesh)
    a, b = check_conforming(keys, owners)
    check_outer(problem, keys)
    held = held_values(problem)
    check_free_normal(problem, ~np.isnan(held))
    check_rigid_motions(problem, ~np.isnan(held), part_vertices(problem.mesh, a, b))


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


def check_outer(problem: Given, keys: np.ndarray) -> None:
    """Contact takes place on the outer boundary, not on an interface inside the body."""
    mesh = problem.mesh
    for name in problem.contact_names:
        wanted = combine(facets_of(mesh, name), mesh)
        if not np.isin(wanted, keys).all():
            raise ValueError(f"contact={name!r} is not a boundary of elements of the mesh")
        if np.isin(keys, wanted).sum() > len(np.unique(wanted)):
            raise ValueError(
                f"contact={name!r} lies inside the body: a part of its outer boundary is needed"
            )


def held_values(problem: Given) -> np.ndarray:
    """The given displacements at the vertices, shape (vertices, N), NaN where free.

    Raises
    ------
    ValueError
        If two boundaries give different values to a common vertex.
    """
    mesh, N = problem.mesh, problem.N
    given = [("clamped", name, i, 0.0) for name in problem.clamped_names for i in range(N)]
    given += [
        (f"prescribed[{name!r}]", name, i, value)
        for names, components in (problem.prescribed or {}).items()
        for name in boundary_names("prescribed", names, mesh)
        for i, value in enumerate(components)
        if value is not None
    ]
    held = np.full((mesh.nv, N), np.nan)
    owner = np.full((mesh.nv, N), "", dtype=object)
    for argument, name, i, value in given:
        vertices, values = boundary_values(value, mesh, name)
        old = held[vertices, i]
        scale = max(np.abs(values).max(initial=0.0), np.nanmax(np.abs(old), initial=0.0))
        clash = np.abs(values - old) > 1e-8 * scale  # False where old is NaN
        if clash.any():
            k = int(np.flatnonzero(clash)[0])
            raise ValueError(
                f"{argument} gives u_{'xyz'[i]} = {values[k]:g} at a vertex where "
                f"{owner[vertices[k], i]} gives {old[k]:g}: the values must agree"
            )
        held[vertices, i], owner[vertices, i] = values, argument
    return held


def boundary_values(value: Coefficient, mesh: Mesh, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the vertices on a boundary and the values of a scalar coefficient there."""
    if is_number(value):
        vertices = np.array(sorted(vertices_of(mesh, (name,))), dtype=int)
        return vertices, np.full(len(vertices), float(value))
    vertices, values = at_corners(value, mesh, [name])
    return vertices, values[:, 0]


def at_corners(
    value: CoefficientFunction, mesh: Mesh, names: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and values at the corners of all boundary elements, once for each element."""
    return corner_vertices(mesh, names), sample(value, mesh, names, corners=True)


def check_free_normal(problem: Given, held: np.ndarray) -> None:
    """Where a held boundary meets contact, the normal displacement must remain free, (2.2)."""
    mesh, contact = problem.mesh, problem.contact_names
    if not contact or not held[sorted(vertices_of(mesh, contact))].any():
        return
    vertices, normal = at_corners(outward_normal(mesh), mesh, contact)
    free = np.linalg.norm(np.where(held[vertices], 0.0, normal), axis=1)
    if free.min() < FREE_NORMAL:
        where = vertex_coordinates(mesh)[vertices[free.argmin()]]
        raise ValueError(
            f"prescribed={problem.prescribed!r} holds the normal displacement of "
            f"contact={problem.contact!r} at {where.round(6).tolist()}: where they meet, the "
            "normal component must be free (None)"
        )


def check_rigid_motions(problem: Given, held: np.ndarray, pairs: np.ndarray) -> None:
    """The held components rule out every rigid motion of every connected part.

    A part that may touch another body can be held by contact alone: whether it is shows in the
    solution.  ``pairs`` are those of ``part_vertices``.
    """
    touching = set()
    for pair in problem.contact_pairs:
        for names in (pair.first, pair.second):
            touching |= vertices_of(problem.mesh, boundary_names("contact", names, problem.mesh))
    for free, vertices in free_motions(problem, held, pairs):
        if touching.isdisjoint(vertices.tolist()):
            centre = vertex_coordinates(problem.mesh)[vertices].mean(axis=0)
            raise ValueError(
                f"clamped={problem.clamped!r} and prescribed={problem.prescribed!r} leave {free} "
                f"rigid motion(s) of the part around {centre.round(6).tolist()}: "
                "every connected part must be held"
            )


def has_floating_parts(problem: Given) -> bool:
    """Whether parts of the body are held by the contact with others alone."""
    if not problem.contact_pairs:
        return False
    a, b = check_conforming(*element_facets(problem.mesh))
    held = ~np.isnan(held_values(problem))
    return any(free_motions(problem, held, part_vertices(problem.mesh, a, b)))


def free_motions(
    problem: Given, held: np.ndarray, pairs: np.ndarray
) -> Iterator[tuple[int, np.ndarray]]:
    """Number of free rigid motions and vertices of each part that has some.

    ``pairs`` are those of ``part_vertices``; parts with common vertices are looked at together.
    """
    if problem.kinematics.hoop:  # u_r / r is a strain: only the motion along the axis is free
        held = held | np.array([True, False])
    x = vertex_coordinates(problem.mesh)
    scaled = x / np.ptp(x[pairs[:, 1]], axis=0).max()
    parts = pairs[-1, 0] + 1
    by_vertex = pairs[np.argsort(pairs[:, 1], kind="stable")]
    again = np.flatnonzero(by_vertex[1:, 1] == by_vertex[:-1, 1])
    joints = np.column_stack([by_vertex[again, 0], by_vertex[again + 1]])
    group = connected(parts, joints[:, 0], joints[:, 1])
    for number in np.unique(group):
        members = np.flatnonzero(group == number)
        equations = [_held_rows(pairs, held, scaled, members, part) for part in members]
        equations += _joint_rows(joints[np.isin(joints[:, 0], members)], scaled, members)
        free, moving = _mechanisms(np.vstack(equations), len(members))
        if free:
            yield free, pairs[pairs[:, 0] == members[moving], 1]


def _mechanisms(equations: np.ndarray, parts: int) -> tuple[int, int]:
    """The number of free rigid motions and the part that moves most in one of them."""
    columns = equations.shape[1]
    R = np.linalg.qr(np.vstack([equations, np.zeros((columns, columns))]), mode="r")
    _, size, motion = np.linalg.svd(R)
    length = np.linalg.norm(motion[-1].reshape(parts, -1), axis=1)
    return int(np.count_nonzero(size <= 1e-8)), int(length.argmax())


def _held_rows(
    pairs: np.ndarray, held: np.ndarray, x: np.ndarray, members: np.ndarray, part: int
) -> np.ndarray:
    """Equations for the held components of one part, reduced to as many as it has motions."""
    vertices = pairs[pairs[:, 0] == part, 1]
    v, i = np.nonzero(held[vertices])
    R = np.linalg.qr(rigid_rows(x[vertices[v]], i), mode="r")
    return _placed(R, members, part)


def _joint_rows(joints: np.ndarray, x: np.ndarray, members: np.ndarray) -> list[np.ndarray]:
    """Equations for the equal displacements of parts a, b at a common vertex v."""
    N = x.shape[1]
    equations = []
    for a, b, v in joints:
        rows = rigid_rows(np.repeat(x[v][None], N, axis=0), np.arange(N))
        equations.append(_placed(rows, members, a) - _placed(rows, members, b))
    return equations


def _placed(rows: np.ndarray, members: np.ndarray, part: int) -> np.ndarray:
    """Rows for one part among the columns of all ``members``."""
    wide = np.zeros((len(rows), len(members), rows.shape[1]))
    wide[:, np.searchsorted(members, part)] = rows
    return wide.reshape(len(rows), len(members) * rows.shape[1])


def rigid_rows(x: np.ndarray, i: np.ndarray) -> np.ndarray:
    """Components ``i`` of the rigid motions at points ``x`` (n, N): shape (n, N(N+1)/2)."""
    N = x.shape[1]
    rotations = [x[:, b] * (i == a) - x[:, a] * (i == b) for a in range(N) for b in range(a + 1, N)]
    return np.column_stack([np.eye(N)[i], *rotations])


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
    """For each of ``count`` items the smallest item connected to it by the pairs (a, b)."""
    label = np.arange(count)
    while True:
        smallest = np.minimum(label[a], label[b])
        if (label[a] == smallest).all() and (label[b] == smallest).all():
            return label
        np.minimum.at(label, label[a], smallest)
        np.minimum.at(label, label[b], smallest)
        while (label[label] != label).any():
            label = label[label]
