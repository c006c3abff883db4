"""Supports along oblique directions as rows d . u = value with forces of either sign.

Every node has a row of its own, those of quadratic displacements between the vertices as well, so
that a roller along an axis is the same support as a prescribed component.  Normals of facets that
differ little are averaged at their nodes; faces that meet at an angle have a row each.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BND, H1, ElementId, FESpace, GridFunction
from scipy.sparse import csr_matrix, eye

from ngepc.discretisation.loads import Supports
from ngepc.discretisation.rows import (
    ContactRows,
    MeetingFaces,
    facet_rules,
    rows_along,
    surface_measure,
)
from ngepc.discretisation.spaces import nodes_at
from ngepc.model.places import Place, Roller, values_at
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.support import FREE_NORMAL, HELD_NORMAL


def roller_rows(problem: Problem, supports: Supports) -> dict[Place, ContactRows]:
    """The rows of each roller, but for directions that other supports hold already.

    A ValueError if two supports give a node different displacements along one direction.
    """
    scalar, taken = H1(problem.mesh, order=problem.order), {}
    result = {}
    for place, roller in problem.rollers.items():
        values, found = _nodal_values(problem, scalar, place, roller), []
        for node, directions in _directions(problem, scalar, place, roller).items():
            held = taken.setdefault(node, _Held(supports.free[node], supports.values[node]))
            for d in directions:
                d = d / np.linalg.norm(d)
                if held.takes(d, values[node], place):
                    found.append((node, d))
        nodes = np.array([node for node, _ in found], dtype=int)
        result[place] = rows_along(
            np.array([d for _, d in found]).reshape(-1, problem.N),
            csr_matrix(eye(scalar.ndof))[nodes],
            vertices=np.zeros(len(found), dtype=int),
            gaps=values[nodes],
            weights=np.zeros(len(found)),  # no part of the contact area
            tied=True,
        )
    return result


class _Held:
    """The directions that supports hold at one node: orthonormal, with their displacements."""

    def __init__(self, free: np.ndarray, values: np.ndarray) -> None:
        fixed = np.flatnonzero(~free)
        self._basis, self._values = np.eye(len(free))[fixed], values[fixed]

    def takes(self, d: np.ndarray, value: float, place: Place) -> bool:
        """Whether a direction is new; it is held from now on."""
        shares = self._basis @ d
        rest, value = d - shares @ self._basis, value - shares @ self._values
        size = np.linalg.norm(rest)
        if size < HELD_NORMAL and abs(value) > 1e-8 * max(1e-300, *np.abs(self._values)):
            raise ValueError(
                f"prescribed[{place!r}] and another support give a node different displacements "
                f"along {d.round(6).tolist()}: the values must agree, {value:g} is left"
            )
        if size < FREE_NORMAL:
            return False
        self._basis = np.vstack([self._basis, rest / size])
        self._values = np.append(self._values, value / size)
        return True


def _directions(
    problem: Problem, scalar: FESpace, place: Place, roller: Roller
) -> dict[int, list[np.ndarray]]:
    """Node -> directions, of any length: the given one, or the normals of the faces there."""
    if roller.direction is not None:
        return {int(n): [np.array(roller.direction)] for n in nodes_at(scalar, place)}
    region, faces = problem.mesh.Boundaries(place), MeetingFaces()
    points = problem.mesh.MapToAllElements(facet_rules(problem, 1), region)
    normals = surface_measure(problem, points)[:, None] * np.asarray(problem.normal(points))
    for facet, n in zip(region.Elements(), normals, strict=True):
        for node in scalar.GetDofNrs(ElementId(BND, facet.nr)):
            faces.taking(node, place, n)
    return {node: [n for _, n in here] for node, here in faces.at.items()}


def _nodal_values(problem: Problem, scalar: FESpace, place: Place, roller: Roller) -> np.ndarray:
    """Coefficients of the given displacement along the direction, shape (nodes,)."""
    values = GridFunction(scalar)
    if isinstance(place, str):
        values.Set(as_scalar(roller.value), definedon=problem.mesh.Boundaries(place))
    else:
        vertices, given = values_at(roller.value, problem.mesh, place)
        values.vec.FV().NumPy()[vertices] = given[:, 0]
    return values.vec.FV().NumPy().copy()
