"""Rollers in bounds: supports of the nodes along one direction, in place of contact rows.

A roller on a side parallel to an axis holds a component of the displacement, and is changed to
that.  Others hold the direction d at the nodes of straight sides.  Where both ends of a side are
held along d, so are all points between them: the displacement is admissible, and the traction
along d is that of the support.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import BND, ET, IntegrationRule

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.roller_rows import HeldDirections, directions_of_roller
from ngepc.discretisation.slanted import SlantedNodes
from ngepc.discretisation.supports import Supports
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import cells_of, regions_of
from ngepc.model.places import Place, Roller
from ngepc.model.problem import Problem

ALONG = 1e-12
"""Smaller components of a unit vector count as zero."""
STRAIGHT = 1e-9
"""The part of a normal that the supports of a vertex may leave free, for rounding."""
CENTRES = {
    2: {ET.SEGM: IntegrationRule(ET.SEGM, 0)},
    3: {shape: IntegrationRule(shape, 0) for shape in (ET.TRIG, ET.QUAD)},
}
"""By dimension, one point on each boundary element."""


def in_components(problem: Problem) -> Problem:
    """The problem with rollers along axes as supports of components; itself if there are none."""
    found = {place: components_of(problem, place) for place in problem.rollers}
    found = {place: held for place, held in found.items() if held is not None}
    if not found:
        return problem
    other = copy(problem)
    vars(other)["prescribed"] = problem.single("prescribed") | found
    return other


def components_of(problem: Problem, place: Place) -> tuple | None:
    """The prescribed components that are the same as a roller; None if its direction is no axis."""
    roller = problem.rollers[place]
    if not isinstance(place, str):
        return None
    directions = directions_at(problem, place, roller)
    first = directions[0]
    if np.abs(directions - first).max() > ALONG:
        return None
    axis = int(np.abs(first).argmax())
    if np.abs(np.delete(first, axis)).max() > ALONG:
        return None
    held = [None] * problem.N
    held[axis] = roller.value if first[axis] > 0 else -roller.value
    return tuple(held)


def directions_at(problem: Problem, place: str, roller: Roller) -> np.ndarray:
    """The unit directions of a roller at the centres of its boundary elements, (elements, N)."""
    mesh = problem.mesh
    region = regions_of(mesh, mesh.dim - 1)
    there = np.array(mesh.GetBoundaries())[region] == place
    if roller.direction is not None:
        d = np.array(roller.direction, dtype=float)
        return np.tile(d / np.linalg.norm(d), (there.sum(), 1))
    points = mesh.MapToAllElements(CENTRES[mesh.dim], BND)
    return np.asarray(problem.normal(points))[there]


def by_nodes(discrete: DiscreteProblem) -> DiscreteProblem:
    """The discrete problem with rollers as supports of nodes; itself if it has no rows of rollers.

    ValueError for sides that are not straight, see ``slanted_nodes``.
    """
    if not discrete.contact.rollers:
        return discrete
    problem = in_components(discrete.problem)
    other = DiscreteProblem(problem, discrete.points)
    if problem.rollers:
        other.supports.slanted = slanted_nodes(problem, other.supports)
        other.contact = ContactConditions(without_rollers(problem), other.supports)
        other.rows = other.contact.rows
    return other


def without_rollers(problem: Problem) -> Problem:
    """The problem without rollers."""
    other = copy(problem)
    given = problem.single("prescribed").items()
    kept = {place: held for place, held in given if place not in problem.rollers}
    vars(other)["prescribed"] = kept or None
    return other


def slanted_nodes(problem: Problem, supports: Supports) -> SlantedNodes:
    """The nodes that rollers hold.

    ValueError where the normals of the facets at a node differ, but too little to be those of two
    sides: the node is held along their mean only, and the displacement penetrates both sides.
    """
    N = problem.N
    scalar = supports.scalar
    held = HeldDirections(supports)
    for place in problem.rollers:
        held.added(place, *directions_of_roller(problem, scalar, place))
    for place, roller in problem.rollers.items():
        check_straight(problem, place, roller, held)
    nodes = np.array(sorted(held.at), dtype=int)
    projectors = np.tile(np.eye(N), (len(nodes), 1, 1))
    values = np.zeros((len(nodes), N))
    for number, node in enumerate(nodes.tolist()):
        basis, known = held.at[node]
        projectors[number] -= basis.T @ basis
        values[number] = known @ basis
    return SlantedNodes(nodes, projectors, values)


def check_straight(
    problem: Problem, place: str, roller: Roller, held: HeldDirections
) -> None:
    """Refuse a roller whose vertices are not held along the directions of all facets there."""
    mesh = problem.mesh
    vertices, region = cells_of(mesh, mesh.dim - 1)
    there = np.array(mesh.GetBoundaries())[region] == place
    directions = directions_at(problem, place, roller)
    corners = vertices[there, : 2 ** (mesh.dim - 1)]
    for nodes, d in zip(corners, directions, strict=True):
        for node in nodes[nodes >= 0].tolist():
            basis, _ = held.at[node]
            if np.linalg.norm(d - (basis @ d) @ basis) > STRAIGHT:
                raise ValueError(
                    f"prescribed[{place!r}]: bounds need rollers on straight sides, one boundary "
                    "each, whose directions differ by 6 degrees or more at corners, or not at all"
                )


def state_by_nodes(state: State, other: DiscreteProblem) -> State:
    """The state on the discrete problem of ``by_nodes``, without forces of rows of rollers."""
    if other is state.discrete:
        return state
    conditions = state.discrete.contact
    rows = len(other.rows)
    normal = conditions.normal(state.contact)[:rows]
    forces = np.append(normal, along_of(conditions, state.contact)[:rows])
    return other.state(other.supports.admissible(state.u), contact=forces)


def along_of(conditions: ContactConditions, forces: np.ndarray) -> np.ndarray:
    """The tangential ones among the forces of all rows, (rows, 0 or N - 1)."""
    count = len(conditions.rows)
    return forces[count:].reshape(count, conditions.friction.d)


def result_by_nodes(result: ExactResult) -> ExactResult:
    """The result on the discrete problem of ``by_nodes``."""
    other = by_nodes(result.discrete)
    if other is result.discrete:
        return result
    state = state_by_nodes(result.state, other)
    return ExactResult(state, result.status, result.ending, result.history)
