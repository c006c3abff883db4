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
    "Evolution": "evolution.result",
    "ElementwisePlasticStrain": "plastic_strain",
    "ExactContact": "balanced",
    "Fields": "recovery",
    "Fractional": "tichonov",
    "FullProduct": "tichonov",
    "Krylov": "krylov.solver",
    "Material": "material",
    "NearMinimum": "linesearch",
    "NewtonOptions": "newton",
    "NodalContact": "balanced",
    "PathOptions": "path.options",
    "PathResult": "path.result",
    "PenaltyContact": "balanced",
    "PointwisePlasticStrain": "plastic_strain",
    "PrimalOptions": "primal.options",
    "PrimalResult": "primal.result",
    "Problem": "problem",
    "Schedule": "evolution.load_path",
    "ReturnMapping": "predictor",
    "SolverError": "results",
    "Status": "results",
    "SurfaceGradient": "tichonov",
    "Units": "regularisation",
    "cold_start": "evolution.solver",
    "duality_report": "duality",
    "evolve": "evolution.solver",
    "export_html": "plotting.views",
    "export_vtu": "export",
    "follow_path": "path.solver",
    "Chord": "path.chord",
    "augmented_lagrangian": "shifts",
    "lame_parameters": "material",
    "live_plot_monitor": "monitors",
    "load_cycle": "evolution.load_path",
    "lshape_problem": "examples",
    "outward_normal": "normals",
    "plot_field": "plotting.fields",
    "plot_history": "plotting.curves",
    "plot_plastic_zone": "plotting.fields",
    "primal_newton": "primal.solver",
    "semismooth_newton": "newton",
    "show": "plotting.views",
    "split": "balanced",
    "table_monitor": "monitors",
    "solve_automatically": "automatic",
    "wrench_problem": "examples",
    "write_report": "report",
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
