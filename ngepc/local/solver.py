"""The door: solve the discrete problem of one time step exactly."""

from __future__ import annotations

from ngepc.discretisation.stiffness import StiffnessBlocks
from ngepc.local.active_set import InexactTarget
from ngepc.local.factors import Factors
from ngepc.local.iterative import Iterative
from ngepc.local.newton import primal_dual_newton
from ngepc.local.result import ExactResult
from ngepc.local.start import starting_state
from ngepc.local.step import ExactTarget
from ngepc.local.system import DiscreteProblem
from ngepc.model.problem import Problem
from ngepc.results.outcome import Monitor


def solve_exactly(
    problem: Problem,
    start: object | None,
    tolerance: float,
    max_iterations: int,
    inverse: str | Iterative,
    monitor: Monitor | None,
) -> ExactResult:
    """Minimise J(u, p) of (2.14) over the discrete displacements with N u <= gaps.

    Parameters
    ----------
    problem, start, monitor
        As for ``semismooth_newton``.
    tolerance, max_iterations, inverse
        As in ``NewtonOptions``.
    """
    discrete = DiscreteProblem(problem)
    state = starting_state(discrete, start)
    target = ExactTarget(discrete)
    if isinstance(inverse, str):
        tangent = Factors(discrete, inverse)
    else:
        blocks = StiffnessBlocks(discrete.points, discrete.free, discrete.added)
        tangent = inverse.tangent(discrete, blocks)
        if inverse.forcing is not None:
            target = InexactTarget(discrete, inverse.forcing, tolerance)
    return primal_dual_newton(discrete, state, tangent, tolerance, max_iterations, monitor, target)
