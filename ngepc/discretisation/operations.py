"""The operations of formulas, and their enclosures by intervals on boundary facets.

Each kind of operation has a rule for values, first and second derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import reduce
from operator import add

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.linalg.intervals import Intervals, enclosing
from ngepc.linalg.jets import Jet

UNIT = 1e-15
"""Rounding errors of NGSolve's unit normals."""

Values = Callable[[CoefficientFunction], np.ndarray]
"""Gives the values of a coefficient at points of the facets, (facets, points, components)."""


@dataclass(frozen=True, eq=False)
class Operation:
    """A part of a formula: the name of its kind, its operands, and a number that belongs to it.

    ``given`` is the coefficient itself.
    """

    kind: str
    operands: tuple[Operation, ...]
    number: float | None
    given: CoefficientFunction = field(repr=False)


@dataclass(frozen=True, eq=False)
class FacetCorners:
    """Facets, or simplices in them, on which formulas are enclosed.

    ``places`` (facets, corners, N) enclose the corners; with one corner each it is a box that
    contains the facet, and nothing is known of derivatives.  ``values`` gives those of a
    coefficient at points of the facets.
    """

    places: Intervals
    values: Values

    def __len__(self) -> int:
        return len(self.places.low)

    def chosen(self, rows: np.ndarray) -> FacetCorners:
        """Some of the facets."""
        return FacetCorners(self.places[rows], lambda one: self.values(one)[rows])

    def constant(self, numbers: Intervals) -> Jet:
        """The function with these values (facets,)."""
        columns = self.places.shape[1] + 1
        return Jet(
            Intervals(
                np.repeat(numbers.low[:, None], columns, axis=1),
                np.repeat(numbers.high[:, None], columns, axis=1),
            )
        )


NUMBER = "Constant"

NORMAL_VECTOR = "normal vector"

SIGN = "sign"

CHOICE = "IfPos"

SAME = "cl_UnaryOpCF<GenericIdentity>"

DIFFERENCE = "cl_BinaryOpCF<GenericMinus>"


@dataclass(frozen=True, eq=False)
class Enclosing:
    """Enclosures of the parts of a formula on facets.

    ``found`` has those that are known; ``limits`` intervals in which the value of a part is known
    to lie where a condition holds.
    """

    facets: FacetCorners
    limits: dict[Operation, Intervals] = field(default_factory=dict)
    found: dict[Operation, list[Jet]] = field(default_factory=dict)

    def of(self, part: Operation) -> list[Jet]:
        """The components of a part."""
        if part not in self.found:
            components = RULES[part.kind](self, part)
            if part in self.limits:
                components = [components[0].limited(self.limits[part])]
            self.found[part] = components
        return self.found[part]

    def operands(self, part: Operation) -> list[list[Jet]]:
        """The components of the operands of a part."""
        return [self.of(one) for one in part.operands]

    def where(
        self, condition: Operation, positive: bool, rows: np.ndarray
    ) -> Enclosing:
        """The same on some facets, in the part of each where a condition is > 0, or <= 0.

        Of a difference p - q > 0 it follows that p > q and q < p.
        """
        limits = {part: limit[rows] for part, limit in self.limits.items()}
        there = Enclosing(self.facets.chosen(rows), limits)
        there._limit(condition, Intervals.exactly(np.zeros(len(rows))), positive)
        if condition.kind == DIFFERENCE:
            first, second = condition.operands
            of_first = self.of(first)[0].whole[rows]
            of_second = self.of(second)[0].whole[rows]
            there._limit(first, of_second, positive)
            there._limit(second, of_first, not positive)
        return there

    def _limit(self, part: Operation, other: Intervals, above: bool) -> None:
        """Limit a part to values above or below some value of intervals (facets,)."""
        far = np.full(other.shape, np.inf)
        limit = Intervals(other.low, far) if above else Intervals(-far, other.high)
        old = self.limits.get(part)
        self.limits[part] = limit if old is None else old.within(limit)


def _number(here: Enclosing, part: Operation) -> list[Jet]:
    numbers = np.full(len(here.facets), part.number)
    return [here.facets.constant(Intervals.exactly(numbers))]


def _zero(here: Enclosing, part: Operation) -> list[Jet]:
    zero = Intervals.exactly(np.zeros(len(here.facets)))
    return [here.facets.constant(zero)] * part.given.dim


def _coordinate(here: Enclosing, part: Operation) -> list[Jet]:
    return [Jet.affine(here.facets.places[:, :, part.number])]


def _normal(here: Enclosing, part: Operation) -> list[Jet]:
    values = here.facets.values(part.given)[:, 0]
    return [here.facets.constant(Intervals.around(column, UNIT)) for column in values.T]


def _sign(here: Enclosing, part: Operation) -> list[Jet]:
    values = here.facets.values(part.given)[:, :, 0]
    return [here.facets.constant(enclosing(values.min(axis=1), values.max(axis=1)))]


def _same(here: Enclosing, part: Operation) -> list[Jet]:
    return here.of(part.operands[0])


def _vector(here: Enclosing, part: Operation) -> list[Jet]:
    return [one for components in here.operands(part) for one in components]


def _component(here: Enclosing, part: Operation) -> list[Jet]:
    return [here.of(part.operands[0])[part.number]]


def _sum(here: Enclosing, part: Operation) -> list[Jet]:
    return [a + b for a, b in zip(*here.operands(part), strict=True)]


def _difference(here: Enclosing, part: Operation) -> list[Jet]:
    return [a - b for a, b in zip(*here.operands(part), strict=True)]


def _scaled(here: Enclosing, part: Operation) -> list[Jet]:
    factor = _number(here, part)[0]
    return [factor * one for one in here.of(part.operands[0])]


