"""The primal-dual Newton method for the discrete problem itself, globalised by its energy.

With w = -q a variable of its own, the conditions at a point that yields,

    2 mu_2 (dev eps(u) - p) = stress(s, w),    |s| w = r(|s|) s,

are linearised together.  Elimination of w point by point leaves an elasticity-like matrix in u that
is symmetric and positive definite for every w with |w| <= r (``Law.moduli``).  Contact is kept
exact in each step: u + du minimises Newton's model over N u <= gaps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.local.factors import Factors
from ngepc.local.iterative import IterativeTangent
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.iteration import newton_iteration
from ngepc.results.outcome import Monitor
from ngepc.results.step import ContactStep, ExactTarget, Line, Target

QUADRATIC = 5.0
"""A full step that divides the residual by more puts w on the sphere |w| = beta.

That is the derivative of the radial return itself, with which convergence ends quadratically; far
from the solution the w that is carried along keeps the tangent from being too soft.
"""


def primal_dual_newton(
    discrete: DiscreteProblem,
    state: State,
    tangent: Factors | IterativeTangent,
    tolerance: float,
    max_iterations: int,
    monitor: Monitor | None = None,
    target: Callable[[State, IterativeTangent], Target] | None = None,
) -> ExactResult:
    """Newton steps from a state until the residual is small or something stops them.

    ``target`` finds where Newton's model is smallest, exactly by default.
    """
    step = PrimalDualStep(tangent, ExactTarget(discrete) if target is None else target)
    return newton_iteration(state, step, tolerance, max_iterations, monitor)


class PrimalDualLine(Line):
    """Strains are affine in t; w and the forces of the rows move along."""

    def __init__(self, here: State, target: Target) -> None:
        super().__init__(here, target)
        discrete, du = here.discrete, target.change
        self._volume, self._deviator = discrete.points.strain(du)
        pull, dot = discrete.supports.pull(du), discrete.points.processes.dot
        self._springs = dot(pull, here.u), dot(pull, du)

    def internal_work(self, t: float) -> float:
        """The stress times the change of the strain, and the springs'."""
        here, law, volume, e = self.here, self.here.discrete.law, self._volume, self._deviator
        stress = law.stress(law.returned(here.deviator + t * e))
        mean = law.bulk * (here.volume + t * volume) * volume
        start, rise = self._springs
        work = here.discrete.points.integral(mean + np.einsum("pd,pd->p", stress, e))
        return work + start + t * rise

    def state(self, t: float) -> State:
        """The state at u + t du."""
        here, law = self.here, self.here.discrete.law
        moved = law.linearised(here.at, here.yielding, law.two_mu[:, None] * self._deviator)
        w = here.yielding + t * (moved - here.yielding)
        return here.discrete.state(here.u + t * self.target.change, w, self.forces(t))


class PrimalDualStep(ContactStep):
    """A step in u and w."""

    line, result = PrimalDualLine, ExactResult

    def __call__(self, here: State) -> tuple[State, float, int] | None:
        """The next state, the step length and its trials; None if no length lowers J."""
        found = super().__call__(here)
        if found is None or found[1] < 1.0 or here.penetration > here.touching_distance:
            return found
        state, *rest = found
        falls = here.residual_norm > QUADRATIC * state.residual_norm
        return (state.on_sphere() if falls else state, *rest)

    def rival(self, state: State) -> tuple[bool, str]:
        """Whether friction allows other equilibria beside a solution, see ``NewtonStep``."""
        return super().rival(state.on_sphere())

    def numbers(self, state: State) -> dict[str, float]:
        """Solves of the step, and what yields and slips."""
        points = state.discrete.points
        return {
            "back_substitutions": self.tangent.back_substitutions,
            "linear_iterations": self.tangent.linear_iterations,
            "friction_active": state.discrete.contact.area(state.sliding),
            "plastic_active": points.integral(state.at.yields.astype(float)),
        }
