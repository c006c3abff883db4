"""The result of the method at the integration points: the discrete solution and what it tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import H1, CoefficientFunction, GridFunction, Norm

from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.discretisation.points import Moduli
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, Recovered
from ngepc.results.outcome import Ending, History, Status
from ngepc.results.summary import Summarised


@dataclass(frozen=True, eq=False, repr=False)
class ExactResult(Summarised, Recovered, Ending):
    """What ``semismooth_newton`` returns without gamma; the state is there whatever the status.

    Parameters
    ----------
    state
        The last iterate: u, q and the contact forces.
    status
        How the run ended.
    ending
        A sentence about it, empty for a run that converged.
    history
        Records of all iterates.
    """

    state: State
    status: Status
    ending: str
    history: History

    method_label = "exact"

    @property
    def discrete(self) -> DiscreteProblem:
        """The discrete problem that was solved."""
        return self.state.discrete

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.discrete.problem

    @property
    def iterations(self) -> int:
        """Newton steps done."""
        return self.history.records[-1].iteration if self.history.records else 0

    @property
    def residual_norm(self) -> float:
        """Relative norm of the forces out of balance and of what contact leaves."""
        return self.state.residual_norm

    @property
    def residual_rounding(self) -> float:
        """What rounding leaves of ``residual_norm``: a smaller tolerance cannot be met."""
        return self.state.rounding

    @property
    def primal_energy(self) -> float:
        """J(u, p) of (2.14), with int F |slip| where there is friction (force times length)."""
        return self.state.energy

    @cached_property
    def dual_energy(self) -> float:
        """J*(lambda, q), the dual functional of the discrete problem (force times length).

        J + J* >= 0 bounds the energy error of any state, and is zero at the solution.  It takes one
        factorisation: y with D y = (l - N' lambda, q).
        """
        return dual_energy(self.state)

    @cached_property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self.discrete.supports.function(self.state.u)

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        return self._functions.function(self.state.at.plastic_strain, "plastic_increment")

    @cached_property
    def plastic_dual(self) -> GridFunction:
        """The dual variable q = h p - dev sigma + dev alpha_2 (3.8), d components (stress)."""
        return self._functions.function(self.discrete.law.dual_variable(self.state.at), "q")

    @cached_property
    def _functions(self) -> PointFunctions:
        return PointFunctions(self.discrete.points)

    @property
    def fields(self) -> Fields:
        """All fields that follow from (u, p)."""
        return Fields(self.problem, self.displacement, self.plastic_increment)

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Nodal forces of loads, obstacles and supports."""
        state, discrete = self.state, self.discrete
        missing = state.internal_forces + state.contact_forces - discrete.load
        return Equilibrium(
            self.problem,
            discrete.load.T,
            -state.contact_forces.T,
            missing.T,
            discrete.supports.free.T,
        )

    @property
    def nodal_contact_forces(self) -> np.ndarray:
        """Force >= 0 of each contact row, positive in compression, shape (m,)."""
        return self.state.multipliers

    @property
    def contact_force(self) -> float:
        """Resultant of the normal contact pressure, positive in compression (force)."""
        return float(self.state.multipliers.sum())

    @cached_property
    def contact_pressure(self) -> GridFunction:
        """Contact forces over the area that belongs to them (stress), positive in compression.

        Draw it on the contact boundary; inside the body it is the P1 extension and means nothing.
        """
        rows, nv = self.discrete.rows, self.problem.mesh.nv
        pressure = GridFunction(H1(self.problem.mesh, order=1), name="contact_pressure")
        force = np.bincount(rows.vertices, self.state.multipliers, minlength=nv)
        area = np.bincount(rows.vertices, rows.weights, minlength=nv)
        pressure.vec.FV().NumPy()[:] = force / np.where(area > 0, area, 1.0)
        return pressure

    @property
    def contact_area(self) -> float:
        """Area that belongs to the rows with a contact force."""
        return float(self.discrete.rows.weights[self.state.multipliers > 0].sum())

    @cached_property
    def contact_facets(self) -> int:
        """Number of contact facets all of whose vertices are pressed."""
        rows, mesh = self.discrete.rows, self.problem.mesh
        pressed = set(rows.vertices[self.state.multipliers > 0].tolist())
        return sum(
            all(vertex.nr in pressed for vertex in facet.vertices)
            for name in self.problem.contact_names
            for facet in mesh.Boundaries(name).Elements()
        )

    @property
    def penetration(self) -> float:
        """The deepest penetration of a contact row (length), rounding for a solution."""
        return self.state.penetration

    @property
    def yield_excess(self) -> CoefficientFunction:
        """|p| of this step: positive where the body yields, the plastic active set."""
        return Norm(self.plastic_increment)

    @cached_property
    def message(self) -> str:
        """How the run ended, and what a user must know of the solution."""
        return " ".join(filter(None, (self.ending, *observations(self))))


FEW_FACETS = 4
"""Fewer facets in contact do not resolve a contact zone."""

SMALL_STRAIN = 0.1
"""Largest |eps(u)| at the points that small-strain kinematics is meant for."""


def observations(result: ExactResult) -> list[str]:
    """Sentences about a solution that a user must not overlook."""
    state, rows, found = result.state, result.discrete.rows, []
    touching = np.count_nonzero(state.multipliers > 0)
    if len(rows) and not touching:
        nearest = int(state.open_gap.argmin())
        mesh = result.problem.mesh
        place = np.asarray(mesh.ngmesh.Coordinates())[rows.vertices[nearest], : mesh.dim]
        found.append(
            f"Nothing touches the obstacle: the smallest gap left is {state.open_gap[nearest]:.3g} "
            f"at {tuple(float(f'{c:.4g}') for c in place)}."
        )
    elif touching and result.contact_facets < FEW_FACETS:
        found.append(
            f"Only {result.contact_facets} whole facets ({touching} nodes) are in contact: refine "
            "the contact boundary before you trust pressures."
        )
    size = np.sqrt(state.volume**2 / result.problem.kinematics.size + (state.deviator**2).sum(1))
    if size.max(initial=0.0) > SMALL_STRAIN:
        found.append(
            f"Strains reach {size.max():.2g}: small-strain kinematics is meant for less than "
            f"{SMALL_STRAIN:g}."
        )
    return found


def dual_energy(state: State) -> float:
    """J*(lambda, q) at a state (force times length).

    It is minus the least value over y = (u, p) of

        1/2 <D y, y> + l(y) - int q . p + lambda . (N u - gaps),

    where the p that is best for u is p = (q + s) / (2 mu_2 + h) at each point.
    """
    discrete, law, points = state.discrete, state.discrete.law, state.discrete.points
    tangent = Factors(discrete, "sparsecholesky")
    h, two_mu, q = law.hardening, law.two_mu, -law.projected(state.yielding)
    zero, direction = np.zeros_like(two_mu), np.zeros_like(q)
    tangent.update(Moduli(law.bulk, two_mu * h / (two_mu + h), zero, direction))
    u = state.u
    for _ in range(2):
        volume, e = points.strain(u)
        p = (q + law.returned(e).trial) / (two_mu + h)[:, None]
        stress = two_mu[:, None] * (e - law.initial - p)
        forces = points.forces(law.bulk * volume, stress)
        u = u + tangent.solve(discrete.load - state.contact_forces - forces)
    volume, e = points.strain(u)
    p = (q + law.returned(e).trial) / (two_mu + h)[:, None]
    elastic = e - p - law.initial
    density = 0.5 * (law.bulk * volume**2 + two_mu * (elastic**2 - law.initial**2).sum(1))
    density += 0.5 * h * (p**2).sum(1) + ((law.back - q) * p).sum(1)
    work = np.vdot(discrete.load, u) + state.multipliers @ discrete.rows.open_gap(u)
    return -(points.integral(density) - float(work))
