"""Sliders of a laboratory: the number that each one changes, and the changed problem."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from ngepc.checks.arguments import is_number, require_number, sample
from ngepc.checks.sentences import in_words
from ngepc.evolution.load_path import scaled
from ngepc.model.data import moved_gap
from ngepc.model.material import Material
from ngepc.model.places import Roller, values_at
from ngepc.model.problem import Problem

POSITIONS = 200  # of a slider whose range has no step
LOADS = ("traction", "pressure", "body_force", "prescribed")

Change = Callable[..., Problem]
"""Called as change(problem, name=value, ...) with the values of the user's sliders."""


@dataclass(frozen=True)
class Slider:
    """A number of a problem, its range and its initial value."""

    name: str
    least: float
    most: float
    step: float
    value: float

    @classmethod
    def of(
        cls, problem: Problem, name: str, given: tuple, change: Change | None
    ) -> Slider:
        """The slider of a name and (least, most[, step]), at the value of the problem."""
        needed = "(least, most) or (least, most, step) with least < most is needed"
        if not isinstance(given, tuple | list) or len(given) not in (2, 3):
            raise TypeError(f"{name}={in_words(given)}: {needed}")
        numbers = [require_number(f"{name}[{i}]", n) for i, n in enumerate(given)]
        least, most, *rest = numbers
        if not least < most or any(step <= 0 for step in rest):
            raise ValueError(f"{name}={in_words(given)}: {needed}")
        step = rest[0] if rest else round_step((most - least) / POSITIONS)
        value = current(problem, name, change is not None)
        value = 0.5 * (least + most) if value is None else value
        return cls(name, least, most, step, min(max(value, least), most))


def round_step(size: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above ``size``."""
    power = 10.0 ** math.floor(math.log10(size))
    return max(n * power for n in (1, 2, 5) if n * power <= size * (1 + 1e-12))


def current(problem: Problem, name: str, own: bool) -> float | None:
    """The present number of a slider called ``name``; None for a slider of the user."""
    if name == "load":
        size = load_size(problem)
        if not size:
            raise ValueError(f"load: the problem has none of {', '.join(LOADS)}")
        return size
    if name == "obstacle":
        if not problem.contact_names:
            raise ValueError("obstacle: the problem has no rigid obstacle")
        return 0.0
    numbers = numbers_of(problem)
    if name in numbers:
        return numbers[name]
    if own:
        return None
    legal = ["load", "obstacle", *numbers]
    raise ValueError(
        f"{name}=...: the sliders of this problem are {', '.join(legal)}, and those that "
        "change= knows"
    )


def field_names(owner: object) -> list[str]:
    """Names of the fields of a dataclass."""
    return [f.name for f in fields(owner)]


def numbers_of(problem: Problem) -> dict[str, float]:
    """Numbers of a problem and its material by their names; a data sheet's before the others."""
    sheet = sheet_numbers(problem.material)
    numbers = number_fields(problem) | sheet | number_fields(problem.material) | sheet
    return {name: value for name, value in numbers.items() if name != "order"}


def number_fields(owner: object) -> dict[str, float]:
    """The fields of a dataclass that are numbers."""
    values = {name: getattr(owner, name) for name in field_names(owner)}
    return {name: float(value) for name, value in values.items() if is_number(value)}


def sheet_numbers(material: Material) -> dict[str, float]:
    """The numbers of a tensile test that ``Material.metal`` was given; none with a curve."""
    given = material.data_sheet
    if "curve" in given:
        return {}
    return {name: float(value) for name, value in given.items() if is_number(value)}


def material_with(material: Material, numbers: Mapping[str, float]) -> Material:
    """A material with other numbers: those of its data sheet first, then its fields."""
    sheet = {n: v for n, v in numbers.items() if n in sheet_numbers(material)}
    others = {n: v for n, v in numbers.items() if n not in sheet}
    if sheet:
        material = Material.metal(**{**material.data_sheet, **sheet})
    return replace(material, **others) if others else material


def load_size(problem: Problem) -> float:
    """The size of the largest load: on boundaries, edges and points, else in the body, else u."""
    mesh = problem.mesh
    tractions = [values_at(g, mesh, place)[1] for place, g in problem.loads.items()]
    body_forces = [] if problem.f is None else [sample(problem.f, mesh)]
    moves = [sample(v, mesh) for v in prescribed_values(problem)]
    for kind in (tractions, body_forces, moves):
        sizes = [np.linalg.norm(values, axis=1).max() for values in kind]
        if sizes and max(sizes) > 0:
            return float(f"{max(sizes):.12g}")
    return 0.0


def prescribed_values(problem: Problem) -> list:
    """All prescribed components of displacements, and those along directions."""
    given = problem.single("prescribed").values()
    along = [roller.value for roller in given if isinstance(roller, Roller)]
    others = [components for components in given if not isinstance(components, Roller)]
    return along + [v for components in others for v in components if v is not None]


def loads(problem: Problem) -> list[str]:
    """The arguments that are loads; supports that do not move are none."""
    moving = any(not is_number(v) or v != 0 for v in prescribed_values(problem))
    kinds = [n for n in LOADS if getattr(problem, n) is not None]
    return kinds if moving else [n for n in kinds if n != "prescribed"]


def changed(
    problem: Problem, values: Mapping[str, float], change: Change | None
) -> Problem:
    """The problem with the values of the sliders."""
    at_start = {n: current(problem, n, change is not None) for n in values}
    own = {n: v for n, v in values.items() if at_start[n] is None}
    changes: dict[str, object] = {}
    material: dict[str, float] = {}
    for name, value in values.items():
        if name in own or value == at_start[name]:
            continue
        if name == "load":
            factor = value / at_start[name]
            changes |= {n: scaled(getattr(problem, n), factor) for n in loads(problem)}
        elif name in field_names(problem):
            changes[name] = value
        elif name != "obstacle":
            material[name] = value
    if values.get("obstacle"):
        gap = changes.get("gap", problem.gap)
        changes["gap"] = moved_gap(gap, values["obstacle"])
    if material:
        changes["material"] = material_with(problem.material, material)
    moved = problem.changed(**changes) if changes else problem
    return change(moved, **own) if own else moved
