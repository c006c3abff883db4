"""The data of a part of the material as parameters: "law.saturation", "overlay.bounds[1]".

A part is the hardening law, the rate law, Hill's ellipsoid, or the sub-elements of an overlay.  The
derivatives of beta(g) and its integral by the data of a law, at the g of a solution, and those of
Hill's form, are difference quotients of the law's formulas.  Solutions are not differenced, and a
law of one's own needs nothing but its formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, fields, replace

import numpy as np
from ngsolve import Mesh

from ngepc.checks.arguments import is_number, require_coefficient, sample
from ngepc.checks.sentences import counted, in_words
from ngepc.discretisation.finer import seen
from ngepc.discretisation.resistance import Resistance
from ngepc.local.system import State
from ngepc.model.data import as_scalar
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ
from ngepc.sensitivity.equations import STENCIL, Data

PARTS = ("law", "rate", "hill", "overlay")
"""Fields of a material that have data of their own."""

STEP = 1e-3  # step of differences in a datum, relative to its size


def is_of_part(name: str) -> bool:
    """Whether a name is that of a datum of a part: "law.saturation"."""
    part, dot, _ = name.partition(".")
    return bool(dot) and part in PARTS


@dataclass(frozen=True, eq=False)
class PartDatum:
    """A datum of a part of a material: the part's name, the field, its entry or None, its value."""

    part: str
    field: str
    entry: int | None
    value: object

    @classmethod
    def of(cls, material: Material, name: str) -> PartDatum:
        """The datum with this name; ValueError if the material has none."""
        part, _, rest = name.partition(".")
        given = getattr(material, part)
        if given is None:
            raise ValueError(f"parameters={name!r}: the material has no {part}")
        field, _, rest = rest.partition("[")
        if field not in vars(given):
            legal = ", ".join(f"{part}.{known}" for known in vars(given))
            raise ValueError(f"parameters={name!r}: one of {legal} is needed")
        value = getattr(given, field)
        if not rest:
            return cls(part, field, None, value)
        several = isinstance(value, tuple)
        number = rest.removesuffix("]")
        if not (several and number.isdigit() and int(number) < len(value)):
            has = counted(len(value), "entry", "entries") if several else "no entries"
            raise ValueError(f"parameters={name!r}: {field} has {has}")
        return cls(part, field, int(number), value[int(number)])

    def changed(self, given: object, value: object) -> dict[str, object]:
        """Field of the part -> its value after a change of the datum."""
        if self.entry is None:
            return {self.field: value}
        table = list(getattr(given, self.field))
        table[self.entry] = value
        return {self.field: tuple(table)}


def numeric_data(material: Material) -> dict[str, float]:
    """The data of a material and of its parts that are numbers, by the names of parameters."""
    found = {}
    for field in fields(material):
        value = getattr(material, field.name)
        if is_number(value) and material.overlay is None:
            found[field.name] = float(value)
        if field.name not in PARTS or value is None:
            continue
        for name, datum in vars(value).items():
            whole = f"{field.name}.{name}"
            if is_number(datum):
                found[whole] = float(datum)
            for k, one in enumerate(datum if isinstance(datum, tuple) else ()):
                if is_number(one):
                    found[f"{whole}[{k}]"] = float(one)
    if material.overlay is not None:
        elastic = {name: getattr(material, name) for name in ("lame_lambda", "lame_mu")}
        found |= {name: float(v) for name, v in elastic.items() if is_number(v)}
    return found


def follows_law(material: Material, mesh: Mesh) -> bool:
    """Whether the yield stress of a material is that of its hardening law, as in ``with_law``."""
    if material.law is None:
        return False
    at_rest = sample(as_scalar(PEEQ * material.law.stress(0.0)), mesh)
    given = sample(as_scalar(material.yield_stress), mesh)
    return bool(np.allclose(at_rest, given, rtol=1e-12, atol=0.0))


def with_constants(problem: Problem, values: Mapping[str, float]) -> Problem:
    """The problem with other data of its material and of its parts, by name.

    The yield stress changes with the hardening law if it follows that, and with the first bound of
    an overlay.
    """
    material = problem.material
    changes = {n: v for n, v in values.items() if not is_of_part(n)}
    parts: dict[str, object] = {}
    for name in values.keys() - changes.keys():
        datum = PartDatum.of(material, name)
        part = parts.get(datum.part, getattr(material, datum.part))
        parts[datum.part] = replace(part, **datum.changed(part, values[name]))
    if "yield_stress" not in values:
        if "law" in parts and follows_law(material, problem.mesh):
            changes["yield_stress"] = PEEQ * parts["law"].stress(0.0)
        if "overlay" in parts:
            changes["yield_stress"] = parts["overlay"].bounds[0]
    return replace(problem, material=replace(material, **changes, **parts))


