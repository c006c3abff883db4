"""What derivatives are taken with respect to: directions in which the data of a problem change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from ngsolve import CF

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.checks.kinds import require_instance, require_text
from ngepc.discretisation.conditions import ContactConditions, at_rows
from ngepc.discretisation.loads import Supports, applied_forces
from ngepc.discretisation.rows import contact_rows
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.contact import Coulomb
from ngepc.model.given import Given
from ngepc.model.places import Roller
from ngepc.sensitivity.radial import Data
from ngepc.sensitivity.shape import MovingBody, vertex_motion


@dataclass(frozen=True, eq=False)
class Direction:
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

    datum: str
    change: object = None

    def __post_init__(self) -> None:
        require_text("datum", self.datum)

    @property
    def inherited(self) -> bool:
        """Whether later steps of a history take the datum from the step before."""
        return self.datum.startswith("initial")


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
    if not isinstance(parameters, Mapping):
        if not isinstance(parameters, list | tuple) or not parameters:
            raise TypeError(f"parameters={parameters!r}: names of data are needed")
        for number, name in enumerate(parameters):
            require_text(f"parameters[{number}]", name)
        parameters = {name: Direction(name) for name in parameters}
    for name, direction in parameters.items():
        require_instance(f"parameters[{name!r}]", direction, Direction, "a Direction")
        datum, _, boundary = direction.datum.partition(":")
        legal = [*MATERIAL, *_CHANGES, "shape"]
        if datum not in legal:
            needed = ", ".join(legal)
            raise ValueError(f"parameters={direction.datum!r}: one of {needed} is needed")
        if boundary and datum not in BY_BOUNDARY:
            raise ValueError(f"parameters={direction.datum!r}: only {datum!r} has a derivative")
    return dict(parameters)


def changed_data(constants: Constants, direction: Direction) -> Data:
    """The change of the data of a discrete problem per unit of a direction.

    ValueError if the problem has no such datum.
    """
    datum, _, boundary = direction.datum.partition(":")
    if datum == "shape":
        motion = vertex_motion(constants.discrete.problem, direction.change)
        return MovingBody(constants.state, motion).data()
    if datum in MATERIAL:
        value = getattr(constants.discrete.problem.material, datum)
        change = _natural(value) if direction.change is None else direction.change
        amount = constants.discrete.points.at(change)
        return {key: slope * amount for key, slope in MATERIAL[datum](constants).items()}
    return _CHANGES[datum](constants.discrete, boundary, direction.change)


class Constants:
    """The material constants of a state at its points, by the letters of section 2.

    ``growth`` is k_1 H sigma_y, by which alpha_1 grows with |p|, ``memory`` d beta / d alpha_1,0.
    """

    def __init__(self, state: State) -> None:
        self.state, self.discrete = state, state.discrete
        material, at = self.discrete.problem.material, self.discrete.points.at
        self.size = self.discrete.points.kinematics.size
        self.sigma_y, self.k = at(material.yield_stress), at(material.hardening)
        self.H, self.k_1 = at(material.hardening_modulus), at(material.hardening_stiffness)
        self.alpha_1 = at(self.discrete.problem.alpha_0[0])
        self.growth, self.memory = self.k_1 * self.H * self.sigma_y, self.sigma_y * self.H


def _natural(value: Coefficient) -> Coefficient:
    """The change of a constant that is taken if none is given: 1, or the coefficient itself."""
    return 1.0 if is_number(value) else value


MATERIAL: dict[str, Callable[[Constants], dict]] = {
    "lame_lambda": lambda c: {"bulk": 1.0},
    "lame_mu": lambda c: {"two_mu": 2.0, "bulk": 2.0 / c.size},
    "yield_stress": lambda c: {
        "hardening": 2 * c.H**2 * c.sigma_y * c.k_1,
        "beta": 1 + c.H * c.alpha_1,
        "isotropic": c.k_1 * c.H,
    },
    "hardening": lambda c: {"hardening": 1.0, "kinematic": 1.0},
    "hardening_modulus": lambda c: {
        "hardening": 2 * c.H * c.sigma_y**2 * c.k_1,
        "beta": c.sigma_y * c.alpha_1,
        "isotropic": c.k_1 * c.sigma_y,
    },
    "hardening_stiffness": lambda c: {
        "hardening": (c.H * c.sigma_y) ** 2,
        "isotropic": c.H * c.sigma_y,
    },
}
"""Material constant -> derivatives of h, beta, ... of ``Material`` with respect to it."""


def _of_boundary(name: str, given: Mapping | None, boundary: str) -> Mapping:
    """The part of a mapping of single boundaries that a parameter names, all of it by default."""
    if not given:
        raise ValueError(f"parameters={name!r}: the problem has none")
    if boundary and boundary not in given:
        legal = ", ".join(sorted(map(str, given)))
        raise ValueError(f"parameters='{name}:{boundary}': one of {legal} is needed")
    return {boundary: given[boundary]} if boundary else given


def _load(name: str, discrete: DiscreteProblem, boundary: str, change: object) -> Data:
    """The forces of a load alone, in which they are linear."""
    problem = discrete.problem
    given = getattr(problem, name) if change is None else change
    alone = Given(problem.mesh, problem.material, kinematics=problem.kinematics, **{name: given})
    if name != "body_force":
        alone = replace(alone, **{name: _of_boundary(name, alone.single(name), boundary)})
    elif given is None:
        raise ValueError("parameters='body_force': the problem has none")
    return {"load": applied_forces(alone, discrete.supports.space)}


def _gap(discrete: DiscreteProblem, boundary: str, change: object) -> Data:
    problem, gaps = discrete.problem, np.zeros(len(discrete.rows))
    part, still = discrete.contact.on_obstacles, dict.fromkeys(discrete.problem.contact_names, 0.0)
    if not isinstance(change, Mapping):
        change = dict.fromkeys(still, 1.0 if change is None else change)
    moved = still | dict(_of_boundary("gap", change, boundary))
    if all(is_number(value) and value == 1 for value in moved.values()):
        gaps[part] = 1.0
    else:
        gaps[part] = contact_rows(replace(problem, gap=moved), discrete.supports).gaps
    return {"gaps": gaps}


def _prescribed(discrete: DiscreteProblem, boundary: str, change: Mapping | None) -> Data:
    problem = discrete.problem
    moved = _of_boundary("prescribed", problem.prescribed if change is None else change, boundary)
    given = {name: _at_rest(one) for name, one in (problem.prescribed or {}).items()}
    other = replace(problem, prescribed=given | dict(moved))
    supports, gaps = Supports(other), np.zeros(len(discrete.rows))
    part = discrete.contact.roller_part
    gaps[part] = ContactConditions(other, supports).rows.gaps[part]
    return {"values": supports.values, "gaps": gaps}


def _at_rest(given: Roller | Sequence) -> Roller | tuple:
    if isinstance(given, Roller):
        return replace(given, value=0.0)
    return tuple(None if component is None else 0.0 for component in given)


def _friction(discrete: DiscreteProblem, boundary: str, change: Coefficient | None) -> Data:
    law, rows = discrete.problem.friction, discrete.rows
    if law is None:
        raise ValueError("parameters='friction': the problem has none")
    given = law.coefficient if isinstance(law, Coulomb) else law
    values = at_rows(discrete.problem, rows, _natural(given) if change is None else change)
    if isinstance(law, Coulomb):
        return {"coefficient": values}
    return {"cap": rows.weights * values}


def _initial_strain(discrete: DiscreteProblem, boundary: str, change: CF | None) -> Data:
    if change is None:
        if discrete.problem.initial_plastic_strain is None:
            raise ValueError("parameters='initial_plastic_strain': the problem has none")
        return {"initial": discrete.law.initial}
    points = discrete.points
    return {"initial": points.at(points.kinematics.coordinates(change))}


_CHANGES: dict[str, Callable[[DiscreteProblem, str, object], Data]] = {
    "traction": partial(_load, "traction"),
    "pressure": partial(_load, "pressure"),
    "body_force": partial(_load, "body_force"),
    "gap": _gap,
    "prescribed": _prescribed,
    "friction": _friction,
    "initial_plastic_strain": _initial_strain,
}
