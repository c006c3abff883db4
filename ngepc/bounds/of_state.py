"""The bound for a state on its own mesh: the data that states share, and the best stress."""

from __future__ import annotations

from typing import Any

import numpy as np

from ngepc.bounds.algebraic import FewSolves, algebraic_part
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.data import BoundData, feasible_state
from ngepc.bounds.held import holding_pressure
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.plane import PlaneBoundData
from ngepc.bounds.revolution import RevolutionData, discrete_gap
from ngepc.bounds.rollers import by_nodes
from ngepc.bounds.sizes import check_sizes
from ngepc.bounds.solid import SolidBoundData
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem, State


def bound_of(bound_data: BoundData, state: State) -> ErrorBound:
    """The bound for a state, with a tangent of its own."""
    discrete = bound_data.discrete
    problem = discrete.problem
    if problem.N == 3 and problem.order == 2:
        return bound_of_state(bound_data, state, FewSolves(discrete))
    return bound_of_state(bound_data, state, Factors(discrete, "sparsecholesky"))


def bound_data_of(discrete: DiscreteProblem) -> BoundData:
    """The data shared by the bounds of all states on the mesh of a discrete problem.

    ValueError for a problem that no bound covers.
    """
    check_covered(discrete.problem)
    return data_on(by_nodes(discrete))


def data_on(discrete: DiscreteProblem) -> BoundData | RevolutionData:
    """The same for a problem that is known to be covered: the check takes a while."""
    if discrete.problem.kinematics.hoop:
        return RevolutionData(discrete)
    return (PlaneBoundData if discrete.problem.N == 2 else SolidBoundData)(discrete)


def bound_of_state(
    bound_data: BoundData, given: State, tangent: Factors | FewSolves
) -> ErrorBound:
    """The bound for a state on the mesh of the data; ``tangent`` may be that of an earlier one."""
    return bound_and_search(bound_data, given, tangent)[0]


def bound_and_search(
    bound_data: BoundData, given: State, tangent: Factors | FewSolves
) -> tuple[ErrorBound, Any]:
    """The same, and the solver that found the stress, see ``BestStress``."""
    check_sizes(given)
    state, moved = feasible_state(bound_data, given)
    if isinstance(bound_data, RevolutionData):
        return bound_of_ring(bound_data, state, tangent, moved), None
    algebraic = algebraic_part(state, tangent)
    return best_bound(bound_data, (state, moved, algebraic), tangent, None)


def bound_of_ring(
    bound_data: RevolutionData, state: State, tangent: Factors, moved: float
) -> ErrorBound:
    """The bound for an admissible state of a body of revolution."""
    algebraic = discrete_gap(state, tangent)
    found = bound_data.bound(state)
    total = float(found.per_cell.sum())
    return ErrorBound(
        state,
        found.energy,
        total,
        algebraic,
        found.per_cell,
        found.admissible,
        found.pressure,
        moved,
    )


def best_bound(
    bound_data: BoundData,
    given: tuple[State, float, float],
    tangent: Factors | FewSolves,
    pressure: np.ndarray | None,
) -> tuple[ErrorBound, Any]:
    """The same for an admissible state, with the numbers ``moved`` and ``algebraic``.

    The contact pressure at the vertices of the facets is that of the state by default.
    """
    state, moved, algebraic = given
    contact = bound_data.contact
    if pressure is None:
        pressure = contact.from_rows.pressure(state.multipliers)
    pressure = holding_pressure(bound_data, state, pressure)
    z, at_points, P, search, w = bound_data.best_stress(state, tangent, pressure)
    gaps = bound_data.at_nodes.integrals(
        z, bound_data.cells.volume, bound_data.gaps(state, at_points)
    )
    gaps += bound_data.boundary_gaps(state, P, w)
    law = bound_data.conjugate
    whole = gaps
    # (gaps^(1/2) + rho / (2 m)^(1/2))^2, J is m-convex in eps(u)
    if bound_data.carried.left.any():
        h = bound_data.discrete.law.least_hardening[:: bound_data.each]
        softest = law.two_mu * h / (law.two_mu + h)
        m = np.minimum(softest, bound_data.problem.kinematics.size * law.bulk)
        left = bound_data.carried.left
        with np.errstate(divide="ignore", invalid="ignore"):
            missing = np.where(left > 0, left / np.sqrt(2 * m), 0.0)
        whole = (np.sqrt(np.maximum(gaps, 0.0)) + missing) ** 2
    total = float(whole.sum())
    energy = bound_data.energy(state)
    oscillation = total - float(gaps.sum())
    found = (energy, total, algebraic, whole, z, P, moved, oscillation)
    return ErrorBound(state, *found, sprung=w), search
