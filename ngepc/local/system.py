"""The discrete problem of one time step: minimise J(u, p) over nodal u with N u <= gaps.

p and the dual variable q are given at the integration points.  The plastic strain that is best for
u is known in closed form there (``discretisation.law``), so that J is a function of u alone.  With
w = -q as an independent variable, the conditions at a point that yields,

    2 mu_2 (dev eps(u) - p) = stress(s, w),    |s| w = r(|s|) s,

are linearised together.  Elimination of w point by point leaves an elasticity-like matrix in u that
is symmetric and positive definite for every w with |w| <= r (``Law.moduli``).  Far from the
solution the w that is carried along keeps it from being too soft; on the sphere |w| = r it is the
derivative of the radial return itself, with which convergence ends quadratically.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ngepc.discretisation.body import DiscreteBody, Iterate
from ngepc.discretisation.element_stiffness import ElementStiffness
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.law import Return
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.supports import Supports
from ngepc.linalg.secants import Compliance
from ngepc.model.data import same_fields
from ngepc.model.problem import Problem

DISCRETISED = ("mesh", "kinematics", "order")
"""Fields of a problem that determine its points and nodes."""


class DiscreteProblem(DiscreteBody):
    """The discretised problem: points, law, supports, contact rows and loads."""

    def __init__(
        self,
        problem: Problem,
        points: Points | None = None,
        like: DiscreteProblem | None = None,
    ) -> None:
        """``like`` is an earlier discrete problem, from which unchanged data are taken."""
        if like is not None and not same_fields(problem, like.problem, *DISCRETISED):
            like = None
        super().__init__(problem, like)
        if points is None and like is not None:
            points = like.points
        self.points = points or points_of(problem, self.supports)
        self.law = law_of(problem, self.points)
        if like is not None and self.floats_like(like):
            vars(self)["floating"] = like.floating
        if like is None or not self.has_tangents_of(like):
            return
        vars(self)["stiffness"] = like.stiffness
        if same_fields(problem, like.problem, "material"):
            vars(self)["stiffness_diagonal"] = like.stiffness_diagonal
            self._take_elastic(like)

    def _take_elastic(self, like: DiscreteProblem) -> None:
        """Take over what is known of the elastic body."""
        if "elastic" in vars(like):
            vars(self)["elastic"] = like.elastic
        same_rows = self.contact.matrix is like.contact.matrix
        if same_rows and "elastic_compliance" in vars(like):
            vars(self)["elastic_compliance"] = like.elastic_compliance

    def floats_like(self, other: DiscreteProblem) -> bool:
        """Whether the same parts float, on springs of the same stiffness."""
        alike = self.supports.holds_like(other.supports)
        rows = self.contact.matrix is other.contact.matrix
        return alike and rows and same_fields(self.problem, other.problem, "material")

    def has_tangents_of(self, other: DiscreteProblem) -> bool:
        """Whether tangents have the same pattern, and the same springs beside the stress.

        The springs of rollers and of floating parts follow the material.
        """
        mine = self.problem
        steered = mine.rollers or self.floating.centres
        same = ("contact", "friction", "material")[: 3 if steered else 2]
        alike = self.supports.holds_like(other.supports)
        return alike and same_fields(mine, other.problem, *same)

    @cached_property
    def elastic(self) -> Factors:
        """The factors of the elastic stiffness."""
        factors = Factors(self, "sparsecholesky")
        factors.update(self.law.elastic_moduli)
        return factors

    @cached_property
    def elastic_compliance(self) -> Compliance:
        """The compliance of the contact rows of the elastic body, by a solve for each force."""
        every = np.arange(len(self.contact))
        return Compliance.of(self.contact.compliance(self.elastic.solve, every))

    @cached_property
    def stiffness(self) -> ElementStiffness:
        """The object that assembles the tangents, see ``DiscreteBody``."""
        stiffness = ElementStiffness(self.points, self.free).with_added(self.added)
        return stiffness.with_slanted(self.supports.slanted)

    @cached_property
    def stiffness_diagonal(self) -> np.ndarray:
        """Diagonal of the elastic stiffness, see ``DiscreteBody``."""
        diagonal = self.points.diagonal(self.law.bulk, self.law.two_mu)
        springs = self.supports.stiffness.diagonal().reshape(diagonal.shape)
        return diagonal + self.problem.nodal_processes.summed(springs)

    def law_at(self, u: np.ndarray) -> Return:
        """The law at the strain of displacements."""
        return self.law.returned(*self.law.beyond_initial(*self.points.strain(u)))

    def at_rest(self) -> State:
        """See ``DiscreteBody``."""
        return self.state(self.starting_displacement(None))

    def state(
        self,
        u: np.ndarray,
        yielding: np.ndarray | None = None,
        contact: np.ndarray | None = None,
        at: Return | None = None,
    ) -> State:
        """The state with displacements ``u``; w = r s/|s| and no contact forces by default.

        A given w is projected onto |w| <= r(|s|).  ``at`` is the law at the strain of ``u``, if it
        is known.
        """
        at = self.law_at(u) if at is None else at
        yielding = self.law.yielding_part(at) if yielding is None else yielding
        contact = np.zeros(len(self.contact)) if contact is None else contact
        return State(self, u, self.law.projected(yielding, at), contact, at)


def points_of(problem: Problem, supports: Supports) -> Points:
    """The points of a problem, with the space of its supports."""
    parts = problem.mesh, problem.kinematics, problem.order
    return Points(*parts, scalar=supports.scalar)


@dataclass(frozen=True, eq=False)
class State(Iterate):
    """An iterate, see ``Iterate``: u, the dual variable w and the contact forces.

    ``yielding`` is w = -q at the points, |w| <= r(|s|), a variable of its own, shape (points, d);
    ``at`` is the law at the strain of u.
    """

    discrete: DiscreteProblem
    u: np.ndarray
    yielding: np.ndarray
    contact: np.ndarray
    at: Return = field(repr=False)

    @property
    def body(self) -> DiscreteProblem:
        """The discrete problem, see ``Iterate``."""
        return self.discrete

    @property
    def volume(self) -> np.ndarray:
        """tr eps(u) beyond the initial strain at the points, free components included."""
        return self.at.volume

    @property
    def deviator(self) -> np.ndarray:
        """Coordinates of the deviator of that strain, shape (points, d)."""
        return self.at.deviator

    def with_radial_return(self) -> State:
        """The same state with w = r s/|s| where s yields."""
        other = copy(self)
        object.__setattr__(other, "yielding", self.discrete.law.yielding_part(self.at))
        return other

    def along(self, change: np.ndarray) -> tuple[Callable, Callable]:
        """The work of the stress at u + t du times du, and the state there, see ``Iterate``.

        w moves along.  The law is evaluated once for a length t that is asked for twice in a row.
        """
        law = self.discrete.law
        points = self.discrete.points
        supports = self.discrete.supports
        volume, e = points.strain(change)
        pull = supports.pull(change)
        dot = points.processes.dot
        start = dot(pull, self.u)
        rise = dot(pull, change)
        latest = {}
        stresses = {}

        def at(t: float) -> Return:
            """The law at u + t du."""
            if t == 0.0:
                return self.at
            if t not in latest:
                latest.clear()
                latest[t] = self.discrete.law_at(self.u + t * change)
            return latest[t]

        def work(t: float) -> float:
            """The derivative of the energy along the step."""
            if t not in stresses:
                stresses.clear()
                stresses[t] = law.stress(at(t)) if t else self.stress
            mean, stress = stresses[t]
            power = mean * volume + np.einsum("pd,pd->p", stress, e)
            return points.integral(power) + start + t * rise

        def moved(t: float, contact: np.ndarray) -> State:
            """The state at a step length."""
            w = law.linearised(self.at, self.yielding, volume, e)
            w = self.yielding + t * (w - self.yielding)
            state = self.discrete.state(self.u + t * change, w, contact, at(t))
            if t in stresses:
                vars(state)["stress"] = stresses[t]
            return state

        return work, moved

    @cached_property
    def stress(self) -> tuple[np.ndarray, np.ndarray]:
        """The factor of tr eps in sigma : eps, and dev sigma in coordinates (points, d)."""
        return self.discrete.law.stress(self.at)

    @cached_property
    def energy(self) -> float:
        """J(u, p) of (2.14) with the p that is best for u, and friction (force times length)."""
        density = self.discrete.law.energy_density(self.at)
        pull = self.discrete.supports.pull(self.u)
        work = self.discrete.points.processes.dot(
            self.discrete.load - 0.5 * pull, self.u
        )
        return self.discrete.points.integral(density) - work + self.friction_work

    @property
    def moduli(self) -> Moduli:
        """The moduli of the tangent at the points."""
        return self.discrete.law.moduli(self.at, self.yielding)

    @property
    def flowing(self) -> float:
        """The largest |p| among points without hardening left."""
        discrete = self.discrete
        return discrete.points.processes.maximum(discrete.law.flowing(self.at))

    @property
    def plastic_measure(self) -> float:
        """Area or volume of the part that yields in this step."""
        return self.discrete.points.integral(self.at.yields.astype(float))

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress and on the springs, shape (nodes, N)."""
        pull = self.discrete.supports.pull(self.u)
        return pull + self.discrete.points.forces(*self.stress)
