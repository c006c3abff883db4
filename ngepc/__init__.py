"""ngepc: elasto-plastic contact with NGSolve.

The public names are listed in ``__init__.pyi``, for static tools and for this file.  They are
loaded when they are first used, so that ``import ngepc`` and ``ngepc --help`` are fast.
"""

import ast
import importlib
import logging
from pathlib import Path

from ngepc._deprecated import MOVED, found, install
from ngepc._version import __version__ as __version__


def _homes() -> dict[str, str]:
    """Public name -> the module that it is imported from, read from ``__init__.pyi``."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = (node for node in stub.body if isinstance(node, ast.ImportFrom))
    return {alias.name: node.module for node in imports for alias in node.names}


_HOME = _homes()

__all__ = [
    "__version__",
    *sorted(n for n, home in _HOME.items() if home.count(".") > 1),
]

install()

_GONE = {
    "DualParameters": "Coupled(gamma, ...) has what is left of it",
    "Fractional": "FullProduct() has no boundary conditions either, and needs no dense matrix",
    "augmented_lagrangian": "semismooth_newton(problem) solves the problem without regularisation",
}
"""Public names of the previous version -> what to take instead."""


def __getattr__(name: str) -> object:
    if f"ngepc.{name}" in MOVED:
        return found(f"ngepc.{name}", stacklevel=2)
    if name not in _HOME:
        instead = f", it is gone: {_GONE[name]}" if name in _GONE else ""
        raise AttributeError(f"module 'ngepc' has no attribute {name!r}{instead}")
    home = _HOME[name]
    if home.count(".") > 1:
        value = getattr(importlib.import_module(home), name)
    else:
        value = importlib.import_module(f"{home}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_HOME})


logging.getLogger(__name__).addHandler(logging.NullHandler())
