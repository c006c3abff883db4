"""Saved runs of ``ngepc solve``: the state of a result and how its problem was made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.cli.arguments import build_problem
from ngepc.dual.newton import NewtonOptions
from ngepc.dual.regularisation import Coupled
from ngepc.model.problem import Problem
from ngepc.primal.result import PrimalResult
from ngepc.primal.solver import primal_newton
from ngepc.results import checkpoint
from ngepc.results.outcome import History, IterationRecord, Status
from ngepc.results.restore import restore

FINGERPRINT = {"kind": "run of ngepc solve"}

SETTINGS = (
    "problem", "nodes", "maxh", "method", "gamma", "tolerance", "quadrature_points",
)  # fmt: skip


def save_run(path: Path, settings: dict, record: dict, result: object) -> None:
    """Write a run atomically.

    Parameters
    ----------
    path
        The file, by convention ending in .npz.
    settings
        The entries of ``SETTINGS``.
    record
        ``records.solve_record`` and provenance.
    result
        The result of the run.
    """
    vector = result.v if settings["method"] == "dual" else result.displacement.vec
    arrays = {"state": np.array(vector.FV().NumPy())}
    kept = {"settings": {k: settings[k] for k in SETTINGS}, "record": record}
    kept["history"] = result.history.as_rows()
    checkpoint.save(path, FINGERPRINT, kept, arrays)


def load_run(path: Path) -> tuple[dict, object]:
    """The record and the result of a saved run, fields included.

    Raises
    ------
    ValueError
        If there is no such file, or it is damaged or no run.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such run; make one by ngepc solve ... --save {path}")
    stored = checkpoint.load(path, FINGERPRINT)
    s, state = stored.record["settings"], stored.arrays["state"]
    problem = build_problem(s["problem"], s["nodes"], s["maxh"])
    if s["method"] == "primal":
        return stored.record["record"], _primal(problem, state)
    options = NewtonOptions(tolerance=s["tolerance"], quadrature_points=s["quadrature_points"])
    status = Status[stored.record["record"]["status"].upper()]
    history = History([IterationRecord(**row) for row in stored.record["history"]])
    result = restore(problem, Coupled(s["gamma"]), state, options, status, history)
    return stored.record["record"], result


def _primal(problem: Problem, state: np.ndarray) -> PrimalResult:
    """The primal solver started where it ended, which takes no step or one."""
    from ngepc.discretisation.spaces import displacement_space

    u = GridFunction(displacement_space(problem))
    u.vec.FV().NumPy()[:] = state
    return primal_newton(problem, u)