def _product(here: Enclosing, part: Operation) -> list[Jet]:
    return [_times(a, b) for a, b in zip(*here.operands(part), strict=True)]


def _times(a: Jet, b: Jet) -> Jet:
    return _square(a) if a is b else a * b


def _quotient(here: Enclosing, part: Operation) -> list[Jet]:
    return [a * _inverse(b) for a, b in zip(*here.operands(part), strict=True)]


def _inner(here: Enclosing, part: Operation) -> list[Jet]:
    operands = here.operands(part)
    first = operands[0]
    second = operands[-1]
    return [reduce(add, [_times(a, b) for a, b in zip(first, second, strict=True)])]


def _multiple(here: Enclosing, part: Operation) -> list[Jet]:
    (factor,), vector = here.operands(part)
    return [factor * one for one in vector]


def _norm(here: Enclosing, part: Operation) -> list[Jet]:
    squares = [_square(one) for one in here.of(part.operands[0])]
    return [_root(reduce(add, squares))]


def _power(here: Enclosing, part: Operation) -> list[Jet]:
    base, exponent = part.operands
    while exponent.kind == SAME:
        (exponent,) = exponent.operands
    if exponent.kind != NUMBER:
        one = here.of(exponent)[0]
        return [Jet(Intervals.unknown(one.value.shape), *one.unknown_derivatives())]
    return [_powers(one, float(exponent.number)) for one in here.of(base)]


def _choice(here: Enclosing, part: Operation) -> list[Jet]:
    condition, above, below = part.operands
    jet = here.of(condition)[0]
    # where a condition has a slope it is zero on nothing but lines or points
    positive = (jet.whole.low > 0) | ((jet.whole.low >= 0) & jet.has_slope)
    negative = jet.whole.high <= 0
    rows = np.flatnonzero(~positive & ~negative)
    found = _determined(here, part, positive, negative)
    if not len(rows):
        return found
    return [
        one.with_values(rows, a.value.hull(b.value))
        for one, a, b in zip(
            found,
            here.where(condition, True, rows).of(above),
            here.where(condition, False, rows).of(below),
            strict=True,
        )
    ]


def _determined(
    here: Enclosing, part: Operation, positive: np.ndarray, negative: np.ndarray
) -> list[Jet]:
    """A choice on facets where the sign of its condition is known; elsewhere it is of no use."""
    _, above, below = part.operands
    if not positive.any():
        return here.of(below)
    if not negative.any():
        return here.of(above)
    pairs = zip(here.of(above), here.of(below), strict=True)
    return [one.where(positive, other) for one, other in pairs]


def _square(a: Jet) -> Jet:
    return a.of(
        Intervals.squared,
        lambda v: v + v,
        lambda v: Intervals.exactly(np.full(v.shape, 2.0)),
    )


def _powers(a: Jet, p: float) -> Jet:
    slope = Intervals.exactly(p)
    bend = Intervals.exactly(p) * Intervals.exactly(p - 1)
    return a.of(
        lambda v: v.power(p),
        lambda v: v.power(p - 1) * slope,
        lambda v: v.power(p - 2) * bend,
    )


def _inverse(a: Jet) -> Jet:
    return a.of(
        Intervals.reciprocal,
        lambda v: -v.squared().reciprocal(),
        lambda v: v.power(3).reciprocal() * Intervals.exactly(2.0),
    )


def _root(a: Jet) -> Jet:
    half = Intervals.exactly(0.5)
    return a.of(
        Intervals.root,
        lambda v: v.root().reciprocal() * half,
        lambda v: -(v * v.root()).reciprocal() * Intervals.exactly(0.25),
    )


def _exponential(a: Jet) -> Jet:
    return a.of(*[Intervals.exponential] * 3)


def _logarithm(a: Jet) -> Jet:
    return a.of(
        Intervals.logarithm, Intervals.reciprocal, lambda v: -v.squared().reciprocal()
    )


def _sine(a: Jet) -> Jet:
    return a.of(Intervals.sine, Intervals.cosine, lambda v: -v.sine())


def _cosine(a: Jet) -> Jet:
    return a.of(Intervals.cosine, lambda v: -v.sine(), lambda v: -v.cosine())


def _each(
    function: Callable[[Jet], Jet],
) -> Callable[[Enclosing, Operation], list[Jet]]:
    """The rule that applies a function to each component."""

    def rule(here: Enclosing, part: Operation) -> list[Jet]:
        """The function of each component of the operand."""
        return [function(one) for one in here.of(part.operands[0])]

    return rule


RULES: dict[str, Callable[[Enclosing, Operation], list[Jet]]] = {
    NUMBER: _number,
    "Zero": _zero,
    "Coord": _coordinate,
    NORMAL_VECTOR: _normal,
    SIGN: _sign,
    "Vectorial": _vector,
    "Component": _component,
    "Scale": _scaled,
    "MultScalVec": _multiple,
    "MultVecVec": _inner,
    "MultVecVecSame": _inner,
    "Norm": _norm,
    CHOICE: _choice,
    SAME: _same,
    "cl_UnaryOpCF<GenericSqrt>": _each(_root),
    "cl_UnaryOpCF<GenericSin>": _each(_sine),
    "cl_UnaryOpCF<GenericCos>": _each(_cosine),
    "cl_UnaryOpCF<GenericExp>": _each(_exponential),
    "cl_UnaryOpCF<GenericLog>": _each(_logarithm),
    "cl_BinaryOpCF<GenericPlus>": _sum,
    DIFFERENCE: _difference,
    "cl_BinaryOpCF<GenericMult>": _product,
    "cl_BinaryOpCF<GenericDiv>": _quotient,
    "cl_BinaryOpCF<GenericPow>": _power,
}
"""What encloses each kind of part."""
