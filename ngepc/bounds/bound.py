"""The bound of the energy error of a result, from an admissible stress.

For every displacement u that is admissible and every stress that is in equilibrium with loads and
a contact pressure P >= 0,

    J(u) - inf J  <=  J(u) + D(sigma)
        =  int [phi(eps(u)) + phi*(sigma) - sigma : eps(u)] + int_contact P (psi - u . n),

where phi is the energy density minimised over p.  Both integrands are nonnegative, so that their
integrals over the cells are the indicators.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ngepc._deprecated import old_names
from ngepc.bounds.algebraic import (
    FewSolves,
    algebraic_gap,
    discrete_forces,
    discrete_stress,
)
from ngepc.bounds.corners import balanced_by_copy, pressure_on_copy, state_on_copy
from ngepc.bounds.counterpart import carried_result, cut_into_simplices
from ngepc.bounds.coverage import CONSTANT, check_covered, is_bilinear
from ngepc.bounds.data import BoundData, feasible_state
from ngepc.bounds.of_state import best_bound, bound_of, data_on
from ngepc.bounds.outcome import ErrorBound, thickened
from ngepc.bounds.rollers import result_by_nodes
from ngepc.bounds.sizes import check_sizes
from ngepc.bounds.thickness import is_of_thickness_one, of_thickness_one
from ngepc.bounds.transfer import check_free_of_functions
from ngepc.bounds.upper_energy import changes
from ngepc.checks.kinds import hint_at_part
from ngepc.checks.sentences import in_words
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.spaces import nodal
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import has_more_corners
from ngepc.model.places import values_at
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status
from ngepc.results.result import DiscreteSolution


@one_blas_thread
def error_bound(result: object) -> ErrorBound:
    """A guaranteed bound of the energy error of a result, converged or not.

    Parameters
    ----------
    result
        The result of a solver of a :class:`Problem`.  Where its displacement penetrates the
        obstacle, the displacement is changed and the plastic strain computed again; the bound holds
        for ``ErrorBound.state``.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver.
    ValueError
        For problems that no bound covers; the message names the argument of the problem.
    RuntimeError
        If rounding leaves the stress out of equilibrium, or supports keep the displacement from
        clearing the obstacle.
    """
    problem = solved_problem(result)
    check_covered(problem)
    if not is_of_thickness_one(problem):
        return thickened(error_bound(of_thickness_one(with_state(result))), problem)
    if has_more_corners(problem.mesh):
        check_free_of_functions(problem)
        result = result_by_nodes(with_state(result))
        check_sizes(result.state)
        return bound_on_simplices(result)
    if not isinstance(result, ExactResult):
        if not problem.contact_pairs:
            data_on(DiscreteProblem(problem))  # refuses boundary data
        result = with_state(result)
    result = result_by_nodes(result)
    check_sizes(result.state)
    bound = None if problem.kinematics.hoop else bound_on_copy(result)
    if bound is None:
        return bound_of(data_on(result.discrete), result.state)
    return bound if math.isfinite(bound.total) else finite_or(bound, result)


def solved_problem(result: object) -> Problem:
    """The problem of a result; TypeError for anything else."""
    problem = getattr(result, "problem", None)
    fields = ("displacement", "contact_pressure")
    has_fields = all(hasattr(type(result), name) for name in fields)
    if not (isinstance(problem, Problem) and has_fields):
        needed = "a result with a displacement is needed"
        within = hint_at_part(result, ExactResult)
        raise TypeError(f"result={in_words(result)}: {needed}{within}")
    return problem


def with_state(result: Any) -> ExactResult:
    """The result itself if it has a state, otherwise one with the same displacement."""
    if isinstance(result, ExactResult):
        return result
    state = state_of(DiscreteProblem(result.problem), result)
    return ExactResult(state, Status.STOPPED, "", History())


def state_of(discrete: DiscreteProblem, result: object) -> State:
    """Displacement and contact forces of any result, with the best plastic strain."""
    if isinstance(result, DiscreteSolution):
        return discrete.state(result.state.u, contact=result.state.contact)
    problem = discrete.problem
    rows = discrete.rows
    pressure = np.zeros(discrete.problem.mesh.nv)
    where = "|".join(problem.contact_names)
    vertices, values = values_at(result.contact_pressure, problem.mesh, where)
    pressure[vertices] = np.maximum(values[:, 0], 0.0)
    u = nodal(result.displacement.vec.FV().NumPy(), problem)
    return discrete.state(u.copy(), contact=rows.between(pressure) * rows.weights)


def bound_on_copy(result: ExactResult) -> ErrorBound | None:
    """The bound with a stress on a bisected copy of the mesh; None as for ``clear_copy``."""
    found = clear_copy(result)
    if found is None:
        return None
    bound_data, carried, state, moved, parents = found
    tangent = Factors(state.discrete, "sparsecholesky")
    own = result.state.with_radial_return()
    if result.problem.order == 1 and not result.problem.contact_pairs:
        balanced = balanced_by_copy(own, discrete_forces(own), state, tangent, parents)
    else:
        balanced = discrete_stress(own, FewSolves(result.discrete))
    algebraic = algebraic_gap(own, *balanced) + max(state.energy - carried.energy, 0.0)
    P = pressure_on_copy(result, carried, bound_data.contact, parents)
    bound, _ = best_bound(bound_data, (state, moved, algebraic), tangent, P)
    cells = result.problem.mesh.ne
    per_cell = np.bincount(parents, bound.per_cell, minlength=cells)
    total = float(per_cell.sum())
    return replace(bound, total=total, per_cell=per_cell, given=result.problem)


def finite_or(infinite: ErrorBound, result: ExactResult) -> ErrorBound:
    """The bound on the mesh of a result, or the infinite one on its copy if that is no better."""
    try:
        own = bound_of(data_on(result.discrete), result.state)
    except RuntimeError:  # beyond limit loads rounding spoils equilibrium
        return infinite
    return own if math.isfinite(own.total) else infinite


def clear_copy(
    result: ExactResult,
) -> tuple[BoundData, State, State, float, np.ndarray] | None:
    """The data on a bisected copy of the mesh, and the state before and after it is cleared.

    The others are ``moved`` and the parents.  None where no element stands out, and where the
    displacement penetrates the obstacle.  For two bodies the copy matches where they meet, and the
    displacement is always changed on the copy, as it is in space.
    """
    found = state_on_copy(result)
    if found is None:
        return None
    carried, parents = found
    always = result.problem.contact_pairs or result.problem.N == 3
    bound_data = data_on(carried.discrete)
    state, moved = feasible_state(bound_data, carried)
    if moved > state.touching_distance and not always:
        return None
    return bound_data, carried, state, moved, parents


def bound_on_simplices(result: ExactResult) -> ErrorBound:
    """The bound of a result on other elements, by a displacement v on triangles or tetrahedra.

    The stress is one on these, in the plane on a bisected copy of them.  Where v is not the
    displacement u of the result, an upper bound of J(u) - J(v) is added.
    """
    problem = result.problem
    cut_mesh = cut_into_simplices(problem)
    made = carried_result(result, cut_mesh)
    found = clear_copy(made)
    if found is None:
        given = made.state
        bound_data = data_on(given.discrete)
        state, moved = feasible_state(bound_data, given)
        parents = cut_mesh.parents
        P = None
    else:
        bound_data, given, state, moved, simplices = found
        parents = cut_mesh.parents[simplices]
        P = pressure_on_copy(made, given, bound_data.contact, simplices)
    own = result.state.with_radial_return()
    balanced = discrete_stress(own, FewSolves(result.discrete))
    algebraic = algebraic_gap(own, *balanced)
    clear = stays_clear(result.state, bound_data, moved)
    replaced = clear and not is_bilinear(problem)
    if clear:
        moved = 0.0
    else:
        algebraic += max(state.energy - given.energy, 0.0)
    all_are_cut = np.bincount(cut_mesh.parents).min() > 1
    loads_are_carried = not bound_data.carried.left.any()
    bound_data.energy_is_replaced = replaced and all_are_cut and loads_are_carried
    tangent = Factors(bound_data.discrete, "sparsecholesky")
    bound, _ = best_bound(bound_data, (state, moved, algebraic), tangent, P)
    per_cell = np.bincount(parents, bound.per_cell, minlength=problem.mesh.ne)
    bound = replace(bound, per_cell=per_cell, given=problem)
    if not replaced:
        return bound
    phi = bound_data.phi(state)
    change = changes(result.state, state, phi, parents, bound.total)
    energy = bound.energy + float(change.sum())
    total = bound.total + float(change.sum())
    per_cell = without_negative(per_cell + change, total)
    return replace(bound, energy=energy, total=total, per_cell=per_cell)


def without_negative(per_cell: np.ndarray, total: float) -> np.ndarray:
    """Indicators with this sum: the negative ones are zero, the others smaller by as much in all.

    What edges and faces share is given to no element in particular.
    """
    positive = np.maximum(per_cell, 0.0)
    if total <= 0 or not positive.any() or not np.isfinite(total):
        return per_cell
    return positive * (total / positive.sum())


def stays_clear(own: State, bound_data: BoundData, moved: float) -> bool:
    """Whether a displacement on other elements is known to be clear of the obstacle.

    On edges of the plane it is v, which was ``moved``.  On faces u . n is a polynomial in the
    reference coordinates.  So is the obstacle, of the same degree, if it is affine, for order two
    quadratic; then the rows bound the Bernstein coefficients of the distance.
    """
    problem = own.discrete.problem
    if problem.N == 2:
        return moved <= own.touching_distance
    if not problem.contact_names:
        return True
    boundary = bound_data.boundary
    bent = [boundary.excess / boundary.cells.measure[boundary.contact, None]]
    if problem.order == 1:
        bent.append(boundary.gap[:, 3:])
    allowed = CONSTANT * np.abs(boundary.gap).max(initial=0.0)
    known = all(np.abs(part).max(initial=0.0) <= allowed for part in bent)
    return known and own.penetration <= own.touching_distance


__getattr__ = old_names(__name__)
