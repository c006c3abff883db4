"""What the primal solver gives back: fields, forces, energies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve import H1, CoefficientFunction, GridFunction, Norm

from ngepc.discretisation.contact import NodalContact
from ngepc.discretisation.return_mapping import interpolated
from ngepc.model.problem import Problem
from ngepc.primal.energy import ReducedEnergy
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, Recovered
from ngepc.results.outcome import Ending, History, Status

ROUNDING_SCALE = 4e-6
"""Part of ``ReducedEnergy.trial_forces`` of which rounding leaves ROUNDING."""

ROUNDING = 1e-10


@dataclass(frozen=True, eq=False)
class State:
    """An iterate with everything that follows from it.

    Parameters
    ----------
    u
        Nodal displacements, shape (N, vertices).
    energy
        J, smallest over p.
    forces
        Internal nodal forces, shape (N, vertices).
    gradient
        Internal minus applied forces at the free components, zero elsewhere.
    multipliers
        Nodal contact forces >= 0, one for each contact row; zero where the gap is open.
    residual_norm
        Forces out of balance, relative; infinite if an obstacle is penetrated.
    rounding
        What rounding leaves of ``residual_norm``.
    """

    u: np.ndarray
    energy: float
    forces: np.ndarray
    gradient: np.ndarray
    multipliers: np.ndarray
    residual_norm: float
    rounding: float

    @classmethod
    def at(
        cls, energy: ReducedEnergy, contact: NodalContact, u: np.ndarray, distance: float
    ) -> State:
        """The state with displacements ``u``; nodes within ``distance`` of the obstacle touch."""
        value, forces = energy.energy(u), energy.internal_forces(u)
        gradient = np.where(energy.free, forces - energy.load, 0.0)
        open_gap = contact.open_gap(u)
        multipliers = contact.multipliers(gradient, open_gap <= distance)
        balance = gradient + np.where(energy.free, contact.nodal_forces(multipliers, u.shape[1]), 0)
        trial = ROUNDING_SCALE * energy.trial_forces(u)
        scale = max(
            np.linalg.norm(energy.load),
            np.linalg.norm(forces),
            min(trial, energy.yield_forces),
        )
        residual = float(np.linalg.norm(balance))
        relative = 0.0 if residual == 0 else residual / scale
        rounding = ROUNDING * trial / scale if trial > 0 else 0.0
        if open_gap.min(initial=0.0) < -distance:
            relative = float("inf")
        return cls(u, value, forces, gradient, multipliers, relative, rounding)

    @property
    def size(self) -> float:
        """Magnitude of the terms that make up the energy."""
        return abs(self.energy) + float(np.vdot(np.abs(self.forces), np.abs(self.u)))

    def slope(self, direction: np.ndarray, held: np.ndarray) -> float:
        """Derivative of the energy along ``direction``; ``held`` are forces that do no work."""
        return float(np.vdot(self.gradient + held, direction))


@dataclass(frozen=True, eq=False, kw_only=True)
class PrimalResult(Recovered, Ending):
    """The last state of ``primal_newton``.

    Parameters
    ----------
    status, message
        How the run ended, and what was seen.
    problem
        The problem that was solved.
    history
        Records of the iterates, start included.
    residual_norm
        Relative norm of the nodal forces out of balance, ``PrimalOptions.tolerance``.
    primal_energy
        J(u, p), (2.14) (force times length).
    dual_energy
        -J at the solution, by the identity J = 1/2 (l(u, p) + int beta|p| - <lambda, psi> +
        <reactions, prescribed u>), which the solution satisfies: the sum with ``primal_energy``
        is a measure of what is left.
    displacement
        u (length).
    plastic_increment
        Coordinates of the plastic strain gained in this step at the plastic points (1).
    contact
        The rows n_i . u_i <= psi_i.
    nodal_contact_forces
        Force >= 0 of each row, positive in compression.
    contact_force
        Their sum: the resultant of the normal contact pressure, positive in compression.
    equilibrium
        Nodal forces of loads, obstacles and supports.
    """

    status: Status
    message: str
    problem: Problem
    history: History
    residual_norm: float
    primal_energy: float
    dual_energy: float
    displacement: GridFunction
    plastic_increment: GridFunction
    contact: NodalContact
    nodal_contact_forces: np.ndarray
    contact_force: float
    equilibrium: Equilibrium

    @classmethod
    def at(
        cls,
        energy: ReducedEnergy,
        contact: NodalContact,
        state: State,
        history: History,
        status: Status,
        message: str,
    ) -> PrimalResult:
        """The result for a state of the discrete problem ``energy`` with ``contact``."""
        energy.set(state.u)
        pushes = contact.nodal_forces(state.multipliers, state.u.shape[1])
        missing = state.forces - energy.load + pushes
        equilibrium = Equilibrium(energy.problem, energy.load, -pushes, missing, energy.free)
        first_order = energy.first_order_energy(state.u)
        work = np.vdot(equilibrium.reaction, state.u) - state.multipliers @ contact.gaps
        displacement = GridFunction(energy.space, name="displacement")
        energy.array(displacement)[:] = state.u
        return cls(
            status=status,
            message=message,
            problem=energy.problem,
            history=history,
            residual_norm=state.residual_norm,
            primal_energy=state.energy,
            dual_energy=-0.5 * (first_order + work),
            displacement=displacement,
            plastic_increment=interpolated(energy.problem, energy.mapping.plastic_increment),
            contact=contact,
            nodal_contact_forces=state.multipliers,
            contact_force=float(state.multipliers.sum()),
            equilibrium=equilibrium,
        )

    @property
    def iterations(self) -> int:
        """Newton steps that were done: factorisations."""
        return len(self.history.records) - 1

    @property
    def fields(self) -> Fields:
        """Stresses, back stress, yield function, zones of (u, p)."""
        return Fields(self.problem, self.displacement, self.plastic_increment)

    @property
    def contact_pressure(self) -> GridFunction:
        """Nodal contact forces over the lumped boundary mass (stress), positive in compression.

        Draw it on the contact boundary; inside the body it is the P1 extension and means nothing.
        """
        pressure = GridFunction(H1(self.problem.mesh, order=1), name="contact_pressure")
        force, mass = np.zeros((2, self.problem.mesh.nv))
        np.add.at(force, self.contact.vertices, self.nodal_contact_forces)
        np.add.at(mass, self.contact.vertices, self.contact.masses)
        pressure.vec.FV().NumPy()[mass > 0] = force[mass > 0] / mass[mass > 0]
        return pressure

    @property
    def yield_excess(self) -> CoefficientFunction:
        """|p| of this step: positive where the body yields, the plastic active set."""
        return Norm(self.plastic_increment)
