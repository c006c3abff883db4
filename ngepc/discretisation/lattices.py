"""Lattices of points in elements, and the parts into which they cut an element.

Quadrilaterals, prisms and hexahedra are treated as the simplices into which their reference
element is cut.  The shares of a point are its coordinates in the reference element, and one minus
their sum; in a simplex these are its barycentric coordinates.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations_with_replacement, permutations
from typing import NamedTuple

import numpy as np
from ngsolve import BND, ET, VOL, CoefficientFunction, IntegrationRule, Mesh

from ngepc.model.elements import element_nodes

SIMPLICES = {1: ET.SEGM, 2: ET.TRIG, 3: ET.TET}

SHAPES = {1: (ET.SEGM,), 2: (ET.TRIG, ET.QUAD), 3: (ET.TET, ET.PRISM, ET.HEX)}
"""Shapes of elements by dimension."""

FINEST = {1: 128, 2: 96, 3: 18}
"""Parts of an edge by dimension: they resolve spots of 1/50 of an edge, 1/10 in space."""

FINEST_FACET = 48
"""Parts of an edge of a triangle on the boundary of a body in space."""

COARSEST = {1: 128, 2: 12, 3: 6}

MOST_POINTS = 8_000_000
"""Points of a lattice on all elements; where they would be more the lattice is coarser."""

GROUPED = {1: 4, 2: 4, 3: 3}
"""Parts of an edge that form a group, by dimension."""

GROUP_DEGREE = 4
"""Of the rule on a group, for quadratic functions, their squares and products with shapes."""


@cache
def parts_of_simplex(dim: int, count: int) -> np.ndarray:
    """The parts of a simplex with ``count`` parts of each edge; barycentric corners.

    Kuhn's parts of the cubes of a lattice, shape (count^dim, dim + 1, dim + 1).
    """
    grid = np.indices((count,) * dim).reshape(dim, -1).T
    found = []
    for order in permutations(range(dim)):
        steps = np.insert(np.cumsum(np.eye(dim)[list(order)], axis=0), 0, 0.0, axis=0)
        corners = grid[:, None] + steps
        inside = (np.diff(corners, axis=2) <= 0).all(axis=(1, 2))
        found.append(corners[inside])
    place = np.concatenate(found) / count
    ends = np.concatenate(
        [np.ones((*place.shape[:2], 1)), place, np.zeros((*place.shape[:2], 1))], axis=2
    )
    return -np.diff(ends, axis=2)


@cache
def pieces_of(shape: ET) -> np.ndarray:
    """The simplices of a reference element: shares of their corners, (pieces, dim + 1, dim + 1).

    Each has the size of the reference simplex.
    """
    if shape == ET.PRISM:
        return _pieces_of_prism()
    if shape not in (ET.QUAD, ET.HEX):
        dim = next(dim for dim, simplex in SIMPLICES.items() if simplex == shape)
        return np.eye(dim + 1)[None]
    dim = 2 if shape == ET.QUAD else 3
    paths = [np.eye(dim)[list(order)] for order in permutations(range(dim))]
    corners = np.array([np.insert(np.cumsum(path, axis=0), 0, 0, 0) for path in paths])
    return with_last_share(corners)


def _pieces_of_prism() -> np.ndarray:
    """The three tetrahedra of the reference prism."""
    low = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 0)], dtype=float)
    high = low + np.array([0.0, 0.0, 1.0])
    corners = [[*low[: k + 1], *high[k:]] for k in range(3)]
    return with_last_share(np.array(corners))


def with_last_share(places: np.ndarray) -> np.ndarray:
    """Shares (..., dim + 1) of points of a reference element (..., dim)."""
    last = 1 - places.sum(axis=-1, keepdims=True)
    return np.concatenate([places, last], axis=-1)


@cache
def degree_two(dim: int) -> np.ndarray:
    """Barycentric points of a rule with equal weights that is exact for degree two."""
    share = (1 - (dim + 2) ** -0.5) / (dim + 1)
    return share + (1 - (dim + 1) * share) * np.eye(dim + 1)


def parts_of_edges(mesh: Mesh, kind: object) -> int:
    """Parts of an edge in the lattice on the elements of a body (VOL) or its boundary (BND)."""
    inside = kind == VOL
    dim = mesh.dim if inside else mesh.dim - 1
    finest = FINEST_FACET if dim == 2 and not inside else FINEST[dim]
    elements = mesh.ne if inside else mesh.GetNE(BND)
    if (element_nodes(mesh)[:, mesh.dim + 1 :] >= 0).any():
        elements *= math.factorial(dim)  # at most as many pieces
    each = MOST_POINTS * math.factorial(dim) / max(elements, 1)
    wanted = min(finest, max(COARSEST[dim], each ** (1 / dim)))
    return math.ceil(wanted / GROUPED[dim]) * GROUPED[dim]


def rule_at(shares: np.ndarray) -> IntegrationRule:
    """NGSolve's rule with these barycentric points (q, dim + 1), all weights zero."""
    places = list(zip(*shares[:, :-1].T.tolist(), strict=True))
    return IntegrationRule(places, [0.0] * len(places))


