"""Frozen dataclasses that validate their fields from their type hints."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from typing import Annotated, get_args, get_type_hints

from ngepc.checks.arguments import (
    Coefficient,
    require_component,
    require_datum,
    require_direction,
    require_integer,
    require_number,
    require_vector,
)
from ngepc.checks.kinds import require_flag, require_text


class Check(partial):
    """A check with its range: called with a name and a value, it returns the value to store."""

    def __repr__(self) -> str:
        return f"{self.func.__name__}({', '.join(f'{k}={v}' for k, v in self.keywords.items())})"


NotNegative = Annotated[float, Check(require_number, least=0)]
Positive = Annotated[float, Check(require_number, least=0, strict=True)]
Fraction = Annotated[float, Check(require_number, least=0, strict=True, below=1)]
Count = Annotated[int, Check(require_integer, least=1)]
Component = Annotated[int, Check(require_component)]
Vector = Annotated[Sequence[float], Check(require_vector, lengths=(2, 3))]
Along = Annotated[Sequence[float], Check(require_direction, lengths=(2, 3))]
Text = Annotated[str, Check(require_text)]
Flag = Annotated[bool, Check(require_flag)]
Datum = Annotated[Coefficient, Check(require_datum)]
PositiveDatum = Annotated[Coefficient, Check(require_datum, least=0, strict=True)]
NotNegativeDatum = Annotated[Coefficient, Check(require_datum, least=0)]


def declared_check(hint: object) -> Check | None:
    """The check in a type hint, also if the argument may be None."""
    parts = (hint, *(part for part in get_args(hint) if get_args(part)))
    return next(
        (a for part in parts for a in get_args(part) if isinstance(a, Check)), None
    )


@cache
def declared_checks(kind: type) -> dict[str, Check]:
    """Name of a field -> its check, for those that have one."""
    hints = get_type_hints(kind, include_extras=True)
    found = {name: declared_check(hint) for name, hint in hints.items()}
    return {name: check for name, check in found.items() if check}


class Declared:
    """A frozen dataclass that checks its fields and stores what the checks return.

    A field with the default None may be None.
    """

    def __post_init__(self) -> None:
        for name, check in declared_checks(type(self)).items():
            value = getattr(self, name)
            if value is not None or getattr(type(self), name, 0) is not None:
                vars(self)[name] = check(name, value)
