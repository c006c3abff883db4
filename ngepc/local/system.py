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
from ngsolve import H1, GridFunction

from ngepc.discretisation.law import Law, Return
from ngepc.discretisation.loads import Supports, applied_forces, nodal
from ngepc.discretisation.points import Points
from ngepc.discretisation.rows import ContactRows, contact_rows
from ngepc.model.problem import Problem, as_scalar

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12
"""Part of the largest displacement that a gap has to exceed to be open."""

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that counts as a force where nothing else does, in a body without forces."""


class DiscreteProblem:
    """Points, law, supports, contact rows and loads of a problem: what no Newton step changes.

    Parameters
    ----------
    problem
        Data of the time step.

    Attributes
    ----------
    points, law, supports, rows
        What the modules of these names make of the problem.
    load
        Nodal forces of tractions and body force, shape (nodes, N).
    friction
        Bound of the tangential force of each contact row, shape (m,); None without friction.
    slip_origin
        Tangential displacements of the rows at the begin of the step, shape (m, N - 1).
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.points = Points(problem.mesh, problem.kinematics, problem.order)
        self.law = Law(problem, self.points)
        self.supports = Supports(problem)
        self.rows: ContactRows = contact_rows(problem, self.supports)
        self.load = applied_forces(problem, self.supports.space)
        self.friction = self._friction_forces()
        self.slip_origin = self._slip_origin()

    def _friction_forces(self) -> np.ndarray | None:
        if self.problem.friction is None:
            return None
        bound = GridFunction(H1(self.problem.mesh, order=1))
        region = self.problem.mesh.Boundaries("|".join(self.problem.contact_names))
        bound.Set(as_scalar(self.problem.friction), definedon=region)
        return self.rows.weights * bound.vec.FV().NumPy()[self.rows.vertices]

    def _slip_origin(self) -> np.ndarray:
        if self.problem.u_0 is None:
            return np.zeros((len(self.rows), self.problem.N - 1))
        u_0 = GridFunction(self.supports.space)
        u_0.Set(self.problem.u_0)
        return self.rows.slip(nodal(u_0.vec.FV().NumPy(), self.problem))

    @cached_property
    def stiffness_diagonal(self) -> np.ndarray:
        """Diagonal of the elastic stiffness, shape (nodes, N): the size of forces per length."""
        return self.points.diagonal(self.law.bulk, self.law.two_mu)

    @cached_property
    def yield_forces(self) -> float:
        """Norm of nodal forces of stresses at the yield bound."""
        sizes = self.points.force_sizes(self.law.beta)
        return float(np.linalg.norm(sizes))

    def state(
        self,
        u: np.ndarray,
        yielding: np.ndarray | None = None,
        multipliers: np.ndarray | None = None,
        active: np.ndarray | None = None,
    ) -> State:
        """The state with displacements ``u``; w = beta s/|s| and no contact forces by default."""
        m = len(self.rows)
        volume, e = self.points.strain(u)
        at = self.law.returned(e)
        if yielding is None:
            yielding = self.law.yielding_part(at)
        multipliers = np.zeros(m) if multipliers is None else multipliers
        active = multipliers > 0 if active is None else active
        return State(self, u, yielding, multipliers, active, volume, e, at)


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
    multipliers
        Contact forces lambda >= 0 of the rows, shape (m,).
    active
        Boolean, shape (m,): rows taken as closed; the next step starts from them.
    volume, deviator, at
        tr eps(u), the coordinates of dev eps(u), and the law there.
    """

    discrete: DiscreteProblem
    u: np.ndarray
    yielding: np.ndarray
    multipliers: np.ndarray
    active: np.ndarray
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
        """J(u, p) of (2.14) with the p that is best for u (force times length)."""
        density = self.discrete.law.energy_density(self.volume, self.at)
        work = float(np.vdot(self.discrete.load, self.u))
        return self.discrete.points.integral(density) - work

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress, shape (nodes, N)."""
        law = self.discrete.law
        return self.discrete.points.forces(law.bulk * self.volume, law.stress(self.at))

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces N' lambda of the body on the obstacle, shape (nodes, N)."""
        return self.discrete.rows.forces(self.multipliers)

    @cached_property
    def imbalance(self) -> np.ndarray:
        """Internal plus contact minus applied forces at free components, zero elsewhere."""
        forces = self.internal_forces + self.contact_forces - self.discrete.load
        return np.where(self.discrete.supports.free, forces, 0.0)

    @cached_property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.discrete.rows.open_gap(self.u)

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
        sizes = [np.linalg.norm(self.discrete.load), np.linalg.norm(self.internal_forces)]
        return float(max(*sizes, min(trial, self.discrete.yield_forces)))

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|, from which the true ones are what does not cancel."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return float(np.linalg.norm(self.discrete.stiffness_diagonal * size))

    @cached_property
    def contact_defect(self) -> np.ndarray:
        """min(lambda, k gap) of the rows, a force, shape (m,): zero where both conditions hold.

        k is the elastic stiffness of the row's nodes.
        """
        rows = self.discrete.rows
        if not len(rows):
            return np.zeros(0)
        stiffness = rows.normal.power(2) @ self.discrete.stiffness_diagonal.ravel()
        return np.minimum(self.multipliers, stiffness * self.open_gap)

    @cached_property
    def residual_norm(self) -> float:
        """Norm of the forces out of balance and of the contact defect, relative."""
        return math.hypot(self._relative(self.imbalance), self.contact_residual_norm)

    @property
    def contact_residual_norm(self) -> float:
        """The part of ``residual_norm`` that contact leaves."""
        return self._relative(self.contact_defect)

    def _relative(self, forces: np.ndarray) -> float:
        size, scale = float(np.linalg.norm(forces)), self.force_scale
        if size == 0 or scale == 0:
            return float(size > 0)  # an obstacle alone, before the first step
        return size / scale

    @property
    def rounding(self) -> float:
        """What rounding leaves of ``residual_norm``."""
        if self.trial_forces == 0 or self.force_scale == 0:
            return 0.0
        return 4 * EPSILON * self.trial_forces / self.force_scale
