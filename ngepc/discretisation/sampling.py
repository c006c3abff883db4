"""Data that an integration rule can miss: sampled on a lattice, integrated adaptively.

Polynomials on elements are integrated by rules that are exact for them.  Any other coefficient is
first sampled on a lattice of points.  If a cubic function does not fit the lattice values, the
element is cut into the parts of the lattice, and these are cut again where the values at their
corners differ.  Neighbouring parts whose values a quadratic function fits are integrated together.
Features narrower than the lattice can still be missed.

Quadrilaterals, prisms and hexahedra are treated as the simplices into which their reference
element is cut.  The shares of a point are its coordinates in the reference element, and one minus
their sum; in a simplex these are its barycentric coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement, permutations
from typing import NamedTuple

import numpy as np
from ngsolve import (
    BND,
    ET,
    VOL,
    CoefficientFunction,
    ElementId,
    IntegrationRule,
    Mesh,
    specialcf,
)

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.model.elements import element_nodes, has_straight_simplices
from ngepc.model.processes import processes_of

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
LEVELS = {1: 12, 2: 4, 3: 1}
"""Largest number of levels of cutting, by dimension."""
STEEP = {1: 0.01, 2: 0.05, 3: 0.1}
"""A part is cut if its corners differ by more than this fraction of the element's variation."""
FOLLOWED = 1e-4
"""Part of the largest value that a cubic function may miss on an element that rules integrate.

A quadratic function may miss as much of the variation in an element on a group of parts.
"""
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


