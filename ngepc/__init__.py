"""ngepc: elasto-plastic contact with NGSolve.

The public names are loaded when they are first used, so that ``ngepc --help`` need not wait for
NGSolve.
"""

import importlib
import logging
from pathlib import Path

from ngepc._version import __version__ as __version__

_HOME = {
    "Armijo": "linalg.linesearch",
    "Balanced": "dual.balanced",
    "Coupled": "dual.regularisation",
    "DualResult": "dual.result",
    "Evolution": "evolution.result",
    "ElementwisePlasticStrain": "dual.plastic_strain",
    "ExactContact": "dual.balanced",
    "Fields": "results.fields",
    "Fractional": "dual.tichonov",
    "FullProduct": "dual.tichonov",
    "Krylov": "krylov.solver",
    "Material": "model.material",
    "NearMinimum": "linalg.linesearch",
    "NewtonOptions": "dual.newton",
    "NodalContact": "dual.balanced",
    "PETSc": "local.petsc",
    "PathOptions": "path.options",
    "PathResult": "path.result",
    "PenaltyContact": "dual.balanced",
    "PointwisePlasticStrain": "dual.plastic_strain",
    "PrimalOptions": "primal.options",
    "PrimalResult": "primal.result",
    "Problem": "model.problem",
    "PyAMG": "local.pyamg",
    "Schedule": "evolution.load_path",
    "ReturnMapping": "dual.predictor",
    "SolverError": "results.outcome",
    "Status": "results.outcome",
    "SurfaceGradient": "dual.tichonov",
    "Units": "dual.regularisation",
    "cold_start": "evolution.solver",
    "duality_report": "theory.duality",
    "evolve": "evolution.solver",
    "export_html": "pictures.views",
    "export_vtu": "pictures.export",
    "follow_path": "path.solver",
    "Chord": "path.chord",
    "augmented_lagrangian": "theory.shifts",
    "lame_parameters": "model.material",
    "live_plot_monitor": "pictures.monitors",
    "load_cycle": "evolution.load_path",
    "lshape_problem": "model.examples",
    "outward_normal": "model.normals",
    "plot_field": "pictures.fields",
    "plot_history": "pictures.curves",
    "plot_plastic_zone": "pictures.fields",
    "primal_newton": "primal.solver",
    "semismooth_newton": "dual.newton",
    "show": "pictures.views",
    "split": "dual.balanced",
    "table_monitor": "pictures.monitors",
    "solve_automatically": "dual.automatic",
    "wrench_problem": "model.examples",
    "write_report": "pictures.report",
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
