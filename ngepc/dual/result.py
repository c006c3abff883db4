"""The result of the dual method: status, history and the fields of (y, v)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from ngsolve import H1, CoefficientFunction, GridFunction, Integrate, Norm, ds
from ngsolve.la import BaseVector

from ngepc.discretisation.loads import applied_forces
from ngepc.discretisation.supports import Supports
from ngepc.dual.blocks import primal_energy
from ngepc.dual.functional import DualFunctional, total
from ngepc.dual.spaces import Coupled
from ngepc.model.data import as_scalar
from ngepc.model.own import require_same_mesh
from ngepc.model.problem import Problem
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.fields import Fields, frobenius
from ngepc.results.outcome import History, IterationRecord, Status
from ngepc.results.remarks import at_plastic_points, not_small, turning
from ngepc.results.result import Result


@dataclass(frozen=True, eq=False, repr=False)
class DualResult(Result):
    """The result of ``semismooth_newton`` with gamma; the state is available for every status.

    Parameters
    ----------
    functional
        J*_gamma with its spaces.
    y, v
        Coefficients of (u, p) and of (z, q).
    status, message
        How the run ended, and a message: what happened, and what to try.
    history
        Records of all iterates.
    """

    functional: DualFunctional
    y: BaseVector
    v: BaseVector
    status: Status
    message: str
    history: History

    @classmethod
    def restored(
        cls,
        functional: DualFunctional,
        v: np.ndarray,
        status: Status,
        history: list[IterationRecord],
    ) -> DualResult:
        """A stored result, from v, its status and ``History.as_rows``; y is solved for."""
        vector = functional.blocks.H_vector()
        vector.FV().NumPy()[:] = v
        y = functional.blocks.primal_of(vector)
        note = functional.blocks.note
        stored = cls(functional, y, vector, status, note, History(history))
        return with_remarks(stored)

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return require_same_mesh(self.functional.blocks.problem)

    @property
    def regularisation(self) -> Coupled:
        """The regularisation that it was solved with."""
        return self.functional.regularisation

    @property
    def method_label(self) -> str:
        """'gamma = 1e4': how the problem was regularised."""
        gamma = f"{self.regularisation.gamma:.4g}"
        return f"gamma = {re.sub(r'e[+]0*', 'e', gamma)}"

    @property
    def residual_norm(self) -> float:
        """||Psi_gamma||_{H*} at the end, with y solved for afresh."""
        require_same_mesh(self.functional.blocks.problem)
        return self.functional.at(self.v).residual_norm

    @property
    def residual_rounding(self) -> float:
        """The rounding error of ``residual_norm``; a smaller tolerance cannot be met."""
        return total(self.functional.rounding(self.y))

    @property
    def dual_energy(self) -> float:
        """J*_gamma(v) (force times length)."""
        require_same_mesh(self.functional.blocks.problem)
        return self.functional.at(self.v, self.y).energy

    @cached_property
    def primal_energy(self) -> float:
        """J(u, p) of (2.14) with the (u, p) that F* is attained at (force times length)."""
        return primal_energy(self.problem, self.displacement, self.plastic_increment)

    @property
    def state(self) -> GridFunction:
        """(u, p, z, q) in the compound space; z is empty without contact."""
        require_same_mesh(self.functional.blocks.problem)
        return self._state

    @cached_property
    def _state(self) -> GridFunction:
        state = GridFunction(self.functional.blocks.X)
        state.vec.Range(0, len(self.y)).data = self.y
        state.vec.Range(len(self.y), len(state.vec)).data = self.v
        return state

    @property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self.state.components[0]

    @property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components.

        It is constant on each element, bounded by |q| <= beta in the mean with P1 functions only.
        """
        return self.state.components[1]

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Nodal forces of loads, obstacles (Lambda* v) and supports."""
        blocks = self.functional.blocks
        V = self.functional.blocks.Y.components[0]
        applied = applied_forces(self.problem, V.components[0]).T
        free = Supports(self.problem).free.T

        def nodal(functional: BaseVector) -> np.ndarray:
            """Its values at the components of the displacement, as those of ``applied``."""
            values = functional.Evaluate().FV().NumPy()
            return values[: V.ndof].reshape(applied.shape).copy()

        internal = nodal(blocks.D * self.y - blocks.load)
        contact = nodal(blocks.Lambda.T * self.v)
        return Equilibrium(self.problem, applied, contact, internal - contact, free)

    @property
    def plastic_dual(self) -> GridFunction:
        """The paper's q, near h p + dev alpha_2,0 - dev sigma (3.8), d coordinates (stress)."""
        return self.state.components[3]

    @property
    def yield_function(self) -> CoefficientFunction:
        """|q|_2 - beta, the von Mises yield function by (3.9) (stress)."""
        return Norm(self.plastic_dual) - as_scalar(self.problem.beta)

    yield_excess = yield_function  # > 0 on the active set

    @cached_property
    def normal_stress(self) -> GridFunction:
        """z, the normal stress (sigma n) . n on Gamma_c (stress); zero without contact.

        Inside the body it is the P1 extension, without a meaning.
        """
        z = GridFunction(H1(self.problem.mesh, order=1), name="normal_stress")
        z.Set(self.state.components[2], definedon=self.functional.blocks.contact)
        return z

    @property
    def contact_pressure(self) -> CoefficientFunction:
        """-z on Gamma_c, positive in compression (stress)."""
        return -self.normal_stress

    @property
    def contact_force(self) -> float:
        """Integral of the contact pressure, positive in compression (force)."""
        on_contact = ds(definedon=self.functional.blocks.contact)
        return Integrate(self.contact_pressure * on_contact, self.problem.mesh)


def with_remarks(result: DualResult) -> DualResult:
    """The same with what a user must know of a solution in front of its message."""
    if result.status is not Status.CONVERGED:
        return result
    problem = result.problem
    fields = Fields(problem, result.displacement, result.plastic_increment)
    strain = float(at_plastic_points(problem, frobenius(fields.strain)).max())
    seen = not_small(strain, turning(problem, fields.displacement), fields)
    message = " ".join(filter(None, (seen, result.message)))
    return replace(result, message=message)
