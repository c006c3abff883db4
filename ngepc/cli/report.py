"""Saved runs of ``ngepc solve``, and ``ngepc report RUN``: one HTML file about a saved run."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.cli.output import name_written
from ngepc.discretisation.spaces import displacement_space
from ngepc.dual.newton import NewtonOptions, prepared, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.pictures.report import solution_sections, write_report
from ngepc.primal.solver import primal_newton
from ngepc.results import checkpoint
from ngepc.results.outcome import History, IterationRecord, Status
from ngepc.results.result import Result
from ngepc.studies.examples import THRESHOLDS, example

FINGERPRINT = {"kind": "run of ngepc solve", "version": 3}

NUMBERS = ("status", "iterations", "residual_norm", "dual_energy", "primal_energy", "error_bound",
           "contact_force", "displacement_l2", "plastic_strain_l2", "wall_time_s")  # fmt: skip
PROVENANCE = ("command", "version", "ngsolve", "numpy", "python")


def run(args: argparse.Namespace) -> int:
    """Write the report and name it."""
    record, result = load_run(args.run_file)
    numbers = [{"what": key.replace("_", " "), "value": record[key]} for key in NUMBERS]
    path = write_report(
        args.out or args.run_file.with_suffix(".html"),
        f"{record['problem']}: {record['method']} method on {record['nodes']} nodes",
        ("The problem", [result.problem]),
        ("Numbers", [numbers, *filter(None, [record["message"]])]),
        *solution_sections(result, "The deformed body", THRESHOLDS[record["problem"]]),
        footer=", ".join(f"{key} {record[key]}" for key in PROVENANCE),
    )
    name_written([path])
    return 0


def save_run(path: Path, place: dict, record: dict, result: Result) -> None:
    """Write a run atomically.

    ``place`` has the keywords of ``example``, ``record`` the ``records.FIELDS``.
    """
    vector = result.v if record["method"] == "paper" else result.displacement.vec
    kept = {"place": place, "record": record, "history": result.history.as_rows()}
    checkpoint.save(path, FINGERPRINT, kept, {"state": np.array(vector.FV().NumPy())})


def load_run(path: Path) -> tuple[dict, Result]:
    """The record and the result of a saved run, fields included.

    The primal method is started where it ended; the default method, which needs a dozen steps,
    solves again.  ValueError if there is no such file, or it is damaged or no run.
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
    functional = prepared(problem, Coupled(record["gamma"]), NewtonOptions())
    v = functional.blocks.H_vector()
    v.FV().NumPy()[:] = state
    history = History([IterationRecord(**row) for row in kept["history"]])
    return record, DualResult.at(functional, v, Status[record["status"].upper()], history)
