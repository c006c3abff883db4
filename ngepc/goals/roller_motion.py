"""Unit motions of supports with rollers along no axis, for reactions.

The reaction along e is the work of the supports' forces in a motion w with w . d = e . d for the
directions d that the support holds, and w . d = 0 for those that others hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from ngsolve import H1

from ngepc.checks.arguments import boundary_names
from ngepc.discretisation.roller_rows import directions_of_roller
from ngepc.discretisation.spaces import nodes_at
from ngepc.discretisation.supports import support_motion
from ngepc.model.places import Place
from ngepc.model.problem import Problem

DEPENDENT = 1e-9
"""Smaller singular values of unit directions count as zero."""

Directions = Mapping[int, list[np.ndarray]]
"""Vertex -> unit vectors along which supports hold it."""


def motion_of_support(
    problem: Problem, support: str, component: int
) -> tuple[np.ndarray, bool]:
    """The unit motion of a support along a component, (nodes, N): zero but at its vertices.

    Where other supports hold a vertex along directions that depend on those of this one, it is the
    share of this one.  The second result says whether there is such a vertex.

    ValueError if the support does not hold the component.
    """
    names = boundary_names("support", support, problem.mesh)
    if not set(names) & set(problem.rollers):
        motion = support_motion(problem, support, component)
        return motion, bool(((motion > 0) & (motion < 1)).any())
    unit = np.eye(problem.N)[component]
    for name in names:
        held = [d for some in directions_of(problem, [name]).values() for d in some]
        if not held or np.abs(held @ unit).max() < DEPENDENT:
            raise ValueError(
                f"support={support!r}: it does not hold component {component}"
            )
    own = directions_of(problem, names)
    places = {place for _, place, _, _ in problem.held} | set(problem.rollers)
    others = directions_of(problem, places - set(names))
    scalar = H1(problem.mesh, order=problem.order)
    motion = np.zeros((scalar.ndof, problem.N))
    shared = False
    for vertex, directions in own.items():
        beside = others.get(vertex, [])
        apart = are_independent(directions, beside)
        w = moved(directions, beside if apart else [], unit)
        motion[vertex] = w if apart else w / 2
        shared = shared or not apart
    return motion, shared


def are_independent(own: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> bool:
    """Whether no direction of a support is a sum of directions of others."""
    if not others:
        return True
    ranks = [
        np.linalg.matrix_rank(np.array(directions), DEPENDENT)
        for directions in (own, others, [*own, *others])
    ]
    return bool(ranks[0] + ranks[1] == ranks[2])


def moved(
    own: Sequence[np.ndarray], others: Sequence[np.ndarray], unit: np.ndarray
) -> np.ndarray:
    """The least w with w . d = unit . d for ``own`` directions d, and zero for the others."""
    wanted = np.append(np.array(own) @ unit, np.zeros(len(others)))
    return np.linalg.lstsq(np.array([*own, *others]), wanted, rcond=DEPENDENT)[0]


def directions_of(problem: Problem, places: Sequence[Place]) -> Directions:
    """The directions along which supports at some places hold vertices."""
    scalar = H1(problem.mesh, order=1)
    axes = np.eye(problem.N)
    found: dict[int, list[np.ndarray]] = {}
    for _, place, axis, _ in problem.held:
        if place in places:
            for vertex in nodes_at(scalar, place).tolist():
                found.setdefault(vertex, []).append(axes[axis])
    for place in problem.rollers:
        if place in places:
            vertices, directions, _ = directions_of_roller(problem, scalar, place)
            for vertex, d in zip(vertices.tolist(), directions, strict=True):
                found.setdefault(vertex, []).append(d)
    return found