def part_changes(state: State, name: str, change: object) -> Data:
    """The change of the data of the law at the points per unit of a change of a datum of a part.

    TypeError, ValueError if the part has no such datum, or the change is not legal for it.
    """
    points = state.discrete.points
    datum = PartDatum.of(state.discrete.problem.material, name)
    value = datum.value
    if change is None:
        change = 1.0 if is_number(value) else value
    several = isinstance(value, tuple)
    values = list(value) if several else [value]
    changes = list(change) if isinstance(change, tuple | list) else [change]
    if len(changes) != len(values):
        needed = f"as many values as the datum has, {len(values)}, are needed"
        raise ValueError(f"change={in_words(change)}: {needed}")
    for one in changes:
        require_coefficient(name, one)
    if datum.part == "overlay":
        return _overlay_changes(state, name, datum, changes)

    given = [points.at(seen(one, points)) for one in values]
    moved = [points.at(seen(one, points)) for one in changes]
    largest = max(np.abs(one).max() for one in moved)
    if largest == 0.0:
        return Data()
    step = STEP * (max(np.abs(one).max() for one in given) or 1.0) / largest
    data = _FORMULAS[datum.part](state)
    original = getattr(state.discrete.law.material, datum.part)
    if datum.part != "hill":
        original = original.at(points.at)
    found = Data()
    for k, weight in STENCIL.items():
        shifted = [v + k * step * c for v, c in zip(given, moved, strict=True)]
        part = copy(original)
        moved_value = tuple(shifted) if several else shifted[0]
        vars(part).update(datum.changed(part, moved_value))
        found += weight / step * data(part)
    return found


def _by_resistance(state: State, other: Resistance, more: Data) -> Data:
    """beta(g) and its integral at the g of the solution, by other data."""
    gained = state.at.gained
    return more + Data(radius=other.bound(gained), hardened=other.energy(gained))


def _of_law(state: State) -> Callable[[object], Data]:
    """The data at the points by the law of hardening."""
    problem = state.discrete.problem
    points = state.discrete.points
    material = problem.material
    follows = follows_law(material, problem.mesh)
    alpha_1 = points.at(problem.alpha_0[0])
    used = state.discrete.law.material
    hardened = 1 + points.at(as_scalar(used.hardening_modulus)) * alpha_1
    resistance = state.discrete.law.resistance

    def data(law: object) -> Data:
        """The data by another hardening law."""
        beta = PEEQ * (law.stress(resistance.accumulated) - law.stress(0.0))
        if follows:
            beta = beta + PEEQ * law.stress(0.0) * hardened
        return _by_resistance(state, resistance.with_law(law), Data(beta=beta))

    return data


def _of_rate(state: State) -> Callable[[object], Data]:
    """The data at the points by the law of the rate."""
    resistance = state.discrete.law.resistance
    return lambda rate: _by_resistance(state, resistance.with_rate(rate), Data())


def _of_hill(state: State) -> Callable[[object], Data]:
    """Hill's form by its coefficients."""
    points = state.discrete.points
    basis = points.kinematics.basis

    def at_points(value: object) -> np.ndarray:
        """Values of a datum at the points."""
        return value if isinstance(value, np.ndarray) else points.at(value)

    return lambda hill: Data(form=hill.form(basis, at_points))


_FORMULAS = {"law": _of_law, "rate": _of_rate, "hill": _of_hill}
"""Name of a part -> data at the points as a function of the part, at a state."""


def _overlay_changes(
    state: State, name: str, datum: PartDatum, changes: list[object]
) -> Data:
    """The changes of shares and of bounds w_k k_k; the sum of all shares stays one."""
    overlay = state.discrete.problem.material.overlay
    points = state.discrete.points
    places = range(len(changes)) if datum.entry is None else [datum.entry]
    found = Data()
    change_of_rest = 0.0
    for place, change in zip(places, changes, strict=True):
        change = points.at(change)
        if datum.field == "bounds":
            found[f"beta {place}"] = overlay.shares[place] * change
            continue
        found[f"share {place}"] = change
        found[f"beta {place}"] = overlay.bounds[place] * change
        change_of_rest = change_of_rest - change
    if overlay.elastic_share:
        rest = change_of_rest + points.at(0.0)
        return found + Data({f"share {len(overlay.shares)}": rest})
    if np.any(change_of_rest):
        raise ValueError(
            f"parameters={name!r}: the shares have the sum 1, a change with the sum 0 is needed, "
            'Direction("overlay.shares", (1.0, -1.0)) for example'
        )
    return found
