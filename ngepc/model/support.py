"""Supports: consistent boundary values, a free normal on contact, no rigid motion left.

On a conforming P1 mesh eps(u) = 0 leaves rigid motions of each part of the mesh whose elements hang
together by facets.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from ngsolve import Mesh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.checks.sentences import counted, in_words
from ngepc.model.data import ProblemData
from ngepc.model.elements import (
    boundary_corners,
    corner_vertices,
    element_facets,
    element_nodes,
    facet_keys,
    vertex_coordinates,
)
from ngepc.model.places import Place, values_at, vertices_at
from ngepc.model.processes import processes_of

FREE_NORMAL = 0.1
"""Least length of the free part of the unit normal where a held boundary meets contact."""

HELD_NORMAL = 1e-8
"""Largest length of the free part where the support holds all of the normal."""


def check_held(problem: ProblemData) -> None:
    """Boundary values that agree, and a free normal where a support meets contact."""
    processes = problem.processes
    held = processes.together(partial(held_values, problem))
    held = _agreed(problem, held)
    processes.together(partial(check_free_normal, problem, held))


def check_motions(problem: ProblemData) -> None:
    """A conforming mesh whose parts have no rigid motion left.

    A part that may touch an obstacle or another body can be held by contact alone: the solver finds
    out.  On a mesh that processes share every part must be held.
    """
    processes = problem.processes
    parts = processes.together(partial(_parts, problem))
    sides = [
        name for pair in problem.contact_pairs for name in (pair.first, pair.second)
    ]
    if processes.size == 1:
        sides += problem.contact_names
    touching = corner_vertices(problem.mesh, sides)
    for motions, vertices in free_motions(problem, parts):
        if not np.isin(vertices, touching).any():
            x = vertex_coordinates(problem.mesh)[vertices]
            centre = processes.total(x.sum(axis=0)) / processes.total(len(x))
            raise ValueError(
                f"clamped={in_words(problem.clamped)} and "
                f"prescribed={in_words(problem.prescribed)} leave "
                f"{counted(motions.shape[2], 'rigid motion')} of the part around "
                f"{centre.round(6).tolist()}: every connected part must be held, if need "
                "be by springs"
            )


def held_directions(problem: ProblemData) -> list[tuple]:
    """Places with the components or directions that supports hold there, without values."""
    components = [(place, axis) for _, place, axis, _ in problem.held]
    rollers = [(place, r.direction) for place, r in problem.rollers.items()]
    return components + rollers


def _agreed(problem: ProblemData, held: np.ndarray) -> np.ndarray:
    """``held_values`` of all processes: a boundary may end where another one has its elements."""
    processes = problem.processes
    given = ~np.isnan(held)
    count = processes.summed(given.astype(float))
    values = processes.summed(np.nan_to_num(held)) / np.where(count > 0, count, np.nan)
    scale = np.abs(held).max(initial=0.0, where=given)
    if processes.any(np.abs(held - values) > 1e-8 * scale):
        raise ValueError(
            f"clamped={in_words(problem.clamped)} and "
            f"prescribed={in_words(problem.prescribed)} give a vertex that "
            "processes share different displacements: the values must agree"
        )
    return values


def _parts(problem: ProblemData) -> list[np.ndarray]:
    """``part_vertices`` of this process, after all checks that need no other one."""
    mesh = problem.mesh
    keys, owners = element_facets(mesh)
    a, b = check_conforming(keys, owners)
    for name in problem.contact_names:
        check_outer(f"contact={name!r}", name, mesh, keys)
    for name in pressed_names(problem):
        check_outer(f"pressure[{name!r}]", name, mesh, keys)
    return part_vertices(mesh, a, b)


def pressed_names(problem: ProblemData) -> list[str]:
    """The boundaries under a pressure."""
    return list(problem.single("pressure"))


def check_outer(given: str, name: str, mesh: Mesh, keys: np.ndarray) -> None:
    """Refuse a boundary inside the body, which has no outer normal.

    ``keys`` are those of the facets of all elements, ascending, ``given`` is what names it.
    """
    wanted = facet_keys(boundary_corners(mesh, [name]), mesh)
    beside = np.searchsorted(keys, wanted, "right") - np.searchsorted(keys, wanted)
    if (beside == 0).any():
        raise ValueError(f"{given} is not a boundary of elements of the mesh")
    if (beside > 1).any() or name in getattr(mesh, "interfaces", ()):
        raise ValueError(f"{given} lies inside the body: an outer boundary is needed")


def check_conforming(
    keys: np.ndarray, owners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of elements that share a facet; an error if more than two share one."""
    same = keys[1:] == keys[:-1]
    if (same[1:] & same[:-1]).any():
        raise ValueError(
            "mesh has elements that overlap: a facet belongs to more than two"
        )
    a, b = np.sort([owners[:-1][same], owners[1:][same]], axis=0)
    pairs = np.sort(a * (owners.max() + 1) + b)
    if (pairs[1:] == pairs[:-1]).any():
        raise ValueError(
            "mesh has elements that overlap: two of them share several facets"
        )
    return a, b


