"""Receipts: files that prove an interval of the least energy of a body, or of a goal.

The file contains mesh, data, displacement, stress and contact pressure in the form that
``check_receipt`` reads: fields are given by Bernstein coefficients, first those of the vertices,
then those of the edges.  Its cells are the N + 1 parts of the cells of the mesh,
on which the stress of the error bound is a polynomial.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ngepc._version import __version__
from ngepc.bounds.bound import state_of
from ngepc.bounds.counterpart import on_simplices
from ngepc.bounds.coverage import CONSTANT
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.data import BoundData
from ngepc.bounds.of_state import bound_data_of, bound_of_state
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.rollers import in_components, result_by_nodes
from ngepc.checks.kinds import require_instance, require_path
from ngepc.checks.sentences import in_words
from ngepc.discretisation.factors import Factors
from ngepc.goals import check_receipt
from ngepc.goals.goal_interval import GoalBound
from ngepc.goals.receipt_arrays import FileOf, clear_state, goal_arrays, receipt_arrays
from ngepc.goals.receipt_file import (
    in_file_order,
    lossy,
    lossy_in_goal,
    proved_intervals,
    with_hints,
)
from ngepc.goals.receipt_mesh import Pieces
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.model.features import require_covered
from ngepc.results.files import check_writable

COVERS = BOUNDED - {"friction", "hardening law", "plane stress"}
COVERS -= {"anisotropic yield", "cyclic hardening", "springs"}
COVERS -= {"rate", "two bodies", "held by contact", "hexahedra", "thickness"}
COVERS -= {"axisymmetric"}
"""Features that receipts cover; of rollers those along an axis, which hold a component."""

CLEARANCE = 1e-10
"""Fraction of the largest displacement by which bodies are moved away from the obstacle."""
CLEAR_OF_GOAL = 1e-7
"""The same for intervals of goals; mostly the distance is smaller."""
ROUNDINGS = 8
"""Distance to the obstacle, over what rounding can hide of displacement, gap and adjoint."""
SPARE = 1e-3
"""Fraction by which lambda is enlarged at least, so that conditions hold in spite of rounding."""
LIGHT = 1e-4
"""Stresses and loads of the body, over those of the goal by lambda, are no less than this part."""
LEAST_FACTOR = 1e-18
"""Lambda where a goal has no loads at all; the checker reads none below 1e-20."""
WIDER = 1e-12
"""Fraction of the intervals by which claims are widened, for rounding on other machines."""
BISECTIONS = 6
"""No cell is bisected more often, but for its neighbours."""
FAR_WIDER = 3.0
"""Width of an interval of a receipt, over that of the goal, from which on a warning says so."""
VISIBLE = 0.01
"""... if it is wider than this part of its ends."""
MOST_CELLS = 100_000
"""Files with more cells are not bisected further: rounding errors of all cells add up."""
LOSS = 0.07
"""Part of the error bound that the checker may lose on cells that are not bisected."""
SHARP = 1e-4
"""Intervals of goals are taken to be no narrower than this part of their ends."""
LOSS_OF_GOAL = 0.15
"""The same part of the width of a goal: its bisected cells cost more than those of energies."""


@one_blas_thread
def write_receipt(
    result: ExactResult | GoalBound, path: str | Path
) -> tuple[float, float]:
    """Write the proof of an interval to a file, and check it.

    ``ngepc check FILE`` checks it, and so does ``check_receipt.py`` alone, with numpy.

    Parameters
    ----------
    result
        A result of ``semismooth_newton`` without gamma, converged or not: the file proves an
        interval of the least energy.  Or an interval of ``goal_bound``: the file proves that, too.
        Of ``solved = solve_to(...)`` these are ``solved.result`` and ``solved.goal``.
    path
        The file, which ends in .npz.

    Returns
    -------
    lower, upper
        An interval that contains the least energy of the continuous problem, or the goal.  A
        warning says where rounding makes it far wider than that of ``goal_bound``.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver or of ``goal_bound``.
    ValueError
        For problems without a receipt; the message names the reason: friction, hardening laws,
        plane stress, data that are known from samples only, loads, initial strains and histories
        that vary inside elements, obstacles that are not affine on facets, gaps that are closed
        where supports move vertices of the contact boundary, bodies in several pieces, goals of
        bodies at rest; and everything that error bounds do not cover.
    RuntimeError
        As ``error_bound``.
    """
    if not isinstance(result, GoalBound):
        what = (
            "a result without gamma (of solve_to: solved.result) "
            "or an interval of goal_bound (solved.goal)"
        )
        require_instance("result", result, ExactResult, what)
    path = require_path("path", path, ".npz")
    goal = result if isinstance(result, GoalBound) else None
    problem = result.problem if goal is None else goal.bound.problem
    require_covered(in_components(problem), "a receipt", COVERS - {"rollers"})
    check_writable(path)
    if goal is None:
        result = on_simplices(result_by_nodes(result))
        bound_data = bound_data_of(result.discrete)
        tangent = Factors(bound_data.discrete, "sparsecholesky")
        state = state_of(bound_data.discrete, result)
        bound = bound_of_state(bound_data, state, tangent)
    else:
        bound = goal.bound
        check_strained(bound)
        bound_data = bound_data_of(bound.state.discrete)
    check_written(bound_data, bound)
    words, header = words_of(bound_data, bound, goal)
    header |= widened(proved_intervals(words, header))
    np.savez(path, header=json.dumps(header), receipt=words)
    if goal is None:
        return header["lower"], header["upper"]
    proved = header["goal lower"], header["goal upper"]
    warn_if_wide(goal.proved, proved)
    return proved


def warn_if_wide(interval: tuple[float, float], proved: tuple[float, float]) -> None:
    """Warn where rounding makes the interval of a receipt far wider than that of the goal."""
    width = proved[1] - proved[0]
    seen = width > VISIBLE * max(map(abs, proved))
    if seen and width > FAR_WIDER * (interval[1] - interval[0]):
        warnings.warn(
            f"the receipt proves {in_words(proved)}, the interval of the goal is "
            f"{in_words(interval)}: rounding errors of small cells rule it, as the goal is small "
            "beside the loads; a coarser mesh has fewer of them",
            UserWarning,
            stacklevel=4,
        )


def widened(proved: dict[str, float]) -> dict[str, float]:
    """Claims from what the checker proves: rounding on other machines may differ."""
    claims = {}
    for name in ("", "goal "):
        if name + "lower" in proved:
            lower = proved[name + "lower"]
            upper = proved[name + "upper"]
            wider = WIDER * (abs(lower) + abs(upper))
            claims[name + "lower"] = lower - wider
            claims[name + "upper"] = upper + wider
    return claims


def words_of(
    bound_data: BoundData, bound: ErrorBound, goal: GoalBound | None
) -> tuple[np.ndarray, dict[str, object]]:
    """The words of the file, and its header without the intervals."""
    draft = Draft(bound_data, bound)
    draft.bisect(draft.of_energy, partial(lossy, allowed=LOSS * bound.total))
    if goal is None:
        words, header = draft.of_energy()
        return with_hints(words, header), header

    lower, upper = goal.proved
    seen = max(upper - lower, SHARP * max(abs(lower), abs(upper)))
    of_goal = partial(draft.of_goal, goal)
    allowed = LOSS_OF_GOAL * seen / goal.factor
    draft.bisect(of_goal, partial(lossy_in_goal, allowed=allowed))
    words, header = of_goal()
    return with_hints(words, header), header


class Draft:
    """Words without hints and headers of a file, on cells that may still be bisected."""

    def __init__(self, bound_data: BoundData, bound: ErrorBound) -> None:
        self._bound_data = bound_data
        self._bound = bound
        self._pieces = Pieces(bound_data.cells, bound_data.problem.order)
        self._largest = np.abs(bound.state.u).max(initial=0.0)

    def _header(self) -> dict[str, object]:
        """What all headers have."""
        return {
            "format": check_receipt.FORMAT,
            "made by": f"ngepc {__version__}",
            "kinematics": self._bound_data.problem.kinematics.name,
            "order": self._bound_data.problem.order,
        }

    def of_energy(self) -> tuple[np.ndarray, dict[str, object]]:
        """Those of an energy."""
        clearance = CLEARANCE * self._largest
        u = clear_state(self._bound_data, self._bound.state, clearance)
        file = FileOf(self._bound_data, self._pieces)
        header = self._header()
        layers = [receipt_arrays(file, self._bound, u)]
        return in_file_order(file.cells, layers, header), header

    def of_goal(self, goal: GoalBound) -> tuple[np.ndarray, dict[str, object]]:
        """Those of a goal, whose factor depends on what rounding hides on these cells."""
        wrong = check_receipt.Body(*self.of_energy()).wrong.max()
        factor, distance = factor_and_distance(goal, self._largest, wrong)
        clearance = CLEARANCE * self._largest + distance
        motion = goal.terms.motion
        u = clear_state(self._bound_data, self._bound.state, clearance, motion)
        file = FileOf(self._bound_data, self._pieces)
        body = receipt_arrays(file, self._bound, u)
        adjoint = goal_arrays(file, goal, u)
        factor = max(factor, least_factor(body, adjoint))
        adjoint = {name: values / factor for name, values in adjoint.items()}
        header = self._header() | {"goal": goal.name, "factor": factor}
        layers = [body, adjoint]
        return in_file_order(file.cells, layers, header), header

    def bisect(
        self,
        draft: Callable[[], tuple[np.ndarray, dict[str, object]]],
        lossy_cells: Callable[[check_receipt.Body], np.ndarray],
    ) -> None:
        """Bisect cells until bounds lose little on all of them."""
        for _ in range(BISECTIONS):
            body = check_receipt.Body(*draft())
            marked = lossy_cells(body)
            if body.K > MOST_CELLS or not marked.any():
                break
            self._pieces.bisect(marked)


def factor_and_distance(
    goal: GoalBound, largest: float, wrong: float
) -> tuple[float, float]:
    """Lambda of a receipt, and the distance to the obstacle, so that rounding is less than both.

    The adjoint satisfies its conditions with ``goal.factor``, so that what lambda is larger by,
    times the distance, remains for the rounding error of z . n, which is ``wrong`` of its size.
    ``largest`` is the largest displacement.
    """
    N = goal.pair.z.shape[-1]
    moves = max(np.abs(goal.pair.z).max(), goal.terms.factor.max(initial=0.0))
    hidden = ROUNDINGS * (N + 1) * wrong * moves
    more = max(goal.factor * SPARE, hidden / (CLEAR_OF_GOAL * largest))
    return goal.factor + more, hidden / more


def least_factor(body: dict[str, np.ndarray], goal: dict[str, np.ndarray]) -> float:
    """Lambda with which rounding errors of the goal's loads stay beside those of the body.

    A goal that is exact has a lambda near zero, by which its loads are divided.
    """
    strained = largest_stress(body)
    part = LIGHT * largest_stress(goal) / strained if strained else 0.0
    return max(part, LEAST_FACTOR)


def largest_stress(arrays: dict[str, np.ndarray]) -> float:
    """The largest number among stresses, tractions and pressures of a receipt."""
    loads = "stress", "traction", "pressure"
    return max(np.abs(arrays[name]).max(initial=0.0) for name in loads)


def check_strained(bound: ErrorBound) -> None:
    """Refuse the goal of a body at rest with a ValueError: all numbers would be rounding."""
    if not bound.strain_energy + bound.total > 0:
        raise ValueError(
            "result: nothing strains the body, whose goals are exact, and a file would prove them "
            "up to rounding only; write_receipt(result of the solver) proves the least energy"
        )


def check_written(bound_data: BoundData, bound: ErrorBound) -> None:
    """Refuse problems without a receipt with a ValueError that names the argument."""
    law = bound_data.discrete.law
    if not bound.guaranteed:
        raise ValueError(f"result: a receipt needs a proved bound. {bound.message}")
    if bound_data.carried.left.any():
        raise ValueError(
            "body_force, traction: a receipt needs a body force that is constant on "
            "elements and tractions that are affine"
        )
    gap, bent = np.split(bound_data.boundary.gap, [bound_data.cells.N], axis=1)
    excess = bound_data.boundary.excess / bound_data.contact.measure[:, None]
    curved = max(np.abs(excess).max(initial=0.0), np.abs(bent).max(initial=0.0))
    if curved > CONSTANT * np.abs(gap).max(initial=0.0):
        raise ValueError("gap: a receipt needs an obstacle that is affine on facets")
    for name, values in (
        ("initial_hardening", law.back),
        ("initial_plastic_strain", law.initial),
        ("initial_hardening (alpha_1)", law.beta[:, None]),
        ("initial_strain", np.broadcast_to(law.distortion, law.initial.shape)),
        ("initial_strain", np.broadcast_to(law.swelling, law.beta.shape)[:, None]),
    ):
        by_cell = values.reshape(-1, bound_data.each, values.shape[1])
        if np.ptp(by_cell, axis=1).any():
            raise ValueError(f"{name}: a receipt needs one value on each element")
