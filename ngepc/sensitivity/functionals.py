"""Functionals of a solution with their derivatives: forces, energies, displacements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Protocol

import numpy as np
from ngsolve import VOL, ElementId

from ngepc.checks.arguments import boundary_names, require_integer, require_vector
from ngepc.checks.kinds import require_text
from ngepc.local.system import State
from ngepc.sensitivity.contact import RowSides
from ngepc.sensitivity.radial import Data


@dataclass(frozen=True, eq=False)
class Slope:
    """The value and the derivative of a functional F(u, p, tau, mean, x; data) at a state.

    ``u`` is with respect to nodal displacements, shape (nodes, N); ``p``, ``stress`` and ``mean``
    with respect to the plastic strain gained and the deviatoric stress (points, d), and to the
    mean stress (points,), densities: the weights of the points are left out; ``contact`` with
    respect to ``State.contact``, ``explicit`` to the data themselves.  0 stands for none.
    """

    value: float
    u: np.ndarray | float = 0.0
    p: np.ndarray | float = 0.0
    stress: np.ndarray | float = 0.0
    mean: np.ndarray | float = 0.0
    contact: np.ndarray | float = 0.0
    explicit: Data = field(default_factory=dict)

    def of_points(self, state: State, p: np.ndarray, stress: np.ndarray, mean: np.ndarray) -> float:
        """The part of a change of F that changes at the points make."""
        local = (self.p * p + self.stress * stress).sum(axis=1) + self.mean * mean
        return state.discrete.points.integral(local)


class Functional(Protocol):
    """What derivatives are taken of."""

    def slope(self, state: State) -> Slope:
        """Value and derivative at a state."""
        ...


def _contact_force(state: State) -> Slope:
    """The resultant of the normal contact forces, positive in compression (force)."""
    contact, pressing = np.zeros_like(state.contact), ~state.discrete.rows.tied
    contact[: len(pressing)] = pressing
    return Slope(float(contact @ state.contact), contact=contact)


def _primal_energy(state: State) -> Slope:
    """J(u, p) of (2.14), with the sum of b |slip| where there is friction (force times length).

    p is best for u, so that J depends on u and on the data.
    """
    law, at = state.discrete.law, state.at
    elastic = law.stress(at) / law.two_mu[:, None]
    forces = state.internal_forces - state.discrete.load
    sides, still = RowSides(state), np.zeros(len(state.multipliers))
    slip, bound = (np.where(sides.slips, a, 0.0) for a in (sides.slip, sides.bound))
    dragged = state.discrete.contact.forces(sides.stacked(still, bound))
    explicit = {
        "two_mu": 0.5 * ((elastic**2).sum(1) - (law.initial**2).sum(1)),
        "bulk": 0.5 * state.volume**2,
        "hardening": 0.5 * at.gained**2,
        "beta": at.gained,
        "back": at.plastic_strain,
        "initial": -law.two_mu[:, None] * (elastic + law.initial),
        "load": -state.u,
        "start": -dragged,
        "cap": np.where(sides.grows, 0.0, slip),
        "coefficient": np.where(sides.grows, state.multipliers * slip, 0.0),
    }
    on_contact = sides.stacked(sides.coefficient * slip, still)
    return Slope(state.energy, u=forces + dragged, contact=on_contact, explicit=explicit)


def _elastic_energy(state: State) -> Slope:
    """1/2 int sigma : (eps(u) - p_0 - p), what the body gives back (force times length)."""
    law = state.discrete.law
    elastic = law.stress(state.at) / law.two_mu[:, None]
    sizes, volumes = (elastic**2).sum(axis=1), state.volume**2
    energy = state.discrete.points.integral(0.5 * (law.bulk * volumes + law.two_mu * sizes))
    explicit = {"bulk": -0.5 * volumes, "two_mu": -0.5 * sizes}
    return Slope(energy, stress=elastic, mean=state.volume, explicit=explicit)


def _dissipation(state: State) -> Slope:
    """Int beta |p|, what the plastic strain of the step costs (force times length)."""
    beta, at = state.discrete.law.beta, state.at
    value = state.discrete.points.integral(beta * at.gained)
    return Slope(value, p=beta[:, None] * at.direction, explicit={"beta": at.gained})


_SLOPES = (_contact_force, _primal_energy, _elastic_energy, _dissipation)
NAMES = {slope.__name__[1:]: SimpleNamespace(slope=slope) for slope in _SLOPES}
"""Functionals that a name is enough for."""


@dataclass(frozen=True)
class DisplacementAt:
    """One component of the displacement at a point (length).

    Parameters
    ----------
    point
        N coordinates, in the body.
    component
        0, 1 or 2.
    """

    point: Sequence[float]
    component: int

    def __post_init__(self) -> None:
        require_vector("point", self.point, (2, 3))
        require_integer("component", self.component, 0, 2)

    def slope(self, state: State) -> Slope:
        """Value and derivative at a state.

        Raises
        ------
        TypeError, ValueError
            If the point is not in the body, or there is no such component.
        """
        points, N = state.discrete.points, state.discrete.problem.N
        place = require_vector("point", self.point, (N,))
        component = require_integer("component", self.component, 0, N - 1)
        if not points.mesh.Contains(*place):
            raise ValueError(f"point={self.point!r}: a point in the body is needed")
        there = points.mesh(*place)
        element = ElementId(VOL, there.nr)
        shape = np.array(points.scalar.GetFE(element).CalcShape(*there.pnt))
        u = np.zeros_like(state.u)
        u[list(points.scalar.GetDofNrs(element)), component] = shape
        return Slope(float(np.vdot(u, state.u)), u=u)


@dataclass(frozen=True)
class Reaction:
    """One component of the force of a support on the body (force).

    Parameters
    ----------
    support
        Name of a clamped or prescribed boundary.
    component
        0, 1 or 2.
    """

    support: str
    component: int

    def __post_init__(self) -> None:
        require_text("support", self.support)
        require_integer("component", self.component, 0, 2)

    def slope(self, state: State) -> Slope:
        """Value and derivative at a state: the work of all forces in a motion of the support.

        Raises
        ------
        TypeError, ValueError
            If there is no such support or component.
        """
        discrete, problem = state.discrete, state.discrete.problem
        component = require_integer("component", self.component, 0, problem.N - 1)
        (name,) = boundary_names("support", self.support, problem.mesh)
        region = problem.mesh.Boundaries(name)
        there = np.array(discrete.supports.space.components[component].GetDofs(region), dtype=bool)
        there[problem.mesh.nv :] = False
        motion = np.zeros_like(state.u)
        motion[there, component] = ~discrete.supports.free[there, component]
        if not motion.any():
            raise ValueError(f"support={self.support!r}: it does not hold component {component}")
        missing = state.internal_forces + state.contact_forces - discrete.load
        volume, e = discrete.points.strain(motion)
        rows, value = discrete.contact.displacement(motion), float(np.vdot(motion, missing))
        return Slope(value, stress=e, mean=volume, contact=rows, explicit={"load": -motion})
