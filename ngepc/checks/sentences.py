"""Numbers, and the values of arguments, as a sentence shows them."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from dataclasses import Field, fields, is_dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context
from types import FunctionType

import numpy as np
from ngsolve import CoefficientFunction, Mesh

ADDRESS = " at 0x"  # part of what Python prints for an object without words of its own
ROUNDING = 1e-14  # part of an energy that rounding errors may hide
SHOWN = 12  # entries of a long sequence that a message shows


def in_words(value: object) -> str:
    """The value of an argument, short and readable, for a message.

    A mesh or a coefficient is shown by its kind, an object by its class and the fields that differ
    from their defaults, with six digits.  A single number keeps all of its digits.
    """
    if isinstance(value, np.generic):
        return repr(value.item())
    return repr(value) if isinstance(value, numbers.Real) else _short(value)


def counted(number: int, one: str, several: str | None = None) -> str:
    """A number with what it counts: "0 nodes", "1 node", "2 nodes", "2 meshes".

    ``several`` is the plural where it is not ``one`` with an s.
    """
    return f"{number} {one}" if number == 1 else f"{number} {several or one + 's'}"


def arguments_in_words(given: Mapping[str, object]) -> str:
    """Names and values as in a call: "young=210000.0, poisson=0.3"."""
    return ", ".join(f"{name}={_short(value)}" for name, value in given.items())


def _short(value: object) -> str:
    """A value on one line, numbers with six digits."""
    if isinstance(value, float | np.floating):
        return repr(float(f"{value:.6g}"))
    if isinstance(value, Mesh):
        return f"<mesh, {value.dim}D, {counted(value.ne, 'element')}>"
    if isinstance(value, CoefficientFunction):
        return "<coefficient>"
    if isinstance(value, Mapping):
        entries = (f"{key!r}: {_short(one)}" for key, one in value.items())
        return f"{{{', '.join(entries)}}}"
    if type(value) in (list, tuple):
        return _sequence(value)
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape}" if value.size > SHOWN else repr(value)
    if is_dataclass(value) and not isinstance(value, type):
        return _record(value)
    if isinstance(value, FunctionType):
        return f"<function {value.__name__}>"
    text = repr(value)
    return _named(type(value)) if ADDRESS in text else text


def _sequence(value: list | tuple) -> str:
    """The entries in their brackets, the first few of many."""
    entries = [_short(one) for one in value[:SHOWN]]
    if len(value) > SHOWN:
        entries.append(f"... {len(value)} in all")
    text = ", ".join(entries)
    if isinstance(value, list):
        return f"[{text}]"
    return f"({text},)" if len(value) == 1 else f"({text})"


def _record(value: object) -> str:
    """The class and the fields that differ from their defaults; its own words if it has some."""
    kind = type(value)
    if hasattr(value, "_as_call"):
        name, given = value._as_call()
        return f"{name}({arguments_in_words(given)})"
    generated = hasattr(kind.__repr__, "__wrapped__")
    if not generated:
        return repr(value) if kind.__repr__ is not object.__repr__ else _named(kind)
    given = {
        field.name: getattr(value, field.name)
        for field in fields(value)
        if field.repr and not _is_default(field, getattr(value, field.name))
    }
    return f"{kind.__name__}({arguments_in_words(given)})"


def _named(kind: type) -> str:
    """An object that has no words of its own, by its class."""
    return f"<{kind.__name__}>"


def _is_default(field: Field, value: object) -> bool:
    """Whether a field has its default; coefficients and arrays are compared as objects."""
    same_kind = type(value) is type(field.default)
    plain = isinstance(value, numbers.Real | str)
    return value is field.default or (same_kind and plain and value == field.default)


def in_percent(part: float, digits: int = 2) -> str:
    """``part`` of a whole in percent: 1.9 gives "190 percent", never "1.9e+02 percent"."""
    return _rounded(part, Context(digits, ROUND_HALF_EVEN))


def at_most_percent(part: float, digits: int = 2) -> str:
    """As ``in_percent``, rounded up, so that a bound stays true: .0342 gives "3.5 percent".

    It is at least 1e-12 percent: rounding errors hide what is smaller.
    """
    return _rounded(max(part, ROUNDING), Context(digits, ROUND_CEILING))


def _rounded(part: float, context: Context) -> str:
    """``part`` in percent, rounded to the digits and in the direction of ``context``."""
    return f"{float(context.create_decimal(100 * part)):g} percent"


def outward(lower: float, upper: float, digits: int = 6) -> tuple[str, str]:
    """Both ends of an interval, rounded so that the printed one contains it."""
    below = Context(digits, ROUND_FLOOR).create_decimal(lower)
    above = Context(digits, ROUND_CEILING).create_decimal(upper)
    return f"{float(below):.{digits}g}", f"{float(above):.{digits}g}"


def interval_in_words(lower: float, upper: float, kind: str) -> str:
    """An interval and how it is known, "2.757 +- 1.4 percent (between 2.718 and ..., proved)".

    An interval that contains zero, or one end of which is infinite, is said by its ends.
    """
    below, above = outward(lower, upper)
    ends = f"between {below} and {above}"
    if not math.isfinite(upper - lower) or lower <= 0 <= upper:
        return f"{ends} ({kind})"
    half = (upper - lower) / abs(upper + lower)
    digits = min(max(2 - math.floor(math.log10(max(half, 1e-9))), 2), 6)
    middle = float(f"{(lower + upper) / 2:.{digits}g}")
    part = max(upper - middle, middle - lower) / abs(middle)
    half = _rounded(part, Context(2, ROUND_CEILING))
    return f"{middle:.{digits}g} +- {half} ({ends}, {kind})"
