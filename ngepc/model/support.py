"""What holds a body: boundary values that agree, a contact normal that is free, no rigid motion."""

from __future__ import annotations

from functools import partial

import numpy as np

from ngepc.checks.arguments import boundary_names
from ngepc.model.elements import (
    element_facets,
    facets_of,
    outward_normal,
    vertex_coordinates,
    vertices_of,
)
from ngepc.model.given import Given
from ngepc.model.places import values_at
from ngepc.model.rigid import check_conforming, directed, free_motions, part_vertices

FREE_NORMAL = 0.1
"""Least length of the free part of the unit normal where a held boundary meets contact."""

HELD_NORMAL = 1e-8
"""Largest length of the free part where the support holds all of the normal."""


def check_support(problem: Given) -> None:
    """A conforming mesh, boundary values that agree, a free normal on contact, no rigid motion."""
    held, pairs = problem.processes.together(partial(_held, problem))
    check_rigid_motions(problem, held, pairs)


def _held(problem: Given) -> tuple[np.ndarray, np.ndarray]:
    """The held components and the parts of this process."""
    keys, owners = element_facets(problem.mesh)
    a, b = check_conforming(keys, owners)
    check_outer(problem, keys)
    held = held_values(problem)
    check_free_normal(problem, held)
    return ~np.isnan(held), part_vertices(problem.mesh, a, b)


def check_outer(problem: Given, keys: np.ndarray) -> None:
    """Contact takes place on the outer boundary, not on an interface inside the body."""
    mesh = problem.mesh
    for name in problem.contact_names:
        wanted = facets_of(mesh, name)
        if not np.isin(wanted, keys).all():
            raise ValueError(f"contact={name!r} is not a boundary of elements of the mesh")
        inside = np.isin(keys, wanted).sum() > len(np.unique(wanted))
        if inside or name in getattr(mesh, "interfaces", ()):
            raise ValueError(
                f"contact={name!r} lies inside the body: a part of its outer boundary is needed"
            )


def held_values(problem: Given) -> np.ndarray:
    """The given displacements at the vertices, shape (vertices, N), NaN where free."""
    mesh, N = problem.mesh, problem.N
    given = [("clamped", name, i, 0.0) for name in problem.clamped_names for i in range(N)]
    given += [
        (f"prescribed[{place!r}]", place, i, value)
        for place, components in problem.held_components.items()
        for i, value in enumerate(components)
        if value is not None
    ]
    held = np.full((mesh.nv, N), np.nan)
    owner = np.full((mesh.nv, N), "", dtype=object)
    for argument, place, i, value in given:
        vertices, values = values_at(value, mesh, place)
        values = values[:, 0]
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


def check_free_normal(problem: Given, held: np.ndarray) -> None:
    """Where a support meets contact, the normal displacement is free, or all held and in the gap.

    ``held`` has the values of ``held_values``.
    """
    mesh = problem.mesh
    rollers = {p: directed(mesh, p, r.direction) for p, r in problem.rollers.items()}
    for name in problem.contact_names:
        vertices, normal = values_at(outward_normal(mesh), mesh, name)
        _check_normals(problem, name, vertices, normal, held[vertices])
        for place, (nodes, directions) in rollers.items():
            for i in np.flatnonzero(np.isin(vertices, nodes)):
                here = directions[nodes == vertices[i]]
                if (np.abs(here @ normal[i]) > np.sqrt(1 - FREE_NORMAL**2)).any():
                    raise ValueError(
                        f"prescribed[{place!r}] holds the normal displacement of contact={name!r}: "
                        "where they meet, the normal component must be free"
                    )


def _check_normals(
    problem: Given, name: str, vertices: np.ndarray, normal: np.ndarray, held: np.ndarray
) -> None:
    """At the vertices of a contact boundary a free part of the normal, or none in the gap."""
    fixed, u = ~np.isnan(held), np.nan_to_num(held)
    gap = values_at(problem.gaps[name], problem.mesh, name)[1][:, 0]
    free = np.linalg.norm(np.where(fixed, 0.0, normal), axis=1)
    size = max(np.abs(a[fixed.any(axis=1)]).max(initial=0.0) for a in (u, gap))
    partly = (free > HELD_NORMAL) & (free < FREE_NORMAL)
    if (free < FREE_NORMAL).all():
        partly[:] = True
    pushed = (free <= HELD_NORMAL) & (np.einsum("ki,ki->k", u, normal) - gap > 1e-8 * size)
    for bad, why in (
        (partly, "where they meet, the normal component must be free (None)"),
        (pushed, "the given displacement there must not exceed the gap, a larger gap is needed"),
    ):
        if bad.any():
            k = int(np.flatnonzero(bad)[0])
            where = vertex_coordinates(problem.mesh)[vertices[k]].round(6).tolist()
            raise ValueError(
                f"clamped={problem.clamped!r} and prescribed={problem.prescribed!r} hold the "
                f"normal displacement of contact={name!r} at {where}, gap={gap[k]:g}: {why}"
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
    for motions, vertices in free_motions(problem, held, pairs):
        if touching.isdisjoint(vertices.tolist()):
            x, processes = vertex_coordinates(problem.mesh)[vertices], problem.processes
            centre = processes.total(x.sum(axis=0)) / processes.total(len(x))
            raise ValueError(
                f"clamped={problem.clamped!r} and prescribed={problem.prescribed!r} leave "
                f"{motions.shape[2]} rigid motion(s) of the part around "
                f"{centre.round(6).tolist()}: "
                "every connected part must be held, if need be by springs"
            )


def floating_motions(problem: Given) -> list[tuple[np.ndarray, np.ndarray]]:
    """``free_motions`` of the parts that contact with others has to hold; mostly none."""
    if not problem.contact_pairs:
        return []
    a, b = check_conforming(*element_facets(problem.mesh))
    held = ~np.isnan(held_values(problem))
    return list(free_motions(problem, held, part_vertices(problem.mesh, a, b)))
