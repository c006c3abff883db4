"""Data that an integration rule can miss: sampled on a lattice, integrated adaptively.

Polynomials on elements are integrated by rules that are exact for them.  Any other coefficient is
first sampled on a lattice of points.  If a cubic function does not fit the lattice values, the
element is cut into the parts of the lattice, and these are cut again where the values at their
corners differ.  Neighbouring parts whose values a quadratic function fits are integrated together.
Features narrower than the lattice can still be missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

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
from ngepc.discretisation.lattices import (
    SHAPES,
    Piece,
    centre_rule,
    cubics,
    cut,
    degree_two,
    group_basis,
    group_rule,
    groups_of_parts,
    lattice,
    lattice_parts,
    lattice_rule,
    parts_of_edges,
    rule_at,
    values_at_shares,
    with_centres,
)
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.model.elements import has_straight_simplices, vertex_coordinates
from ngepc.model.processes import processes_of

LEVELS = {1: 12, 2: 4, 3: 1}
"""Largest number of levels of cutting, by dimension."""
STEEP = {1: 0.01, 2: 0.05, 3: 0.1}
"""A part is cut if its corners differ by more than this fraction of the element's variation."""
FOLLOWED = 1e-4
"""Part of the largest value that a cubic function may miss on an element that rules integrate.

A quadratic function may miss as much of the variation in an element on a group of parts.
"""

AT_ONCE = 200_000
"""Points that are looked at together at most: each takes some hundred bytes."""


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


def rounding_of_gaps(mesh: Mesh) -> float:
    """Rounding errors of gaps (length): nothing else is left where an obstacle touches.

    Gaps are differences of coordinates, whose size they do not tell.
    """
    return 1e-12 * float(np.abs(vertex_coordinates(mesh)).max(initial=0.0))


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
    rounding
        Size of the rounding errors of the values: nothing smaller is hidden.
    """

    def __init__(
        self,
        mesh: Mesh,
        value: Coefficient,
        kind: object,
        chosen: np.ndarray | None = None,
        rounding: float = 0.0,
    ) -> None:
        self.mesh = mesh
        self.value = value
        self.kind = kind
        self.rounding = rounding
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
        return np.sort(numbers[missed > max(FOLLOWED * size, self.rounding)])

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
