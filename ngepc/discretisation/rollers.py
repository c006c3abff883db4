"""Supports along oblique directions as rows d . u = value with forces of either sign.

Every node has a row of its own, those of quadratic displacements between the vertices as well, so
that a roller along an axis is the same support as a prescribed component.  Normals of facets that
differ little are averaged at their nodes; faces that meet at an angle have a row each.
"""

from __future__ import annotations

from itertools import chain, repeat

import numpy as np
from ngsolve import BND, H1, ElementId, FESpace, GridFunction
from scipy.sparse import csr_matrix, eye

from ngepc.discretisation.loads import Supports
from ngepc.discretisation.quadrature import rules_of
from ngepc.discretisation.rows import ContactRows, meeting_faces, rows_along, surface_measure
from ngepc.discretisation.spaces import nodes_at
from ngepc.model.places import Place, Roller, values_at
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.support import FREE_NORMAL, HELD_NORMAL


def roller_rows(problem: Problem, supports: Supports) -> dict[Place, ContactRows]:
    """The rows of each roller, but for directions that other supports hold already.

    A ValueError if two supports give a node different displacements along one direction.
    """
    scalar, taken, result = H1(problem.mesh, order=problem.order), {}, {}
    for place, roller in problem.rollers.items():
        values, new = _nodal_values(problem, scalar, place, roller), []
        nodes, directions = _directions(problem, scalar, place, roller)
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        for node, d in zip(nodes.tolist(), directions, strict=True):
            held = taken.setdefault(node, _Held(supports.free[node], supports.values[node]))
            new.append(held.takes(d, values[node], place))
        nodes, directions = nodes[new], directions[new]
        result[place] = rows_along(
            directions,
            csr_matrix(eye(scalar.ndof))[nodes],
            vertices=np.zeros(len(nodes), dtype=int),
            gaps=values[nodes],
            weights=np.zeros(len(nodes)),  # no part of the contact area
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
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and directions of any length: the given one, or the normals of the faces there."""
    if roller.direction is not None:
        nodes = nodes_at(scalar, place)
        return nodes, np.tile(np.array(roller.direction, dtype=float), (len(nodes), 1))
    region = problem.mesh.Boundaries(place)
    points = problem.mesh.MapToAllElements(rules_of(problem.N - 1, 1), region)
    normals = surface_measure(problem, points)[:, None] * np.asarray(problem.normal(points))
    facets = [scalar.GetDofNrs(ElementId(BND, facet.nr)) for facet in region.Elements()]
    corners = np.repeat(normals, [len(nodes) for nodes in facets], axis=0)
    nodes, sums = meeting_faces(chain.from_iterable(facets), repeat(place, len(corners)), corners)
    return nodes, sums @ corners


def _nodal_values(problem: Problem, scalar: FESpace, place: Place, roller: Roller) -> np.ndarray:
    """Coefficients of the given displacement along the direction, shape (nodes,)."""
    values = GridFunction(scalar)
    if isinstance(place, str):
        values.Set(as_scalar(roller.value), definedon=problem.mesh.Boundaries(place))
    else:
        vertices, given = values_at(roller.value, problem.mesh, place)
        values.vec.FV().NumPy()[vertices] = given[:, 0]
    return values.vec.FV().NumPy().copy()
