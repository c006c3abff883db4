"""ngepc: elasto-plastic contact with NGSolve.

The public names are loaded when they are first used, so that ``ngepc --help`` need not wait for
NGSolve.
"""

import importlib
import logging
from pathlib import Path

from ngepc._version import __version__ as __version__

_HOME = {
    "Armijo": "linesearch",
    "Balanced": "balanced",
    "Coupled": "regularisation",
    "DualResult": "dual_result",
    "Fractional": "tichonov",
    "FullProduct": "tichonov",
    "ExactContact": "balanced",
    "Material": "material",
    "NearMinimum": "linesearch",
    "NewtonOptions": "newton",
    "PenaltyContact": "balanced",
    "PathOptions": "path_options",
    "PathResult": "path_result",
    "Problem": "problem",
    "SolverError": "results",
    "Status": "results",
    "SurfaceGradient": "tichonov",
    "Units": "regularisation",
    "duality_report": "duality",
    "follow_path": "path",
    "lame_parameters": "material",
    "lshape_problem": "examples",
    "outward_normal": "normals",
    "semismooth_newton": "newton",
    "wrench_problem": "examples",
}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module 'ngepc' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"ngepc.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


logging.getLogger(__name__).addHandler(logging.NullHandler())

_checkout = Path(__file__).resolve().parent.parent
if (_checkout / "geometries" / "bisection.py").is_file() and str(_checkout) not in __path__:
    __path__.append(str(_checkout))  # run from a checkout: geometries/ stands beside ngepc/
