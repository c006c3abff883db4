"""Saved runs of ``ngepc solve``: the state of a result and how its problem was made."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.spaces import displacement_space
from ngepc.dual.newton import NewtonOptions, prepared, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.model.problem import Problem
from ngepc.primal.solver import primal_newton
from ngepc.results import checkpoint
from ngepc.results.outcome import History, IterationRecord, Status
from ngepc.results.result import Result
from ngepc.studies.examples import example

FINGERPRINT = {"kind": "run of ngepc solve", "version": 3}


def save_run(path: Path, place: dict, gamma: float | None, record: dict, result: Result) -> None:
    """Write a run atomically.

    ``place`` has the keywords of ``example``; ``gamma`` is None but for the paper's method;
    ``record`` has the ``records.FIELDS``.
    """
    vector = result.displacement.vec if gamma is None else result.v
    kept = {"place": place, "gamma": gamma, "record": record, "history": result.history.as_rows()}
    checkpoint.save(path, FINGERPRINT, kept, {"state": np.array(vector.FV().NumPy())})


def load_run(path: Path) -> tuple[dict, Result]:
    """The record and the result of a saved run, fields included.

    The primal method is started where it ended; the default method, which needs a dozen steps,
    solves again.

    Raises
    ------
    ValueError
        If there is no such file, or it is damaged or no run.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such run; make one by ngepc solve ... --save {path}")
    stored = checkpoint.load(path, FINGERPRINT)
    kept, state = stored.record, stored.arrays["state"]
    problem, record = example(**kept["place"]), kept["record"]
    if record["method"] == "default":
        return record, semismooth_newton(problem)
    if record["method"] == "primal":
        u = GridFunction(displacement_space(problem))
        u.vec.FV().NumPy()[:] = state
        return record, primal_newton(problem, u)
    run = record["status"], kept["history"]
    return record, restore(problem, kept["gamma"], state, NewtonOptions(), *run)


def restore(
    problem: Problem,
    gamma: float,
    v: np.ndarray,
    options: NewtonOptions,
    status: str,
    rows: Iterable[dict],
) -> DualResult:
    """The result of an earlier run, the primal variable solved for afresh.

    ``v`` has the coefficients of (z, q), ``status`` is its label, ``rows`` are those of the
    history.  ValueError if ``v`` does not fit the spaces.
    """
    functional = prepared(problem, Coupled(gamma), options)
    dual = functional.blocks.H_vector()
    if v.shape != (len(dual),):
        raise ValueError(f"v has shape {v.shape}: {len(dual)} coefficients are needed")
    dual.FV().NumPy()[:] = v
    history = History([IterationRecord(**row) for row in rows])
    return DualResult.at(functional, dual, Status[status.upper()], history)
