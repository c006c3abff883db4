"""The data of a law of hardening as parameters: "law.saturation", "law.stress_there[1]".

A law is a formula for R(x) with some data.  The derivatives of beta(g) and its integral with
respect to these data, at the |p| of a solution, are difference quotients of the formula.
No solution is differenced, and a user's law needs nothing but its formulas.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace

import numpy as np
from ngsolve import Mesh

from ngepc.checks.arguments import is_number, require_coefficient, sample
from ngepc.local.system import State
from ngepc.model.data import as_scalar
from ngepc.model.hardening import HardeningLaw
from ngepc.model.material import PEEQ, Material
from ngepc.model.problem import Problem
from ngepc.sensitivity.equations import STENCIL, Data

OF_LAW = "law."  # before the name of a datum of the law of hardening
STEP = 1e-3  # of differences in a datum of a law, relative to its size


def law_datum(law: HardeningLaw | None, name: str) -> tuple[str, int | None, object]:
    """The field of a law that "law.field" or "law.field[k]" names, k or None, and its value.

    ValueError if the law has no such datum.
    """
    if law is None:
        raise ValueError(f"parameters={name!r}: the material has no law")
    field, _, rest = name.removeprefix(OF_LAW).partition("[")
    if field not in vars(law):
        legal = ", ".join(f"{OF_LAW}{known}" for known in vars(law))
        raise ValueError(f"parameters={name!r}: one of {legal} is needed")
    value = getattr(law, field)
    if not rest:
        return field, None, value
    several = isinstance(value, tuple)
    number = rest.removesuffix("]")
    if not (several and number.isdigit() and int(number) < len(value)):
        count = len(value) if several else "no"
        raise ValueError(f"parameters={name!r}: {field} has {count} entries")
    return field, int(number), value[int(number)]


def new_value(law: HardeningLaw, name: str, value: object) -> dict[str, object]:
    """Field of a law -> its value after a change of the datum with this name."""
    field, number, _ = law_datum(law, name)
    if number is None:
        return {field: value}
    table = list(getattr(law, field))
    table[number] = value
    return {field: tuple(table)}


def follows_law(material: Material, mesh: Mesh) -> bool:
    """Whether the yield stress of a material is that of its law, as in ``with_law``."""
    if material.law is None:
        return False
    at_rest = sample(as_scalar(PEEQ * material.law.stress(0.0)), mesh)
    given = sample(as_scalar(material.yield_stress), mesh)
    return bool(np.allclose(at_rest, given, rtol=1e-12, atol=0.0))


def with_constants(problem: Problem, values: Mapping[str, float]) -> Problem:
    """The problem with other data of its material and of the law of it, by name."""
    material = problem.material
    changes = {n: v for n, v in values.items() if not n.startswith(OF_LAW)}
    law = material.law
    for name in values.keys() - changes.keys():
        law = replace(law, **new_value(law, name, values[name]))
    if law is not material.law:
        changes["law"] = law
        if "yield_stress" not in values and follows_law(material, problem.mesh):
            changes["yield_stress"] = PEEQ * law.stress(0.0)
    return replace(problem, material=replace(material, **changes))


def law_changes(state: State, name: str, change: object) -> Data:
    """The change of beta and of its integral per unit of a change of a datum of the law.

    TypeError, ValueError if the law has no such datum, or the change is not legal for it.
    """
    problem = state.discrete.problem
    points = state.discrete.points
    material = problem.material
    _, _, value = law_datum(material.law, name)
    if change is None:
        change = 1.0 if is_number(value) else value
    several = isinstance(value, tuple)
    values = list(value) if several else [value]
    changes = list(change) if isinstance(change, tuple | list) else [change]
    if len(changes) != len(values):
        raise ValueError(f"change={change!r}: {len(values)} values are needed")
    for one in changes:
        require_coefficient(name, one)
    given = [points.at(one) for one in values]
    moved = [points.at(one) for one in changes]
    largest = max(np.abs(one).max() for one in moved)
    if largest == 0.0:
        return Data()
    step = STEP * (max(np.abs(one).max() for one in given) or 1.0) / largest

    there = material.law.at(points.at)
    follows = follows_law(material, problem.mesh)
    alpha_1 = points.at(problem.alpha_0[0])
    hardened = 1 + points.at(as_scalar(material.hardening_modulus)) * alpha_1
    resistance = state.discrete.law.resistance
    gained = state.at.gained
    found = Data()
    for k, weight in STENCIL.items():
        shifted = [v + k * step * c for v, c in zip(given, moved, strict=True)]
        law = copy(there)
        vars(law).update(
            new_value(law, name, tuple(shifted) if several else shifted[0])
        )
        beta = PEEQ * (law.stress(resistance.accumulated) - law.stress(0.0))
        if follows:
            beta = beta + PEEQ * law.stress(0.0) * hardened
        other = resistance.with_law(law)
        bound = other.bound(gained)
        energy = other.energy(gained)
        found += weight / step * Data(beta=beta, radius=bound, hardened=energy)
    return found
