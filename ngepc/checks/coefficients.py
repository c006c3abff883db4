"""Parts of a coefficient function: find functions of meshes and parameters, and replace them.

NGSolve evaluates a function of another mesh wherever it is asked, with zero outside that mesh, and
a ``Parameter`` has its present value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from netgen.meshing import NgException
from ngsolve import CoefficientFunction, GridFunction, Mesh, Parameter

FUNCTION = "gridfunction"
PARAMETER = "parameterc"
SILENT = "boundaryfromvolume"  # its text does not name what it has inside

NOT_ARCHIVED = (NgException, RuntimeError, TypeError)
"""What NGSolve raises for coefficients that its archive does not know, as normal vectors."""

LEAVES = (GridFunction, Parameter)

ZERO = CoefficientFunction(0.0)


def as_constant(value: float) -> CoefficientFunction:
    """A number as a coefficient: NGSolve makes a sum twenty times as fast as ``CF(value)``."""
    return ZERO + float(value) if value else ZERO


def children(node: object) -> list[object]:
    """The direct operands of a coefficient; none where NGSolve does not give them.

    A gradient has its space among them, which has no operands.
    """
    if isinstance(node, LEAVES) or not isinstance(node, CoefficientFunction):
        return []
    try:
        parts = node.data["childs"]
    except NOT_ARCHIVED:
        return []
    return [part for part in parts if part is not None]


def leaves_of(value: object, *kinds: str) -> Iterator[CoefficientFunction]:
    """The innermost operands, each once, of those that mention one of some ``kinds``.

    The text of a coefficient names its operands and is much cheaper than the operands.
    """
    if not isinstance(value, CoefficientFunction) or not mentions(value, *kinds):
        return
    waiting = [value]
    met = {}
    while waiting:
        node = waiting.pop()
        if id(node) in met:
            continue
        met[id(node)] = node  # kept, so that no other one gets its id
        parts = children(node)
        waiting += [part for part in parts if mentions(part, *kinds)]
        if not parts:
            yield node


def mentions(node: CoefficientFunction, *kinds: str) -> bool:
    """Whether the text of a coefficient names operands of some ``kinds``, or leaves some out."""
    text = str(node).lower()
    return any(kind in text for kind in (*kinds, SILENT))


def hides(leaf: CoefficientFunction, kind: str) -> bool:
    """Whether an innermost operand hides a part of a ``kind`` that cannot be replaced."""
    return not isinstance(leaf, LEAVES) and mentions(leaf, kind)


def rebuilt(
    value: CoefficientFunction,
    replace: Callable[[CoefficientFunction], CoefficientFunction],
) -> CoefficientFunction:
    """The coefficient with ``replace(operand)`` in place of each innermost operand."""
    made: dict[int, tuple] = {}

    def rebuilt_once(node: CoefficientFunction) -> CoefficientFunction:
        """The changed node, made once."""
        if id(node) not in made:
            made[id(node)] = node, with_new_operands(node)
        return made[id(node)][1]

    def with_new_operands(node: CoefficientFunction) -> CoefficientFunction:
        """The node with changed operands, itself if none has changed."""
        old = children(node)
        if not old:
            return replace(node)
        new = [rebuilt_once(part) for part in old]
        if all(a is b for a, b in zip(old, new, strict=True)):
            return node
        remaining = iter(new)
        data = dict(node.data)
        data["childs"] = [p if p is None else next(remaining) for p in data["childs"]]
        return CoefficientFunction(data)

    return rebuilt_once(value)


def with_numbers(name: str, value: CoefficientFunction) -> CoefficientFunction:
    """The coefficient with the present value in place of each ``Parameter``.

    ValueError if one is in a part that cannot be rebuilt.
    """
    leaves = list(leaves_of(value, PARAMETER))
    require_no_hidden_parameter(name, leaves)
    if not any(isinstance(leaf, Parameter) for leaf in leaves):
        return value
    return rebuilt(value, _as_number)


def require_no_hidden_parameter(name: str, leaves: list[CoefficientFunction]) -> None:
    """A ValueError if one of the innermost operands hides a ``Parameter``."""
    if any(hides(leaf, PARAMETER) for leaf in leaves):
        raise ValueError(
            f"{name} has a Parameter inside a part that cannot be rebuilt, for example a "
            "CacheCF: a number or a coefficient without such a part is needed"
        )


def _as_number(leaf: CoefficientFunction) -> CoefficientFunction:
    return CoefficientFunction(leaf.Get()) if isinstance(leaf, Parameter) else leaf


def with_own_functions(name: str, value: CoefficientFunction) -> CoefficientFunction:
    """``with_numbers`` and with copies of its GridFunctions."""
    leaves = list(leaves_of(value, PARAMETER, FUNCTION))
    require_no_hidden_parameter(name, leaves)
    if not any(isinstance(leaf, LEAVES) for leaf in leaves):
        return value
    return rebuilt(value, _as_own)


def _as_own(leaf: CoefficientFunction) -> CoefficientFunction:
    if not isinstance(leaf, GridFunction):
        return _as_number(leaf)
    own = GridFunction(leaf.space, name=leaf.name)
    own.vec.data = leaf.vec
    return own


def foreign_meshes(name: str, value: object, mesh: Mesh) -> list[Mesh]:
    """The other meshes that have functions in a coefficient on ``mesh``, each once.

    ValueError if one has another dimension, or if an operand that NGSolve does not open has
    functions.
    """
    found = []
    for leaf in leaves_of(value, FUNCTION):
        if hides(leaf, FUNCTION):
            raise ValueError(
                f"{name} has a GridFunction inside a part that cannot be read, for example a "
                "CacheCF: the function itself is needed"
            )
        other = leaf.space.mesh if isinstance(leaf, GridFunction) else mesh
        if other.dim != mesh.dim:
            raise ValueError(
                f"{name} has a GridFunction of another mesh, of dimension {other.dim}: "
                f"one of dimension {mesh.dim} is needed"
            )
        if other is not mesh and other not in found:
            found.append(other)
    return found
