"""Goals of guaranteed intervals on one mesh, as loads, contact facets and motions of supports."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.data import BoundData
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.goals.kinds import GoalForm, as_goal
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.problem import Problem


@dataclass(frozen=True, eq=False, kw_only=True)
class GoalTerms(GoalForm):
    """A goal on one mesh: its form, and the number of each contact facet.

    Parameters
    ----------
    factor
        1 where the pressure of the facet counts, else 0, (facets,).
    lower
        The same goal for ``BoundData.lower``; None if that is None.
    """

    factor: np.ndarray = field(repr=False)
    lower: GoalTerms | None = None

    @property
    def is_contact_force(self) -> bool:
        """Whether it is the resultant of contact pressures, none of which are negative."""
        return self.load is None and self.motion is None

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
        return self.work(state) + self.contact_force(bound_data, state)

    def contact_force(self, bound_data: BoundData, state: State) -> float:
        """The part of the goal that is made of contact pressures; zero without it."""
        if not self.factor.any():
            return 0.0
        forces = np.maximum(state.multipliers, 0.0)
        if (self.factor == 1).all():
            return float(forces.sum())
        return float(self.factor @ bound_data.contact.from_rows.resultants(forces))


def check_goal(goal: object, problem: Problem) -> None:
    """TypeError, ValueError for goals that are not legal, before anything is solved."""
    as_goal(goal).form(problem)


def goal_of_result(goal: object, result: ExactResult) -> float:
    """The goal of a result, also on quadrilaterals and hexahedra, as its own numbers say it."""
    form = as_goal(goal).form(result.problem)
    contact = result.state.body.contact
    forces = contact.of_obstacles(result.state.contact)
    pressures = [contact.normal(forces[name]).sum() for name in form.pressed]
    return float(sum(pressures)) + form.work(result.state)


def terms_of(goal: object, bound_data: BoundData) -> GoalTerms:
    """A goal, or its name, on the mesh of some ``BoundData``.

    TypeError, ValueError for goals that are not legal or not covered.
    """
    form = as_goal(goal).form(bound_data.problem)
    boundary = bound_data.boundary
    for name in () if form.load is None else form.load.tractions:
        boundary.on((name,), f"boundary={name!r} of the goal")
    lower = None
    if bound_data.lower is not None:
        lower = terms_of(goal, bound_data.lower)
    factor = boundary.contact_of(form.pressed).astype(float)
    return GoalTerms(**vars(form), factor=factor, lower=lower)
