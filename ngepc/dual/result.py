"""The result of the dual method: status, history and the fields that (y, v) stand for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ngsolve import H1, CoefficientFunction, GridFunction, Integrate, Norm, ds
from ngsolve.la import BaseVector

from ngepc.discretisation.loads import Supports, applied_forces
from ngepc.dual.blocks import CONTACT, PLASTIC, primal_energy
from ngepc.dual.functional import DualFunctional
from ngepc.dual.iterates import Iterate
from ngepc.dual.spaces import Coupled
from ngepc.model.problem import Problem, as_scalar
from ngepc.results.equilibrium import Equilibrium
from ngepc.results.outcome import History, Status
from ngepc.results.result import Result


@dataclass(frozen=True, eq=False, repr=False)
class DualResult(Result):
    """What ``semismooth_newton`` returns; the state is there whatever the status says.

    Parameters
    ----------
    functional
        J*_gamma with its spaces.
    y, v
        Coefficients of (u, p) and of (z, q).
    status, message
        How the run ended; the message says what was seen and what to try.
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
    def at(
        cls, functional: DualFunctional, v: BaseVector, status: Status, history: History
    ) -> DualResult:
        """The result with dual variable ``v``, the primal one solved for afresh."""
        return cls(functional, functional.blocks.primal_of(v), v, status, "", history)

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.functional.blocks.problem

    @property
    def method_label(self) -> str:
        """'gamma = 1e4': how the problem was regularised."""
        return f"gamma = {self.regularisation.gamma:.4g}"

    @property
    def regularisation(self) -> Coupled:
        """The regularisation that it was solved with."""
        return self.functional.regularisation

    @property
    def residual_norm(self) -> float:
        """||Psi_gamma||_{H*} at the end, with y solved for afresh."""
        return Iterate.at(self.functional, self.v).norms.total

    @property
    def residual_rounding(self) -> float:
        """What rounding leaves of ``residual_norm``; no tolerance below it can be met."""
        return self.functional.rounding(self.y).total

    @property
    def dual_energy(self) -> float:
        """J*_gamma(v) (force times length)."""
        return Iterate(self.functional, self.y, self.v, self.functional.terms(self.v)).energy

    @cached_property
    def primal_energy(self) -> float:
        """J(u, p) of (2.14) with the (u, p) that F* is attained at (force times length)."""
        return primal_energy(self.problem, self.displacement, self.plastic_increment)

    @cached_property
    def _fields(self) -> dict[str, GridFunction]:
        return self.functional.blocks.fields(self.y, self.v)

    @property
    def state(self) -> GridFunction:
        """(u, p, z, q) in the compound space; no z without contact."""
        return self._fields["state"]

    @property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self._fields["displacement"]

    @property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components.

        It is constant on each element, bounded by |q| <= beta in the mean with P1 functions only.
        """
        return self._fields["plastic_strain"]

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Nodal forces of loads, obstacles (Lambda* v) and supports."""
        blocks, V = self.functional.blocks, self.functional.blocks.Y.components[0]
        internal, contact = self.y.CreateVector(), self.y.CreateVector()
        internal.data = blocks.D * self.y - blocks.load
        contact.data = blocks.Lambda.T * self.v
        applied, free = applied_forces(self.problem, V).T, Supports(self.problem).free.T
        internal, contact = (
            f.FV().NumPy()[: V.ndof].reshape(applied.shape).copy() for f in (internal, contact)
        )
        return Equilibrium(self.problem, applied, contact, internal - contact, free)

    @property
    def plastic_dual(self) -> GridFunction:
        """The paper's q = h p - dev sigma (3.8) in d coordinates (stress)."""
        return self._fields[PLASTIC]

    @property
    def yield_function(self) -> CoefficientFunction:
        """|q|_2 - beta, the von Mises yield function by (3.9) (stress)."""
        return Norm(self.plastic_dual) - as_scalar(self.problem.beta)

    @property
    def yield_excess(self) -> CoefficientFunction:
        """|q| - beta (stress): > 0 on the active set."""
        return self.yield_function

    @cached_property
    def normal_stress(self) -> CoefficientFunction:
        """z, the normal stress (sigma n) . n on Gamma_c (stress); zero without contact.

        Inside the body it is the P1 extension and means nothing.
        """
        if CONTACT not in self._fields:
            return as_scalar(0.0)
        z = GridFunction(H1(self.problem.mesh, order=1), name="normal_stress")
        on_contact = self.problem.mesh.Boundaries("|".join(self.problem.contact_names))
        z.Set(self._fields[CONTACT], definedon=on_contact)
        return z

    @property
    def contact_pressure(self) -> CoefficientFunction:
        """-z on Gamma_c, positive in compression (stress)."""
        return -self.normal_stress

    @property
    def contact_force(self) -> float:
        """Resultant of the normal contact pressure, positive in compression (force)."""
        if not self.problem.contact_names:
            return 0.0
        on_contact = ds("|".join(self.problem.contact_names))
        return Integrate(self.contact_pressure * on_contact, self.problem.mesh)
