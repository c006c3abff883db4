"""Results as JSON: plain dictionaries with their provenance, written whole or not at all."""

from __future__ import annotations

import json
import math
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import InnerProduct, Integrate

from ngepc._version import __version__
from ngepc.results.files import check_writable, replace_contents

__all__ = ["check_writable", "l2_norm", "provenance", "solve_record", "to_json", "write_text"]


def provenance(seed: int | None = None) -> dict[str, Any]:
    """Versions and the command that a result came from, and the seed where chance took part."""
    command = " ".join(["ngepc", *sys.argv[1:]]) if sys.argv else "ngepc"
    return {
        "version": __version__,
        "ngsolve": version("ngsolve"),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "command": command,
        **({} if seed is None else {"seed": seed}),
    }


def l2_norm(field: Any, mesh: Any) -> float:
    """The L2 norm over the body of a scalar, vector or matrix coefficient."""
    return math.sqrt(max(0.0, Integrate(InnerProduct(field, field), mesh)))


def solve_record(name: str, result: Any, wall_time: float) -> dict[str, Any]:
    """One solve as a dictionary, for ``ngepc solve --json``.

    Parameters
    ----------
    name
        Name of the problem.
    result
        A result of any solver.
    wall_time
        Seconds from the start of the solve.
    """
    mesh = result.problem.mesh
    return {
        "problem": name,
        "nodes": mesh.nv,
        "triangles": mesh.ne,
        "status": result.status.label,
        "message": result.message,
        "iterations": result.iterations,
        "dual_energy": result.dual_energy,
        "primal_energy": result.primal_energy,
        "residual_norm": result.residual_norm,
        "residual_norms": result.history.residual_norms,
        "step_lengths": result.history.step_lengths,
        "halvings": result.history.halvings,
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
