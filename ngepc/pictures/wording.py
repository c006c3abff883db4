"""Descriptions of problems and materials in words and numbers, for reports."""

from __future__ import annotations

import math

import numpy as np

from ngepc._deprecated import old_names
from ngepc.checks.arguments import is_number, require_components, sample
from ngepc.checks.sentences import counted
from ngepc.model.data import Components
from ngepc.model.hardening import HardeningLaw
from ngepc.model.hill import Hill
from ngepc.model.material import Material
from ngepc.model.places import Coulomb, Roller, values_at
from ngepc.model.problem import Problem
from ngepc.model.viscosity import RateLaw
from ngepc.pictures.drawable import PLAIN, UnitNames
from ngepc.pictures.quantities import (
    amount,
    load_unit,
    number,
    per_length,
    stiffness_unit,
    unit_of,
    vector,
)
from ngepc.pictures.rows import Rows, row

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


def describe_problem(problem: Problem, units: UnitNames = PLAIN) -> Rows:
    """The data of a problem in words: mesh, material, supports, loads, contact."""
    mesh = problem.mesh
    elements = f"{counted(mesh.ne, 'element')} of order {problem.order}"
    rows = [
        row("mesh", f"{mesh.nv} nodes, {elements}"),
        row("kinematics", problem.kinematics.name),
    ]
    if problem.thickness is not None:
        length = unit_of(units, "length")
        rows.append(row("thickness", number(problem.thickness, length)))
    if problem.duration is not None:
        rows.append(row("length of the time step", number(problem.duration)))
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
    return [
        *_elasticity(material, stress, size),
        *_yielding(material, stress, size),
        *_hardening(material, stress),
        *([row(HILL, said_law(material.hill))] if material.hill is not None else []),
        *([row(RATE, said_law(material.rate))] if material.rate is not None else []),
    ]


def _elasticity(material: Material, stress: str, size: int) -> Rows:
    """Lame's parameters; of a body in three dimensions also E and Poisson's ratio."""
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
    return rows


def _yielding(material: Material, stress: str, size: int) -> Rows:
    """The bound of the deviator, and the yield stress of a bar that belongs to it."""
    bound = material.yield_stress
    rows = [row("yield bound of |dev σ|", amount(bound, stress))]
    if is_number(bound):
        share = math.sqrt((size - 1) / size)  # |dev sigma| over the tension of a bar
        rows.append(row(GIVEN["yield_stress"][0], number(bound / share, stress)))
    return rows


def _hardening(material: Material, stress: str) -> Rows:
    """Linear hardening other than zero, and the law or the sub-elements; or that there is none."""
    moduli = {
        "kinematic hardening modulus": material.hardening,
        "isotropic hardening, h": material.isotropic_hardening,
    }
    zero = [name for name, value in moduli.items() if is_number(value) and value == 0]
    rows = [row(n, amount(v, stress)) for n, v in moduli.items() if n not in zero]
    if material.law is not None:
        return [*rows, row("hardening law", said_law(material.law))]
    if material.overlay is not None:
        return [*rows, row("hardening", _layers(material))]
    return rows or [row("hardening", "none: perfectly plastic")]


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
            along = "its normal"
            if given.direction is not None:
                along = vector(np.array([given.direction]))
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
    for place, given in problem.single("springs").items():
        unit = stiffness_unit(units, problem, place)
        rows.append(row(f"support {place!r}", f"springs, {_stiffness(given, unit)}"))
    return rows


def _stiffness(given: object, unit: str) -> str:
    """The stiffness of springs along the axes, or along the normal."""
    if not isinstance(given, Components):
        return f"{amount(given, unit)} along the normal"
    if all(map(is_number, given)):
        return f"{vector(np.array([given], float), unit)}"
    return "which vary in space"


def _loads(problem: Problem, units: UnitNames) -> Rows:
    stress = unit_of(units, "stress")
    rows = []
    for place, value in problem.single("pressure").items():
        rows.append(row(f"load on {place!r}", f"pressure {amount(value, stress)}"))
    for place, value in problem.single("traction").items():
        known = require_components("traction", value, problem.N)
        values = values_at(known, problem.mesh, place)[1]
        kind = "traction" if isinstance(place, str) else "force"
        unit = stress if isinstance(place, str) else load_unit(units, problem, place)
        rows.append(row(f"load on {place!r}", f"{kind} {vector(values, unit)}"))
    if problem.f is not None:
        values = sample(problem.f, problem.mesh)
        force = vector(values, per_length(units, stress))
        rows.append(row("load in the body", f"body force {force}"))
    history = ("initial_plastic_strain", "initial_hardening", "initial_strain")
    for name in history:
        value = getattr(problem, name)
        if value is not None:
            text = number(value) if is_number(value) else "given"
            rows.append(row(name.replace("_", " "), text))
    return rows


def _contact(problem: Problem, units: UnitNames) -> Rows:
    length = unit_of(units, "length")
    rows = []
    for name, gap in problem.given_gaps.items():
        text = f"rigid obstacle, gap {amount(gap, length)}"
        rows.append(row(f"contact of {name!r}", text))
    for pair in problem.contact_pairs:
        how = "glued to" if pair.tied else "may touch"
        rows.append(row(f"contact of {pair.first!r}", f"{how} {pair.second!r}"))
    friction = problem.friction
    if isinstance(friction, Coulomb):
        text = f"Coulomb's law, coefficient {amount(friction.coefficient, '')}"
        if friction.limit is not None:
            text += f", at most {amount(friction.limit, unit_of(units, 'stress'))}"
        rows.append(row("friction", text))
    elif friction is not None:
        bound = amount(friction, unit_of(units, "stress"))
        rows.append(row("friction", f"Tresca's law, bound {bound}"))
    return rows


__getattr__ = old_names(__name__)