def values_at_shares(
    mesh: Mesh,
    numbers: np.ndarray,
    shares: np.ndarray,
    value: CoefficientFunction,
    kind: object = VOL,
) -> np.ndarray:
    """Values at the same points of several elements, shape (elements, points, components).

    ``shares`` (points, dim + 1) are those of the points.
    """
    somewhere = mesh.MapToAllElements(rule_at(shares[:1]), kind)
    points = np.repeat(somewhere[numbers], len(shares))
    for axis, places in zip("xyz", shares[:, :-1].T, strict=False):
        points[axis] = np.tile(places, len(numbers))
    return np.asarray(value(points)).reshape(len(numbers), len(shares), -1)


def cut(corners: np.ndarray, count: int = 2) -> np.ndarray:
    """The count^dim parts of each of some simplices, corners (parts, dim + 1, dim + 1)."""
    dim = corners.shape[2] - 1
    children = np.einsum("cab,pbd->pcad", parts_of_simplex(dim, count), corners)
    return children.reshape(-1, dim + 1, dim + 1)


def groups_of_parts(dim: int, count: int) -> np.ndarray:
    """The groups of the parts of a lattice, barycentric corners (groups, dim + 1, dim + 1)."""
    return parts_of_simplex(dim, count // GROUPED[dim])


@cache
def lattice_parts(dim: int, count: int) -> np.ndarray:
    """The parts of a lattice, group after group, barycentric corners (parts, dim + 1, dim + 1)."""
    return cut(groups_of_parts(dim, count), GROUPED[dim])


@cache
def lattice(dim: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Which lattice point is which corner of ``lattice_parts``, and the points (q, dim + 1)."""
    corners = lattice_parts(dim, count)
    keys = (corners.reshape(-1, dim + 1) * count).round().astype(int)
    points, index = np.unique(keys, axis=0, return_inverse=True)
    return index.reshape(corners.shape[:2]), points / count


@cache
def lattice_rule(piece: Piece, count: int) -> IntegrationRule:
    """The lattice points in a piece as a rule of NGSolve."""
    return rule_at(lattice(piece.dim, count)[1] @ piece.corners)


@cache
def centre_rule(piece: Piece, count: int) -> IntegrationRule:
    """The centres of ``lattice_parts`` in a piece as a rule of NGSolve."""
    return rule_at(lattice_parts(piece.dim, count).mean(axis=1) @ piece.corners)


@cache
def cubics(dim: int, count: int) -> np.ndarray:
    """An orthonormal basis of the cubic functions at lattice points, (q, functions)."""
    points = lattice(dim, count)[1]
    powers = [
        np.prod(points[:, list(chosen)], axis=1)
        for chosen in combinations_with_replacement(range(dim + 1), 3)
    ]
    return np.linalg.qr(np.stack(powers, axis=1))[0]


class Piece(NamedTuple):
    """A simplex of the reference element of a shape."""

    shape: ET
    number: int

    @property
    def corners(self) -> np.ndarray:
        """Shares of its corners, (dim + 1, dim + 1)."""
        return pieces_of(self.shape)[self.number]

    @property
    def dim(self) -> int:
        """Its dimension."""
        return len(self.corners) - 1

    @classmethod
    def all(cls, shape: ET) -> list[Piece]:
        """All pieces of a shape."""
        return [cls(shape, number) for number in range(len(pieces_of(shape)))]


@cache
def group_basis(dim: int) -> np.ndarray:
    """An orthonormal basis of the quadratic functions where a group is sampled, (q, functions).

    These are the corners and centres of its parts, one part after the other.
    """
    corners = parts_of_simplex(dim, GROUPED[dim])
    points = with_centres(corners).reshape(-1, dim + 1)
    first, second = np.transpose(list(combinations_with_replacement(range(dim + 1), 2)))
    return np.linalg.qr(points[:, first] * points[:, second])[0]


@cache
def group_rule(dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points of a rule for one group, (q, dim + 1), and weights with the sum one."""
    rule = IntegrationRule(SIMPLICES[dim], GROUP_DEGREE)
    inside = np.array(rule.points)[:, :dim]
    shares = np.column_stack([inside, 1 - inside.sum(axis=1)])
    weights = np.array(rule.weights)
    return shares, weights / weights.sum()


def with_centres(corners: np.ndarray) -> np.ndarray:
    """The corners of parts and their centres, (parts, dim + 2, .)."""
    return np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
