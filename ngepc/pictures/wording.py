"""A problem, a result and a history in words and numbers, for tables of reports.

Every row has what it is and its value with the unit; there are no vectors and no Python objects.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.bounds.bound import error_bound
from ngepc.checks.arguments import is_number, sample
from ngepc.evolution.result import Evolution
from ngepc.local.result import ExactResult
from ngepc.model.hardening import HardeningLaw
from ngepc.model.material import PEEQ, Material
from ngepc.model.places import Coulomb, Roller, values_at
from ngepc.model.problem import Problem
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


def unit_of(units: UnitNames, kind: str) -> str:
    """What stands behind a number."""
    name = getattr(units, kind, "")
    return f" {name}" if name else ""


def number(value: float, unit: str = "") -> str:
    """A number with five digits and its unit."""
    return f"{value:.5g}{unit}".replace("-", "−")


def row(what: str, value: object) -> dict[str, object]:
    """A row of a table."""
    return {"what": what, "value": value}


def amount(value: object, unit: str) -> str:
    """A number, or that it varies in space."""
    return number(value, unit) if is_number(value) else "varies in space"


def describe_problem(problem: Problem, units: UnitNames = PLAIN) -> Rows:
    """What a problem is given, in words: mesh, material, supports, loads, contact."""
    mesh = problem.mesh
    elements = f"{mesh.ne} elements of order {problem.order}"
    rows = [
        row("mesh", f"{mesh.nv} nodes, {elements}"),
        row("kinematics", problem.kinematics.name),
    ]
    rows += describe_material(problem.material, units)
    return (
        rows
        + _supports(problem, units)
        + _loads(problem, units)
        + _contact(problem, units)
    )


def describe_material(material: Material, units: UnitNames = PLAIN) -> Rows:
    """A material as it was given, with E and Poisson's ratio where it was given otherwise."""
    stress = unit_of(units, "stress")
    if material.data_sheet:
        return [_given(name, v, units) for name, v in material.data_sheet.items()]
    lame_lambda, lame_mu = material.lame_lambda, material.lame_mu
    rows = [
        row("Lamé parameter λ", amount(lame_lambda, stress)),
        row("Lamé parameter μ", amount(lame_mu, stress)),
    ]
    if is_number(lame_lambda) and is_number(lame_mu):
        total = lame_lambda + lame_mu
        young = lame_mu * (3 * lame_lambda + 2 * lame_mu) / total
        rows.append(row("Young's modulus E", number(young, stress)))
        rows.append(row("Poisson's ratio", number(lame_lambda / (2 * total))))
    bound = material.yield_stress
    rows.append(row("yield bound of |dev σ|", amount(bound, stress)))
    if is_number(bound):
        words = "the same as the stress of a tensile test"
        rows.append(row(words, number(bound / PEEQ, stress)))
    others = {
        "kinematic hardening modulus": material.hardening,
        "isotropic hardening, h": material.isotropic_hardening,
    }
    zero = [name for name, value in others.items() if is_number(value) and value == 0]
    rows += [row(n, amount(v, stress)) for n, v in others.items() if n not in zero]
    if material.law is not None:
        rows.append(row("hardening law", said_law(material.law)))
    elif len(zero) == len(others):
        rows.append(row("hardening", "none: perfectly plastic"))
    return rows


def _given(name: str, value: object, units: UnitNames) -> dict[str, object]:
    if name == "curve":
        stress, strains = unit_of(units, "stress"), [strain for strain, _ in value]
        ends = f"from {number(value[0][1], stress)} to {number(value[-1][1], stress)}"
        said = f"{len(value)} points, {ends}, strains up to {number(strains[-1])}"
        return row("stress-strain curve of a tensile test", said)
    words, kind = GIVEN[name]
    unit = unit_of(units, kind)
    return row(words, value if isinstance(value, str) else amount(value, unit))


def said_law(law: HardeningLaw) -> str:
    """The name of a law and its numbers."""
    numbers = [f"{k} {v:g}" for k, v in vars(law).items() if is_number(v)]
    return ", ".join([type(law).__name__, *numbers])


def _supports(problem: Problem, units: UnitNames) -> Rows:
    length = unit_of(units, "length")
    rows = [row(f"support '{name}'", "clamped") for name in problem.clamped_names]
    for place, given in problem.single("prescribed").items():
        if isinstance(given, Roller):
            along = "its normal" if given.direction is None else "one direction"
            said = f"displacement along {along}: {amount(given.value, length)}"
        else:
            known = [
                f"u_{letter} = {amount(value, length)}"
                for letter, value in zip("xyz", given, strict=False)
                if value is not None
            ]
            said = ", ".join(known)
        rows.append(row(f"support {place!r}", said))
    for place in problem.spring_constants:
        rows.append(row(f"support {place!r}", "springs"))
    return rows


