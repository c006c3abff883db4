"""Checks of arguments that are not numbers: objects, functions, texts, names of files.

Each failure is a TypeError, or a ValueError where the kind is right, and names the argument, its
value and what is needed.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from ngsolve import CoefficientFunction, Mesh

from ngepc.checks.sentences import in_words

T = TypeVar("T")


def require_instance(
    name: str, value: T, kind: type | tuple[type, ...], needed: str
) -> T:
    """``value``, an instance of ``kind``; ``needed`` describes it in the message."""
    if not isinstance(value, kind):
        within = hint_at_part(value, kind)
        raise TypeError(f"{name}={in_words(value)}: {needed} is needed{within}")
    return value


def hint_at_part(value: object, kind: type | tuple[type, ...]) -> str:
    """Where the result of an adaptive run, or a history, has an instance of ``kind``."""
    if isinstance(getattr(value, "result", None), kind):
        return ", such as its .result"
    if isinstance(getattr(value, "solution", None), kind):
        return ", such as its .solution"
    steps = getattr(value, "steps", None)
    if isinstance(steps, list) and steps:
        last = steps[-1]
        if isinstance(getattr(last, "solution", None), kind):
            return ", such as its .steps[-1].solution"
    return ""


def require_attributes(
    name: str, value: object, attributes: Iterable[str], needed: str
) -> None:
    """Accept an object (not a class) that has the ``attributes`` of a protocol."""
    if isinstance(value, type) or not all(hasattr(value, a) for a in attributes):
        raise TypeError(f"{name}={in_words(value)}: {needed} is needed")


def require_mesh(
    name: str, value: object, dimensions: tuple[int, ...] = (2, 3)
) -> None:
    """Accept an NGSolve mesh of one of the dimensions."""
    require_instance(name, value, Mesh, "an ngsolve.Mesh")
    if value.dim not in dimensions:
        legal = " or ".join(map(str, dimensions))
        raise ValueError(f"{name} has dimension {value.dim}: {legal} is needed")


def require_function(
    name: str, value: object, of: str, *, optional: bool = False
) -> None:
    """Accept a function whose argument ``of`` describes, or None if it is ``optional``."""
    wrong = not callable(value) or isinstance(value, CoefficientFunction)
    if wrong and not (optional and value is None):
        raise TypeError(f"{name}={in_words(value)}: a function of {of} is needed")


def require_text(name: str, value: object, *, optional: bool = False) -> str | None:
    """``value``, a string, also an empty one, or None if it is ``optional``."""
    if not isinstance(value, str) and not (optional and value is None):
        raise TypeError(f"{name}={in_words(value)}: a text is needed")
    return value


def require_flag(name: str, value: object) -> bool:
    """``value``, True or False."""
    return require_instance(name, value, bool, "True or False")


def require_path(name: str, value: object, suffix: str = "") -> Path:
    """``value``, the name of a file as a text or path, as a Path that ends in ``suffix``."""
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise TypeError(f"{name}={in_words(value)}: the name of a file is needed")
    if not os.fspath(value):
        raise ValueError(f"{name}={in_words(value)}: the name of a file is needed")
    if suffix and Path(value).suffix != suffix:
        raise ValueError(
            f"{name}={str(value)!r}: a name that ends in {suffix!r} is needed"
        )
    return Path(value)


def require_sequence(name: str, value: object, of: str) -> None:
    """Accept anything that has a length and is iterated by position, but no text and no mapping."""
    listed = hasattr(value, "__len__") and hasattr(value, "__getitem__")
    if not listed or isinstance(value, str | bytes | Mapping | type):
        raise TypeError(f"{name}={in_words(value)}: a sequence of {of} is needed")


def require_mapping(name: str, value: object, needed: str) -> None:
    """Accept a mapping with at least one entry."""
    require_instance(name, value, Mapping, f"a mapping of {needed}")
    if not value:
        raise ValueError(f"{name}={in_words(value)}: at least one entry is needed")