def held_values(problem: ProblemData) -> np.ndarray:
    """The given displacements at the vertices, shape (vertices, N), NaN where free."""
    mesh = problem.mesh
    N = problem.N
    held = np.full((mesh.nv, N), np.nan)
    owner = np.full((mesh.nv, N), "", dtype=object)
    if problem.kinematics.hoop:
        radii = np.abs(vertex_coordinates(mesh)[:, 0])
        axis = radii <= 1e-12 * radii.max()
        held[axis, 0] = 0.0
        owner[axis, 0] = "the axis of revolution"
    for argument, place, i, value in problem.held:
        vertices, values = values_at(value, mesh, place)
        values = values[:, 0]
        old = held[vertices, i]
        scale = max(
            np.abs(values).max(initial=0.0), np.nanmax(np.abs(old), initial=0.0)
        )
        # none where old is NaN
        clash = np.flatnonzero(np.abs(values - old) > 1e-8 * scale)
        if len(clash):
            k = clash[0]
            raise ValueError(
                f"{argument} gives u_{'xyz'[i]} = {values[k]:g} at a vertex where "
                f"{owner[vertices[k], i]} gives {old[k]:g}: the values must agree"
            )
        held[vertices, i] = values
        owner[vertices, i] = argument
    return held


def check_free_normal(problem: ProblemData, held: np.ndarray) -> None:
    """Where a support meets contact, the normal displacement is free, or all held and in the gap.

    ``held`` has the values of ``held_values``.
    """
    for name in problem.contact_names:
        some_held = not np.isnan(held[vertices_at(name, problem.mesh)]).all()
        if not some_held and not problem.rollers:
            continue
        vertices, normal = values_at(problem.normal, problem.mesh, name)
        _check_held_on_contact(problem, name, held[vertices], vertices, normal)
        for place in problem.rollers:
            _check_roller_on_contact(problem, name, place, vertices, normal)


def holds_contact(problem: ProblemData) -> bool:
    """Whether a support holds the whole normal displacement at a vertex of contact."""
    fixed = ~np.isnan(held_values(problem))
    for name in problem.contact_names:
        vertices, normal = values_at(problem.normal, problem.mesh, name)
        free = np.linalg.norm(np.where(fixed[vertices], 0.0, normal), axis=1)
        if (free <= HELD_NORMAL).any():
            return True
    return False


def _check_held_on_contact(
    problem: ProblemData,
    name: str,
    held: np.ndarray,
    vertices: np.ndarray,
    normal: np.ndarray,
) -> None:
    """The components that clamps and given displacements hold at vertices of contact."""
    gap = values_at(problem.gaps[name], problem.mesh, name)[1][:, 0]
    fixed = ~np.isnan(held)
    u = np.nan_to_num(held)
    free = np.linalg.norm(np.where(fixed, 0.0, normal), axis=1)
    none_free = (free < FREE_NORMAL).all()
    partly = (free > HELD_NORMAL) & (free < FREE_NORMAL) | none_free
    size = max(np.abs(a[fixed.any(axis=1)]).max(initial=0.0) for a in (u, gap))
    overlap = np.einsum("ki,ki->k", u, normal) - gap
    beyond = (overlap > 1e-8 * size) & (free <= HELD_NORMAL)
    for why, bad in {
        "where they meet, the normal component must be free (None)": partly,
        "the given displacement must not exceed the gap there, a larger gap is needed": beyond,
    }.items():
        if bad.any():
            k = int(bad.argmax())
            where = vertex_coordinates(problem.mesh)[vertices[k]].round(6).tolist()
            raise ValueError(
                f"clamped={in_words(problem.clamped)} and "
                f"prescribed={in_words(problem.prescribed)} hold the "
                f"normal displacement of contact={name!r} at {where}, gap={gap[k]:g}: {why}"
            )


def _check_roller_on_contact(
    problem: ProblemData,
    name: str,
    place: Place,
    vertices: np.ndarray,
    normal: np.ndarray,
) -> None:
    """The direction of a roller is not the normal where both meet."""
    direction = problem.rollers[place].direction or problem.normal
    nodes, directions = values_at(direction, problem.mesh, place)
    both = np.isin(vertices, nodes)
    for node, n in zip(vertices[both], normal[both], strict=True):
        along = np.abs(directions[nodes == node] @ n)
        if (along > np.sqrt(1 - FREE_NORMAL**2)).any():
            raise ValueError(
                f"prescribed[{place!r}] holds the normal displacement of contact={name!r}: "
                "where they meet, it must be free"
            )


