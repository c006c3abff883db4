"""Which coefficients are known to be polynomials of low degree on the elements of a mesh.

Numbers, coordinates and functions of finite element spaces of the mesh are polynomials on straight
simplices, and so are sums and products of these, and quotients by what is constant on each element.
NGSolve's text of an expression says what it is made of, each part in a line that is indented below
the whole; what is not known by name is taken for something else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from ngsolve import CF, CoefficientFunction, GridFunction, Mesh

from ngepc.checks.arguments import Coefficient
from ngepc.checks.coefficients import FUNCTION, as_constant, foreign_meshes, leaves_of

HIGHEST = 3
"""The highest degree that the rules of loads and bounds integrate exactly."""

CONSTANTS = re.compile(
    r"-?[0-9.]+(e[+-]?[0-9]+)?|ZeroCF|ConstantCF|normal vector|Identity matrix|none"
    r"|.*UnitVector.*|.*ParameterCoefficientFunction.*"
)
COORDINATES = re.compile(r"coordinate [xyz]")
FUNCTIONS = re.compile(r".*GridFunction.*")
SUMS = re.compile(
    r"unary operation ' '|binary operation '[-+]'|scale \S+|VectorialCoefficientFunction"
    r"|.*DomainWiseCoefficientFunction.*|.*ComponentCoefficientFunction.*|reshape|.*Reshape.*"
    r"|symmetric|skew-symmetric|trace|Matrix transpose"
)
PRODUCTS = re.compile(
    r"binary operation '\*'|innerproduct.*|(matrix|scalar)-(vector|matrix) multiply"
)
QUOTIENTS = re.compile(r"binary operation '/'")
OF_CONSTANTS = re.compile(r"unary operation '\w+'|binary operation 'pow'")
"""What is known of constants alone: it is constant on each element, too."""
CHOICE = re.compile(r".*IfPosCoefficientFunction.*")
ON_FACET = re.compile(".*BoundaryFromVolume.*")
KNOWN = re.compile(
    "|".join(
        kind.pattern
        for kind in (
            CONSTANTS,
            COORDINATES,
            FUNCTIONS,
            SUMS,
            PRODUCTS,
            QUOTIENTS,
            OF_CONSTANTS,
            CHOICE,
            ON_FACET,
        )
    )
)
ORIENTATION = ("innerproduct.*", "normal vector", ON_FACET)
BEGIN = "coef "
SIZE = re.compile(r", (?:fix size|dim)")
END = re.compile(r", (?:real|complex)\b")
"""What is before and behind the name of a part in its line."""
COMPILED = "Compiled CF"
"""How the text of a compiled coefficient begins; that of a sum with it can have a hundred MB."""
SAME = "same vectors"
"""How NGSolve marks an inner product of something with itself, which it prints once."""


class NoPolynomialError(Exception):
    """A part of a coefficient may be no polynomial."""


def is_polynomial(
    value: Coefficient | None, mesh: Mesh | None = None, highest: int = HIGHEST
) -> bool:
    """Whether a coefficient is known to be a polynomial of this degree at most on each element.

    A function of another mesh than ``mesh`` is none on the elements of this one.
    """
    if not isinstance(value, CoefficientFunction):
        return True
    if mesh is not None and foreign_meshes("data", value, mesh):
        return False
    return degree_of(value) <= highest


def degree_of(value: CoefficientFunction) -> float:
    """No less than the degree of a coefficient on each element, inf where it may be no polynomial.

    All functions of finite elements in it count with the highest order among them.
    """
    text = str(value)
    if text.startswith(COMPILED):
        return math.inf
    functions = [
        leaf for leaf in leaves_of(value, FUNCTION) if isinstance(leaf, GridFunction)
    ]
    order = max((_order(function) for function in functions), default=0)
    if not text.startswith(BEGIN):
        # NGSolve prints zeros, multiples and functions differently where they are the whole
        text = str(CF((value, as_constant(1.0))))
    lines = list(_lines(text))
    if not _all_known(lines):
        return math.inf
    try:
        return _degree(lines, 0, order)[0]
    except NoPolynomialError:
        return math.inf


def _all_known(lines: list[tuple[int, str]]) -> bool:
    """Whether the degree of each kind of part is known; a part is printed wherever it is used."""
    names = {name for _, name in lines}
    return all(KNOWN.fullmatch(_plain(name)) for name in names)


def _plain(name: str) -> str:
    """The name of a part without its size."""
    return SIZE.split(name, maxsplit=1)[0]


def _order(function: GridFunction) -> int:
    """The degree of a function on a simplex; in spaces of vectors it may be one more."""
    space = function.space
    plain = re.fullmatch(r"(Vector)?(h1|l2|H1|L2).*|.*[sS]urface.*", space.type)
    return space.globalorder + (0 if plain else 1)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Depth and name of each part of an expression."""
    for line in text.split("\n"):
        part = line.lstrip(" ")
        if part.startswith(BEGIN):
            name = END.split(part.removeprefix(BEGIN), maxsplit=1)[0]
            yield len(line) - len(part), name.strip()


def _degree(lines: list[tuple[int, str]], at: int, order: int) -> tuple[int, int]:
    """The degree of the part that begins at a line, and the line after it.

    NoPolynomialError is raised for the first part that may be none.
    """
    depth, name = lines[at]
    below = []
    following = at + 1
    if CHOICE.fullmatch(name) and _is_orientation(lines[at + 1 : at + 4]):
        below.append(0)
        following = at + 4
    while following < len(lines) and lines[following][0] > depth:
        degree, following = _degree(lines, following, order)
        below.append(degree)
    return _combined(_plain(name), below, order), following


def _is_orientation(lines: list[tuple[int, str]]) -> bool:
    """Whether these are the sign of n . v in ``outward_normal``, the same on all of a facet."""
    names = [name for _, name in lines]
    return len(names) == 3 and all(map(re.fullmatch, ORIENTATION, names))


def _combined(name: str, below: list[int], order: int) -> int:
    """The degree of an expression with this name from those of its operands."""
    if FUNCTIONS.fullmatch(name):
        return order
    if CONSTANTS.fullmatch(name):
        return 0
    if COORDINATES.fullmatch(name):
        return 1
    if SUMS.fullmatch(name) and below:
        return max(below)
    if CHOICE.fullmatch(name) and below and below[0] == 0:
        return max(below)
    if PRODUCTS.fullmatch(name) and below:
        return 2 * below[0] if SAME in name or len(below) == 1 else sum(below)
    if QUOTIENTS.fullmatch(name) and below[1:] == [0]:
        return below[0]
    if OF_CONSTANTS.fullmatch(name) and below and not any(below):
        return 0
    raise NoPolynomialError
