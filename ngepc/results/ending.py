"""Whether a run of Newton's method ends at an iterate, and what is said of it then."""

from __future__ import annotations

import numpy as np

from ngepc.checks.sentences import counted
from ngepc.discretisation.body import EPSILON, Iterate
from ngepc.discretisation.floating import SMALL
from ngepc.model.elements import largest_slenderness
from ngepc.results.outcome import History, Status

FREE = 100.0
"""Without hardening, a larger |p| shows that the load is beyond the limit load."""

FLOWS = 1.0
"""The same where the steps are used up; a few bodies carry loads that strain them so much."""

SETTLED = 0.5
"""Near rounding, the run ends if a step leaves more than this fraction of the residual."""

UNCHANGED = 0.99
"""A run in which a part drifts ends if a step leaves more than this fraction of the residual."""

SAME_ENERGY = 1e-8
"""Part of the energy by which the last step may lower it where rounding hides the residual."""

OBSERVED = 5
"""Last falls of the energy from which the following ones are predicted."""

SLENDER = 300.0
"""Elements that are more times as long as thick are named as a cause of rounding errors."""


def end_of(
    here: Iterate, history: History, tolerance: float, max_iterations: int
) -> tuple[Status | None, str]:
    """The status and message if the run ends at a state; a status of None to go on."""
    steps = len(history.records) - 1
    before = history.before
    residual = here.residual_norm
    if not np.isfinite(residual + here.energy):
        return Status.NONFINITE, "The energy or the residual is NaN or infinite."
    within = is_within(here, tolerance)
    if within:
        if not (here.hidden_by_rounding and falls(history)):
            return Status.CONVERGED, ""
        if steps < max_iterations and not keeps_falling(history, max_iterations):
            return None, ""
    if here.body.unheld:
        return Status.UNHELD, here.body.unheld
    if here.flowing > FREE:
        return Status.LIMIT_LOAD, (
            f"After {counted(steps, 'step')} |p| reaches {here.flowing:.2g} where the material no "
            "longer hardens: the loads are at or beyond the limit load, which limit_load(problem) "
            "bounds."
        )
    if before is not None and residual > SETTLED * before and residual <= here.rounding:
        return Status.STAGNATED, limited_by_rounding(
            here, f"After {counted(steps, 'step')} the", within
        )
    if before is not None and UNCHANGED * before < residual <= SMALL and here.drifting:
        return Status.STAGNATED, here.drifting
    if steps == max_iterations:
        return Status.ITERATION_LIMIT, (
            f"{counted(steps, 'step')}, relative residual {residual:.3g}, last step length "
            f"{history.records[-1].step_length:.3g}. {unfinished(here)}"
        )
    return None, ""


def unfinished(here: Iterate) -> str:
    """What is said of a state where the steps are used up."""
    if here.drifting:
        return here.drifting
    if here.flowing > FLOWS:
        return (
            f"|p| reaches {here.flowing:.2g} where the material no longer hardens: most likely the "
            "loads are near the limit load or beyond it, which limit_load(problem) bounds."
        )
    return "Try more steps or a smaller load step."


def is_within(here: Iterate, tolerance: float) -> bool:
    """Whether residual and penetration of a state are small enough."""
    feasible = here.penetration <= here.touching_distance
    return feasible and here.residual_norm <= tolerance


def falls(history: History) -> bool:
    """Whether the last step has lowered the energy by more than ``least_fall``.

    The energy is quadratic in the error of u, and rounding changes it by less.
    """
    if len(history.records) < 2:
        return False
    before, last = (record.energy for record in history.records[-2:])
    return before - last > least_fall(history)


def least_fall(history: History) -> float:
    """The least fall of the energy that is no rounding error (force times length).

    ``SAME_ENERGY`` of the last energy, and ``EPSILON``^2 of the largest one: where nothing is
    strained at the end, the last one is a rounding error of u, squared.
    """
    energies = np.abs([record.energy for record in history.records])
    return float(SAME_ENERGY * energies[-1] + EPSILON**2 * energies.max())


def keeps_falling(history: History, max_iterations: int) -> bool:
    """Whether the energy would still fall by more than ``least_fall`` in the last step allowed.

    The falls of the last steps are continued as a geometric sequence.
    """
    records = history.records[-1 - OBSERVED :]
    energies = np.array([record.energy for record in records])
    fallen = -np.diff(energies)
    if len(fallen) < OBSERVED or fallen.min() <= 0:
        return False
    ratio = min(fallen[-1] / fallen[0], 1.0) ** (1 / (OBSERVED - 1))
    left = max_iterations - records[-1].iteration
    return bool(fallen[-1] * ratio**left > least_fall(history))


def no_descent(here: Iterate, history: History, tolerance: float) -> tuple[Status, str]:
    """The status and message where no step length lowers the energy."""
    within = is_within(here, tolerance)
    if within and not falls(history):
        return Status.CONVERGED, ""
    if within or here.residual_norm <= here.rounding:
        return Status.STAGNATED, limited_by_rounding(here, "The", within)
    text = f"No step length lowers the energy at the relative residual {here.residual_norm:.3g}"
    if slender := slender_elements(here):
        return Status.LINESEARCH_FAILED, f"{text}. {slender}"
    return Status.LINESEARCH_FAILED, f"{text}; try a smaller load step."


def limited_by_rounding(here: Iterate, after: str, within: bool = False) -> str:
    """The message for a residual of rounding errors, ``within`` the tolerance or not."""
    cause = slender_elements(here) or (
        "Stresses are small differences of large ones: hardening or springs are small compared "
        "with the elastic moduli, or the body is slender or nearly incompressible."
    )
    left = f"{here.residual_norm:.3g}. Rounding errors leave about {here.rounding:.2g}"
    text = f"{after} relative residual is {left}. {cause}"
    if within:
        return text
    return f"{text} A tolerance above {1.1 * here.rounding:.2g} can be met."


def slender_elements(here: Iterate) -> str:
    """A remark on elements in which rounding errors are large, "" without any."""
    problem = here.body.problem
    slender = problem.processes.maximum(np.array([largest_slenderness(problem.mesh)]))
    if slender < SLENDER:
        return ""
    return (
        f"Elements are up to {slender:.2g} times as long as thick, and rounding errors grow with "
        "the square of that: mesh the body with elements of better shape."
    )
