"""Results and histories in numbers, with how exact they are, for reports."""

from __future__ import annotations

import numpy as np

from ngepc.bounds.bound import error_bound
from ngepc.checks.sentences import at_most_percent, in_percent
from ngepc.evolution.result import Evolution
from ngepc.goals.goal_bound import goal_bound
from ngepc.local.indicators import error_indicators
from ngepc.local.result import ExactResult
from ngepc.pictures.drawable import PLAIN, UnitNames
from ngepc.pictures.quantities import force_unit, number, unit_of, units_of
from ngepc.pictures.rows import Rows, row
from ngepc.pictures.sampling import corners_of, visible
from ngepc.results.fields import Fields
from ngepc.results.remarks import at_plastic_points
from ngepc.results.result import Result


def describe_result(result: Result, units: UnitNames = PLAIN) -> Rows:
    """The answer in numbers: forces, extremes of the fields, the error, how the run ended."""
    length = unit_of(units, "length")
    stress = unit_of(units, "stress")
    fields = result.fields
    mises = number(largest_at_points(fields, "von_mises"), stress)
    peeq = number(largest_at_points(fields, "accumulated_plastic_strain"))
    steps = [row("Newton steps", str(result.iterations))]
    return [
        *contact_answer(result, units),
        row("largest displacement", number(largest(fields, "displacement"), length)),
        row("largest von Mises stress (integration points)", mises),
        row("largest equivalent plastic strain (PEEQ)", peeq),
        *reaction_answer(result, units),
        row("error of the mesh", how_exact(result)),
        row("status", str(result.status).replace("_", " ")),
        *(steps if result.history.records else []),
        row("relative residual", number(result.residual_norm, digits=2)),
    ]


def contact_answer(result: Result, units: UnitNames) -> Rows:
    """The contact force with its interval, and the largest pressure; nothing without contact."""
    problem = result.problem
    if not problem.touching_names:
        return []
    unit = force_unit(units, problem)
    pressure = number(largest_pressure(result), unit_of(units, "stress"))
    rows = [row("contact force", number(result.contact_force, unit))]
    interval = interval_of_force(result, unit)
    if interval:
        rows.append(row("interval of the contact force", interval))
    return [*rows, row("largest contact pressure", pressure)]


def interval_of_force(result: Result, unit: str) -> str:
    """The interval of the contact force of the continuous problem; '' if none is known.

    In the plane, where it costs about as much as the solution.
    """
    if result.problem.N != 2 or not isinstance(result, ExactResult):
        return ""
    try:
        found = goal_bound(result, "contact_force")
    except (ValueError, RuntimeError):
        return ""
    lower, upper = (number(end, digits=4) for end in found.interval)
    proof = "guaranteed" if found.guaranteed else "computed, not proved"
    return f"{lower} to {upper}{unit} ({proof})"


def reaction_answer(result: Result, units: UnitNames) -> Rows:
    """The forces of the supports on the body, without rounding errors."""
    unit = force_unit(units, result.problem)
    rows = []
    for place, force in result.equilibrium.reactions.items():
        rounded = np.where(np.abs(force) > 1e-9 * np.abs(force).max(), force, 0.0)
        directions = result.problem.kinematics.directions
        for letter, component in zip(directions, rounded, strict=False):
            what = f"force of support {str(place)!r} on the body, {letter}"
            rows.append(row(what, number(component, unit)))
    return rows


def largest(fields: Fields, name: str) -> float:
    """The largest size of a field at the points of a picture."""
    values = corners_of(fields, visible(fields, getattr(fields, name))).values
    return float((np.linalg.norm(values, axis=2) if values.ndim == 3 else values).max())


def largest_at_points(fields: Fields, name: str) -> float:
    """The largest value of a scalar field at the integration points, where the law holds."""
    return float(at_plastic_points(fields.problem, getattr(fields, name)).max())


def largest_pressure(result: Result) -> float:
    """The largest contact pressure at the corners of the contact boundary."""
    where = "|".join(result.problem.touching_names)
    return float(corners_of(result.fields, result.contact_pressure, where).values.max())


def how_exact(result: Result) -> str:
    """The bound of the energy error, an estimate if there is none, or the reason."""
    if not isinstance(result, ExactResult):
        return "not known: the exact method is needed"
    try:
        bound = error_bound(result)
    except (ValueError, RuntimeError):
        return estimated_error(result)
    size = f"{at_most_percent(bound.relative)} of the energy"
    if bound.guaranteed:
        return f"at most {size}, guaranteed"
    return f"at most {size}, known from samples of the data"


def estimated_error(result: ExactResult) -> str:
    """The estimate of the error in energy from recovered stresses."""
    try:
        error = sum(error_indicators(result).vec)
    except ValueError as reason:
        return f"not known: {str(reason).partition(': ')[2] or reason}"
    part = error / abs(result.primal_energy) if result.primal_energy else 0.0
    return f"about {in_percent(part)} of the energy, an estimate without guarantee"


COLUMNS = {
    "time": ("time", ""),
    "iterations": ("Newton steps", ""),
    "contact_force": ("contact force", "force"),
    "max_contact_pressure": ("largest pressure", "stress"),
    "max_plastic_strain": ("largest |p|", ""),
    "dissipation": ("dissipation", "energy"),
    "elastic_energy": ("elastic energy", "energy"),
}
"""Columns of the table of a history -> their headings, and the kinds of their units."""


def describe_history(history: Evolution, units: UnitNames = PLAIN) -> Rows:
    """A row of numbers for each step."""
    names = units_of(units, history.problem)
    heads = {
        name: f"{words} ({names[kind]})" if names.get(kind) else words
        for name, (words, kind) in COLUMNS.items()
    }
    return [
        {words: getattr(step.record, name) for name, words in heads.items()}
        for step in history.steps
    ]
