"""What can be asked for in guaranteed intervals: the kinds of goals.

A goal Q is linear in the solution: the work l(u) of a load, the resultant of contact pressures, or
a reaction, which is minus the work of all forces in a motion of a support.  Each kind is a class;
its ``form`` says for a problem what it is made of.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from ngsolve import BND, CF, L2, VOL, CoefficientFunction, GridFunction, Integrate, Mesh

from ngepc.checks.arguments import (
    boundary_names,
    require_component,
    require_components,
    require_vector,
)
from ngepc.checks.declared import Component, Declared, Text
from ngepc.checks.declared import Vector as Coordinates
from ngepc.checks.kinds import require_mapping, require_text
from ngepc.checks.sentences import in_words
from ngepc.discretisation.loads import applied_forces
from ngepc.goals.roller_motion import motion_of_support
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.data import Vector
from ngepc.model.elements import elements_by_shape, vertex_coordinates
from ngepc.model.located import located
from ngepc.model.places import Edge, Point
from ngepc.model.problem import Problem

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


@dataclass(frozen=True, eq=False, kw_only=True)
class GoalForm:
    """A goal of a problem: the sum of what is given here.

    Parameters
    ----------
    name
        For messages and pictures.
    load
        A problem whose tractions and body force are the load of the goal, for its own loads the
        problem itself; None if there is none.
    pressed
        The contact boundaries whose pressure counts.
    motion
        Minus the unit motion of the support of a reaction, (nodes, N); None if there is none.
    note
        What was replaced to make the goal continuous; may be empty.
    is_mean
        Whether it is a mean displacement, which has the same value for every thickness; other goals
        are forces and works, which are those of the whole thickness.
    """

    name: str
    load: Problem | None = None
    pressed: Sequence[str] = ()
    motion: np.ndarray | None = field(default=None, repr=False)
    note: str = ""
    is_mean: bool = False

    def forces(self, discrete: DiscreteProblem) -> np.ndarray:
        """Nodal forces of the load, (nodes, N)."""
        if self.load is None:
            return np.zeros_like(discrete.load)
        if self.load is discrete.problem:
            return discrete.load
        return applied_forces(self.load, discrete.supports.scalar)

    def work(self, state: State) -> float:
        """The work of the load, less that of all forces in the motion of the support."""
        value = float(np.vdot(self.forces(state.discrete), state.u))
        if self.motion is not None:
            value -= float(np.vdot(self.motion, state.residual_force))
        return value


class Goal(ABC):
    """A kind of goals."""

    @abstractmethod
    def form(self, problem: Problem) -> GoalForm:
        """The goal of a problem; TypeError, ValueError if it is not legal there."""


class ContactForce(Goal):
    """'contact_force': the resultant of the contact pressure."""

    def form(self, problem: Problem) -> GoalForm:
        """The pressure on all contact boundaries; ValueError without contact."""
        pressed = boundaries_in_contact(problem)
        if not pressed:
            raise ValueError("contact=None: a contact force needs contact")
        return GoalForm(name="contact force", pressed=pressed)


class WorkOfLoads(Goal):
    """'work': the work of the loads of the problem."""

    def form(self, problem: Problem) -> GoalForm:
        """The loads of the problem."""
        return GoalForm(name="work of the loads", load=problem)


NAMED = {"contact_force": ContactForce(), "work": WorkOfLoads()}
"""Goals with a name."""


@dataclass(frozen=True)
class ContactForceOn(Goal, Declared):
    """The integral of the contact pressure on some contact boundaries (force).

    Parameters
    ----------
    boundary
        Name of a contact boundary, or of several, 'a|b'.  Of two bodies: the boundary of either.
    """

    boundary: Text

    def form(self, problem: Problem) -> GoalForm:
        """The pressure on these boundaries; ValueError if none is in contact."""
        names = boundary_names("boundary", self.boundary, problem.mesh)
        touching = boundaries_in_contact(problem)
        pressed = [name for name in names if name in touching]
        if not pressed:
            raise ValueError(
                f"boundary={self.boundary!r}: a contact boundary is needed"
            )
        return GoalForm(name=f"contact force on {self.boundary}", pressed=pressed)


@dataclass(frozen=True)
class MeanDisplacement(Goal, Declared):
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

    def form(self, problem: Problem) -> GoalForm:
        """The load whose work is the mean; ValueError if the boundary does not move."""
        names = boundary_names("boundary", self.boundary, problem.mesh)
        component = require_component("component", self.component, problem.N)
        clamped = sorted(set(names) & set(problem.clamped_names))
        if clamped:
            raise ValueError(
                f"boundary={self.boundary!r}: {clamped[0]!r} is clamped and does not move"
            )
        region = problem.mesh.Boundaries("|".join(names))
        size = Integrate(CF(1), problem.mesh, BND, definedon=region)
        traction = [0.0] * problem.N
        traction[component] = 1 / size
        load = loaded(problem, dict.fromkeys(names, tuple(traction)), None)
        name = component_of("mean displacement", self.boundary, component)
        return GoalForm(name=name, load=load, is_mean=True)


@dataclass(frozen=True)
class LoadWork(Goal):
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

    def form(self, problem: Problem) -> GoalForm:
        """The load on the body of the problem."""
        load = loaded(problem, self.traction, self.body_force)
        return GoalForm(name="work", load=load)


@dataclass(frozen=True)
class PointDisplacement(Goal, Declared):
    """``DisplacementAt`` as a goal: the mean over the element with the point."""

    point: Coordinates
    component: Component

    def form(self, problem: Problem) -> GoalForm:
        """The load whose work is the mean; ValueError if the point is not in the body."""
        return MeanAround(self, problem.mesh).form(problem)


@dataclass(frozen=True)
class MeanAround(Goal):
    """The mean displacement over the element of another ``mesh``, which a bound has cut."""

    place: PointDisplacement
    mesh: Mesh

    def form(self, problem: Problem) -> GoalForm:
        """The load whose work is the mean; ValueError if the point is not in the body."""
        point = self.place.point
        component = require_component("component", self.place.component, problem.N)
        at = require_vector("point", point, (problem.N,))
        number = int(located(self.mesh, np.array([at]))["nr"][0])
        if number < 0:
            raise ValueError(f"point={in_words(point)}: a point in the body is needed")
        around = cells_within(problem.mesh, self.mesh, number)
        patch = GridFunction(L2(problem.mesh, order=0))
        patch.vec.FV().NumPy()[around] = 1.0
        size = Integrate(patch, problem.mesh, VOL)
        patch.vec.FV().NumPy()[around] = 1 / size
        force = [CF(0.0)] * problem.N
        force[component] = patch
        load = loaded(problem, None, CF(tuple(force)))
        note = f"The displacement is the mean over the element that contains {point}."
        return GoalForm(name="displacement", load=load, note=note, is_mean=True)


@dataclass(frozen=True)
class SupportReaction(Goal, Declared):
    """``Reaction`` as a goal: minus the work of all forces in a unit motion of the support."""

    support: Text
    component: Component

    def __post_init__(self) -> None:
        if isinstance(self.support, Point | Edge):
            raise TypeError(
                f"support={self.support}: the name of a boundary is needed; "
                "result.equilibrium.reactions has the forces of points and edges"
            )
        super().__post_init__()

    def form(self, problem: Problem) -> GoalForm:
        """The motion; ValueError if the support does not hold the component."""
        component = require_component("component", self.component, problem.N)
        motion, shared = motion_of_support(problem, self.support, component)
        note = MEETING if shared else ""
        name = component_of("reaction", self.support, component)
        return GoalForm(name=name, motion=-motion, note=note)


def as_goal(goal: object) -> Goal:
    """A goal from its name, or itself; TypeError, ValueError if it is none."""
    if isinstance(goal, str) and goal in NAMED:
        return NAMED[goal]
    if isinstance(goal, Goal):
        return goal
    wrong = ValueError if isinstance(goal, str) else TypeError
    raise wrong(f"goal={in_words(goal)}: {LEGAL} is needed")


def over_elements_of(mesh: Mesh, goal: Goal) -> Goal:
    """A goal that is a mean over an element over one of this mesh; other goals as they are."""
    return MeanAround(goal, mesh) if isinstance(goal, PointDisplacement) else goal


def component_of(what: str, place: str, component: int) -> str:
    """The name of a component on a boundary: "reaction of left along x"."""
    return f"{what} of {place} along {'xyz'[component]}"


def boundaries_in_contact(problem: Problem) -> list[str]:
    """Names of the boundaries where obstacles are, and of both of each pair."""
    names = list(problem.touching_names)
    for pair in problem.contact_pairs:
        names += boundary_names("contact", pair.second, problem.mesh)
    return names


def loaded(
    problem: Problem, traction: Mapping[str, Vector] | None, body_force: Vector | None
) -> Problem:
    """A problem without history that carries only these loads."""
    traction = dict(traction) if traction else None
    return problem.changed(traction=traction, body_force=body_force, pressure=None)


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


def cells_within(mesh: Mesh, other: Mesh, number: int) -> np.ndarray:
    """Numbers of the elements of a mesh that make up one element of another mesh."""
    if mesh is other:
        return np.array([number])
    found = []
    for numbers, vertices in elements_by_shape(mesh):
        centres = vertex_coordinates(mesh)[vertices].mean(axis=1)
        found.append(numbers[located(other, centres)["nr"] == number])
    return np.concatenate(found)
