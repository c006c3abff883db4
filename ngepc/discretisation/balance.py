"""What no Newton step changes, what is left of balance at an iterate, and what rounding leaves."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.floating import Floating
from ngepc.discretisation.loads import Supports, applied_forces
from ngepc.discretisation.prolongation import nodal_values
from ngepc.linalg.secants import Compliance
from ngepc.model.problem import Problem
from ngepc.model.processes import Team

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12  # part of the largest displacement that a gap has to exceed to be open

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that counts as a force where nothing else does, in a body without forces."""


class Frame:
    """Supports, contact rows and loads of a problem; the problems of both exact methods inherit it.

    They have ``stiffness_diagonal``, that of the elastic stiffness (nodes, N), and
    ``yield_forces``, the norm of nodal forces of stresses at the yield bound.
    """

    stiffness_diagonal: np.ndarray
    yield_forces: float

    def __init__(self, problem: Problem) -> None:
        self.problem, self.supports = problem, Supports(problem)
        self.contact = ContactConditions(problem, self.supports)
        self.rows, self.free = self.contact.rows, self.supports.free
        self.load = applied_forces(problem, self.supports.space)  # nodal forces, (nodes, N)

    @cached_property
    def row_stiffness(self) -> np.ndarray:
        """Elastic stiffness of each row of ``contact`` (force per length)."""
        return self.contact.stiffness(self.stiffness_diagonal)

    @cached_property
    def floating(self) -> Floating:
        """The parts that contact alone holds."""
        return Floating(self.problem, self.contact, self.load)

    @cached_property
    def added(self) -> csr_matrix:
        """What tangents have besides the stress: springs, also those that only steer the steps."""
        weak = self.floating.springs(self.stiffness_diagonal).ravel()
        parts = self.supports.stiffness, self.contact.grip(self.row_stiffness), diags(weak)
        return sum((part for part in parts[1:] if part.count_nonzero()), parts[0]).tocsr()

    def starting_displacement(self, start: object | None) -> np.ndarray:
        """Prescribed displacements, and inside those of ``start`` (``nodal_values``) or zero."""
        u = self.supports.values.copy()
        if start is not None:
            u = np.where(self.free, nodal_values(start, self.problem), u)
        return self.contact.on_rollers(u, self.free)

    def compliance(self) -> Compliance:
        """A first guess of the compliance of all rows, which learns."""
        known = self.floating.compliance(self.stiffness_diagonal)
        return Compliance(
            1 / (self.row_stiffness + self.contact.springs(self.row_stiffness)), known
        )


class Balance:
    """Forces and gaps of an iterate; the iterates of both exact methods inherit it.

    It needs nodal displacements u and nodal forces of the stress, both (nodes, N), and forces of
    the contact conditions: normal forces >= 0, with friction then tangential ones.
    """

    frame: Frame
    u: np.ndarray
    contact: np.ndarray
    internal_forces: np.ndarray

    @property
    def multipliers(self) -> np.ndarray:
        """Normal forces lambda >= 0 of the rows, shape (m,)."""
        return self.frame.contact.normal(self.contact)

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces of the body on the obstacle, friction included, shape (nodes, N)."""
        return self.frame.contact.forces(self.contact)

    @cached_property
    def missing(self) -> np.ndarray:
        """Internal plus contact minus applied forces: reactions where held."""
        return self.internal_forces + self.contact_forces - self.frame.load

    @cached_property
    def imbalance(self) -> np.ndarray:
        """``missing`` at the free components, zero elsewhere."""
        return np.where(self.frame.free, self.missing, 0.0)

    @cached_property
    def gaps(self) -> np.ndarray:
        """What the contact conditions leave open, ``ContactConditions.gaps``."""
        return self.frame.contact.gaps(self.u)

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.frame.contact.normal(self.gaps)

    @property
    def tangential_forces(self) -> np.ndarray:
        """Tangential forces of the body on the obstacle, shape (m, N - 1)."""
        return self.frame.contact.tangential(self.contact)

    @property
    def slip(self) -> np.ndarray:
        """What the rows have slipped in this step (length), shape (m, N - 1)."""
        return -self.frame.contact.tangential(self.gaps)

    @property
    def sliding(self) -> np.ndarray:
        """Boolean, shape (m,): rows with friction that slip."""
        bound, slip = self.frame.contact.bound(self.contact), np.linalg.norm(self.slip, axis=1)
        return (bound > 0) & (slip > self.touching_distance)

    @property
    def touching_distance(self) -> float:
        """Gaps and penetrations below it are rounding (length)."""
        return TOUCHING * self._processes.most(np.abs(self.u))

    @property
    def penetration(self) -> float:
        """The deepest penetration (length), or what opens where nothing may; 0 if feasible."""
        tied = self.frame.contact.rows.tied
        depth = np.where(tied, np.abs(self.open_gap), -self.open_gap)
        return self._processes.most(np.maximum(depth, 0.0))

    @cached_property
    def friction_work(self) -> float:
        """The sum of bound times |slip| (force times length), zero without friction."""
        return self.frame.contact.friction_work(self.contact, self.gaps, self.touching_distance)

    @property
    def _processes(self) -> Team:
        """Those that share the body."""
        return self.frame.contact.processes

    @cached_property
    def force_scale(self) -> float:
        """The force that residuals are relative to."""
        sizes = [self._processes.norm(a) for a in (self.frame.load, self.internal_forces)]
        least = min(ROUNDING_SCALE * self.trial_forces, self.frame.yield_forces)
        return max(*sizes, self.contact_defect, least)

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|, from which the true ones are what does not cancel."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return self._processes.norm(self.frame.stiffness_diagonal * size)

    @cached_property
    def residual_norm(self) -> float:
        """Norm of the forces out of balance and of the contact defect, relative."""
        imbalance = self._processes.norm(self.imbalance)
        return math.hypot(self._relative(imbalance), self.contact_residual_norm)

    @property
    def contact_residual_norm(self) -> float:
        """The part of ``residual_norm`` that contact leaves."""
        return self._relative(self.contact_defect)

    @cached_property
    def contact_defect(self) -> float:
        """Norm of what the forces of contact lack, min(lambda, k gap) without friction."""
        contact, pushed = self.frame.contact, self.frame.row_stiffness * self.gaps
        own = contact.defect(self.contact, pushed)[contact.own]
        return math.sqrt(self._processes.total(float(own @ own)))

    def _relative(self, size: float) -> float:
        """A force over ``force_scale``."""
        if size == 0 or self.force_scale == 0:  # an obstacle that pushes a body at rest
            return float(size > 0)
        return size / self.force_scale

    @property
    def rounding(self) -> float:
        """What rounding leaves of ``residual_norm``."""
        if self.trial_forces == 0 or self.force_scale == 0:
            return 0.0
        return 4 * EPSILON * self.trial_forces / self.force_scale