AT_ONCE = 200_000
"""Points that are looked at together at most: each takes some hundred bytes."""


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


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of one piece, and the values of a coefficient at their corners and centres.

    ``corners`` (parts, dim + 1, dim + 1) are barycentric in the piece, ``values``
    (parts, dim + 2, k); ``size`` (parts,) are parts of the piece's, zero where a group is
    integrated as a whole.
    """

    corners: np.ndarray
    values: np.ndarray
    size: np.ndarray

    def differences(self) -> np.ndarray:
        """By how much the values differ on each part, (parts, k)."""
        return differences_on(self.values)

    def chosen(self, mask: np.ndarray) -> Parts:
        """Some of the parts."""
        return Parts(self.corners[mask], self.values[mask], self.size[mask])

    @classmethod
    def joined(cls, several: list[Parts]) -> Parts:
        """All of several."""
        fields = ((p.corners, p.values, p.size) for p in several)
        return cls(*(np.concatenate(field) for field in zip(*fields, strict=True)))


def differences_on(values: np.ndarray) -> np.ndarray:
    """By how much values (parts, points, k) differ on each part, (parts, k)."""
    return np.ptp(np.ascontiguousarray(values.swapaxes(0, 1)), axis=0)


def variation(values: np.ndarray) -> np.ndarray:
    """By how much values (parts, points, k) differ on all parts, (k,)."""
    columns = values.reshape(-1, values.shape[-1]).T
    return np.ptp(np.ascontiguousarray(columns), axis=1)


def smooth_groups(values: np.ndarray, dim: int) -> np.ndarray:
    """Which groups of the parts of a lattice have values that a quadratic function fits.

    ``values`` (parts, dim + 2, k) are those at the corners and centres of all parts.
    """
    basis = group_basis(dim)
    components = values.shape[2]
    of_groups = values.reshape(-1, len(basis), components)
    missed = of_groups - basis @ (basis.T @ of_groups)
    largest = np.abs(np.ascontiguousarray(missed.swapaxes(0, 1))).max(axis=0)
    return (largest <= FOLLOWED * variation(values)).all(axis=1)


@dataclass(frozen=True, eq=False)
class HiddenRule:
    """An adaptive rule: points in one element, weights, and the values of a coefficient.

    ``shares`` (q, dim + 1) are those of the points; ``weights`` (q,)
    add up to the size of the element; ``values`` (q, k).  ``corners`` (parts, dim + 2, dim + 1) are
    those of the parts and their centres, with the values ``at_corners`` (parts, dim + 2, k).
    ``unresolved`` (k,) is
    the integral of the squares of the differences on the parts that were not resolved.
    """

    shares: np.ndarray
    weights: np.ndarray
    values: np.ndarray
    corners: np.ndarray
    at_corners: np.ndarray
    unresolved: np.ndarray

    @classmethod
    def joined(cls, several: list[HiddenRule]) -> HiddenRule:
        """The rule on all pieces of an element."""
        if len(several) == 1:
            return several[0]
        names = ("shares", "weights", "values", "corners", "at_corners")
        arrays = {
            name: np.concatenate([getattr(rule, name) for rule in several])
            for name in names
        }
        return cls(**arrays, unresolved=sum(rule.unresolved for rule in several))


class Scan:
    """A coefficient on elements, sampled on a lattice.

    ``hidden`` are the numbers of the elements where a rule of moderate order would miss something;
    ``rule(number)`` integrates there.

    Parameters
    ----------
    mesh, value
        The mesh, and the coefficient.
    kind
        VOL or BND: elements of the body or of its boundary.
    chosen
        Which of them, as booleans; all by default.  Pyramids are left out.
    """

    def __init__(
        self,
        mesh: Mesh,
        value: Coefficient,
        kind: object,
        chosen: np.ndarray | None = None,
    ) -> None:
        self.mesh = mesh
        self.value = value
        self.kind = kind
        self.dim = mesh.dim if kind == VOL else mesh.dim - 1
        self.hidden = np.zeros(0, dtype=int)
        if is_polynomial(value, mesh):
            return
        self._seen = value.Compile()  # each common part is evaluated once
        numbers = np.arange(mesh.ne if kind == VOL else mesh.GetNE(BND))
        if chosen is not None:
            numbers = numbers[chosen]
        shapes = [self._shape(number) for number in numbers.tolist()]
        found = []
        for shape in SHAPES[self.dim]:
            same = np.array([other == shape for other in shapes], dtype=bool)
            found.append((shape, numbers[same]))
        self.hidden = self._hidden(found)

    def _shape(self, number: int) -> ET:
        """The shape of an element."""
        return self.mesh[ElementId(self.kind, number)].type

    @cached_property
    def count(self) -> int:
        """Parts of an edge in the lattice."""
        return parts_of_edges(self.mesh, self.kind)

    @cached_property
    def _straight(self) -> bool:
        """Whether the Jacobian of each element is constant."""
        return has_straight_simplices(self.mesh)

    def _hidden(self, by_shape: list[tuple[ET, np.ndarray]]) -> np.ndarray:
        """The elements whose lattice values no cubic function fits, beside the largest value."""
        numbers = np.concatenate([some for _, some in by_shape])
        measured = [self._missed(shape, some) for shape, some in by_shape]
        sizes, missed = np.concatenate(measured, axis=1)
        size = processes_of(self.mesh).maximum(sizes)
        return np.sort(numbers[missed > FOLLOWED * size])

    def _missed(self, shape: ET, numbers: np.ndarray) -> np.ndarray:
        """The largest value on each element, and by how much a cubic function misses, (2, k)."""
        found = np.zeros((2, len(numbers)))
        if not len(numbers):
            return found
        basis = cubics(self.dim, self.count)
        together = max(AT_ONCE // len(basis), 1)
        for first in range(0, len(numbers), together):
            some = slice(first, first + together)
            for piece in Piece.all(shape):
                values = self.on_lattice(numbers[some], piece)
                fitted = basis @ (basis.T @ values)
                size = np.abs(values).max(axis=(1, 2))
                missed = np.abs(values - fitted).max(axis=(1, 2))
                found[:, some] = np.maximum(found[:, some], [size, missed])
        return found

    def on_lattice(self, numbers: np.ndarray, piece: Piece) -> np.ndarray:
        """Values on the lattice in a piece, shape (elements, points, components)."""
        shares = lattice(self.dim, self.count)[1] @ piece.corners
        return self.on_elements(numbers, shares)

    def lattice_in(self, shape: ET) -> np.ndarray:
        """The shares of the lattice points in elements of a shape, (points, dim + 1)."""
        points = lattice(self.dim, self.count)[1]
        return np.concatenate([points @ piece.corners for piece in Piece.all(shape)])

    def hidden_alike(self) -> Iterator[tuple[ET, np.ndarray]]:
        """The ``hidden`` of one shape, as many as are looked at together."""
        shapes = [self._shape(number) for number in self.hidden.tolist()]
        for shape in SHAPES[self.dim]:
            numbers = self.hidden[[other == shape for other in shapes]]
            together = max(AT_ONCE // len(self.lattice_in(shape)), 1)
            for first in range(0, len(numbers), together):
                yield shape, numbers[first : first + together]

    def on_elements(
        self,
        numbers: np.ndarray,
        shares: np.ndarray,
        value: CoefficientFunction | None = None,
    ) -> np.ndarray:
        """Values, or those of another coefficient, (elements, points, components)."""
        value = self._seen if value is None else value
        return values_at_shares(self.mesh, numbers, shares, value, self.kind)

    def at(
        self, number: int, shares: np.ndarray, value: CoefficientFunction
    ) -> np.ndarray:
        """Another coefficient at points of one element given by shares, (points, components)."""
        return self._at(number, rule_at(shares), value)

    def _at(
        self, number: int, rule: IntegrationRule, value: CoefficientFunction = None
    ) -> np.ndarray:
        """Values at the points of a rule on one element, (points, components)."""
        trafo = self.mesh.GetTrafo(ElementId(self.kind, number))
        found = (self._seen if value is None else value)(trafo(rule))
        return np.asarray(found).reshape(len(rule), -1)

    def rule(self, number: int) -> HiddenRule:
        """Points on the parts of the lattice, cut where values differ, and on smooth groups."""
        pieces = Piece.all(self._shape(number))
        return HiddenRule.joined([self._rule(number, piece) for piece in pieces])

    def _rule(self, number: int, piece: Piece) -> HiddenRule:
        """The rule on one piece of an element."""
        dim = self.dim
        parts, groups = self._sampled(number, piece)
        limit = STEEP[dim] * variation(parts.values)
        kept = []
        for level in range(LEVELS[dim] + 1):
            steep = (parts.differences() > limit).any(axis=1)
            if level == LEVELS[dim] or not steep.any():
                break
            kept.append(parts.chosen(~steep))
            parts = self._cut(number, piece, parts.chosen(steep))
        unresolved = parts.size[steep] @ parts.differences()[steep] ** 2

        parts = Parts.joined([*kept, parts])
        inside, weights = points_on(groups, parts)
        shares = inside @ piece.corners
        rule = rule_at(shares)
        weights = weights * self._measure(number, rule)
        return HiddenRule(
            shares=shares,
            weights=weights,
            values=self._at(number, rule),
            corners=with_centres(parts.corners) @ piece.corners,
            at_corners=parts.values,
            unresolved=unresolved * weights.sum(),
        )

    def _sampled(self, number: int, piece: Piece) -> tuple[Parts, np.ndarray]:
        """The parts of the lattice, and the groups of them that are integrated as one.

        In these no part has values that differ much.
        """
        dim = self.dim
        corners = lattice_parts(dim, self.count)
        index = lattice(dim, self.count)[0]
        at_lattice = self._at(number, lattice_rule(piece, self.count))[index]
        centres = self._at(number, centre_rule(piece, self.count))
        values = np.concatenate([at_lattice, centres[:, None]], axis=1)

        groups = groups_of_parts(dim, self.count)
        steep = differences_on(values) > STEEP[dim] * variation(values)
        smooth = smooth_groups(values, dim)
        smooth &= ~steep.reshape(len(groups), -1).any(axis=1)
        each = len(corners) // len(groups)
        size = np.where(np.repeat(smooth, each), 0.0, 1 / len(corners))
        return Parts(corners, values, size), groups[smooth]

    def _cut(self, number: int, piece: Piece, parts: Parts) -> Parts:
        """The 2^dim parts of each of some parts."""
        corners = cut(parts.corners)
        size = np.repeat(parts.size / 2**self.dim, 2**self.dim)
        return Parts(corners, self._at_corners(number, piece, corners), size)

    def _at_corners(self, number: int, piece: Piece, corners: np.ndarray) -> np.ndarray:
        """Values at corners and centres of parts of a piece, (parts, dim + 2, .).

        A corner that several parts share is evaluated once.
        """
        every = corners.reshape(-1, self.dim + 1)
        first, index = self._distinct(every)
        distinct = rule_at(every[first] @ piece.corners)
        at_corners = self._at(number, distinct)[index]
        at_corners = at_corners.reshape(*corners.shape[:2], -1)

        centres = rule_at(corners.mean(axis=1) @ piece.corners)
        at_centres = self._at(number, centres)
        return np.concatenate([at_corners, at_centres[:, None]], axis=1)

    def _distinct(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first of equal barycentric points (n, dim + 1), and the place of each among these.

        They are points of the finest lattice, where coordinates are integers.
        """
        most = self.count * 2 ** LEVELS[self.dim]
        on_lattice = (points * most).round().astype(np.int64)
        powers = (most + 1) ** np.arange(self.dim)
        codes = on_lattice[:, :-1] @ powers
        _, first, index = np.unique(codes, return_index=True, return_inverse=True)
        return first, index

    def _measure(self, number: int, rule: IntegrationRule) -> np.ndarray:
        """The size of the element by the Jacobian at the points of a rule, (points,)."""
        if self._straight:
            rule = rule_at(np.full((1, self.dim + 1), 1 / (self.dim + 1)))
        jacobian = specialcf.JacobianMatrix(self.mesh.dim, self.dim)
        J = self._at(number, rule, jacobian).reshape(-1, self.mesh.dim, self.dim)
        return np.sqrt(np.linalg.det(J.swapaxes(1, 2) @ J)) / math.factorial(self.dim)


def points_on(groups: np.ndarray, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points on groups and on parts, (q, dim + 1), and weights with the sum one."""
    dim = groups.shape[2] - 1
    alone = parts.chosen(parts.size > 0)
    inside, of_group = group_rule(dim)
    on_groups = np.matmul(inside, groups).reshape(-1, dim + 1)
    on_parts = np.matmul(degree_two(dim), alone.corners).reshape(-1, dim + 1)

    left = 1 - alone.size.sum()
    group_weights = np.tile(of_group * left / max(len(groups), 1), len(groups))
    part_weights = np.repeat(alone.size / (dim + 1), dim + 1)
    shares = np.concatenate([on_groups, on_parts])
    return shares, np.concatenate([group_weights, part_weights])
