"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy under the contact conditions N u <= gaps.  All iterates but the start are
feasible and every step goes downhill.

Everything is assembled from symbolic forms of NGSolve: it checks ``ngepc.local`` independently,
with which it shares supports, loads, integration rules, contact rows, factors and the loop
(``results.iteration``); energy, tangent and plastic strain are its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from ngsolve import GridFunction, InnerProduct, Norm

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.kinds import require_function, require_instance
from ngepc.discretisation.factors import tangent_of
from ngepc.discretisation.points import interpolated
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.linalg.direct import require_solver
from ngepc.model.data import as_scalar
from ngepc.model.own import own_copy, require_same_mesh
from ngepc.model.problem import Problem
from ngepc.primal.energy import PrimalState, ReducedEnergy
from ngepc.results.fields import frobenius
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor
from ngepc.results.result import DiscreteSolution


@dataclass(frozen=True, kw_only=True)
class PrimalOptions(Declared):
    """Options of ``primal_newton``.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the residual forces and of the contact
        defect, relative to the larger of the norms of applied and internal forces, or to the
        smaller of beta/h and 4e-6 |K| |u|, where strains cancel; in [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.
    inverse
        NGSolve's name of a direct solver, or, for large bodies, ``PETSc()`` or ``PyAMG()``.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: Annotated[float, Check(require_number, least=1e-13, below=1)] = 1e-10
    max_iterations: Count = 100
    inverse: Annotated[str | object, Check(require_solver)] = "sparsecholesky"


class PrimalResult(DiscreteSolution):
    """The last state of ``primal_newton``, see ``DiscreteSolution``."""

    state: PrimalState
    method_label = "exact (primal)"

    @cached_property
    def largest_strain(self) -> float:
        """The largest |eps(u)| at the points."""
        mesh = self.problem.mesh
        rules = self.state.body.rules
        points = mesh.MapToAllElements(rules, mesh.Materials(".*"))
        return self.problem.processes.maximum(
            np.asarray(frobenius(self.strain)(points))
        )

    @cached_property
    def dual_energy(self) -> float:
        """-J by an identity that holds at the solution only.

        J = 1/2 (l(u, p) + int beta |p| - contact forces . N u + <reactions, prescribed u>), (2.15),
        (2.16), without friction; with friction its work is added.  With a law of hardening the
        integral is chosen such that the sum is 2 J.  The sum with ``primal_energy`` measures the
        remaining error.
        """
        state = self.state
        reduced = state.body
        mapping = state.here.mapping
        problem = mapping.problem
        p_0 = problem.p_0
        p = mapping.plastic_increment
        back = problem.kinematics.coordinates(problem.alpha_0[1])
        density = (
            2 * mapping.hardening_energy
            - mapping.bound * Norm(p)
            + InnerProduct(back, p)
            - 2 * as_scalar(problem.material.lame_mu) * InnerProduct(p_0, p_0)
            - InnerProduct(mapping.stress, p_0 + problem.eps_0)
        )
        fixed = np.where(reduced.free, 0.0, state.residual_force)
        work = float(np.vdot(fixed - state.contact_forces - reduced.load, state.u))
        friction = -state.contact @ state.gaps + state.multipliers @ state.open_gap
        return -0.5 * (reduced.integral(density.Compile()) + work) - friction

    @property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        require_same_mesh(self.state.body.problem)
        return self._plastic_increment

    @cached_property
    def _plastic_increment(self) -> GridFunction:
        increment = self.state.here.mapping.plastic_increment
        return interpolated(self.problem, increment)


@one_blas_thread
@crew()
def primal_newton(
    problem: Problem,
    start: GridFunction | object | None = None,
    options: PrimalOptions | None = None,
    monitor: Monitor | None = None,
) -> PrimalResult:
    """Minimise J(u, p) of (2.14) over continuous displacements and pointwise plastic strains.

    The points are those of ``discretisation.rules``, for all kinematics and both orders.

    Parameters
    ----------
    problem
        Data of the time step.
    start
        A displacement to start from: a GridFunction or any result with ``displacement``, on this
        or on another mesh of the body (it is evaluated at the vertices).  None starts from zero.
    options
        Tolerance and limits; None for the defaults.
    monitor
        Called with the record of every iterate; raising StopIteration ends the run.

    Returns
    -------
    PrimalResult
        ``status`` is CONVERGED only if the residual of the returned state meets the tolerance.

    Raises
    ------
    TypeError
        If ``problem``, ``start`` or ``options`` is of the wrong kind.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_function("monitor", monitor, "a record", optional=True)
    options = PrimalOptions() if options is None else options
    require_instance("options", options, PrimalOptions, "PrimalOptions(...)")
    body = ReducedEnergy(own_copy(problem))
    u = body.starting_displacement(start)
    state = PrimalState(body, u, np.zeros(len(body.contact)))
    tangent = tangent_of(body, options.inverse)
    limits = options.tolerance, options.max_iterations
    return newton_iteration(state, tangent, PrimalResult, *limits, monitor)
