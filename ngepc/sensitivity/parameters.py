"""What derivatives are taken with respect to: directions in which the data of a problem change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.checks.declared import Declared, Text
from ngepc.checks.kinds import require_instance, require_mapping, require_text
from ngepc.discretisation.conditions import ContactConditions, at_rows
from ngepc.discretisation.loads import Supports, applied_forces
from ngepc.discretisation.rows import contact_rows
from ngepc.evolution.load_path import scaled
from ngepc.local.system import State
from ngepc.model.contact import Coulomb
from ngepc.model.given import Given
from ngepc.model.material import Material, split_hardening
from ngepc.model.places import places
from ngepc.model.problem import Problem
from ngepc.sensitivity.radial import Data
from ngepc.sensitivity.shape import shape_data


@dataclass(frozen=True, eq=False)
class Direction(Declared):
    """A change of one datum of a problem; derivatives are per unit of it.

    Parameters
    ----------
    datum
        A material constant such as "lame_mu", or "traction", "pressure", "body_force", "gap",
        "prescribed", "friction" (the bound, or Coulomb's coefficient), "initial_plastic_strain".
        After a colon one boundary: "traction:left", "prescribed:top".  "shape" moves the vertices
        by ``change``, a vector, while nobody else uses the mesh.
    change
        What is added to the datum per unit, of the form that ``Problem`` or ``Material`` takes it:
        ``mesh.MaterialCF({"core": 1.0})`` for the constant of one region.  None for the natural
        one: 1 for a material constant or friction that is a number and for a gap, which moves as a
        whole; the datum itself for all others, so that the derivative is with respect to a factor.
    """

    datum: Text
    change: object = None

    @property
    def inherited(self) -> bool:
        """Whether later steps of a history take the datum from the step before."""
        return self.datum.startswith("initial")


MATERIAL = tuple(field.name for field in fields(Material) if field.name != "law")
"""Names of the material constants."""

BY_BOUNDARY = ("traction", "pressure", "gap", "prescribed")
"""Data that a colon and the name of a boundary may follow."""

Parameters = str | Sequence[str] | Mapping[str, Direction]
"""Names of data with their natural change, or name of the answer -> ``Direction``."""


def directions(parameters: Parameters) -> dict[str, Direction]:
    """Name -> direction.

    TypeError, ValueError if a parameter is neither a known name nor a Direction.
    """
    if isinstance(parameters, str):
        parameters = [parameters]
    if isinstance(parameters, list | tuple) and parameters:
        parameters = {name: Direction(require_text("parameters", name)) for name in parameters}
    require_mapping("parameters", parameters, "names of data, or name -> Direction")
    legal = [*MATERIAL, *_CHANGES]
    for name, direction in parameters.items():
        require_instance(f"parameters[{name!r}]", direction, Direction, "a Direction")
        datum, _, boundary = direction.datum.partition(":")
        if datum not in legal:
            needed = f"one of {', '.join(legal)} is needed"
            raise ValueError(f"parameters={direction.datum!r}: {needed}")
        if boundary and datum not in BY_BOUNDARY:
            raise ValueError(f"parameters={direction.datum!r}: only {datum!r} has a derivative")
    return dict(parameters)


def changed_data(state: State, direction: Direction) -> Data:
    """The change of the data of a discrete problem per unit of a direction.

    ValueError if the problem has no such datum.
    """
    problem, at = state.discrete.problem, state.discrete.points.at
    datum, _, boundary = direction.datum.partition(":")
    change = _natural(problem, datum) if direction.change is None else direction.change
    if datum in MATERIAL:
        slopes, amount = by_material(problem)[datum], at(change)
        return Data({name: at(slope) * amount for name, slope in slopes.items()})
    if datum in BY_BOUNDARY:
        change = _by_boundary(problem, datum, boundary, change)
    return _CHANGES[datum](state, change)


def by_material(problem: Problem) -> dict[str, dict[str, Coefficient]]:
    """Material constant -> derivatives of 2 mu_2, h, beta, ... with respect to it."""
    m, (alpha_1, _) = problem.material, split_hardening(problem.initial_hardening)
    H, k_1, sigma_y = m.hardening_modulus, m.hardening_stiffness, m.yield_stress
    alpha_1 = 0.0 if alpha_1 is None else alpha_1
    by_H, by_sigma_y = 2 * H * sigma_y * sigma_y * k_1, 2 * H * H * sigma_y * k_1
    return {
        "lame_lambda": {"bulk": 1.0},
        "lame_mu": {"two_mu": 2.0, "bulk": 2.0 / problem.kinematics.size},
        "yield_stress": {"hardening": by_sigma_y, "beta": 1 + H * alpha_1, "isotropic": k_1 * H},
        "hardening": {"hardening": 1.0, "kinematic": 1.0},
        "hardening_modulus": {
            "hardening": by_H,
            "beta": sigma_y * alpha_1,
            "isotropic": k_1 * sigma_y,
        },
        "hardening_stiffness": {"hardening": H * H * sigma_y * sigma_y, "isotropic": H * sigma_y},
    }


def _natural(problem: Problem, datum: str) -> object:
    """The change that is taken if none is given."""
    given = getattr(problem.material if datum in MATERIAL else problem, datum, None)
    if datum == "gap":
        return 1.0
    if isinstance(given, Coulomb):
        given = given.coefficient
    if datum != "shape" and (given is None or given == {}):
        raise ValueError(f"parameters={datum!r}: the problem has none")
    return 1.0 if is_number(given) else given


def _by_boundary(problem: Problem, datum: str, boundary: str, change: object) -> dict:
    """Single boundary -> change, of the boundary that a parameter names or of all."""
    if not isinstance(change, Mapping):
        change = dict.fromkeys(problem.contact_names, change)
    single = {p: v for key, v in change.items() for p in places(datum, key, problem.mesh)}
    if not single:
        raise ValueError(f"parameters={datum!r}: the problem has none")
    if boundary and boundary not in single:
        legal = ", ".join(sorted(map(str, single)))
        raise ValueError(f"parameters='{datum}:{boundary}': one of {legal} is needed")
    return {boundary: single[boundary]} if boundary else single


def _load(name: str, state: State, change: object) -> Data:
    """The forces of a load alone, in which they are linear."""
    problem = state.discrete.problem
    alone = Given(problem.mesh, problem.material, kinematics=problem.kinematics, **{name: change})
    return Data(load=applied_forces(alone, state.discrete.supports.space))


def _gap(state: State, change: dict) -> Data:
    discrete, problem = state.discrete, state.discrete.problem
    gaps, part = np.zeros(len(discrete.rows)), discrete.contact.on_obstacles
    moved = dict.fromkeys(problem.contact_names, 0.0) | change
    if all(is_number(value) and value == 1 for value in moved.values()):
        gaps[part] = 1.0
    else:
        gaps[part] = contact_rows(replace(problem, gap=moved), discrete.supports).gaps
    return Data(gaps=gaps)


def _prescribed(state: State, change: dict) -> Data:
    discrete, problem = state.discrete, state.discrete.problem
    other = replace(problem, prescribed=scaled(problem.single("prescribed"), 0.0) | change)
    supports, gaps = Supports(other), np.zeros(len(discrete.rows))
    part = discrete.contact.roller_part
    gaps[part] = ContactConditions(other, supports).rows.gaps[part]
    return Data(values=supports.values, gaps=gaps)


def _friction(state: State, change: Coefficient) -> Data:
    law, rows = state.discrete.problem.friction, state.discrete.rows
    if law is None:
        raise ValueError("parameters='friction': the problem has none")
    values = at_rows(state.discrete.problem, rows, change)
    if isinstance(law, Coulomb):
        return Data(coefficient=values)
    return Data(cap=rows.weights * values)


def _initial_strain(state: State, change: CoefficientFunction) -> Data:
    points = state.discrete.points
    return Data(initial=points.at(points.kinematics.coordinates(change)))


_CHANGES: dict[str, Callable[[State, object], Data]] = {
    "traction": partial(_load, "traction"),
    "pressure": partial(_load, "pressure"),
    "body_force": partial(_load, "body_force"),
    "gap": _gap,
    "prescribed": _prescribed,
    "friction": _friction,
    "initial_plastic_strain": _initial_strain,
    "shape": shape_data,
}
