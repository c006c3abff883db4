"""Formulas: coefficients made of coordinates, numbers and elementary functions.

NGSolve's archive gives the operands and the numbers of a coefficient exactly.  A coefficient whose
parts are all known can be enclosed on boundary facets, with its first and second derivatives; what
is not known by name is no formula.  Values of NGSolve at points check what was read.
"""

from __future__ import annotations

import re
import struct

from ngsolve import CoefficientFunction, GridFunction, Parameter

from ngepc.checks.coefficients import NOT_ARCHIVED
from ngepc.discretisation.operations import (
    CHOICE,
    NORMAL_VECTOR,
    NUMBER,
    RULES,
    SIGN,
    Enclosing,
    FacetCorners,
    Operation,
)
from ngepc.linalg.jets import Jet

DEEPEST = 200
"""Expressions that are nested more deeply are not read."""


class NotReadError(Exception):
    """A coefficient has a part that is not known."""


def formula_of(value: CoefficientFunction) -> Operation | None:
    """The formula of a coefficient; None if a part of it is not known."""
    try:
        return _read(value, {}, 0)
    except NotReadError:
        return None


def formula_on(formula: Operation, facets: FacetCorners) -> Jet:
    """Enclosures of a scalar formula on facets."""
    return Enclosing(facets).of(formula)[0]


def _read(
    value: CoefficientFunction,
    known: dict[int, tuple[CoefficientFunction, Operation]],
    depth: int,
) -> Operation:
    """The part for a coefficient, the same one wherever it is used."""
    if id(value) not in known:
        if depth > DEEPEST:
            raise NotReadError
        # the coefficient is kept, so that no other one gets its id
        known[id(value)] = value, _new_part(value, known, depth)
    return known[id(value)][1]


def _new_part(
    value: CoefficientFunction,
    known: dict[int, tuple[CoefficientFunction, Operation]],
    depth: int,
) -> Operation:
    if isinstance(value, GridFunction) or value.is_complex:
        raise NotReadError
    if isinstance(value, Parameter):
        return Operation(NUMBER, (), value.Get(), value)
    if NORMAL.fullmatch(str(value).strip()):
        return Operation(NORMAL_VECTOR, (), None, value)
    kind, rest, operands = _opened(value)
    if kind == CHOICE and _is_orientation(operands[0]):
        # only the sign of the condition is used
        condition = Operation(SIGN, (), None, operands[0])
        others = [_read(one, known, depth + 1) for one in operands[1:]]
        return Operation(kind, (condition, *others), None, value)
    if kind not in RULES:
        raise NotReadError
    number = None
    if kind in NUMBERS:
        size, code = NUMBERS[kind]
        (number,) = struct.unpack(code, rest[-size:])
    parts = tuple(_read(one, known, depth + 1) for one in operands)
    return Operation(kind, parts, number, value)


def _opened(value: CoefficientFunction) -> tuple[str, bytes, list[CoefficientFunction]]:
    """Kind, remaining data and operands of a coefficient."""
    try:
        archive = value.data
    except NOT_ARCHIVED as error:
        raise NotReadError from error
    data = archive["data"]
    (length,) = struct.unpack("<i", data[4:8])
    name = data[8 : 8 + length].decode()
    kind = re.sub(
        r"ngfem::|ngcomp::|T_(?=MultVecVec)|CoefficientFunction|<\d+>", "", name
    )
    return kind, data[8 + length :], list(archive["childs"])


def _is_orientation(condition: CoefficientFunction) -> bool:
    """Whether a condition is n . v in ``outward_normal``, with one sign on a facet."""
    kind, _, operands = _opened(condition)
    if kind != "MultVecVec":
        return False
    if not NORMAL.fullmatch(str(operands[0]).strip()):
        return False
    try:
        return _opened(operands[1])[0] == "BoundaryFromVolume"
    except NotReadError:
        return False


NORMAL = re.compile(r"coef normal vector, real, dim=[23]")

NUMBERS = {
    "Constant": (8, "<d"),
    "Scale": (8, "<d"),
    "Coord": (4, "<i"),
    "Component": (4, "<i"),
}
"""Kinds with a number at the end of their data: its size and code."""
