"""The adjoint of a goal: a displacement z, and a stress in equilibrium with the goal's load.

Any pair that satisfies the conditions of ``goal_bound`` on the contact boundary gives a bound. Here
z solves the tangent problem for the load of the goal with z . n = c on the active contact rows, and
the stress is the best admissible one for this z.  Where the conditions are violated, z is changed
at single nodes and the pressure of the stress is cut off.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ngepc.bounds.balance import factorise, without_weak_springs
from ngepc.bounds.coordinates import Displaced
from ngepc.bounds.data import AdjointStress, BoundData
from ngepc.bounds.held import RigidWorks, limited_pressure
from ngepc.discretisation.conditions import dependent_forces
from ngepc.discretisation.factors import Factors
from ngepc.goals.adjoint_conditions import ROUNDING, AdjointConditions
from ngepc.goals.goal_terms import GoalTerms
from ngepc.goals.held_rows import Held, HeldRows
from ngepc.linalg.secants import Compliance
from ngepc.local.system import State

TOUCHES = 1e-10  # fraction of the largest force of a row above which it presses
UNBALANCED = 1e-8
"""Works on rigid motions relative to the sum of the forces that count as zero."""
ALONG = 1e-8
"""Smaller parts of a unit vector are not held by supports."""
HOLDS = 20  # largest number of passes until no more rows are held
LOOSEST = 1e-3
HELD = 0.3
"""Tolerance of the values of held rows, as a part of the root of the error bound, and the largest.

