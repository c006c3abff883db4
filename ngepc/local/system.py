"""The discrete problem of one time step: minimise J(u, p) over nodal u with N u <= gaps.

p and the dual variable q live at the integration points.  The plastic strain that is best for u is
known in closed form there (``discretisation.law``), so that J is a function of u alone.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.law import Law, Return
from ngepc.discretisation.loads import Supports, applied_forces
from ngepc.discretisation.points import Points
from ngepc.discretisation.rows import ContactRows
from ngepc.discretisation.stiffness import Stiffness
from ngepc.model.problem import Problem
from ngepc.model.support import has_floating_parts

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12
"""Part of the largest displacement that a gap has to exceed to be open."""

FLOATING = 1e-4
"""Stiffness of all springs of a floating part, about, relative to that of the part."""

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that counts as a force where nothing else does, in a body without forces."""


class DiscreteProblem:
    """Points, law, supports, contact rows and loads of a problem: what no Newton step changes.

    Parameters
    ----------
    problem
        Data of the time step.
    points
        The integration points; None for those of the problem's mesh, kinematics and order.

    Attributes
    ----------
    points, law, supports, contact, rows
        What the modules of these names make of the problem.
    load
        Nodal forces of tractions and body force, shape (nodes, N).
    """

    def __init__(self, problem: Problem, points: Points | None = None) -> None:
        self.problem = problem
        self.points = points or Points(problem.mesh, problem.kinematics, problem.order)
        self.law = Law(problem, self.points)
        self.supports = Supports(problem)
        self.contact = ContactConditions(problem, self.supports)
        self.rows: ContactRows = self.contact.rows
        self.load = applied_forces(problem, self.supports.space)

    @cached_property
    def stiffness(self) -> Stiffness:
        """The pattern of the tangents; who fills it takes ``another()``."""
        return Stiffness(self.points, self.supports.free, self.springs)

    @cached_property
    def stiffness_diagonal(self) -> np.ndarray:
        """Diagonal of the elastic stiffness, shape (nodes, N): the size of forces per length."""
        return self.points.diagonal(self.law.bulk, self.law.two_mu)

    @cached_property
    def row_stiffness(self) -> np.ndarray:
        """Elastic stiffness of each row of ``contact`` (force per length)."""
        return self.contact.stiffness(self.stiffness_diagonal)

    @cached_property
    def springs(self) -> np.ndarray | None:
        """Weak springs of the tangent for parts that contact alone holds; None if there are none.

        They resist the change of each Newton step, not the displacement: a proximal term that does
        not change the solution and costs about a factor FLOATING in the speed of convergence.
        """
        if not has_floating_parts(self.problem):
            return None
        return FLOATING / len(self.supports.free) * self.stiffness_diagonal

    @cached_property
    def yield_forces(self) -> float:
        """Norm of nodal forces of stresses at the yield bound."""
        sizes = self.points.force_sizes(self.law.beta)
        return float(np.linalg.norm(sizes))

    def state(
        self,
        u: np.ndarray,
        yielding: np.ndarray | None = None,
        contact: np.ndarray | None = None,
    ) -> State:
        """The state with displacements ``u``; w = beta s/|s| and no contact forces by default."""
        volume, e = self.points.strain(u)
        at = self.law.returned(e)
        if yielding is None:
            yielding = self.law.yielding_part(at)
        contact = np.zeros(len(self.contact)) if contact is None else contact
        return State(self, u, yielding, contact, volume, e, at)


