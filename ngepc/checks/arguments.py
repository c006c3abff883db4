"""Checks of numbers, vectors, coefficients and names of boundaries.

Each failure, a TypeError or a ValueError, names the argument, its value and what is legal.
"""

import math
import numbers
from collections.abc import Iterable, Mapping, Sequence
from math import inf

import numpy as np
from netgen.meshing import NgException
from ngsolve import (
    CF,
    ET,
    VOL,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IntegrationRule,
    Mesh,
    specialcf,
    x,
    y,
    z,
)
from ngsolve.fem import ElementTopology

from ngepc.checks.coefficients import as_constant, foreign_meshes
from ngepc.checks.sentences import in_words

Coefficient = float | CoefficientFunction
"""A number or an NGSolve CoefficientFunction."""

Names = Sequence[str] | None
"""Names of boundaries, None for the body."""

Shapes = Iterable[tuple[int, ...]]
"""Legal shapes of a coefficient; () is a scalar."""

SCALAR: Shapes = ((),)

ELEMENT_TYPES = {1: (ET.SEGM,), 2: (ET.TRIG, ET.QUAD), 3: (ET.TET, ET.HEX, ET.PRISM)}
"""Element shapes by dimension."""

COVERED = 6
"""Degree of the rule at whose points a function of another mesh has to be defined."""
COVERED_OUTSIDE = {1: 255, 2: 31}
"""The same for elements of the boundary by dimension: 128 points on an edge, as loads have."""

BEYOND = 1e-4
"""Distance of a point just outside a mesh from it, relative to an element's width."""

PATTERN = frozenset("\\^$.*+?()[]{}|")  # characters that NGSolve reads as a pattern


