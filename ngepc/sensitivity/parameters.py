"""What derivatives are taken with respect to: directions in which the data of a problem change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import CF

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.checks.kinds import require_instance, require_text
from ngepc.discretisation.conditions import ContactConditions, at_rows
from ngepc.discretisation.loads import Supports, forces_of
from ngepc.discretisation.rows import contact_rows
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.contact import Coulomb
from ngepc.model.places import Roller, places
from ngepc.model.problem import as_scalar, as_vector
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


Parameters = str | Sequence[str] | Mapping[str, Direction]
"""Names of data with their natural change, or name of the answer -> ``Direction``."""


def directions(parameters: Parameters) -> dict[str, Direction]:
    """Name -> direction.

    Raises
    ------
    TypeError, ValueError
        If a parameter is neither a known name nor a Direction.
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
        datum = direction.datum.partition(":")[0]
        if datum not in (*MATERIAL, *_CHANGES, "shape"):
            legal = ", ".join([*MATERIAL, *_CHANGES, "shape"])
            raise ValueError(f"parameters={direction.datum!r}: one of {legal} is needed")
    return dict(parameters)


def changed_data(constants: Constants, direction: Direction) -> Data:
    """The change of the data of a discrete problem per unit of a direction.

    Raises
    ------
    ValueError
        If the problem has no such datum.
    """
    datum, _, boundary = direction.datum.partition(":")
    if datum == "shape":
        motion = vertex_motion(constants.discrete.problem, direction.change)
        return MovingBody(constants.state, motion).data()
    if datum in MATERIAL:
        return _material(constants, datum, direction.change)
    return _CHANGES[datum](constants.discrete, boundary, direction.change)


class Constants:
    """The material constants of a state at its points, by the letters of section 2."""

    def __init__(self, state: State) -> None:
        self.state, discrete = state, state.discrete
        material, at = discrete.problem.material, discrete.points.at
        self.discrete, self.size = discrete, discrete.points.kinematics.size
        self.sigma_y, self.k = at(material.yield_stress), at(material.hardening)
        self.H, self.k_1 = at(material.hardening_modulus), at(material.hardening_stiffness)
        self.alpha_1 = at(discrete.problem.alpha_0[0])

    @property
    def growth(self) -> np.ndarray:
        """k_1 H sigma_y, by which alpha_1 grows with |p|."""
        return self.k_1 * self.H * self.sigma_y

    @property
    def memory(self) -> np.ndarray:
        """d beta / d alpha_1,0."""
        return self.sigma_y * self.H


def _material(constants: Constants, name: str, change: Coefficient | None) -> Data:
    value = getattr(constants.discrete.problem.material, name)
    if change is None:
        change = 1.0 if is_number(value) else value
    amount = constants.discrete.points.at(change)
    return {key: slope * amount for key, slope in MATERIAL[name](constants).items()}


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
    if not boundary:
        return given
    if boundary not in given:
        raise ValueError(
            f"parameters='{name}:{boundary}': one of {', '.join(sorted(map(str, given)))} is needed"
        )
    return {boundary: given[boundary]}


def _traction(discrete: DiscreteProblem, boundary: str, change: Mapping | None) -> Data:
    given = discrete.problem.single("traction") if change is None else _by_place(discrete, change)
    loads = {p: as_vector(g) for p, g in _of_boundary("traction", given, boundary).items()}
    return {"load": forces_of(discrete.problem, discrete.supports.space, loads, None)}


def _pressure(discrete: DiscreteProblem, boundary: str, change: Mapping | None) -> Data:
    problem = discrete.problem
    given = problem.single("pressure") if change is None else _by_place(discrete, change)
    chosen = _of_boundary("pressure", given, boundary)
    loads = {name: -as_scalar(p) * problem.normal for name, p in chosen.items()}
    return {"load": forces_of(problem, discrete.supports.space, loads, None)}


def _by_place(discrete: DiscreteProblem, change: Mapping) -> dict:
    mesh = discrete.problem.mesh
    return {p: g for key, g in change.items() for p in places("parameters", key, mesh)}


def _body_force(discrete: DiscreteProblem, boundary: str, change: object) -> Data:
    f = discrete.problem.f if change is None else as_vector(change)
    if f is None:
        raise ValueError("parameters='body_force': the problem has none")
    return {"load": forces_of(discrete.problem, discrete.supports.space, {}, f)}


def _gap(discrete: DiscreteProblem, boundary: str, change: object) -> Data:
    problem, gaps = discrete.problem, np.zeros(len(discrete.rows))
    names, part = problem.contact_names, discrete.contact.on_obstacles
    if change is None and not boundary:
        _of_boundary("gap", dict.fromkeys(names), "")
        gaps[part] = 1.0
        return {"gaps": gaps}
    if not isinstance(change, Mapping):
        change = dict.fromkeys(names, 1.0 if change is None else change)
    change = dict.fromkeys(names, 0.0) | dict(_of_boundary("gap", change, boundary))
    gaps[part] = contact_rows(replace(problem, gap=change), discrete.supports).gaps
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
    if change is None:
        change = 1.0 if is_number(given) else given
    values = at_rows(discrete.problem, rows, change)
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
    "traction": _traction,
    "pressure": _pressure,
    "body_force": _body_force,
    "gap": _gap,
    "prescribed": _prescribed,
    "friction": _friction,
    "initial_plastic_strain": _initial_strain,
}
