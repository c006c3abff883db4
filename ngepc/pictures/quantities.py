"""Numbers and units as engineers write them."""

from __future__ import annotations

import math

import numpy as np

from ngepc.checks.arguments import is_number
from ngepc.model.places import Edge, Place
from ngepc.model.problem import Problem
from ngepc.pictures.drawable import UnitNames

FORCES = {
    ("mm", "MPa"): "N",
    ("mm", "GPa"): "kN",
    ("m", "Pa"): "N",
    ("m", "kPa"): "kN",
    ("m", "MPa"): "MN",
}
"""Units of length and stress -> the unit of stress times an area."""
SMALLEST = 1e-4
"""Smaller numbers are written with a power of ten."""
LARGEST = 1e7
"""Numbers from here on are written with a power of ten."""
ALIKE = 1e-6
"""Vectors that differ by less, relative to the largest, are written as one."""
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_of(units: UnitNames, kind: str) -> str:
    """The unit behind a number."""
    name = getattr(units, kind, "")
    return f" {name}" if name else ""


def force_unit(units: UnitNames, problem: Problem) -> str:
    """The unit of forces: stress times an area, in plane models without thickness per length."""
    length = units.length
    stress = units.stress
    if not (length and stress):
        return ""
    per_length = problem.N == 2 and not is_whole_body(problem)
    area = FORCES.get((length, stress))
    if area is None:
        return f" {stress}·{length}" if per_length else f" {stress}·{length}²"
    return f" {area}/{length}" if per_length else f" {area}"


def load_unit(units: UnitNames, problem: Problem, place: Place) -> str:
    """The unit of a force at a point, and of one along an edge, per length."""
    force = force_unit(units, problem)
    return per_length(units, force) if isinstance(place, Edge) else force


def stiffness_unit(units: UnitNames, problem: Problem, place: Place) -> str:
    """The unit of a load over that of a displacement."""
    stress = unit_of(units, "stress")
    if isinstance(place, str):
        return per_length(units, stress)
    is_whole = problem.N == 3 or is_whole_body(problem)
    if isinstance(place, Edge) or not is_whole:
        return stress  # a force per length over a length
    return per_length(units, force_unit(units, problem))


def per_length(units: UnitNames, unit: str) -> str:
    """A unit over that of lengths; empty where one has no name."""
    return f"{unit}/{units.length}" if unit and units.length else ""


def units_of(units: UnitNames, problem: Problem) -> dict[str, str]:
    """Kind of quantity -> its unit, empty where it has no name."""
    force = force_unit(units, problem).strip()
    energy = force.removesuffix(f"/{units.length}")  # per length: N mm/mm is N
    if energy == force:
        energy = _longer(force, units.length) if force else ""
    return {
        "length": units.length,
        "stress": units.stress,
        "force": force,
        "energy": energy,
    }


def _longer(unit: str, length: str) -> str:
    """A unit times a length: 'N·mm', and 'MPa·cm²' for 'MPa·cm'."""
    for power, following in (("", "²"), ("²", "³")):
        if unit.endswith(f"·{length}{power}"):
            return f"{unit.removesuffix(power)}{following}"
    return f"{unit}·{length}"


def is_whole_body(problem: Problem) -> bool:
    """Whether forces in the plane are those of a whole ring or of a given thickness."""
    return problem.kinematics.hoop or problem.thickness is not None


def number(value: float, unit: str = "", digits: int = 5) -> str:
    """A number as engineers write it, with its unit: 210000 MPa, 0.0287, 4.2·10⁻¹³.

    All digits before the decimal point are written; ``digits`` of them count otherwise.
    """
    size = abs(value)
    if size >= 10 ** (digits - 1) and size < LARGEST:
        text = f"{value:.0f}"
    elif value == 0 or SMALLEST <= size < LARGEST or not math.isfinite(value):
        text = f"{value:.{digits}g}"
    else:
        factor, power = f"{value:.{digits - 1}e}".split("e")
        factor = factor.rstrip("0").rstrip(".")
        text = f"{factor}·10{str(int(power)).translate(SUPERSCRIPTS)}"
    return f"{text}{unit}".replace("-", "−")


def amount(value: object, unit: str) -> str:
    """A number, or the remark that it varies in space."""
    return number(value, unit) if is_number(value) else "varies in space"


def vector(values: np.ndarray, unit: str = "") -> str:
    """The components of vectors (n, N) that are all alike, otherwise their sizes."""
    sizes = np.linalg.norm(values, axis=1)
    low = sizes.min()
    high = sizes.max()
    if np.abs(values - values[0]).max() <= ALIKE * high:
        components = np.where(np.abs(values[0]) > ALIKE * high, values[0], 0.0)
        return f"({', '.join(map(number, components.tolist()))}){unit}"
    if high - low <= ALIKE * high:
        return f"of size {number(high, unit)}"
    return f"of size between {number(low, unit)} and {number(high, unit)}"
