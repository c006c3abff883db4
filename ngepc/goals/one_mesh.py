"""Newton's method on one mesh of an adaptive refinement; the bound says when it is enough."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from ngepc.bounds.data import BoundData
from ngepc.bounds.of_state import bound_and_search, data_on
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.rollers import by_nodes, state_by_nodes
from ngepc.checks.sentences import counted
from ngepc.discretisation.factors import Factors
from ngepc.goals.goal_bound import GoalProblem
from ngepc.linalg.secants import Compliance
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.results.iteration import ExactTarget, newton_iteration
from ngepc.results.outcome import IterationRecord, Status

ALGEBRAIC_SHARE = 0.1
"""Newton iteration ends where its error is this share of the bound."""

LEFT = 0.005
"""Newton's method pauses where further steps gain less than this fraction of the last bound."""

TOLERANCE = 1e-10  # the residual at which Newton stops if no small step stops it before


class Pause:
    """Stops Newton's method where further steps gain less than ``small`` (energy).

    A step that divides the residual by q has lowered the energy by about q^2 times what is left.
    """

    def __init__(self, small: float) -> None:
        self.paused = False  # an interrupt stops Newton's method, too
        self._small = small
        self._before: IterationRecord | None = None

    def __call__(self, record: IterationRecord) -> None:
        """Called with the record of each iterate."""
        before = self._before
        self._before = record
        if before is None:
            return
        remains = record.residual_norm / before.residual_norm
        if abs(before.energy - record.energy) * remains**2 < self._small:
            self.paused = True
            raise StopIteration


class Tools(NamedTuple):
    """What a bound was computed with: data, tangent, search, compliance of the rows, and the state.

    The compliance is None where the rows of rollers are not those of the bound; ``given`` is the
    state before it was cleared of the obstacle.
    """

    bound_data: BoundData
    tangent: Factors
    search: Any
    compliance: Compliance | None
    given: State

    def goals(self, bound: ErrorBound) -> GoalProblem:
        """The intervals of goals for the bound."""
        rest = self.tangent, self.search, self.compliance, self.given
        return GoalProblem.of_bound(self.bound_data, bound, *rest)


def solved(
    state: State, small: float, max_iterations: int
) -> tuple[ExactResult, ErrorBound, int, Tools]:
    """Newton steps on one mesh until their part of the bound is small, and their number.

    The last result is what the bound was computed with.  Newton steps pause where further ones are
    expected to lower the energy by less than a ``small`` amount.
    """
    bound_data = data_on(by_nodes(state.discrete))
    tangent = Factors(state.discrete, "sparsecholesky")
    alike = bound_data.discrete is state.discrete
    nodal = tangent if alike else Factors(bound_data.discrete, "sparsecholesky")
    compliance = state.discrete.compliance()
    target = ExactTarget(state.discrete, lambda: compliance)
    steps = 0
    while True:
        pause = Pause(small)
        limits = (TOLERANCE, max_iterations - steps)
        result = newton_iteration(state, tangent, ExactResult, *limits, pause, target)
        steps += result.iterations
        held = state_by_nodes(result.state, bound_data.discrete)
        bound, search = bound_and_search(bound_data, held, nodal)
        known = compliance if alike else None
        tools = Tools(bound_data, nodal, search, known, held)
        if not pause.paused:
            return result, bound, steps, tools
        # Newton steps do not reduce the cost of clearing the obstacle between the nodes
        left = bound.algebraic - (bound.state.energy - result.primal_energy)
        if left <= ALGEBRAIC_SHARE * bound.total:
            part = max(left, 0.0) / bound.total if bound.total > 0 else 0.0
            ending = (
                f"Newton's method stopped after {counted(steps, 'step')}: its share of the error "
                f"bound is {part:.1e}."
            )
            ended = replace(result, status=Status.BOUNDED, ending=ending)
            return ended, bound, steps, tools
        state = result.state
        small = small / 30
