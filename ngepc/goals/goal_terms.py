"""Goals of guaranteed intervals, as loads, contact facets and motions of supports.

A goal Q is linear in the solution: the work l(u) of a load, the resultant of c P with a number c on
each contact facet, or a reaction, which is minus the work of all forces in a motion of a support.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from ngsolve import BND, CF, L2, VOL, CoefficientFunction, GridFunction, Integrate, Mesh

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.data import BoundData
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.checks.arguments import (
    boundary_names,
    require_component,
    require_components,
    require_vector,
)
from ngepc.checks.declared import Component, Declared, Text
from ngepc.checks.kinds import require_mapping, require_text
from ngepc.checks.sentences import in_words
from ngepc.discretisation.loads import applied_forces
from ngepc.goals.roller_motion import motion_of_support
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.data import Vector
from ngepc.model.elements import elements_by_shape, vertex_coordinates
from ngepc.model.problem import Problem

NAMES = ("contact_force", "work")
"""Goals with a name: the resultant of the contact pressure, the work of the problem's loads."""

LEGAL = (
    "'contact_force', 'work', ContactForceOn(...), MeanDisplacement(...), DisplacementAt(...), "
    "LoadWork(...) or Reaction(...)"
)
"""All goals, as messages have them."""

MEETING = (
    "Where supports meet, the force at a vertex is shared equally, so that their reactions mix in "
    "the elements there."
)
"""What a reaction is if other supports hold vertices of its support."""


@dataclass(frozen=True)
class ContactForceOn(Declared):
    """The integral of the contact pressure on some contact boundaries (force).

    Parameters
    ----------
    boundary
        Name of a contact boundary, or a pattern of several.  Of two bodies: the boundary of either.
    """

    boundary: Text


@dataclass(frozen=True)
class MeanDisplacement(Declared):
    """The mean of one component of the displacement over a boundary (length).

    Parameters
    ----------
    boundary
        Name of the boundary, which is not clamped.
    component
        0, 1 or 2.
    """

    boundary: Text
    component: Component


def require_vector_data(name: str, value: object) -> None:
    """Accept a vector of two or three components, numbers or coefficients."""
    size = value.dim if isinstance(value, CoefficientFunction) else 0
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        size = len(value)
    if size not in (2, 3):
        raise TypeError(
            f"{name}={in_words(value)}: a vector of 2 or 3 components is needed"
        )
    require_components(name, value, size)


@dataclass(frozen=True)
class LoadWork:
    """The work that a load would do, int g . u + int f . u (force times length).

    Parameters
    ----------
    traction, body_force
        g and f, as those of a ``Problem``, constant on elements or with g affine; at least one.
    """

    traction: Mapping[str, Vector] | None = None
    body_force: Vector | None = None

    def __post_init__(self) -> None:
        if self.traction is not None:
            require_mapping(
                "traction", self.traction, "boundary name -> force per area"
            )
            for name, force in self.traction.items():
                require_text("traction", name)
                require_vector_data(f"traction[{name!r}]", force)
        if self.body_force is not None:
            require_vector_data("body_force", self.body_force)
        elif not self.traction:
            raise ValueError(
                f"traction={self.traction!r}, body_force=None: LoadWork needs one of them; the "
                "work of the loads of the problem is goal='work'"
            )


@dataclass(frozen=True)
class MeanAround:
    """The mean of one component of the displacement over the element of a mesh with a point.

    Parameters
    ----------
    point, component
        As of ``DisplacementAt``.
    mesh
        That of the result, whose elements may be cut for a bound.
    """

    point: Sequence[float]
    component: int
    mesh: Mesh

    @classmethod
    def of(cls, goal: object, mesh: Mesh) -> object:
        """A goal that has a point, over the elements of this mesh; other goals as they are."""
        return cls(goal.point, goal.component, mesh) if hasattr(goal, "point") else goal


