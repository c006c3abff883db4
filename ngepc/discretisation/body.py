"""The discretised body (supports, contact rows, loads), and the residual of an iterate."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import H1, LinearForm, dx, specialcf
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.floating import LOOSE, SMALL, Floating, LooselyHeld
from ngepc.discretisation.loads import applied_forces
from ngepc.discretisation.prolongation import nodal_values
from ngepc.discretisation.stiffness import Stiffness
from ngepc.discretisation.supports import Supports
from ngepc.linalg.secants import Compliance
from ngepc.model.data import as_scalar, same_fields
from ngepc.model.elements import plastic_points
from ngepc.model.problem import Problem
from ngepc.model.processes import Team
from ngepc.model.support import floating_motions, held_directions

EPSILON = float(np.finfo(float).eps)

TOUCHING = 1e-12  # a gap is open beyond this fraction of the largest displacement

ROUNDING_SCALE = 4e-6
"""Part of |K| |u| that residuals are relative to, in a body without forces."""

DRIFT = 0.99  # part of a residual that comes from rigid motions if it is called drift

ROWS = ("contact", "friction")
"""Fields of a problem that determine its contact rows, except for their gaps, and their law."""


class DiscreteBody:
    """Supports, contact rows and loads of a problem, which both exact methods inherit."""

    stiffness: Stiffness  # assembles the tangents
    stiffness_diagonal: np.ndarray  # of the elastic stiffness, shape (nodes, N)

    def __init__(self, problem: Problem, like: DiscreteBody | None = None) -> None:
        """``like`` is an earlier body of the same mesh, from which unchanged data are taken."""
        self.problem = problem
        self.supports = supports_of(problem, like)
        self.contact = contact_of(problem, self.supports, like)
        self.rows = self.contact.rows
        self.free = self.supports.free
        # nodal forces, shape (nodes, N)
        self.load = applied_forces(problem, self.supports.scalar)

    def __getstate__(self) -> dict:
        """Everything except matrices of NGSolve, which are assembled again."""
        left_out = ("stiffness", "elastic", "elastic_compliance")
        return {name: part for name, part in vars(self).items() if name not in left_out}

    @cached_property
    def row_stiffness(self) -> np.ndarray:
        """Elastic stiffness of each row of ``contact`` (force per length)."""
        return self.contact.stiffness(self.stiffness_diagonal)

    @cached_property
    def yield_forces(self) -> float:
        """Norm of nodal forces of stresses at the yield bound."""
        problem = self.problem
        mesh = self.problem.mesh
        density = (
            problem.kinematics.weight * as_scalar(problem.beta) / specialcf.mesh_size
        )
        rules = plastic_points(mesh, problem.order)
        test = H1(mesh, order=1).TestFunction()
        forces = (
            LinearForm(density * test * dx(intrules=rules)).Assemble().vec.FV().NumPy()
        )
        return problem.processes.norm(problem.processes.summed(forces))

    @cached_property
    def floating(self) -> Floating:
        """The parts that are held by contact alone."""
        return self.floating_parts(floating_motions(self.problem))

    def floating_parts(self, found: list[tuple[np.ndarray, np.ndarray]]) -> Floating:
        """The same for motions and vertices of these parts."""
        diagonal = self.stiffness_diagonal if found else np.zeros_like(self.load)
        return Floating(found, self.problem, self.contact, diagonal)

    @cached_property
    def unheld(self) -> str:
        """A message if contact cannot balance the loads; empty if it can."""
        return self.floating.unheld(self.load)

    @cached_property
    def loosely_held(self) -> LooselyHeld | None:
        """The parts that springs much softer than the body hold, if there are any."""
        springs = self.problem.springs
        found = floating_motions(self.problem, springs=False) if springs else []
        if not found:
            return None
        held = LooselyHeld(found, self.problem, self.supports, self.stiffness_diagonal)
        return held if held.share < LOOSE else None

    @cached_property
    def added(self) -> csr_matrix:
        """The springs in the tangent: those of the problem, and those that only stabilise steps."""
        springs = self.supports.stiffness
        if self.contact.rollers:
            springs = springs + self.contact.friction_springs(self.row_stiffness)
        if self.floating.centres:
            springs = springs + diags(self.floating.springs.ravel())
        return springs.tocsr()

    def starting_displacement(self, start: object | None) -> np.ndarray:
        """Prescribed displacements, and elsewhere those of ``start`` (``nodal_values``) or zero."""
        u = self.supports.values.copy()
        if start is not None:
            u = np.where(self.free, nodal_values(start, self.problem), u)
        return self.contact.on_rollers(u, self.free)

    def at_rest(self) -> Iterate:
        """The iterate without contact forces at the displacements of the supports."""
        raise NotImplementedError

    def compliance(self) -> Compliance:
        """A first guess of the compliance of all rows; see ``Compliance.learn``."""
        stiffness = self.row_stiffness + self.contact.springs(self.row_stiffness)
        return Compliance(1 / stiffness, self.floating.compliance)


def supports_of(problem: Problem, like: DiscreteBody | None) -> Supports:
    """The supports of a problem, those of an earlier body where they are the same."""
    if like is None:
        return Supports(problem)
    if same_fields(problem, like.problem, "clamped", "prescribed", "springs"):
        return like.supports
    alike = held_directions(problem) == held_directions(like.problem)
    return Supports(problem, like.supports if alike else None)


def contact_of(
    problem: Problem, supports: Supports, like: DiscreteBody | None
) -> ContactConditions:
    """The conditions of contact of a problem, those of an earlier body where they are the same."""
    if like is None or not same_fields(problem, like.problem, *ROWS):
        return ContactConditions(problem, supports)
    same_gap = same_fields(problem, like.problem, "gap")
    if not same_gap and problem.processes.size > 1:
        return ContactConditions(problem, supports)
    alike = supports is like.supports or not problem.rollers
    if not (alike and np.array_equal(supports.free, like.free)):
        return ContactConditions(problem, supports)
    if not same_gap:
        return like.contact.with_gaps(problem, supports)
    if same_fields(problem, like.problem, "initial_displacement"):
        return like.contact
    return like.contact.from_displacement(problem, supports)


class Iterate:
    """Forces, gaps and residual of an iterate; the iterates of both exact methods inherit it."""

    body: DiscreteBody
    u: np.ndarray  # nodal displacements, shape (nodes, N)
    contact: np.ndarray
    """Forces of the rows: normal ones >= 0, with friction then tangential ones."""
    internal_forces: np.ndarray  # nodal forces of the stress, shape (nodes, N)
    energy: float  # J with the p that is best for u, and friction (force times length)
    moduli: Any  # data for which ``DiscreteBody.stiffness`` assembles the tangent
    flowing: float  # the largest |p| where the material no longer hardens
    plastic_measure: float  # area or volume of the part that yields in this step

    def with_radial_return(self) -> Iterate:
        """The state whose tangent is the second derivative of the energy: by default this one."""
        return self

    def along(self, change: np.ndarray) -> tuple[Callable, Callable]:
        """The derivative of the internal energy at u + t du along du, and the state there."""
        raise NotImplementedError

    @property
    def multipliers(self) -> np.ndarray:
        """Normal forces lambda >= 0 of the rows, shape (m,)."""
        return self.body.contact.normal(self.contact)

    @cached_property
    def contact_forces(self) -> np.ndarray:
        """Nodal forces of the body on the obstacle, friction included, shape (nodes, N)."""
        return self.body.contact.forces(self.contact)

    @cached_property
    def residual_force(self) -> np.ndarray:
        """Internal plus contact minus applied forces: reactions where held."""
        return self.internal_forces + self.contact_forces - self.body.load

    @cached_property
    def free_residual(self) -> np.ndarray:
        """The part of ``residual_force`` that no support takes."""
        return self.body.supports.kept(self.residual_force)

    @cached_property
    def gaps(self) -> np.ndarray:
        """The gaps and slips of the contact rows, ``ContactConditions.gaps``."""
        return self.body.contact.gaps(self.u)

    @property
    def open_gap(self) -> np.ndarray:
        """gaps - N u, negative where the obstacle is penetrated, shape (m,)."""
        return self.body.contact.normal(self.gaps)

    @property
    def tangential_forces(self) -> np.ndarray:
        """Tangential forces of the body on the obstacle, shape (m, N - 1)."""
        return self.body.contact.tangential(self.contact)

    @property
    def slip(self) -> np.ndarray:
        """The slip of the rows in this step (length), shape (m, N - 1)."""
        return -self.body.contact.tangential(self.gaps)

    @property
    def sliding(self) -> np.ndarray:
        """Boolean, shape (m,): rows with friction that slip."""
        bound = self.body.contact.bound(self.contact)
        slip = np.linalg.norm(self.slip, axis=1)
        return (bound > 0) & (slip > self.touching_distance)

    @property
    def touching_distance(self) -> float:
        """Smaller gaps and penetrations count as rounding (length)."""
        return TOUCHING * self._processes.maximum(np.abs(self.u))

    @property
    def penetration(self) -> float:
        """The deepest penetration, or opening of tied rows (length); 0 if feasible."""
        tied = self.body.contact.rows.tied
        depth = np.where(tied, np.abs(self.open_gap), -self.open_gap)
        return self._processes.maximum(np.maximum(depth, 0.0))

    @cached_property
    def friction_work(self) -> float:
        """The sum of bound times |slip| (force times length), zero without friction."""
        return self.body.contact.friction_work(
            self.contact, self.gaps, self.touching_distance
        )

    @property
    def _processes(self) -> Team:
        """The processes that share the body."""
        return self.body.contact.processes

    @cached_property
    def _forces(self) -> float:
        """The size of loads, internal forces and of the contact defect."""
        sizes = [
            self._processes.norm(a) for a in (self.body.load, self.internal_forces)
        ]
        return max(*sizes, self.contact_defect)

    @cached_property
    def force_scale(self) -> float:
        """The force that residuals are relative to."""
        rounding = ROUNDING_SCALE * self.trial_forces
        if rounding <= self._forces:
            return self._forces
        return max(self._forces, min(rounding, self.body.yield_forces))

    @property
    def hidden_by_rounding(self) -> bool:
        """Whether residuals are relative to more than the forces of the body.

        So it is where strains are small beside |u| over the size of the elements, in bending of
        slender bodies for example.  Then a small residual does not say that u is accurate.
        """
        return self.force_scale > self._forces

    @cached_property
    def trial_forces(self) -> float:
        """Norm of forces of size |K| |u|; the internal forces are small differences of these."""
        size = np.linalg.norm(self.u, axis=1, keepdims=True)
        return self._processes.norm(self.body.stiffness_diagonal * size)

    @cached_property
    def contact_defect(self) -> float:
        """Norm of the defect of the contact forces, min(lambda, k gap) without friction."""
        return self.body.contact.defect(
            self.contact, self.body.row_stiffness * self.gaps
        )

    @cached_property
    def residual_norm(self) -> float:
        """Norm of the forces out of balance and of the contact defect, relative."""
        imbalance = self._processes.norm(self.free_residual)
        return math.hypot(self._relative(imbalance), self.contact_residual_norm)

    @property
    def contact_residual_norm(self) -> float:
        """The part of ``residual_norm`` that is due to contact."""
        return self._relative(self.contact_defect)

    @property
    def rounding(self) -> float:
        """The rounding error of ``residual_norm``."""
        left = 4 * EPSILON * self.trial_forces
        return self._relative(left) if self.force_scale else 0.0

    @property
    def drifting(self) -> str:
        """A message if all that is left moves a part as a rigid body."""
        left = self.residual_norm
        floating = self.body.floating
        if not floating.centres:
            return ""
        drift = floating.drift(self.free_residual)
        if self._relative(self._processes.norm(drift)) < DRIFT * left:
            return ""
        centre = floating.place
        if left > SMALL:
            return (
                f"The part around ({centre}) still moves as a rigid body, and {left:.2g} of the "
                "forces move it: contact and friction hold it only just, if at all. More friction "
                "or a support at a point holds it."
            )
        return (
            f"The part around ({centre}) is free to move as a rigid body, and {left:.2g} of the "
            "forces move it: hold it, by friction or a support at a point. A tolerance above "
            f"{1.1 * left:.2g} can be met."
        )

    def _relative(self, size: float) -> float:
        """A force over ``force_scale``."""
        if size == 0 or self.force_scale == 0:  # an obstacle that pushes a body at rest
            return float(size > 0)
        return size / self.force_scale
