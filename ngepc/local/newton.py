"""The primal-dual Newton method for the discrete problem itself, globalised by its energy."""

from __future__ import annotations

from dataclasses import dataclass

from ngepc.discretisation.contact_step import rival
from ngepc.linalg.linesearch import nearly_flat
from ngepc.local.factors import Tangent
from ngepc.local.result import ExactResult
from ngepc.local.step import ExactTarget, Line, TargetFinder
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor

QUADRATIC = 5.0
"""A full step that divides the residual by more puts w on the sphere |w| = beta.

That is the derivative of the radial return itself, with which convergence ends quadratically; far
from the solution the w that is carried along keeps the tangent from being too soft.
"""


def primal_dual_newton(
    discrete: DiscreteProblem,
    state: State,
    tangent: Tangent,
    tolerance: float,
    max_iterations: int,
    monitor: Monitor | None = None,
    target: TargetFinder | None = None,
) -> ExactResult:
    """Newton steps from a state until the residual is small or something stops them.

    Parameters
    ----------
    discrete, state
        The discrete problem and where to start.
    tangent
        The linear solver.
    tolerance, max_iterations, monitor
        As for ``newton_iteration``.
    target
        What finds where Newton's model is smallest; None for ``ExactTarget``.
    """
    target = ExactTarget(discrete) if target is None else target
    step = PrimalDualStep(tangent, target)
    return newton_iteration(state, step, tolerance, max_iterations, monitor)


@dataclass(frozen=True, eq=False)
class PrimalDualStep:
    """A step in u and w, see ``NewtonStep``.

    Parameters
    ----------
    tangent, target
        The linear solver, and what finds where Newton's model is smallest.
    """

    tangent: Tangent
    target: TargetFinder

    result = ExactResult

    def __call__(self, here: State) -> tuple[State, float, int] | None:
        """The next state, the step length and its trials; None if no length lowers J."""
        line = Line(here, self.target(here, self.tangent))
        if here.penetration > here.touching_distance:
            return line.state(1.0), 1.0, 0  # the first step makes u feasible
        found = nearly_flat(line.slope, line.noise)
        if found is None:
            return None
        t, trials = found
        state = line.state(t)
        if t == 1.0 and here.residual_norm > QUADRATIC * state.residual_norm:
            state = state.on_sphere()
        return state, t, trials

    def rival(self, state: State) -> tuple[bool, str]:
        """Whether friction allows other equilibria beside a solution, see ``NewtonStep``."""
        discrete = state.discrete
        if not discrete.contact.friction.d:
            return False, ""
        self.tangent.linearise(state.on_sphere())
        nodal = discrete.problem.order == 1 and not discrete.problem.contact_pairs
        held = self.tangent.stiffened if nodal else None
        return rival(state, self.tangent.solve, self.tangent.examined, held)

    def numbers(self, state: State) -> dict[str, float]:
        """Solves of the step, and what yields and slips."""
        points = state.discrete.points
        return {
            "back_substitutions": self.tangent.back_substitutions,
            "linear_iterations": self.tangent.linear_iterations,
            "friction_active": state.discrete.contact.area(state.sliding),
            "plastic_active": points.integral(state.at.yields.astype(float)),
        }
