"""Dual results that are not solved for: stored ones, and starts on the paper's coarse meshes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ngepc.dual.newton import NewtonOptions, prepared, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.geometries import lshape, wrench
from ngepc.model.examples import lshape_problem, wrench_problem
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, IterationRecord, Status


def restore(
    problem: Problem,
    gamma: float,
    v: np.ndarray,
    options: NewtonOptions,
    status: str,
    rows: Iterable[dict],
) -> DualResult:
    """The result of an earlier run, the primal variable solved for afresh.

    Parameters
    ----------
    problem, gamma, options
        As in that run.
    v
        Coefficients of (z, q), the array ``result.v.FV().NumPy()``.
    status, rows
        Its ``status.label`` and ``history.as_rows()``.

    Raises
    ------
    ValueError
        If ``v`` does not fit the spaces.
    """
    functional = prepared(problem, Coupled(gamma), options)
    dual = functional.blocks.H_vector()
    if v.shape != (len(dual),):
        raise ValueError(f"v has shape {v.shape}: {len(dual)} coefficients are needed")
    dual.FV().NumPy()[:] = v
    history = History([IterationRecord(**row) for row in rows])
    return DualResult.at(functional, dual, Status[status.upper()], history)


def coarse_problem(name: str) -> Problem:
    """The example on its coarse mesh: 417 nodes in the paper's Table 1, 437 for the wrench."""
    if name == "lshape":
        return lshape_problem(lshape.paper_mesh(lshape.COARSE_NODES))
    return wrench_problem(wrench.paper_mesh(wrench.COARSE_NODES))


def coarse_start(name: str, gamma: float, options: NewtonOptions) -> DualResult:
    """The solution for gamma on the coarse mesh of an example, reached in factors of ten."""
    problem, result = coarse_problem(name), None
    gammas = [g for g in (1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9) if g < gamma]
    for value in (*gammas, gamma):
        result = semismooth_newton(problem, value, result, options).or_interrupted()
    return result
