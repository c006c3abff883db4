"""The primal reference solver: Newton on the displacement alone, exact contact, no regularisation.

The plastic strain is eliminated point by point (``return_mapping``); what is left is a convex,
differentiable energy phi(u) under the nodal conditions n_i . u_i <= psi_i.  Each step minimises
Newton's quadratic model of phi over the *feasible* set: one factorisation, and a complementarity
problem on the contact nodes that is solved exactly by primal-dual active sets.  All iterates are
feasible, every step goes downhill, and the line search on phi makes cycles impossible.
"""

from __future__ import annotations

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.kinds import require_function, require_instance
from ngepc.discretisation.prolongation import at_points
from ngepc.model.problem import Problem
from ngepc.primal.options import PrimalOptions
from ngepc.primal.result import PrimalResult
from ngepc.primal.run import Monitor, Run


def primal_newton(
    problem: Problem,
    start: GridFunction | object | None = None,
    options: PrimalOptions | None = None,
    monitor: Monitor | None = None,
) -> PrimalResult:
    """Minimise J(u, p) of (2.14) over P1 displacements and pointwise plastic strains, exactly.

    On quadrilaterals and hexahedra u is (multi)linear and p lives at the 2 x 2 (x 2) Gauss points.

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
    ValueError
        If the problem has friction.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_function("monitor", monitor, "a record", optional=True)
    options = PrimalOptions() if options is None else options
    if problem.friction is not None:
        raise ValueError(
            f"friction={problem.friction!r}: this solver has none, use semismooth_newton"
        )
    require_instance("options", options, PrimalOptions, "PrimalOptions(...)")
    run = Run(problem, None if start is None else nodal_values(start, problem), options, monitor)
    status, message = run.iterate()
    return PrimalResult.at(run.energy, run.contact, run.state, run.history, status, message)


def nodal_values(start: object, problem: Problem) -> np.ndarray:
    """The displacement ``start`` at the vertices of the problem's mesh, shape (N, vertices).

    Parameters
    ----------
    start
        A P1 displacement, or anything with such a ``displacement``.
    problem
        The problem whose mesh receives the values.

    Raises
    ------
    TypeError, ValueError
        If ``start`` is no displacement in N dimensions.
    """
    source = getattr(start, "displacement", start)
    N, mesh = problem.N, problem.mesh
    if not isinstance(source, GridFunction):
        raise TypeError(f"start={start!r}: a displacement or a result that has one is needed")
    own = source.space.mesh
    if own.dim != N or source.dim != N:
        raise ValueError(f"start has {source.dim} components: a displacement of {N} is needed")
    if source.space.ndof != N * own.nv:
        raise ValueError(
            f"start has {source.space.ndof} degrees of freedom on a mesh with {own.nv} vertices: "
            "a P1 displacement is needed"
        )
    values = np.array([c.vec.FV().NumPy()[: own.nv] for c in source.components])
    points, here = (np.asarray(m.ngmesh.Coordinates())[: m.nv, :N] for m in (mesh, own))
    if np.array_equal(points, here):
        return values
    return at_points(own, values.T, points).T
