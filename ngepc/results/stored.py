"""Validation of the contents of files: names, types, shapes, finite numbers.

Invalid contents raise a ValueError with the name of the file, before any work.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

Kind = TypeVar("Kind")


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Whatever is raised inside, but MemoryError, becomes a ValueError that names the file."""
    try:
        yield
    except MemoryError:
        raise  # the file may be in order
    except Exception as error:  # a damaged file may raise anything while it is read
        if str(path) in str(error):
            raise
        problem = f"{type(error).__name__}: {error}"
        raise ValueError(
            f"checkpoint {path} is damaged ({problem}): move it away"
        ) from error


def array_of(path: Path, arrays: Mapping, name: str, size: int) -> np.ndarray:
    """A stored array of ``size`` finite real numbers; ValueError with the file's name if not."""
    found = arrays.get(name)
    legal = isinstance(found, np.ndarray) and found.dtype == float
    if not legal or found.shape != (size,) or not np.isfinite(found).all():
        problem = "is missing" if found is None else f"is {found.dtype} {found.shape}"
        raise ValueError(
            f"checkpoint {path} is damaged: {name!r} {problem}, {size} finite real numbers are "
            "needed; move it away"
        )
    return found


def stored_record(path: Path, kind: type[Kind], row: object) -> Kind:
    """A dataclass from a stored row: exactly its fields, each of the type of its hint.

    Integers are not negative and other numbers finite, but where the default is NaN.  Members of an
    Enum are stored by their names.  ValueError with the file's name if anything else is there.
    """
    with reading(path):
        if not isinstance(row, Mapping):
            raise TypeError(f"{row!r} is no record of {kind.__name__}")
        hints = get_type_hints(kind)
        known = {field.name: field for field in fields(kind)}
        strange = sorted(set(row) - set(known))
        needed = [name for name, f in known.items() if _is_needed(f)]
        missing = [name for name in needed if name not in row]
        if strange or missing:
            raise KeyError(f"{kind.__name__}: {strange} unknown, {missing} missing")
        values = {}
        for name, value in row.items():
            holes = _is_nan(known[name].default)
            values[name] = value_of(name, hints[name], value, holes)
        return kind(**values)


def value_of(name: str, hint: Any, value: object, holes: bool = False) -> object:
    """A stored value as its hint has it; TypeError or ValueError, with its name, if it is not.

    ``holes`` says whether a number may be NaN.
    """
    if get_origin(hint) in (Union, UnionType):
        if value is None and type(None) in get_args(hint):
            return None
        hint = next(part for part in get_args(hint) if part is not type(None))
    inner = get_args(hint)
    if get_origin(hint) is list and isinstance(value, list):
        return [value_of(name, inner[0], one) for one in value]
    if get_origin(hint) is dict and isinstance(value, dict):
        return {key: value_of(name, inner[1], one) for key, one in value.items()}
    if isinstance(hint, type) and issubclass(hint, Enum) and isinstance(value, str):
        return hint[value]
    if hint in (bool, str) and isinstance(value, hint):
        return value
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int and number and isinstance(value, int) and value >= 0:
        return value
    if (
        hint is float
        and number
        and (math.isfinite(value) or (holes and _is_nan(value)))
    ):
        return value
    words = getattr(hint, "__name__", hint)
    raise TypeError(f"{name}={value!r}: {words} is needed")


def _is_needed(field: Any) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)