What is left of the conditions is repaired node by node: of m rows it has about m times the energy
of the square of their error, relative to the largest displacement.
"""
UNMOVED = 1e-5
"""Forces that count as small, relative to those that hold the displacements."""
UNSOLVED = 1e-9
"""A solve that leaves more than this part of them is repeated for what it leaves."""


@dataclass(frozen=True, eq=False)
class Adjoint:
    """An admissible pair.

    ``displaced`` is the displacement ``z`` (nodes, N) with its strain; ``stress`` is admissible,
    with the shape that ``BoundData`` gives to stresses; ``pressure`` is minus its normal traction
    at the vertices of the contact facets; ``energy`` is half the squared residual of the pair in
    the tangent's law; ``least`` is the smallest factor lambda for which the conditions hold; the
    traction of the stress on springs of stiffness K is -K ``sprung`` (elastic facets, N, N), at
    vertices; ``friction`` (facets, N, N) is minus its tangential traction on contact, at vertices.
    """

    displaced: Displaced
    stress: np.ndarray
    pressure: np.ndarray
    energy: float
    least: float
    sprung: np.ndarray
    friction: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """The displacement."""
        return self.displaced.u


@dataclass(frozen=True, eq=False)
class Start:
    """The adjoint of a goal without conditions on open rows.

    ``load`` are the nodal forces of the goal's load, ``forces`` these less what the motion ``lift``
    of supports does, ``wanted`` the values of the rows, ``base`` the solution with those that
    press.
    """

    goal: GoalTerms
    load: np.ndarray
    forces: np.ndarray
    lift: np.ndarray
    wanted: np.ndarray
    base: Held


class AdjointProblem(AdjointConditions):
    """Adjoints of goals around one state.

    ``error`` is the relative error of the state.  ``tangent`` are factors at the state, or near it,
    ``search`` is what found the stress of the bound, ``compliance`` a guess of that of the rows;
    they are made where they are missing.
    """

    def __init__(
        self,
        bound_data: BoundData,
        state: State,
        P: np.ndarray,
        error: float = 1e-4,
        tangent: Factors | None = None,
        search: Any = None,
        compliance: Compliance | None = None,
    ) -> None:
        slack = bound_data.contact.slack(state.u)
        self.penetration = bound_data.contact.lift(slack)
        super().__init__(bound_data, slack, float(np.abs(state.u).max()))
        self.state = state
        self.P = P
        if tangent is None:
            tangent = Factors(bound_data.discrete, "sparsecholesky")
        factorise(state.with_radial_return(), tangent)
        self.tangent = tangent
        rows = bound_data.discrete.rows
        conditions = bound_data.discrete.contact
        self._normals = len(rows)
        count = len(conditions)
        of_friction = bound_data.tangential(state)
        used = np.linalg.norm(of_friction, axis=2)
        self._spare = np.maximum(bound_data.boundary.friction - used, 0.0)
        error = max(error, ROUNDING**2)  # that of an exact solution may be negative
        tolerance = min(LOOSEST, HELD * math.sqrt(error / max(count, 1)))
        if compliance is None:
            compliance = bound_data.discrete.compliance()
        compliance.restart()
        self.rows = HeldRows(conditions.matrix.tocsr(), tangent, compliance, tolerance)
        self._lower: AdjointProblem | None = None
        if bound_data.lower is not None:
            self._lower = AdjointProblem(
                bound_data.lower, bound_data.lower_state, P, error
            )
        elif search is None:
            search = bound_data.search(state)
        self._search = search
        self._motions = bound_data.discrete.floating.motions
        self._works: RigidWorks | None = None
        if self._motions.shape[2]:
            self._works = RigidWorks(bound_data.contact, self._motions)

    def start(self, goal: GoalTerms) -> Start:
        """The adjoint of a goal without conditions on open rows, for all lambda."""
        discrete = self.bound_data.discrete
        forces = load = goal.forces(self.bound_data.discrete)
        lift = np.zeros_like(forces) if goal.motion is None else goal.motion
        if goal.motion is not None:
            strain = discrete.points.strain(lift)
            pulled = discrete.points.forces(*self.tangent.moduli.stress(*strain))
            forces = forces - pulled - discrete.supports.pull(lift)
        wanted = np.zeros(self.rows.matrix.shape[0])
        wanted[: self._normals] = self.of_rows(goal)
        wanted -= self.rows.matrix @ lift.ravel()
        base = self.pressed_rows(forces, wanted)
        start = Start(goal, load, forces, lift, wanted, base)
        self._check_held(start)
        return start

    def _check_held(self, start: Start) -> None:
        """Refuse loads of goals that no contact pressure of floating parts can balance."""
        if self._works is None:
            return
        wanted = self.rigid_works(start)
        found = self.P * self._works.change(self.P, wanted)
        left = np.abs(wanted - self._works.of(found)).max()
        if left > UNBALANCED * np.abs(start.forces).sum():
            raise ValueError(
                f"goal={start.goal.name}: a motion that contact does not prevent changes it"
            )

    def pressed_rows(self, forces: np.ndarray, wanted: np.ndarray) -> Held:
        """The solution for forces (nodes, N) with values of the active rows alone."""
        z = self.tangent.solve(forces) if forces.any() else np.zeros_like(forces)
        free = Held(z, np.zeros(len(wanted)))
        return self.rows.held(free, self.presses, wanted)

    def energy(self, start: Start) -> float:
        """Half the energy of the adjoint without conditions on open rows, in the tangent's law.

        Rounding errors of a rigid motion may have either sign: they count as zero.
        """
        z = start.base.z
        of_lift = start.load - start.forces
        stored = np.vdot(z, self.answered(z)) + np.vdot(2 * z + start.lift, of_lift)
        return max(float(stored) / 2, 0.0)

    def of(self, start: Start, factor: float) -> Adjoint:
        """An admissible pair for lambda >= ``least``, made for the ``factor`` lambda."""
        bound_data = self.bound_data
        goal = start.goal
        z = self._steered(start.base, start.wanted, factor) + start.lift
        if self._lower is not None:
            of_lower = self._lower.of(self._lower.start(goal.lower), factor)
            z, least = self.repaired(goal, z, factor)
            displaced = Displaced.of(bound_data.discrete, z)
            energy = bound_data.missed_energy(
                self.state, self.tangent, displaced, of_lower.stress, of_lower.sprung
            )
            return replace(of_lower, displaced=displaced, energy=energy, least=least)
        pi, rho = self._pressed(start, factor)
        most = factor * self.P
        pi = np.clip(pi, -most, most)
        if self._works is not None:
            balanced = limited_pressure(self._works, pi, most, self.rigid_works(start))
            if balanced is None:
                none = np.empty(0)
                displaced = Displaced(z, none, none)
                return Adjoint(displaced, none, pi, math.inf, math.inf, none, rho)
            pi = balanced
        z, least = self.repaired(goal, z, factor)
        displaced = Displaced.of(bound_data.discrete, z)
        found = self.balanced_stress(start, displaced, pi, rho)
        return Adjoint(
            displaced, found.nodal, pi, found.energy, least, found.sprung, rho
        )

    def answer(self, forces: np.ndarray) -> np.ndarray:
        """Displacements that answer forces (nodes, N); without the weak springs of the tangent."""
        discrete = self.bound_data.discrete
        if discrete.floating.centres:
            return without_weak_springs(discrete, self.tangent, forces)
        return self.tangent.solve(forces)

    def answered(self, z: np.ndarray) -> np.ndarray:
        """The forces that displacements answer, both (nodes, N); without those weak springs."""
        return self.tangent.multiply(z) - self.bound_data.discrete.floating.springs * z

    def left_by(self, z: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """The part of forces that displacements do not answer; all (nodes, N)."""
        return self.bound_data.discrete.supports.kept(forces - self.answered(z))

    def rigid_works(self, start: Start) -> np.ndarray:
        """The works of the goal's load on the motions of floating parts, (motions,)."""
        return np.einsum("ni,nik->k", start.forces, self._motions)

    def admits(self, goal: GoalTerms, adjoint: Adjoint, factor: float) -> bool:
        """Whether the conditions hold for another lambda."""
        if factor >= adjoint.least:
            return True
        if (np.abs(adjoint.pressure) > factor * self.P).any():
            return False
        drag = np.linalg.norm(adjoint.friction, axis=2)
        if (drag > factor * self._spare).any():
            return False
        return math.isfinite(self.least(goal, adjoint.z, factor))

    @cached_property
    def presses(self) -> np.ndarray:
        """Active contact rows, and with friction those that stick, as booleans.

        Of nodes with more rows than components, such as corners, and where supports hold a part of
        the slip, the normal ones alone: a motion of the support may contradict the others.
        """
        multipliers = self.state.multipliers
        active = multipliers > TOUCHES * max(multipliers.max(initial=0.0), 1e-300)
        conditions = self.bound_data.discrete.contact
        bound = conditions.bound(self.state.contact)
        sticks = (bound > 0) & ~self.state.sliding
        d = conditions.friction.d
        dependent = dependent_forces(conditions.rows, d)[self._normals :]
        fixed = self._slips_in_part_held(d)
        return np.append(active, np.repeat(sticks, d) & ~dependent & ~fixed)

    def _slips_in_part_held(self, d: int) -> np.ndarray:
        """Slips, ``d`` of each row, of nodes that a support holds along a part of them."""
        discrete = self.bound_data.discrete
        nodes = np.repeat(discrete.rows.nodes, d)
        along = discrete.rows.tangents[:, :d].reshape(len(nodes), discrete.problem.N)
        kept = discrete.supports.kept_at(nodes, along)
        return (np.abs(along - kept) > ALONG).any(axis=1)

    def _most(self, factor: float) -> np.ndarray:
        """The largest forces of the rows of an adjoint, for lambda."""
        conditions = self.bound_data.discrete.contact
        drag = np.linalg.norm(self.state.tangential_forces, axis=1)
        left = np.maximum(conditions.bound(self.state.contact) - drag, 0.0)
        d = conditions.friction.d
        each = np.repeat(left, d) / math.sqrt(max(d, 1))
        return factor * np.append(self.state.multipliers, each)

    def _steered(self, found: Held, wanted: np.ndarray, factor: float) -> np.ndarray:
        """z with the rows held that have a pressure or violate the conditions."""
        gap = np.full(len(wanted), np.inf)  # slips have no condition
        gap[: self._normals] = np.maximum(self.state.open_gap, 0.0)
        chosen = self.presses.copy()
        values = wanted.copy()
        for _ in range(HOLDS):
            mismatch = wanted - self.rows.matrix @ found.z.ravel()
            most = factor * gap * (1 + ROUNDING)
            more = ~chosen & (np.abs(mismatch) > most + ROUNDING * np.abs(wanted))
            if not more.any():
                break
            values[more] = wanted[more] - np.sign(mismatch[more]) * factor * gap[more]
            chosen |= more
            found = self.rows.held(found, chosen, values)
        return found.z

    def _pressed(self, start: Start, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Pi and rho at the vertices of facets: rows that press or stick hold.

        Their forces are at most lambda P, and lambda times what friction has left.
        """
        forces = self.rows.limited(start.base, self.presses, self._most(factor))
        contact = self.bound_data.contact
        rows = self.bound_data.discrete.rows
        normal, along = np.split(forces, [self._normals])
        pi = contact.from_rows.stresses(normal)
        if not len(along):
            return pi, np.zeros((*self.P.shape, rows.normals.shape[1]))
        along = along.reshape(rows.tangents.shape[:2])
        forces = np.einsum("md,mdc->mc", along, rows.tangents)
        return pi, contact.from_rows.drag(forces, factor * self._spare)

    def of_rows(self, goal: GoalTerms) -> np.ndarray:
        """The number c at each row: the largest of the facets around it."""
        contact = self.bound_data.contact
        rows = self.bound_data.discrete.rows
        at_nodes = np.zeros(len(self.bound_data.discrete.load))
        for column in contact.nodes.T:
            np.maximum.at(at_nodes, column, goal.factor)
        return at_nodes[rows.nodes]

    def balanced_stress(
        self, start: Start, z: Displaced, pi: np.ndarray, rho: np.ndarray
    ) -> AdjointStress:
        """The stress that is best for z, in equilibrium with the goal's load, pi and rho."""
        goal = start.goal
        bound_data = self.bound_data
        discrete = bound_data.discrete
        contact = bound_data.contact
        moments, carried = goal.carried(bound_data)
        moments = moments.copy()
        forces = start.forces.copy()
        pushed = contact.moments(pi[:, :, None] * contact.normal[:, None] + rho)
        contact.subtract(pushed, moments, forces)
        N = bound_data.cells.N
        other = copy(bound_data)
        other.carried = carried
        is_known = (
            np.array_equal(forces, start.forces) and not discrete.floating.centres
        )
        found = start.base.z if is_known else self.answer(forces)
        other.patches = copy(bound_data.patches)
        length = bound_data.cells.measure.max() ** (1 / (N - 1))
        stiff = discrete.law.bulk.max() * length ** (N - 2)
        u = found + start.lift
        holding = max(stiff * np.abs(u).max(), np.abs(start.forces).max())
        other.patches.smallest = smallest = UNMOVED * holding
        left = self.left_by(found, forces)
        if np.abs(left).max() > UNSOLVED * smallest:
            u = u + self.answer(left)
        near = z if np.array_equal(u, z.u) else Displaced.of(discrete, u)
        return other.adjoint_stress(
            self.state, self.tangent, self._search, near, z, moments
        )
