"""The result of the dual method: status, history and the fields that (y, v) stand for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ngsolve import (
    CF,
    H1,
    CoefficientFunction,
    GridFunction,
    IfPos,
    InnerProduct,
    Norm,
    ds,
)
from ngsolve.la import BaseVector

from ngepc.discretisation.pointfunctions import interpolated
from ngepc.dual.blocks import primal_energy
from ngepc.dual.friction import slip, tangent
from ngepc.dual.functional import DualFunctional
from ngepc.dual.regularisation import plastic_threshold
from ngepc.model.problem import Problem, as_scalar
from ngepc.parallel import integral
from ngepc.primal.return_mapping import ReturnMapping
from ngepc.results.equilibrium import Equilibrium, applied_forces
from ngepc.results.fields import Fields, Recovered
from ngepc.results.outcome import Ending, History, Status


@dataclass(frozen=True, eq=False)
class DualResult(Recovered, Ending):
    """What ``semismooth_newton`` returns; the state is there whatever the status says.

    Parameters
    ----------
    functional
        J*_gamma with its spaces.
    y, v
        Coefficients of (u, p) and of (z, q), with friction (z, t, q).
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

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.functional.blocks.problem

    @property
    def iterations(self) -> int:
        """Newton steps done."""
        return self.history.records[-1].iteration

    @property
    def residual_norm(self) -> float:
        """||Psi_gamma||_{H*} at the end, with y solved for afresh."""
        y = self.y.CreateVector()
        self.functional.blocks.primal_of(self.v, y)
        residual = self.functional.residual(y, self.v)
        return self.functional.stationarity_norms(self.v, residual).total

    @property
    def residual_rounding(self) -> float:
        """What rounding leaves of ``residual_norm``, in whatever way that is computed.

        A tolerance below it cannot be met, see ``ngepc.dual.stopping``.
        """
        return self.functional.rounding(self.y).total

    @property
    def dual_energy(self) -> float:
        """J*_gamma(v) (force times length)."""
        return self.functional.smooth_energy(self.y, self.v) + self.functional.penalty(self.v)

    @cached_property
    def primal_energy(self) -> float:
        """J(u, p) of (2.14) with the (u, p) that F* is attained at (force times length)."""
        return primal_energy(self.problem, self.displacement, self.balanced_increment)

    @cached_property
    def state(self) -> GridFunction:
        """(u, p, z, t, q) in the compound space; no z without contact, no t without friction."""
        blocks = self.functional.blocks
        state = GridFunction(blocks.X)
        own = state.vec.local_vec
        own.Range(0, blocks.Y.ndof).data = self.y.local_vec
        own.Range(blocks.Y.ndof, blocks.X.ndof).data = self.v.local_vec
        return state

    @cached_property
    def _primal(self) -> GridFunction:
        primal = GridFunction(self.functional.blocks.Y)
        primal.vec.data = self.y
        return primal

    @property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self._primal.components[0]

    @cached_property
    def balanced_increment(self) -> CoefficientFunction:
        """The p of y, d components: with it the stress is in equilibrium, and the energies hold."""
        blocks, choice = self.functional.blocks, self.functional.regularisation.plastic_strain
        p, q = self._primal.components[1], self.state.components[-1]
        return choice.increment(self.problem, blocks.h_F, p, q)

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components.

        The p of y is constant on each element, but bounded by |q| <= beta in the mean with P1
        functions only, and carries what these do not see.  Where the plastic term is exact (the
        hardening is split) p is therefore the return mapping of u, the p with the least J(u, p);
        docs/balanced.md has the errors of both.  Otherwise it is that of y.
        """
        if self.functional.regularisation.hardening_share == 1:
            return self.balanced_increment
        mapping = ReturnMapping(self.problem, self.displacement)
        return interpolated(self.problem, mapping.plastic_increment)

    @cached_property
    def fields(self) -> Fields:
        """All fields that follow from (u, p); the stress from y."""
        increments = self.plastic_increment, self.balanced_increment
        return Fields(self.problem, self.displacement, *increments)

    @cached_property
    def equilibrium(self) -> Equilibrium:
        """Nodal forces of loads, obstacles (Lambda* v) and supports."""
        blocks, V = self.functional.blocks, self.functional.blocks.Y.components[0]
        internal, contact = self.y.CreateVector(), self.y.CreateVector()
        internal.data = blocks.D * self.y - blocks.load
        contact.data = blocks.Lambda.T * self.v
        applied = applied_forces(self.problem, V)
        internal, contact = (
            f.FV().NumPy()[: V.ndof].reshape(applied.shape).copy() for f in (internal, contact)
        )
        return Equilibrium.of(self.problem, applied, contact, internal - contact)

    @property
    def plastic_dual(self) -> CoefficientFunction:
        """The paper's q = h p - dev sigma (3.8) in d coordinates (stress), see docs/balanced.md."""
        h_G = self.problem.effective_hardening * (
            1 - self.functional.regularisation.hardening_share
        )
        q = self.state.components[-1]
        return q + h_G * self.balanced_increment

    @property
    def yield_function(self) -> CoefficientFunction:
        """|q|_2 - beta, the von Mises yield function by (3.9) (stress)."""
        return Norm(self.plastic_dual) - as_scalar(self.problem.beta)

    @cached_property
    def normal_stress(self) -> CoefficientFunction:
        """z, the normal stress (sigma n) . n on Gamma_c (stress); zero without contact.

        Inside the body it is the P1 extension and means nothing.
        """
        if not self.problem.contact_names:
            return as_scalar(0.0)
        z = GridFunction(H1(self.problem.mesh, order=1), name="normal_stress")
        on_contact = self.problem.mesh.Boundaries("|".join(self.problem.contact_names))
        z.Set(self.state.components[2], definedon=on_contact)
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
        return integral(self.contact_pressure * on_contact, self.problem.mesh)

    @property
    def friction_stress(self) -> CoefficientFunction:
        """Tangential traction on Gamma_c, N components (stress); zero without friction.

        It is t along (-n_y, n_x) in two dimensions, the tangential part of t in three.
        """
        if self.problem.friction is None:
            return CF((0.0,) * self.problem.N)
        t = self.state.components[3]
        return t * tangent(self.problem) if self.problem.N == 2 else slip(self.problem, t)

    @property
    def friction_force(self) -> tuple[float, ...]:
        """Resultant of the friction stress on the body, N components (force)."""
        if self.problem.friction is None:
            return (0.0,) * self.problem.N
        on_contact = ds("|".join(self.problem.contact_names))
        t = self.friction_stress
        return tuple(integral(t[i] * on_contact, self.problem.mesh) for i in range(self.problem.N))

    @property
    def yield_excess(self) -> CoefficientFunction:
        """|q| + nu^/gamma - beta_gamma with the q of J*_gamma (stress): > 0 on the active set."""
        threshold = plastic_threshold(self.problem, self.functional.regularisation)
        return Norm(self.state.components[-1]) - as_scalar(threshold)

    @property
    def sliding(self) -> CoefficientFunction:
        """1 on the part of Gamma_c that slips, |t| > friction bound; 0 where it sticks."""
        if self.problem.friction is None:
            return CF(1.0)
        t = self.state.components[3]
        return IfPos(InnerProduct(t, t) - as_scalar(self.problem.friction) ** 2, 1.0, 0.0)
