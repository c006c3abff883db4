"""Descriptions of problems, results and histories in words and numbers, for reports.

Every row has a name and a value with its unit; there are no vectors and no Python objects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ngepc.bounds.bound import error_bound
from ngepc.checks.arguments import is_number, require_components, sample
from ngepc.checks.sentences import at_most_percent, counted, in_percent
from ngepc.evolution.result import Evolution
from ngepc.goals.goal_bound import goal_bound
from ngepc.local.indicators import error_indicators
from ngepc.local.result import ExactResult
from ngepc.model.hardening import HardeningLaw
from ngepc.model.hill import Hill
from ngepc.model.material import Material
from ngepc.model.places import Coulomb, Roller, values_at
from ngepc.model.problem import Problem
from ngepc.model.viscosity import RateLaw
from ngepc.pictures.drawable import PLAIN, UnitNames
from ngepc.pictures.sampling import corners_of, visible
from ngepc.results.fields import Fields
from ngepc.results.result import Result

Rows = list[dict[str, object]]

GIVEN = {
    "young": ("Young's modulus E", "stress"),
    "poisson": ("Poisson's ratio", ""),
    "yield_stress": ("yield stress R of a tensile test", "stress"),
    "tangent_modulus": ("slope of the stress-strain curve beyond yielding", "stress"),
    "plastic_modulus": ("slope of stress over plastic strain", "stress"),
    "kind": ("hardening", ""),
    "kinematic_share": ("kinematic part of the hardening", ""),
}
"""Arguments of ``Material.metal`` -> words, and their unit."""

RATE = "overstress of the rate of plastic strain"
HILL = "anisotropic yield"


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


def row(quantity: str, value: object) -> dict[str, object]:
    """A row of a table."""
    return {"quantity": quantity, "value": value}


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


def describe_problem(problem: Problem, units: UnitNames = PLAIN) -> Rows:
    """The data of a problem in words: mesh, material, supports, loads, contact."""
    mesh = problem.mesh
    elements = f"{counted(mesh.ne, 'element')} of order {problem.order}"
    rows = [
        row("mesh", f"{mesh.nv} nodes, {elements}"),
        row("kinematics", problem.kinematics.name),
    ]
    rows += describe_material(problem.material, units, problem.kinematics.size)
    return (
        rows
        + _supports(problem, units)
        + _loads(problem, units)
        + _contact(problem, units)
    )


def describe_material(
    material: Material, units: UnitNames = PLAIN, size: int = 3
) -> Rows:
    """A material as it was given, with E and Poisson's ratio where it was given otherwise.

    ``size`` is the number of rows of a stress tensor.
    """
    stress = unit_of(units, "stress")
    if material.data_sheet:
        rows = [_given(name, v, units) for name, v in material.data_sheet.items()]
        if material.overlay is not None:
            return [*rows, row("hardening", f"cyclic, {_layers(material)}")]
        return rows
    lame_lambda = material.lame_lambda
    lame_mu = material.lame_mu
    rows = [
        row("Lamé parameter λ", amount(lame_lambda, stress)),
        row("Lamé parameter μ", amount(lame_mu, stress)),
    ]
    if size == 3 and is_number(lame_lambda) and is_number(lame_mu):
        total = lame_lambda + lame_mu
        young = lame_mu * (3 * lame_lambda + 2 * lame_mu) / total
        rows.append(row("Young's modulus E", number(young, stress)))
        rows.append(row("Poisson's ratio", number(lame_lambda / (2 * total))))
    bound = material.yield_stress
    rows.append(row("yield bound of |dev σ|", amount(bound, stress)))
    if is_number(bound):
        share = math.sqrt((size - 1) / size)  # |dev sigma| over the tension of a bar
        rows.append(row(GIVEN["yield_stress"][0], number(bound / share, stress)))
    others = {
        "kinematic hardening modulus": material.hardening,
        "isotropic hardening, h": material.isotropic_hardening,
    }
    zero = [name for name, value in others.items() if is_number(value) and value == 0]
    rows += [row(n, amount(v, stress)) for n, v in others.items() if n not in zero]
    if material.law is not None:
        rows.append(row("hardening law", said_law(material.law)))
    elif material.overlay is not None:
        rows.append(row("hardening", _layers(material)))
    elif len(zero) == len(others):
        rows.append(row("hardening", "none: perfectly plastic"))
    if material.hill is not None:
        rows.append(row(HILL, said_law(material.hill)))
    if material.rate is not None:
        rows.append(row(RATE, said_law(material.rate)))
    return rows


def _layers(material: Material) -> str:
    """How many sub-elements a cyclic material has."""
    return f"{material.overlay.count} sub-elements"


def _given(name: str, value: object, units: UnitNames) -> dict[str, object]:
    if name == "curve":
        stress = unit_of(units, "stress")
        strains = [strain for strain, _ in value]
        ends = f"from {number(value[0][1], stress)} to {number(value[-1][1], stress)}"
        text = f"{counted(len(value), 'point')}, {ends}, strains up to {number(strains[-1])}"
        return row("stress-strain curve", text)
    if name == "rate":
        return row(RATE, said_law(value))
    if name == "hill":
        return row(HILL, said_law(value))
    words, kind = GIVEN[name]
    unit = unit_of(units, kind)
    return row(words, value if isinstance(value, str) else amount(value, unit))


def said_law(law: HardeningLaw | RateLaw | Hill) -> str:
    """The name of a law and its numbers."""
    numbers = [f"{k} {v:g}" for k, v in vars(law).items() if is_number(v)]
    return ", ".join([type(law).__name__, *numbers])


def _supports(problem: Problem, units: UnitNames) -> Rows:
    length = unit_of(units, "length")
    rows = [row(f"support '{name}'", "clamped") for name in problem.clamped_names]
    for place, given in problem.single("prescribed").items():
        if isinstance(given, Roller):
            along = "its normal" if given.direction is None else "one direction"
            text = f"displacement along {along}: {amount(given.value, length)}"
        else:
            known = [
                f"u_{letter} = {amount(value, length)}"
                for letter, value in zip(
                    problem.kinematics.directions, given, strict=False
                )
                if value is not None
            ]
            text = ", ".join(known)
        rows.append(row(f"support {place!r}", text))
    for place in problem.spring_constants:
        rows.append(row(f"support {place!r}", "springs"))
    return rows


def _loads(problem: Problem, units: UnitNames) -> Rows:
    stress = unit_of(units, "stress")
    rows = []
    for place, value in problem.single("pressure").items():
        rows.append(row(f"load on {place!r}", f"pressure {amount(value, stress)}"))
    for place, value in problem.single("traction").items():
        known = require_components("traction", value, problem.N)
        values = values_at(known, problem.mesh, place)[1]
        kind = "traction" if isinstance(place, str) else "force"
        unit = stress if isinstance(place, str) else ""
        rows.append(row(f"load on {place!r}", f"{kind} {vector(values, unit)}"))
    if problem.f is not None:
        values = sample(problem.f, problem.mesh)
        rows.append(row("load in the body", f"body force {vector(values)}"))
    history = ("initial_plastic_strain", "initial_hardening", "initial_strain")
    for name in history:
        if getattr(problem, name) is not None:
            rows.append(row(name.replace("_", " "), "given"))
    return rows


def _contact(problem: Problem, units: UnitNames) -> Rows:
    length = unit_of(units, "length")
    rows = []
    for name in problem.contact_names:
        gap = problem.gap[name] if isinstance(problem.gap, Mapping) else problem.gap
        text = f"rigid obstacle, gap {amount(gap, length)}"
        rows.append(row(f"contact of {name!r}", text))
    for pair in problem.contact_pairs:
        how = "glued to" if pair.tied else "may touch"
        rows.append(row(f"contact of {pair.first!r}", f"{how} {pair.second!r}"))
    friction = problem.friction
    if isinstance(friction, Coulomb):
        text = f"Coulomb's law, coefficient {amount(friction.coefficient, '')}"
        rows.append(row("friction", text))
    elif friction is not None:
        bound = amount(friction, unit_of(units, "stress"))
        rows.append(row("friction", f"Tresca's law, bound {bound}"))
    return rows


def describe_result(result: Result, units: UnitNames = PLAIN) -> Rows:
    """The answer in numbers: forces, extremes of the fields, the error, how the run ended."""
    length = unit_of(units, "length")
    stress = unit_of(units, "stress")
    fields = result.fields
    peeq = number(largest(fields, "accumulated_plastic_strain"))
    steps = [row("Newton steps", str(result.iterations))]
    return [
        *contact_answer(result, units),
        row("largest displacement", number(largest(fields, "displacement"), length)),
        row("largest von Mises stress", number(largest(fields, "von_mises"), stress)),
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


def flat_rows(rows: Rows) -> Rows:
    """Rows whose vectors and mappings stand in columns of their own: 'reaction_x'."""
    return [dict(item for k, v in one.items() for item in flat(k, v)) for one in rows]


def flat(name: str, value: object) -> list[tuple[str, object]]:
    """A value, or the parts of a vector or a mapping, by their names."""
    if isinstance(value, Mapping):
        pairs = [
            (f"{letter}:{k}", v) for k, vs in value.items() for letter, v in parts(vs)
        ]
        return [(f"{name.removesuffix('s')}_{where}", v) for where, v in pairs]
    if isinstance(value, list | tuple | np.ndarray):
        return [(f"{name}_{letter}", v) for letter, v in parts(value)]
    return [(name, value)]


def parts(vector: object) -> list[tuple[str, float]]:
    """x, y, z and the components of a vector."""
    return [(letter, float(v)) for letter, v in zip("xyz", vector, strict=False)]