@dataclass(frozen=True, eq=False)
class State:
    """An iterate with everything that follows from it.

    Parameters
    ----------
    discrete
        The discrete problem.
    u
        Nodal displacements, shape (nodes, N).
    yielding
        w = -q at the points, |w| <= beta, a variable of its own, shape (points, d).
    contact
        Forces of the contact conditions: normal forces >= 0, with friction then tangential ones.
    volume, deviator, at
        tr eps(u), the coordinates of dev eps(u), and the law there.
    """

    discrete: DiscreteProblem
    u: np.ndarray
    yielding: np.ndarray
    contact: np.ndarray
    volume: np.ndarray
    deviator: np.ndarray
    at: Return = field(repr=False)

    def on_sphere(self) -> State:
        """The same state with w = beta s/|s| where s yields."""
        other = copy(self)
        object.__setattr__(other, "yielding", self.discrete.law.yielding_part(self.at))
        return other

    @cached_property
    def energy(self) -> float:
        """J(u, p) of (2.14) with the p that is best for u, and friction (force times length)."""
        density = self.discrete.law.energy_density(self.volume, self.at)
        work = float(np.vdot(self.discrete.load, self.u))
        return self.discrete.points.integral(density) - work + self.friction_work

    @cached_property
    def friction_work(self) -> float:
        """The sum of bound times |slip| (force times length), zero without friction."""
        return self.discrete.contact.friction_work(self.contact, self.gaps, self.touching_distance)

    @property
    def multipliers(self) -> np.ndarray:
        """Normal forces lambda >= 0 of the rows, shape (m,)."""
        return self.discrete.contact.normal(self.contact)

    @property
    def tangential_forces(self) -> np.ndarray:
        """Tangential forces of the body on the obstacle, shape (m, N - 1)."""
        return self.discrete.contact.tangential(self.contact)

    @property
    def slip(self) -> np.ndarray:
        """What the rows have slipped in this step (length), shape (m, N - 1)."""
        return -self.discrete.contact.tangential(self.gaps)

    @property
    def sliding(self) -> np.ndarray:
        """Boolean, shape (m,): rows with friction that slip."""
        return (self.discrete.contact.bound(self.contact) > 0) & (
            np.linalg.norm(self.slip, axis=1) > self.touching_distance
        )

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress, shape (nodes, N)."""
        law = self.discrete.law
        return self.discrete.points.forces(law.bulk * self.volume, law.stress(self.at))

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces of the body on the obstacle, friction included, shape (nodes, N)."""
        return self.discrete.contact.forces(self.contact)

    @cached_property
    def imbalance(self) -> np.ndarray:
        """Internal plus contact minus applied forces at free components, zero elsewhere."""
        forces = self.internal_forces + self.contact_forces - self.discrete.load
        return np.where(self.discrete.supports.free, forces, 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """What the contact conditions leave open, ``ContactConditions.gaps``."""
        return self.discrete.contact.gaps(self.u)

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.discrete.contact.normal(self.gaps)

    @property
    def touching_distance(self) -> float:
        """Gaps and penetrations below it are rounding (length)."""
        return TOUCHING * float(np.abs(self.u).max(initial=0.0))

    @property
    def penetration(self) -> float:
        """The deepest penetration (length), 0 for a feasible displacement."""
        return float(np.maximum(-self.open_gap, 0.0).max(initial=0.0))

    @cached_property
    def force_scale(self) -> float:
        """The force that residuals are relative to."""
        trial = ROUNDING_SCALE * self.trial_forces
        forces = (self.discrete.load, self.internal_forces, self.contact_defect)
        sizes = [float(np.linalg.norm(given)) for given in forces]
        return max(*sizes, min(trial, self.discrete.yield_forces))

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|, from which the true ones are what does not cancel."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return float(np.linalg.norm(self.discrete.stiffness_diagonal * size))

    @cached_property
    def contact_defect(self) -> np.ndarray:
        """What the forces of contact lack, a force: min(lambda, k gap) without friction."""
        return self.discrete.contact.defect(self.contact, self.discrete.row_stiffness * self.gaps)

    @cached_property
    def residual_norm(self) -> float:
        """Norm of the forces out of balance and of the contact defect, relative."""
        return math.hypot(self._relative(self.imbalance), self.contact_residual_norm)

    @property
    def contact_residual_norm(self) -> float:
        """The part of ``residual_norm`` that contact leaves."""
        return self._relative(self.contact_defect)

    def _relative(self, forces: np.ndarray) -> float:
        size = float(np.linalg.norm(forces))
        if size == 0 or self.force_scale == 0:  # an obstacle that pushes a body at rest
            return float(size > 0)
        return size / self.force_scale

    @property
    def rounding(self) -> float:
        """What rounding leaves of ``residual_norm``."""
        if self.trial_forces == 0 or self.force_scale == 0:
            return 0.0
        return 4 * EPSILON * self.trial_forces / self.force_scale