def _loads(problem: Problem, units: UnitNames) -> Rows:
    stress = unit_of(units, "stress")
    rows = []
    for place, value in problem.single("pressure").items():
        rows.append(row(f"load on {place!r}", f"pressure {amount(value, stress)}"))
    for place, value in problem.single("traction").items():
        known = (
            problem.loads[place] if isinstance(value, CoefficientFunction) else value
        )
        sizes = np.linalg.norm(values_at(known, problem.mesh, place)[1], axis=1)
        kind = "traction" if isinstance(place, str) else "force"
        unit = stress if isinstance(place, str) else ""
        low, high = sizes.min(), sizes.max()
        size = number(high, unit)
        if high - low > 1e-6 * high:
            size = f"between {number(low, unit)} and {number(high, unit)}"
        rows.append(row(f"load on {place!r}", f"{kind} of size {size}"))
    if problem.f is not None:
        size = np.linalg.norm(sample(problem.f, problem.mesh), axis=1).max()
        rows.append(row("load in the body", f"body force up to {number(size)}"))
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
        said = f"rigid obstacle, gap {amount(gap, length)}"
        rows.append(row(f"contact of {name!r}", said))
    for pair in problem.contact_pairs:
        how = "glued to" if pair.tied else "may touch"
        rows.append(row(f"contact of {pair.first!r}", f"{how} {pair.second!r}"))
    friction = problem.friction
    if isinstance(friction, Coulomb):
        said = f"Coulomb's law, coefficient {amount(friction.coefficient, '')}"
        rows.append(row("friction", said))
    elif friction is not None:
        bound = amount(friction, unit_of(units, "stress"))
        rows.append(row("friction", f"Tresca's law, bound {bound}"))
    return rows


def describe_result(result: Result, units: UnitNames = PLAIN) -> Rows:
    """The answer in numbers: how it ended, extremes of the fields, forces, how exact it is."""
    problem = result.problem
    length = unit_of(units, "length")
    stress = unit_of(units, "stress")
    fields = result.fields
    rows = [
        row("status", str(result.status).replace("_", " ")),
        row("Newton steps", str(result.iterations)),
        row("relative residual", f"{result.residual_norm:.1e}"),
        row("largest displacement", number(largest(fields, "displacement"), length)),
        row("largest von Mises stress", number(largest(fields, "von_mises"), stress)),
        row(
            "largest equivalent plastic strain (PEEQ)",
            number(largest(fields, "accumulated_plastic_strain")),
        ),
    ]
    if problem.touching_names:
        pressure = largest_pressure(result)
        rows.append(row("contact force", number(result.contact_force)))
        rows.append(row("largest contact pressure", number(pressure, stress)))
    for place, force in result.equilibrium.reactions.items():
        rounded = np.where(np.abs(force) > 1e-9 * np.abs(force).max(), force, 0.0)
        for letter, component in zip("xyz", rounded, strict=False):
            what = f"force of support {str(place)!r} on the body, {letter}"
            rows.append(row(what, number(component)))
    return [*rows, row("error of the mesh", how_exact(result))]


def largest(fields: Fields, name: str) -> float:
    """The largest size of a field at the points of a picture."""
    values = corners_of(fields, visible(fields, getattr(fields, name))).values
    return float((np.linalg.norm(values, axis=2) if values.ndim == 3 else values).max())


def largest_pressure(result: Result) -> float:
    """The largest contact pressure at the corners of the contact boundary."""
    where = "|".join(result.problem.touching_names)
    return float(corners_of(result.fields, result.contact_pressure, where).values.max())


def how_exact(result: Result) -> str:
    """The guaranteed bound of the error in energy, or why there is none."""
    if not isinstance(result, ExactResult):
        return "not bounded: the exact method is needed"
    try:
        bound = error_bound(result)
    except (TypeError, ValueError) as error:
        return f"not bounded: {str(error).partition(': ')[2] or error}"
    return f"at most {100 * bound.relative:.2g} percent in energy, guaranteed"


COLUMNS = {
    "time": "time",
    "iterations": "Newton steps",
    "contact_force": "contact force",
    "max_contact_pressure": "largest pressure",
    "max_plastic_strain": "largest |p|",
    "dissipation": "dissipation",
    "elastic_energy": "elastic energy",
}
"""Columns of the table of a history -> their headings."""


def describe_history(history: Evolution) -> Rows:
    """A row of numbers for each step."""
    return [
        {words: getattr(step.record, name) for name, words in COLUMNS.items()}
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
