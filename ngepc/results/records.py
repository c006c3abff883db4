"""Records of solves as JSON: fields that are documented and versioned, with their provenance.

``FIELDS`` is schema 1 of ``ngepc solve --json``.  ``ngepc path --json`` has the same fields about
its last solve, with those of the path (``gammas``, ``path_values``, ``changes``,
``inner_iterations``, ...) beside them.  Numbers that are not finite are null.
"""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import InnerProduct, Integrate

from ngepc._version import __version__
from ngepc.results.files import replace_contents

SCHEMA = 2
"""Version of the list: it grows if a field changes its meaning or is removed."""

FIELDS = {
    "schema": "version of this list",
    "problem": "name of the problem",
    "nodes": "vertices of the mesh",
    "elements": "elements of the mesh",
    "unknowns": "free components of the displacement",
    "label": "how the result calls its regularisation: 'gamma = ...' or 'exact', may be empty",
    "status": "converged, iteration_limit, linesearch_failed, stagnated, nonfinite, stopped, ...",
    "message": "what was seen and what to try, empty after a convergent run",
    "iterations": "Newton steps",
    "dual_energy": "J* (force times length)",
    "primal_energy": "J (force times length)",
    "residual_norm": "at the end, the norm depends on the method",
    "residual_norms": "of all iterates, start included",
    "step_lengths": "of all steps",
    "halvings": "of the step length, in all",
    "contact_force": "resultant of the contact pressure, positive in compression (force)",
    "displacement_l2": "L2 norm of u",
    "plastic_strain_l2": "L2 norm of p",
    "wall_time_s": "seconds of the solve",
    "method": "default, paper or primal",
    "gamma": "of the paper's method, else null",
    "start": "zero, coarse or the file of a run",
    "error_asked": "relative energy error asked for with --error, else null",
    "error_bound": "bound of the relative energy error; null for regularised states",
    "guaranteed": "whether error_bound is proved; false where data are known from samples",
    "goal_lower": "lower end of the interval of --goal, else null",
    "goal_upper": "upper end of the interval of --goal, else null",
    "version": "of ngepc",
    "ngsolve": "version",
    "numpy": "version",
    "python": "version",
    "command": "the command line",
}
"""Field of a solve -> what it is."""


TEXTS = ("problem", "label", "status", "message", "method", "start")
TEXTS += ("version", "ngsolve", "numpy", "python", "command")
COUNTS = ("schema", "nodes", "elements", "unknowns", "iterations", "halvings")
LISTS = ("residual_norms", "step_lengths")
"""Fields that are texts, counts and lists of numbers; the others are numbers or None."""
METHODS = ("default", "paper", "primal")


def checked(record: object) -> dict[str, Any]:
    """A record that was stored; KeyError, TypeError or ValueError if it is none."""
    if not isinstance(record, dict):
        raise TypeError(f"{record!r} is no record of a solve")
    missing = [name for name in FIELDS if name not in record]
    if missing:
        raise KeyError(f"{', '.join(missing)} missing in the record")
    for name, value in record.items():
        _check_field(name, value)
    if record["method"] not in METHODS:
        raise ValueError(f"method={record['method']!r}: one of {METHODS} is needed")
    return record


def _check_field(name: str, value: object) -> None:
    """TypeError if a field of a record has a value of another kind."""
    if name not in FIELDS:
        raise KeyError(f"{name} is no field of a record")
    whole = isinstance(value, int) and not isinstance(value, bool) and value >= 0
    if name in TEXTS:
        needed = "a text"
        legal = isinstance(value, str)
    elif name in COUNTS:
        needed = "an integer >= 0"
        legal = whole
    elif name in LISTS:
        needed = "a list of numbers"
        legal = isinstance(value, list) and all(isinstance(v, float) for v in value)
    elif name == "guaranteed":
        needed = "True, False or None"
        legal = value is None or isinstance(value, bool)
    else:
        needed = "a number or None"
        legal = value is None or whole or isinstance(value, float)
    if not legal:
        raise TypeError(f"{name}={value!r}: {needed} is needed")


def provenance() -> dict[str, Any]:
    """The command that made a result, and versions."""
    program = Path(sys.argv[0])
    name = (
        f"python -m {program.parent.name}"
        if program.stem == "__main__"
        else program.stem
    )
    return {
        "version": __version__,
        "ngsolve": version("ngsolve"),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "command": shlex.join([*name.split(), *sys.argv[1:]]),
    }


def l2_norm(field: Any, mesh: Any) -> float:
    """The L2 norm over the body of a scalar, vector or matrix coefficient."""
    return math.sqrt(max(0.0, Integrate(InnerProduct(field, field), mesh)))


def solve_record(name: str, result: Any, wall_time: float) -> dict[str, Any]:
    """One solve as a dictionary, with the fields of ``FIELDS`` that the result provides."""
    mesh = result.problem.mesh
    history = result.history
    names = ("message", "iterations", "dual_energy", "primal_energy", "residual_norm")
    return {
        "schema": SCHEMA,
        "problem": name,
        "nodes": mesh.nv,
        "elements": mesh.ne,
        "unknowns": result.displacement.space.FreeDofs().NumSet(),
        "label": getattr(result, "method_label", ""),
        "status": result.status.label,
        **{field: getattr(result, field) for field in names},
        **{
            f: getattr(history, f)
            for f in ("residual_norms", "step_lengths", "halvings")
        },
        "contact_force": result.contact_force,
        "displacement_l2": l2_norm(result.displacement, mesh),
        "plastic_strain_l2": l2_norm(result.plastic_strain, mesh),
        "wall_time_s": wall_time,
    }


def to_json(record: Any) -> str:
    """JSON text of a record; NaN and infinite numbers become null."""
    return json.dumps(_finite(record), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, see ``files.replace_contents``."""
    replace_contents(path, text.encode())
