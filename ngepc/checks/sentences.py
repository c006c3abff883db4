"""Numbers as a sentence shows them."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Context


def in_percent(part: float, digits: int = 2) -> str:
    """``part`` of a whole in percent: 1.9 gives "190 percent", never "1.9e+02 percent"."""
    return _rounded(part, Context(digits, ROUND_HALF_EVEN))


def at_most_percent(part: float, digits: int = 2) -> str:
    """As ``in_percent``, rounded up, so that a bound stays true: .0342 gives "3.5 percent"."""
    return _rounded(part, Context(digits, ROUND_CEILING))


def _rounded(part: float, context: Context) -> str:
    """``part`` in percent, rounded to the digits and in the direction of ``context``."""
    return f"{float(context.create_decimal(100 * part)):g} percent"


def outward(lower: float, upper: float, digits: int = 6) -> tuple[str, str]:
    """Both ends of an interval, rounded so that the printed one contains it."""
    below = Context(digits, ROUND_FLOOR).create_decimal(lower)
    above = Context(digits, ROUND_CEILING).create_decimal(upper)
    return f"{float(below):.{digits}g}", f"{float(above):.{digits}g}"
