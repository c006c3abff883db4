"""Results from stored dual variables: what checkpoints and studies keep is v alone."""

from __future__ import annotations

import numpy as np

from ngepc.dual.newton import NewtonOptions, prepared
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status


def restore(
    problem: Problem,
    regularisation: Coupled,
    v: np.ndarray,
    options: NewtonOptions,
    status: Status,
    history: History,
) -> DualResult:
    """The result with dual variable ``v``, the primal one solved for afresh.

    Parameters
    ----------
    problem, regularisation, options
        As in the run that gave ``v``.
    v
        Coefficients of (z, q), the array ``result.v.FV().NumPy()``.
    status, history
        Of that run.

    Raises
    ------
    ValueError
        If ``v`` does not fit the spaces.
    """
    functional = prepared(problem, regularisation, options)
    blocks = functional.blocks
    dual = blocks.H_vector()
    if v.shape != (len(dual),):
        raise ValueError(f"v has shape {v.shape}: {len(dual)} coefficients are needed")
    dual.FV().NumPy()[:] = v
    y = blocks.load.CreateVector()
    blocks.primal_of(dual, y)
    return DualResult(functional, y, dual, status, "", history)