def constraints(
    problem: ProblemData, *, springs: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (k,) that supports and springs hold, and unit vectors (k, N) along which they do.

    ``springs`` says whether springs count.
    """
    mesh = problem.mesh
    axes = np.eye(problem.N)
    along = [(place, axes[component]) for _, place, component, _ in problem.held]
    along += [
        (place, r.direction or problem.normal) for place, r in problem.rollers.items()
    ]
    constants = problem.spring_constants if springs else {}
    for place, along_axes in constants.items():
        for d, k in along_axes:
            if values_at(k, mesh, place)[1].max(initial=0.0) > 0:
                along.append((place, d or problem.normal))
    found = [values_at(d, mesh, place) for place, d in along]
    # u_r / r is a strain, so only the translation along the axis is rigid
    if problem.kinematics.hoop:
        found.append((np.arange(mesh.nv), np.tile(axes[0], (mesh.nv, 1))))
    vertices = [np.zeros(0, dtype=int), *(vertices for vertices, _ in found)]
    return np.concatenate(vertices), np.vstack(
        [np.zeros((0, problem.N)), *(d for _, d in found)]
    )


def free_motions(
    problem: ProblemData, parts: list[np.ndarray], *, springs: bool = True
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Free rigid motions of each part that has any, (vertices of the mesh, N, k), and its vertices.

    Each part of ``part_vertices`` is examined alone, even if it shares a vertex or an edge.
    ``springs`` says whether springs hold a part.
    """
    x = vertex_coordinates(problem.mesh)
    processes = problem.processes
    vertices, directions = constraints(problem, springs=springs)
    scaled = x / processes.extent(x[np.concatenate(parts)]).max()
    rows = np.einsum("nj,njk->nk", directions, rigid_motions(scaled[vertices]))
    for own in parts:
        here = processes.all(rows[np.isin(vertices, own)])
        square = np.zeros((rows.shape[1], rows.shape[1]))
        R = np.linalg.qr(np.vstack([*here, square]), mode="r")
        _, size, motion = np.linalg.svd(R)
        free = motion[size <= 1e-8]
        if len(free):
            motions = np.zeros((*x.shape, len(free)))
            motions[own] = rigid_motions(scaled[own]) @ free.T
            yield motions, own


def rigid_motions(x: np.ndarray) -> np.ndarray:
    """All rigid motions at points (n, N): (n, N, N(N+1)/2), translations first."""
    n, N = x.shape
    planes = [(a, b) for a in range(N) for b in range(a + 1, N)]
    motions = np.zeros((n, N, N + len(planes)))
    motions[:, :, :N] = np.eye(N)
    for k, (a, b) in enumerate(planes, start=N):
        motions[:, a, k], motions[:, b, k] = x[:, b], -x[:, a]
    return motions


def part_vertices(mesh: Mesh, a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """The vertices of each part that is connected by facets.

    ``a`` and ``b`` are the pairs of elements that share a facet.
    """
    if processes_of(mesh).size > 1:  # one part: distribute() sees to that
        return [np.arange(mesh.nv)]
    part = connected(mesh.ne, a, b)
    nodes = element_nodes(mesh)[:, : 2**mesh.dim]
    if not part.any():
        return [np.unique(nodes[nodes >= 0])]
    element, corner = np.nonzero(nodes >= 0)
    has = csr_matrix((np.ones(len(element)), (part[element], nodes[element, corner])))
    return np.split(has.indices, has.indptr[1:-1])


def connected(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """For each of ``count`` items the number of the group that the pairs (a, b) connect it to."""
    ends = np.append(0, np.cumsum(np.bincount(a, minlength=count)))
    others = b[np.argsort(a, kind="stable")]
    pairs = csr_matrix((np.ones(len(a)), others, ends), shape=(count, count))
    return connected_components(pairs, directed=False)[1]


def floating_motions(
    problem: ProblemData, *, springs: bool = True
) -> list[tuple[np.ndarray, np.ndarray]]:
    """``free_motions`` of the parts that contact alone has to hold; mostly none.

    Without ``springs`` those that contact and springs hold together.
    """
    if problem.contact is None or problem.processes.size > 1:
        return []
    pairs = check_conforming(*element_facets(problem.mesh))
    parts = part_vertices(problem.mesh, *pairs)
    return list(free_motions(problem, parts, springs=springs))