@dataclass(frozen=True, eq=False)
class GoalTerms:
    """A goal on one mesh.

    Parameters
    ----------
    name
        For messages and pictures.
    load
        A problem whose tractions and body force are the load of the goal, for its own loads the
        problem itself; None if there is none.
    factor
        c on each contact facet.
    motion
        Minus the unit motion of the support of a reaction, (nodes, N); None if there is none.
    note
        What was replaced to make the goal continuous; may be empty.
    is_mean
        Whether it is a mean displacement, which has the same value for every thickness; other goals
        are forces and works, which are those of the whole thickness.
    lower
        The same goal for ``BoundData.lower``; None if that is None.
    """

    name: str
    load: Problem | None
    factor: np.ndarray = field(repr=False)
    motion: np.ndarray | None = field(repr=False)
    note: str = ""
    lower: GoalTerms | None = None
    is_mean: bool = False

    @property
    def is_contact_force(self) -> bool:
        """Whether it is the resultant of contact pressures, none of which are negative."""
        return self.load is None and self.motion is None

    def forces(self, discrete: DiscreteProblem) -> np.ndarray:
        """Nodal forces of the load, (nodes, N)."""
        if self.load is None:
            return np.zeros_like(discrete.load)
        if self.load is discrete.problem:
            return discrete.load
        return applied_forces(self.load, discrete.supports.scalar)

    def carried(self, bound_data: BoundData) -> tuple[np.ndarray, CarriedLoads]:
        """Facet moments of the load's tractions, and its body forces.

        ValueError for loads that stresses do not carry exactly.
        """
        if self.load is None:
            none = np.zeros_like(bound_data.boundary.moments)
            return none, CarriedLoads.none(bound_data.cells)
        if self.load is bound_data.problem:
            return bound_data.boundary.moments, bound_data.carried
        boundary = Boundary(self.load, bound_data.cells)
        carried = CarriedLoads(boundary)
        if carried.left.any():
            raise ValueError(
                f"goal={self.name}: its load varies inside elements; a goal needs a body "
                "force that is constant on elements and affine tractions"
            )
        return boundary.moments, carried

    def value(self, bound_data: BoundData, state: State) -> float:
        """The goal of a discrete state."""
        value = self.work(state)
        if not self.factor.any():
            return value
        forces = np.maximum(state.multipliers, 0.0)
        if (self.factor == 1).all():
            return value + float(forces.sum())
        return value + float(self.factor @ bound_data.contact.resultants(forces))

    def work(self, state: State) -> float:
        """The work of the load, less that of all forces in the motion of the support."""
        value = float(np.vdot(self.forces(state.discrete), state.u))
        if self.motion is not None:
            value -= float(np.vdot(self.motion, state.residual_force))
        return value


def goal_of_result(goal: object, result: ExactResult) -> float:
    """The goal of a result, also on quadrilaterals and hexahedra, as its own numbers say it."""
    problem = result.problem
    if isinstance(goal, ContactForceOn):
        return _force_on(goal.boundary, result)
    terms = _without_facets(goal, problem, np.zeros(1))
    return result.contact_force if terms.factor.any() else terms.work(result.state)


def _force_on(boundary: str, result: ExactResult) -> float:
    """The normal force on contact boundaries with obstacles, or on one of two bodies."""
    contact = result.state.body.contact
    forces = contact.of_obstacles(result.state.contact)
    names = boundary.split("|")
    if set(names) <= forces.keys():
        return sum(contact.normal(forces[name]).sum() for name in names)
    mesh = result.problem.mesh
    region = mesh.Boundaries(boundary)
    return Integrate(result.contact_pressure, mesh, BND, definedon=region)


def terms_of(goal: object, bound_data: BoundData) -> GoalTerms:
    """A goal on the mesh of some ``BoundData``.

    ``goal`` is a name of ``NAMES``, one of the classes here, or has ``point`` and ``component``
    (``DisplacementAt``), ``support`` and ``component`` (``Reaction``).

    TypeError, ValueError for goals that are not legal or not covered.
    """
    if isinstance(goal, GoalTerms):
        return goal
    terms = replace(_terms_of(goal, bound_data), is_mean=is_mean(goal))
    if bound_data.lower is None:
        return terms
    return replace(terms, lower=_terms_of(goal, bound_data.lower))


def check_goal(goal: object, problem: Problem) -> None:
    """TypeError, ValueError for goals that are not legal, before anything is solved."""
    if isinstance(goal, ContactForceOn):
        names = boundary_names("boundary", goal.boundary, problem.mesh)
        _require_contact(goal, not touching_names(problem).isdisjoint(names))
        return
    touching = len(problem.contact_names) + len(problem.contact_pairs)
    _without_facets(goal, problem, np.zeros(touching))


def touching_names(problem: Problem) -> set[str]:
    """Names of the boundaries where obstacles are, and of those of pairs."""
    names = set(problem.contact_names)
    for pair in problem.contact_pairs:
        names.update(pair.first.split("|"), pair.second.split("|"))
    return names


def _require_contact(goal: ContactForceOn, is_there: bool) -> None:
    """ValueError for a boundary without contact."""
    if not is_there:
        raise ValueError(f"boundary={goal.boundary!r}: a contact boundary is needed")


def is_mean(goal: object) -> bool:
    """Whether a goal is a mean displacement: no force, no work."""
    if isinstance(goal, GoalTerms):
        return goal.is_mean
    return isinstance(goal, MeanDisplacement) or hasattr(goal, "point")


def _along(what: str, place: str, goal: Any) -> str:
    """The name of a component on a boundary: "reaction of left along x"."""
    return f"{what} of {place} along {'xyz'[goal.component]}"


