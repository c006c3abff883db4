"""The door: solve the discrete problem of one time step exactly, from zero or an earlier result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.declared import Check, Declared
from ngepc.discretisation.prolongation import at_vertices, nodal_values
from ngepc.discretisation.stiffness import Blocks, StiffnessBlocks, SymbolicBlocks
from ngepc.linalg.direct import require_solver
from ngepc.local.active_set import InexactTarget
from ngepc.local.factors import Factors
from ngepc.local.iterative import Iterative, IterativeTangent
from ngepc.local.newton import primal_dual_newton
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.results.outcome import Monitor


def solve_exactly(
    problem: Problem,
    start: object | None,
    tolerance: float,
    max_iterations: int,
    inverse: str | Iterative | SymbolicForms,
    monitor: Monitor | None,
) -> ExactResult:
    """Minimise J(u, p) of (2.14) over the discrete displacements with N u <= gaps.

    Arguments as of ``semismooth_newton`` and ``NewtonOptions``.
    """
    discrete, target = DiscreteProblem(problem), None
    state = starting_state(discrete, start)
    if isinstance(inverse, str):
        tangent = Factors(discrete, inverse)
    else:
        blocks = StiffnessBlocks(discrete.points, discrete.free, discrete.added)
        tangent = inverse.tangent(discrete, blocks)
        if inverse.forcing is not None:
            target = InexactTarget(discrete, inverse.forcing, tolerance)
    return primal_dual_newton(discrete, state, tangent, tolerance, max_iterations, monitor, target)


@dataclass(frozen=True, kw_only=True)
class SymbolicForms(Declared):
    """A linear solver whose tangents are assembled by a form of NGSolve, the same but slower.

    Parameters
    ----------
    inverse
        The solver, as in ``NewtonOptions``.

    Raises
    ------
    ValueError
        If there is no such solver.
    """

    inverse: Annotated[str | Iterative, Check(require_solver)] = "sparsecholesky"

    @property
    def forcing(self) -> float | None:
        """As for ``Iterative``; None for systems that are solved exactly."""
        return getattr(self.inverse, "forcing", None)

    def tangent(self, discrete: DiscreteProblem, blocks: Blocks) -> Factors | IterativeTangent:
        """The tangent of a discrete problem."""
        if not isinstance(discrete, DiscreteProblem):
            raise ValueError(f"inverse={self!r}: primal_newton has symbolic forms of its own")
        blocks = SymbolicBlocks(discrete.points, discrete.free, discrete.added)
        if isinstance(self.inverse, str):
            return Factors(discrete, self.inverse, blocks)
        return self.inverse.tangent(discrete, blocks)


def starting_state(discrete: DiscreteProblem, start: object | None) -> State:
    """The state to start from: prescribed displacements alone, or those of ``start`` inside.

    ``start`` is a displacement or a result that has one, on this or another mesh; forces of contact
    are carried over by their stresses.  TypeError or ValueError if it is no displacement.
    """
    supports, u, forces = discrete.supports, discrete.supports.values.copy(), None
    if start is not None:
        u = np.where(supports.free, nodal_values(start, discrete.problem), u)
        forces = carried_forces(discrete, start)
    return discrete.state(discrete.contact.on_rollers(u, supports.free), contact=forces)


def carried_forces(discrete: DiscreteProblem, start: object) -> np.ndarray | None:
    """Forces of contact from the stresses of an earlier result, None if it has none."""
    pressure, rows = getattr(start, "contact_pressure", None), discrete.rows
    if not isinstance(pressure, GridFunction) or not len(rows):
        return None
    normal = np.maximum(_on_rows(pressure, discrete)[:, 0], 0.0) * rows.weights
    normal = np.where(rows.tied, 0.0, normal)
    if not discrete.contact.friction.d:
        return normal
    friction = getattr(start, "friction_stress", None)
    tangential = np.zeros((len(rows), rows.tangents.shape[1]))
    if isinstance(friction, GridFunction):
        stress = _on_rows(friction, discrete)
        tangential = -np.einsum("mdj,mj,m->md", rows.tangents, stress, rows.weights)
    return np.concatenate([normal, tangential.ravel()])


def _on_rows(function: GridFunction, discrete: DiscreteProblem) -> np.ndarray:
    """A P1 function, on this or another mesh, at the vertices of the rows: (m, components)."""
    own, mesh, vertices = function.space.mesh, discrete.problem.mesh, discrete.rows.vertices
    values = function.vec.FV().NumPy().reshape(-1, own.nv).T
    return values[vertices] if own is mesh else at_vertices(own, values, mesh, vertices)
