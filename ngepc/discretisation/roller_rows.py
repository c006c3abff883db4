"""The rows of rollers.

Supports along oblique directions are rows d . u = value with forces of either sign.  Every node has
a row of its own, those of quadratic displacements between the vertices as well, so that a roller
along an axis is the same support as a prescribed component.  Normals of facets that differ little
are averaged at their nodes; faces that meet at an angle have a row each.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from ngsolve import FESpace
from scipy.sparse import csr_matrix, eye

from ngepc.discretisation.gap_records import mapped_facets
from ngepc.discretisation.mortar import HALF
from ngepc.discretisation.rows import ContactRows, meeting_faces, rows_along
from ngepc.discretisation.spaces import nodes_at
from ngepc.discretisation.supports import Supports, given_at
from ngepc.model.places import Place, Roller
from ngepc.model.problem import Problem
from ngepc.model.support import FREE_NORMAL, HELD_NORMAL


def not_implied(tied: ContactRows, rollers: Iterable[ContactRows]) -> np.ndarray:
    """Numbers of the rows of glue that rollers and other rows of the same node do not imply.

    Where rollers hold both bodies along d, d . (u_1 - u_2) = 0 already: of the rows along the axes
    that of the largest component of d is left out.
    """
    implied = np.zeros(len(tied), bool)
    for held in rollers:
        count = tied.normal.shape[1] // tied.normals.shape[1]
        d = np.zeros((count, tied.normals.shape[1]))
        d[held.nodes] = held.normals
        own = d[tied.nodes]
        largest = np.abs(own).argmax(axis=1) == np.abs(tied.normals).argmax(axis=1)
        component = np.abs(np.einsum("mc,mc->m", own, tied.normals))
        # zero where the second body is held along d, too
        differs = np.abs(tied.normal @ d.ravel())
        implied |= (component > 0) & largest & (differs < HALF * component)
    return np.flatnonzero(~implied)


class HeldDirections:
    """The directions that supports hold at the nodes of rollers.

    ``at`` maps a node to orthonormal directions (k, N), and the displacements (k,) along them.
    """

    def __init__(self, supports: Supports) -> None:
        self._supports = supports
        self.at: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def added(
        self,
        place: Place,
        nodes: np.ndarray,
        directions: np.ndarray,
        values: np.ndarray,
    ) -> list[bool]:
        """Add the directions (n, N) of a roller at its nodes; which of them are new.

        A ValueError if two supports give a node different displacements along one direction.
        """
        each = zip(nodes.tolist(), directions, values, strict=True)
        return [self._add(place, node, d, value) for node, d, value in each]

    def _add(self, place: Place, node: int, d: np.ndarray, value: float) -> bool:
        """The same for one node."""
        basis, known = self.at.setdefault(node, self._components(node))
        shares = basis @ d
        rest = d - shares @ basis
        left = value - shares @ known
        size = np.linalg.norm(rest)
        if size < HELD_NORMAL and abs(left) > 1e-8 * max(1e-300, *np.abs(known)):
            raise ValueError(
                f"prescribed[{place!r}] and another support give a node different displacements"
                f" along {d.round(6).tolist()}: the values must agree, they differ by {left:g}"
            )
        if size < FREE_NORMAL:
            return False
        basis = np.vstack([basis, rest / size])
        self.at[node] = basis, np.append(known, left / size)
        return True

    def _components(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """The components that are held at a node, as directions."""
        fixed = np.flatnonzero(~self._supports.free[node])
        values = self._supports.values[node, fixed]
        return np.eye(self._supports.free.shape[1])[fixed], values


def directions_of_roller(
    problem: Problem, scalar: FESpace, place: Place
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of a roller, its unit directions there (n, N), and the given displacements (n,).

    A node between two faces comes twice.
    """
    roller = problem.rollers[place]
    nodes, directions = _directions(problem, scalar, place, roller)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    at, given = given_at(scalar, place, roller.value)
    return nodes, directions, given[np.searchsorted(at, nodes)]


def roller_rows(problem: Problem, supports: Supports) -> dict[Place, ContactRows]:
    """The rows of each roller, but for directions that other supports hold already.

    A ValueError if two supports give a node different displacements along one direction.
    """
    scalar = supports.scalar
    held = HeldDirections(supports)
    result = {}
    for place in problem.rollers:
        nodes, directions, values = directions_of_roller(problem, scalar, place)
        new = held.added(place, nodes, directions, values)
        means = csr_matrix(eye(scalar.ndof))[nodes[new]]
        no = np.zeros(sum(new))
        # no contact area
        given = {
            "nodes": nodes[new],
            "corners": np.zeros((len(no), 4), dtype=int),
            "gaps": values[new],
            "weights": no,
        }
        result[place] = rows_along(directions[new], means, tied=True, **given)
    return result


def _directions(
    problem: Problem, scalar: FESpace, place: Place, roller: Roller
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and directions of any length: the given one, or the normals of the faces there."""
    if roller.direction is not None:
        nodes = nodes_at(scalar, place)
        return nodes, np.tile(np.array(roller.direction, dtype=float), (len(nodes), 1))
    nodes = []
    corners = []
    for _, of_facets, _, area, points in mapped_facets(problem, scalar, place, 1):
        nodes.append(of_facets.ravel())
        corners.append(
            np.repeat(area * problem.normal(points), of_facets.shape[1], axis=0)
        )
    nodes = np.concatenate(nodes)
    corners = np.vstack(corners)
    nodes, sums = meeting_faces(nodes, np.zeros(len(nodes)), corners)
    return nodes, sums @ corners