def _terms_of(goal: object, bound_data: BoundData) -> GoalTerms:
    """The same without ``lower``."""
    problem = bound_data.problem
    if not isinstance(goal, ContactForceOn):
        zero = np.zeros(len(bound_data.contact.nodes))
        terms = _without_facets(goal, problem, zero)
        _check_outer(terms, bound_data)
        return terms
    names = boundary_names("boundary", goal.boundary, problem.mesh)
    on = bound_data.boundary.contact_of(names).astype(float)
    _require_contact(goal, on.any())
    return GoalTerms(f"contact force on {goal.boundary}", None, on, None)


def _check_outer(terms: GoalTerms, bound_data: BoundData) -> None:
    """ValueError if a traction of a goal acts on a line inside the body."""
    loaded = () if terms.load is None else terms.load.tractions
    for name in loaded:
        bound_data.boundary.on((name,), f"boundary={name!r} of the goal")


def _without_facets(goal: object, problem: Problem, zero: np.ndarray) -> GoalTerms:
    """The terms of a goal that concerns all contact facets, (facets,) like ``zero``, or none."""
    if isinstance(goal, str):
        return _named(goal, problem, zero)
    if isinstance(goal, MeanDisplacement):
        load = _loaded(problem, _mean_traction(goal, problem), None)
        return GoalTerms(
            _along("mean displacement", goal.boundary, goal), load, zero, None
        )
    if isinstance(goal, LoadWork):
        load = _loaded(problem, goal.traction, goal.body_force)
        return GoalTerms("work", load, zero, None)
    if hasattr(goal, "point") and hasattr(goal, "component"):
        return _displacement_at(goal, problem, zero)
    if hasattr(goal, "support") and hasattr(goal, "component"):
        return _reaction(goal, problem, zero)
    raise TypeError(f"goal={in_words(goal)}: {LEGAL} is needed")


def _named(goal: str, problem: Problem, zero: np.ndarray) -> GoalTerms:
    if goal not in NAMES:
        raise ValueError(f"goal={in_words(goal)}: {LEGAL} is needed")
    if goal == "work":
        return GoalTerms("work of the loads", problem, zero, None)
    if not len(zero):
        raise ValueError("contact=None: a contact force needs contact")
    return GoalTerms("contact force", None, zero + 1.0, None)


def _loaded(
    problem: Problem, traction: Mapping | None, body_force: Vector | None
) -> Problem:
    """A problem without history that carries only these loads."""
    traction = dict(traction) if traction else None
    return problem.changed(traction=traction, body_force=body_force, pressure=None)


def _mean_traction(goal: MeanDisplacement, problem: Problem) -> dict[str, tuple]:
    """The traction whose work is the mean."""
    names = boundary_names("boundary", goal.boundary, problem.mesh)
    component = require_component("component", goal.component, problem.N)
    clamped = sorted(set(names) & set(problem.clamped_names))
    if clamped:
        raise ValueError(
            f"boundary={goal.boundary!r}: {clamped[0]!r} is clamped and does not move"
        )
    region = problem.mesh.Boundaries("|".join(names))
    size = Integrate(CF(1), problem.mesh, BND, definedon=region)
    traction = [0.0] * problem.N
    traction[component] = 1 / size
    return {name: tuple(traction) for name in names}


def _displacement_at(goal: object, problem: Problem, zero: np.ndarray) -> GoalTerms:
    """The mean of a displacement over the element with a point."""
    mesh = getattr(goal, "mesh", problem.mesh)
    place = require_vector("point", goal.point, (problem.N,))
    component = require_component("component", goal.component, problem.N)
    if not mesh.Contains(*place):
        raise ValueError(f"point={in_words(goal.point)}: a point in the body is needed")
    around = cells_within(problem.mesh, mesh, mesh(*place).nr)
    patch = GridFunction(L2(problem.mesh, order=0))
    patch.vec.FV().NumPy()[around] = 1.0
    size = Integrate(patch, problem.mesh, VOL)
    patch.vec.FV().NumPy()[around] = 1 / size
    force = [CF(0.0)] * problem.N
    force[component] = patch
    load = _loaded(problem, None, CF(tuple(force)))
    note = f"The displacement is the mean over the element that contains {goal.point}."
    return GoalTerms("displacement", load, zero, None, note)


def cells_within(mesh: Mesh, other: Mesh, number: int) -> np.ndarray:
    """Numbers of the elements of a mesh that make up one element of another mesh."""
    if mesh is other:
        return np.array([number])
    found = []
    for numbers, vertices in elements_by_shape(mesh):
        centres = vertex_coordinates(mesh)[vertices].mean(axis=1)
        found.append(numbers[other(*centres.T)["nr"] == number])
    return np.concatenate(found)


def _reaction(goal: object, problem: Problem, zero: np.ndarray) -> GoalTerms:
    """The reaction of a support: minus the work of all forces in its unit motion."""
    component = require_component("component", goal.component, problem.N)
    motion, shared = motion_of_support(problem, goal.support, component)
    note = MEETING if shared else ""
    return GoalTerms(_along("reaction", goal.support, goal), None, zero, -motion, note)