def is_number(value: object) -> bool:
    """Whether ``value`` is a real number (booleans are not)."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def require_number(
    name: str,
    value: object,
    least: float = -inf,
    *,
    strict: bool = False,
    most: float = inf,
    below: float = inf,
) -> float:
    """``value`` as a float, finite, >= ``least`` (> if ``strict``), <= ``most``, < ``below``."""
    if not is_number(value):
        raise TypeError(f"{name}={in_words(value)}: a real number is needed")
    try:
        number = float(value)
    except OverflowError:
        number = inf
    legal = math.isfinite(number) and least <= number <= most and number < below
    if not legal or (strict and number == least):
        bounds = {">" if strict else ">=": least, "<=": most, "<": below}
        parts = [
            f"{sign} {bound:g}"
            for sign, bound in bounds.items()
            if math.isfinite(bound)
        ]
        needed = " ".join(["a finite number", " and ".join(parts)]).strip()
        raise ValueError(f"{name}={in_words(value)}: {needed} is needed")
    return number


def require_integer(name: str, value: object, least: int, most: float = inf) -> int:
    """``value`` as an int when it is integral and within [least, most]."""
    if int(require_number(name, value)) != value:
        raise TypeError(f"{name}={in_words(value)}: an integer is needed")
    if not least <= value <= most:
        upper = "" if most == inf else f" and <= {most}"
        raise ValueError(
            f"{name}={in_words(value)}: an integer >= {least}{upper} is needed"
        )
    return int(value)


def require_component(name: str, value: object, N: int = 3) -> int:
    """``value`` as the number of one of N components, 0 for x."""
    legal = " or ".join(f"{k} for {axis}" for k, axis in enumerate("xyz"[:N]))
    if not is_number(value) or value % 1 != 0:
        raise TypeError(f"{name}={in_words(value)}: {legal} is needed")
    if not 0 <= value < N:
        raise ValueError(f"{name}={in_words(value)}: {legal} is needed")
    return int(value)


def require_vector(
    name: str, value: object, lengths: Sequence[int]
) -> tuple[float, ...]:
    """``value``, a sequence of finite numbers of one of the given lengths, as a tuple of floats."""
    text = " or ".join(map(str, lengths))
    if isinstance(value, str) or not isinstance(value, Sequence | np.ndarray):
        raise TypeError(
            f"{name}={in_words(value)}: a sequence of {text} numbers is needed"
        )
    if len(value) not in lengths:
        raise ValueError(f"{name}={in_words(value)}: {text} numbers are needed")
    return tuple(require_number(f"{name}[{i}]", x) for i, x in enumerate(value))


def require_direction(
    name: str, value: object, lengths: Sequence[int]
) -> tuple[float, ...]:
    """``value``, a vector other than zero, as one of length 1."""
    vector = np.array(require_vector(name, value, lengths))
    if not vector.any():
        raise ValueError(
            f"{name}={in_words(value)}: a vector other than zero is needed"
        )
    return tuple((vector / np.linalg.norm(vector)).tolist())


def require_coefficient(name: str, value: object, shapes: Shapes = SCALAR) -> None:
    """Accept finite numbers and CoefficientFunctions of one of the given shapes."""
    shape = ()
    legal = [tuple(s) for s in shapes]
    if is_number(value):
        require_number(name, value)
    elif not isinstance(value, CoefficientFunction):
        raise TypeError(
            f"{name}={in_words(value)}: a number or a CoefficientFunction is needed"
        )
    elif value.is_complex:
        raise TypeError(f"{name} is complex: a real coefficient is needed")
    else:
        shape = tuple(value.dims)
    if shape not in legal and not (shape == (1,) and () in legal):
        text = " or ".join("a scalar" if s == () else f"shape {s}" for s in legal)
        raise ValueError(f"{name} has shape {shape or 'scalar'}: {text} is needed")


def require_datum(
    name: str, value: object, least: float = -inf, **bounds: float
) -> object:
    """``value``, a scalar coefficient, or a number in its range as a float."""
    if is_number(value):
        return require_number(name, value, least, **bounds)
    require_coefficient(name, value)
    return value


def require_components(name: str, value: object, N: int) -> CoefficientFunction:
    """``value``, a vector coefficient or N numbers and scalar coefficients, as a coefficient."""
    if isinstance(value, CoefficientFunction):
        require_coefficient(name, value, [(N,)])
        return value
    if not isinstance(value, tuple | list | np.ndarray):
        raise TypeError(
            f"{name}={in_words(value)}: a vector of {N} components is needed, "
            "numbers or coefficients such as mesh.MaterialCF({...}, default=0)"
        )
    if len(value) != N:
        raise ValueError(f"{name}={in_words(value)}: {N} components are needed")
    data = [require_datum(f"{name}[{i}]", c) for i, c in enumerate(value)]
    return CF(tuple(as_constant(c) if is_number(c) else c for c in data))


def boundary_names(argument: str, value: object, mesh: Mesh) -> tuple[str, ...]:
    """The names in ``value`` ('a', 'a|b' or a sequence), each an existing boundary of ``mesh``."""
    parts = value.split("|") if isinstance(value, str) else value
    listed = isinstance(parts, Sequence) and not isinstance(parts, bytes)
    if not listed or not all(isinstance(part, str) for part in parts):
        needed = "a boundary name or several ('left|right') are needed"
        needed += hint_at_displacements(argument, value)
        raise TypeError(f"{argument}={in_words(value)}: {needed}")
    known = set(mesh.GetBoundaries())
    wrong = next((p for p in parts if p not in known or PATTERN & set(p)), None)
    if wrong is not None or not parts:
        refused = refused_name(argument, wrong, sorted(known))
        raise ValueError(f"{argument}={in_words(value)}: {refused}")
    return tuple(dict.fromkeys(parts))


def refused_name(argument: str, name: str | None, known: list[str]) -> str:
    """What is wrong with the name of a boundary of a mesh with these; None is no name."""
    if name is None:
        return "at least one boundary name is needed"
    if name in known:
        signs = "".join(sorted(PATTERN))
        return (
            f"the name {name!r} has one of the characters {signs}, "
            "which NGSolve reads as a pattern: rename it"
        )
    legal = ", ".join(map(repr, known))
    none = ""
    if argument == "clamped":
        none = " (clamped=None if no boundary is)"
    return f"there is no boundary {name!r}; this mesh has {legal}{none}"


def hint_at_displacements(argument: str, value: object) -> str:
    """Where displacements of boundaries belong, if they were given as ``clamped``."""
    if argument != "clamped" or not isinstance(value, Mapping):
        return ""
    return "; prescribed={'left': (0, None)} takes displacements"


def corner_rules(dim: int) -> dict[ET, IntegrationRule]:
    """Element type -> a rule without weights whose points are the vertices."""
    rules = {}
    for shape in ELEMENT_TYPES[dim]:
        vertices = [tuple(v[:dim]) for v in ElementTopology(shape).vertices]
        rules[shape] = IntegrationRule(points=vertices, weights=[0.0] * len(vertices))
    return rules


def sample(
    value: Coefficient, mesh: Mesh, boundaries: Names = None, rules: dict | None = None
) -> np.ndarray:
    """Values of a coefficient at points, shape (points, components); a number gives one value.

    The points are those of ``rules`` in all elements (or boundary elements), by default inside.
    """
    if not isinstance(value, CoefficientFunction):
        return np.array([[float(value)]])
    dim = mesh.dim - (boundaries is not None)
    rules = rules or {shape: IntegrationRule(shape, 2) for shape in ELEMENT_TYPES[dim]}
    region = VOL if boundaries is None else mesh.Boundaries("|".join(boundaries))
    points = mesh.MapToAllElements(rules, region)
    found = np.asarray(value(points), dtype=float)
    return found.reshape(len(points), math.prod(found.shape[1:]))


def require_covering(
    name: str, value: object, mesh: Mesh, boundaries: Names = None
) -> None:
    """Accept functions of other meshes if those meshes cover the body, or its boundaries.

    NGSolve takes them to be zero outside their mesh.  The points are vertices, many inner points,
    and in the body those just outside the boundary of the other mesh.

    Raises
    ------
    ValueError
        If another mesh has another dimension, or misses a point.
    """
    for other in foreign_meshes(name, value, mesh):
        points = fine_points(mesh, boundaries)
        if boundaries is None:
            beyond = points_beyond(other)
            points = np.vstack([points, beyond[mesh(*beyond.T)["nr"] >= 0]])
        require_points(name, other, points, "|".join(boundaries or ["the body"]))


def require_points(name: str, other: Mesh, points: np.ndarray, where: str) -> None:
    """Accept another mesh that has all of the points, shape (k, N), of ``where``."""
    missed = points[other(*points.T)["nr"] < 0]
    if len(missed):
        first = tuple(missed[0].round(6).tolist())
        raise ValueError(
            f"{name} has a GridFunction of another mesh that misses {len(missed)} of "
            f"{len(points)} points of {where}, for example {first}: a mesh that covers "
            f"{where} is needed"
        )


def fine_points(mesh: Mesh, boundaries: Names = None) -> np.ndarray:
    """Vertices and many inner points of all elements (or boundary elements), shape (k, N)."""
    dim = mesh.dim - (boundaries is not None)
    order = COVERED if boundaries is None else COVERED_OUTSIDE[dim]
    inner = {shape: IntegrationRule(shape, order) for shape in ELEMENT_TYPES[dim]}
    position = CF((x, y, z)[: mesh.dim])
    vertices = sample(position, mesh, boundaries, corner_rules(dim))
    return np.vstack([vertices, sample(position, mesh, boundaries, inner)])


def points_beyond(mesh: Mesh) -> np.ndarray:
    """A point just outside each boundary element of a mesh, shape (k, N)."""
    N = mesh.dim
    inside = CF((1 / (N + 1),) * N)
    outward = BoundaryFromVolumeCF(
        specialcf.JacobianMatrix(N) * (specialcf.xref(N) - inside)
    )
    centre = {shape: IntegrationRule(shape, 0) for shape in ELEMENT_TYPES[N - 1]}
    return sample(CF((x, y, z)[:N]) + BEYOND * outward, mesh, [".*"], centre)


def require_field(
    name: str, value: object, mesh: Mesh, boundaries: Names = None, **how: object
) -> np.ndarray:
    """Values of a coefficient with a legal shape, with ``corners`` at vertices too.

    ``how`` may have these and the range of ``require_in``; without ``shapes`` it is a scalar.
    """
    where = "|".join(boundaries or ["the body"])
    corners = how.pop("corners", False)
    require_coefficient(name, value, how.pop("shapes", SCALAR))
    require_covering(name, value, mesh, boundaries)
    try:
        samples = sample(value, mesh, boundaries)
        if corners:
            rules = corner_rules(mesh.dim - (boundaries is not None))
            samples = np.vstack([samples, sample(value, mesh, boundaries, rules)])
    except (NgException, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{name} cannot be evaluated on {where}: {error}") from error
    try:
        return require_in(name, samples, where, **how)
    except ValueError as error:
        found = "" if boundaries else material_of_least(value, mesh)
        raise ValueError(f"{error}{found}") from None


def material_of_least(value: Coefficient, mesh: Mesh) -> str:
    """Where a coefficient is least or no number, in words, if the mesh has several materials."""
    names = mesh.GetMaterials()
    if len(set(names)) < 2 or not isinstance(value, CoefficientFunction):
        return ""
    samples = sample(value, mesh)
    lowest = np.where(np.isfinite(samples), samples, -inf).min(axis=1)
    number = sample(CF(list(range(len(names)))), mesh)[:, 0]
    least = names[int(number[lowest.argmin()])]
    return f" (in material {least!r})"


def require_in(
    name: str,
    samples: np.ndarray,
    where: str,
    least: float = -inf,
    *,
    strict: bool = False,
) -> np.ndarray:
    """Refuse values (points, components) that are not finite or < ``least`` (<= if ``strict``)."""
    wrong = np.count_nonzero(~np.isfinite(samples).all(axis=1))
    if wrong:
        at = f"{wrong} of {len(samples)} sampled points of {where}"
        raise ValueError(f"{name} is NaN or infinite at {at}: finite values are needed")
    found = float(samples.min(initial=inf))
    if found < least or (strict and found == least):
        sign = ">" if strict else ">="
        raise ValueError(
            f"{name} falls to {found:g}: values {sign} {least:g} are needed"
        )
    return samples
