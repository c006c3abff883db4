"""Data of the material that the integration points miss, integrated by a finer rule.

A law acts at few points of each element, and a thin strip may lie between them.  The polynomial
through the values at the points is therefore compared with the L2 projection of the datum on the
same polynomials, by a rule on many parts of the element.  Where the two differ the projection takes
the place of the datum.  There its integrals are those of a rule on parts that are bisected where
their values differ.  On straight simplices of order one the projection is the mean over the
element, and the discrete energy that of the datum itself.

A projection that leaves the range of the values is moved towards the mean, so that positive data
stay positive.  Everywhere else the datum is what it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, fields
from itertools import product
from typing import NamedTuple

import numpy as np
from ngsolve import (
    CF,
    ET,
    L2,
    VOL,
    CoefficientFunction,
    ElementId,
    GridFunction,
    IfPos,
    Mesh,
    specialcf,
)

from ngepc.checks.arguments import Coefficient, require_datum, require_in
from ngepc.checks.declared import declared_checks
from ngepc.discretisation.lattices import (
    SIMPLICES,
    cut,
    degree_two,
    parts_of_simplex,
    pieces_of,
    rule_at,
    values_at_shares,
)
from ngepc.discretisation.points import Points
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.sampling import AT_ONCE, STEEP
from ngepc.model.data import ProblemData
from ngepc.model.elements import (
    elements_by_shape,
    has_straight_simplices,
    plastic_order,
)
from ngepc.model.material import Material
from ngepc.model.processes import processes_of

POINTS = 2_000_000
"""Points of the finer rule on all elements; more where ``FEWEST`` needs them."""
FEWEST = 4
"""Parts of an edge of the finer rule, at least."""
MOST = {2: 48, 3: 12}
"""Parts of an edge of the finer rule, at most, by dimension."""
NOTICED = 0.01
"""Smaller differences are left, relative to the largest value at the points of the element."""
BISECTED = 20_000
"""Parts along interfaces in all elements, at which bisection ends, see ``_levels``."""
RESOLVED = {2: (32, 400), 3: (8, 48)}
"""Least and largest number of parts of an edge by bisection, by dimension."""
NEAR_CORNERS = 0.999
"""Where parts are looked at before they are bisected: the share of the corner."""


def parts_inside(mesh: Mesh) -> int:
    """Parts of an edge of an element on which data of the material are looked at."""
    each = 1
    for numbers, _ in elements_by_shape(mesh):
        shape = mesh[ElementId(VOL, int(numbers[0]))].type
        each = max(each, len(pieces_of(shape)))
    processes = processes_of(mesh)
    pieces = processes.total(mesh.ne) * processes.maximum(np.array([float(each)]))
    parts = POINTS / (pieces * (mesh.dim + 1))
    return int(np.clip(parts ** (1 / mesh.dim), FEWEST, MOST[mesh.dim]))


def seen_problem(problem: ProblemData, points: Points) -> ProblemData:
    """The problem with ``seen`` data of its material and initial strain."""
    material = seen_material(problem.material, points)
    strain = seen(problem.initial_strain, points)
    if material is problem.material and strain is problem.initial_strain:
        return problem
    other = copy(problem)
    vars(other).update(material=material, initial_strain=strain)
    return other


def seen_material(material: Material, points: Points) -> Material:
    """The material with ``seen`` data; itself if the points miss nothing.

    ValueError if a datum has values between the points that are not legal.
    """

    def look(value: Coefficient | None) -> Coefficient | None:
        """The datum, seen."""
        return seen(value, points)

    parts = ("law", "rate")
    given = {f.name: getattr(material, f.name) for f in fields(material)}
    found = {
        name: _law_seen(value, look) if name in parts else look(value)
        for name, value in given.items()
    }
    changed = {name: v for name, v in found.items() if v is not given[name]}
    if not changed:
        return material
    for name, check in declared_checks(Material).items():
        if name in changed and check.func is require_datum:
            values = points.at(changed[name]).reshape(-1, 1)
            require_in(name, values, "the body", **check.keywords)
    other = copy(material)
    vars(other).update(changed)
    return other


def unresolved_data(problem: ProblemData, points: Points | None = None) -> str:
    """A sentence about data with projections, which the mesh does not resolve; empty without.

    ``points`` are those of the problem, by default new ones, which look at all data again.
    """
    material = problem.material
    laws = [law for law in (material.law, material.rate) if law is not None]
    given = {f.name: getattr(material, f.name) for f in fields(material)}
    given |= {
        f"{type(law).__name__}.{n}": v for law in laws for n, v in vars(law).items()
    }
    given["initial_strain"] = problem.initial_strain
    varying = {n: v for n, v in given.items() if not is_polynomial(v, problem.mesh)}
    if not varying:
        return ""
    if points is None:
        points = Points(problem.mesh, problem.kinematics, problem.order)
    names = [n for n, v in varying.items() if seen(v, points) is not v]
    if not names:
        return ""
    kept = "vary: their integrals over elements are kept, but the mesh does not follow them"
    if len(names) == 1:
        kept = "varies: its integrals over elements are kept, but the mesh does not follow it"
    return (
        f"Between integration points {', '.join(names)} {kept}; refine it there, or let its edges "
        "follow jumps."
    )


def _law_seen(law: object, look: Callable) -> object:
    """A law of hardening or of the rate with seen data."""
    if law is None:
        return None
    other = law.at(look)
    same = all(a is b for a, b in zip(law.data, other.data, strict=True))
    return law if same else other


def seen(value: Coefficient | None, points: Points) -> Coefficient | None:
    """The datum, with its projection in the elements where the points miss something.

    The points keep what was found for later steps of a history.
    """
    varies = isinstance(value, CoefficientFunction) and points.mesh is not None
    if not varies or is_polynomial(value, points.mesh):
        return value
    usual = points.at(value)
    known = points.seen.get(id(value))
    if known is None or not np.array_equal(known.usual, usual):
        known = Seen(value, usual, _with_projections(value, usual, points))
        points.seen[id(value)] = known
    return known.used


@dataclass(frozen=True, eq=False)
class Seen:
    """A datum, its values at the points, and the datum with its projections."""

    given: CoefficientFunction
    usual: np.ndarray
    used: CoefficientFunction


def _with_projections(
    value: CoefficientFunction, usual: np.ndarray, points: Points
) -> CoefficientFunction:
    """The datum, with its projection where that differs from the values at the points."""
    mesh = points.mesh
    values = usual.reshape(len(points), -1).copy()
    missed = np.zeros(mesh.ne)
    rules = []
    parts = parts_inside(mesh)
    alike = zip(elements_by_shape(mesh), points.blocks, strict=True)
    for (numbers, _), block in alike:
        shape = mesh[ElementId(VOL, int(numbers[0]))].type
        finer = FinerRule(points, shape, value, parts)
        differ = finer.differ(numbers, values[block.points])
        missed[numbers[differ]] = 1.0
        if differ.any():
            rules.append((finer, numbers[differ], block.points[differ]))
    many = int(points.processes.total(missed.sum()))
    if not many:
        return value
    for finer, numbers, there in rules:
        values[there] = finer.projections(numbers, many)
    there = GridFunction(L2(mesh, order=0))
    there.vec.FV().NumPy()[:] = missed
    projected = points.functions.function(values.reshape(usual.shape))
    if value.dims:
        parts = tuple(projected[i] for i in range(value.dim))
        projected = CF(parts, dims=tuple(value.dims))
    return IfPos(there - 0.5, projected, value)


class FinerRule:
    """A coefficient on the elements of one shape, and the polynomials through its points."""

    def __init__(
        self, points: Points, shape: ET, value: CoefficientFunction, parts: int
    ) -> None:
        self.mesh = points.mesh
        self.shape = shape
        self.value = value
        self.dim = points.mesh.dim
        degree = plastic_order(points.mesh, points.order)
        self._powers = powers(shape, degree)
        nodes = np.array(points.rules[shape].points)[:, : self.dim]
        self._inverse = np.linalg.inv(self._monomials(nodes))
        self._weight = None
        if points.kinematics.hoop or not has_straight_simplices(points.mesh):
            self._weight = points.kinematics.weight
        self._somewhere = self.mesh.MapToAllElements(
            rule_at(np.eye(self.dim + 1)[:1]), VOL
        )
        self._levels = 0
        self._count = parts
        corners = parts_of_simplex(self.dim, parts)
        pieces = [corners @ piece for piece in pieces_of(shape)]
        self._parts = np.concatenate(pieces)

    def _monomials(self, places: np.ndarray) -> np.ndarray:
        """Products of powers of the coordinates of a reference element, (points, functions)."""
        return np.prod(places[:, None, :] ** self._powers, axis=2)

    def _functions(self, shares: np.ndarray) -> np.ndarray:
        """The polynomials that are 1 at one of the points, (points, functions)."""
        return self._monomials(shares[:, :-1]) @ self._inverse

    def differ(self, numbers: np.ndarray, usual: np.ndarray) -> np.ndarray:
        """In which elements the projection is not what the points say, as booleans.

        ``usual`` (elements, points, components) are the values at the points.
        """
        inside = np.matmul(degree_two(self.dim), self._parts)
        shares = inside.reshape(-1, self.dim + 1)
        functions = self._functions(shares)
        projection = np.linalg.solve(functions.T @ functions, functions.T)
        found = np.zeros(len(numbers), dtype=bool)
        together = max(AT_ONCE // len(shares), 1)
        for first in range(0, len(numbers), together):
            some = slice(first, first + together)
            values = values_at_shares(self.mesh, numbers[some], shares, self.value)
            # values that are not finite have no projection
            with np.errstate(invalid="ignore"):
                away = np.abs(np.matmul(projection, values) - usual[some])
            largest = np.abs(usual[some]).max(axis=(1, 2))
            finite = np.isfinite(values).all(axis=(1, 2))
            found[some] = finite & (away.max(axis=(1, 2)) > NOTICED * largest)
        return found

    def projections(self, numbers: np.ndarray, many: int) -> np.ndarray:
        """The projections at the points of elements, (elements, points, components), limited.

        They are some of ``many`` elements, on all processes.
        """
        self._levels = levels(self.dim, self._count, many)
        together = max(AT_ONCE // (2 * self._parts[..., 0].size), 1)
        chunks = range(0, len(numbers), together)
        found = [self._projected(numbers[k : k + together]) for k in chunks]
        return np.concatenate(found)

    def _projected(self, numbers: np.ndarray) -> np.ndarray:
        """The same for some elements, by one rule on the parts of all."""
        several = list(self._bisected(numbers))
        leaves = Leaves(*map(np.concatenate, zip(*several, strict=True)))
        functions = self._functions(leaves.shares)
        weights = leaves.weights * self._measure(numbers[leaves.owner], leaves.shares)
        order = np.argsort(leaves.owner, kind="stable")
        ends = np.searchsorted(leaves.owner[order], np.arange(1, len(numbers)))
        found = []
        for those in np.split(order, ends):
            values = leaves.values[those]
            weighted = weights[those, None] * functions[those]
            gram = weighted.T @ functions[those]
            projection = np.linalg.solve(gram, weighted.T @ values)
            mean = weights[those] @ values / weights[those].sum()
            extremes = values.min(axis=0), values.max(axis=0)
            found.append(within(projection, mean, *extremes))
        return np.array(found)

    def _bisected(self, numbers: np.ndarray) -> Iterator[Leaves]:
        """The points of a rule on elements, those of the coarse parts first.

        A part is cut where its values differ, at the points and close to the corners.
        """
        count = self.dim + 1
        near = 1 / count + NEAR_CORNERS * (np.eye(count) - 1 / count)
        looked = np.concatenate([degree_two(self.dim), near])
        corners = np.tile(self._parts, (len(numbers), 1, 1))
        owner = np.arange(len(numbers)).repeat(len(self._parts))
        size = 1 / len(self._parts)
        variation = None
        for level in range(self._levels + 1):
            shares = np.matmul(looked, corners)
            there = numbers[owner.repeat(2 * count)]
            values = self._at(there, shares.reshape(-1, count), self.value)
            values = values.reshape(len(corners), 2 * count, -1)
            if variation is None:
                by_element = values.reshape(len(numbers), -1, values.shape[2])
                variation = np.ptp(by_element, axis=1)
            differs = np.ptp(values, axis=1) > STEEP[self.dim] * variation[owner]
            steep = differs.any(axis=1) & (level < self._levels)
            kept = owner[~steep].repeat(count)
            yield Leaves(
                owner=kept,
                shares=shares[~steep, :count].reshape(-1, count),
                weights=np.full(len(kept), size / count),
                values=values[~steep, :count].reshape(len(kept), values.shape[2]),
            )
            if not steep.any():
                return
            corners = cut(corners[steep])
            owner = owner[steep].repeat(2**self.dim)
            size /= 2**self.dim

    def _at(
        self, numbers: np.ndarray, shares: np.ndarray, value: CoefficientFunction
    ) -> np.ndarray:
        """Values at points of elements, one number and shares for each, (points, components)."""
        points = self._somewhere[numbers]
        for axis, places in zip("xyz", shares[:, :-1].T, strict=False):
            points[axis] = places
        return np.asarray(value(points)).reshape(len(numbers), -1)

    def _measure(self, numbers: np.ndarray, shares: np.ndarray) -> np.ndarray | float:
        """The volume that belongs to points of elements, up to a factor."""
        if self._weight is None:
            return 1.0
        jacobian = specialcf.JacobianMatrix(self.dim)
        jacobians = self._at(numbers, shares, jacobian)
        sizes = np.abs(np.linalg.det(jacobians.reshape(-1, self.dim, self.dim)))
        return sizes * self._at(numbers, shares, CF(self._weight))[:, 0]


class Leaves(NamedTuple):
    """Points of a rule on several elements: the place of the element, shares, weights, values."""

    owner: np.ndarray
    shares: np.ndarray
    weights: np.ndarray
    values: np.ndarray


def levels(dim: int, count: int, many: int) -> int:
    """How often parts are bisected in ``many`` elements with ``count`` parts of an edge."""
    wanted = (BISECTED / many) ** (1 / (dim - 1))
    resolved = np.clip(wanted, *RESOLVED[dim])
    return max(math.ceil(math.log2(resolved / count)), 0)


def powers(shape: ET, degree: int) -> np.ndarray:
    """The exponents of the polynomials that the points of a shape determine, (functions, dim)."""
    if shape == ET.PRISM:
        triangle = powers(ET.TRIG, degree)
        return np.array([(*low, k) for low in triangle for k in range(degree + 1)])
    dim = 2 if shape in (ET.TRIG, ET.QUAD) else 3
    every = np.array(list(product(range(degree + 1), repeat=dim)))
    if shape in SIMPLICES.values():
        return every[every.sum(axis=1) <= degree]
    return every


def within(
    values: np.ndarray, mean: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Values (points, components) moved towards their means until low <= values <= high."""
    away = values - mean
    room = np.where(away > 0, high - mean, low - mean)
    beyond = np.abs(away) > np.abs(room)
    share = np.where(beyond, room / np.where(beyond, away, 1.0), 1.0)
    return mean + share.min(axis=0) * away
