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
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import L2, GridFunction

from ngepc._deprecated import old_names
from ngepc.bounds.convex import conjugate_of
from ngepc.bounds.corners import balanced_by_copy, pressure_on_copy, state_on_copy
from ngepc.bounds.counterpart import carried_result, cut_into_simplices
from ngepc.bounds.coverage import CONSTANT, check_covered, is_bilinear
from ngepc.bounds.data import (
    BoundData,
    balanced_stress,
    feasible_state,
    spring_energy,
    strain_coordinates,
)
from ngepc.bounds.held import holding_pressure
from ngepc.bounds.plane import PlaneBoundData
from ngepc.bounds.revolution import RevolutionData, discrete_gap
from ngepc.bounds.rollers import by_nodes, result_by_nodes
from ngepc.bounds.sizes import check_sizes
from ngepc.bounds.solid import SolidBoundData
from ngepc.bounds.thickness import is_of_thickness_one, of_thickness_one
from ngepc.bounds.transfer import check_free_of_functions
from ngepc.bounds.upper_energy import changes
from ngepc.checks.sentences import ROUNDING, at_most_percent, in_words, outward
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.sampled import sampled_data, what_is_unseen
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import has_more_corners
from ngepc.model.places import values_at
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status
from ngepc.results.result import DiscreteSolution


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """A guaranteed bound of the error of a result against the continuous problem.

    Parameters
    ----------
    state
        The displacement u of the bound; J(u) - inf J is its energy error.  It is that of a body of
        thickness one; all energies here are those of the given thickness.  Where few elements have
        most of the error, it is a function on a bisected copy of the mesh, see ``given``.  For
        quadrilaterals and hexahedra it is a function v on simplices that is equal to u on the edges
        of the elements.
    energy
        J(u), with the term int F |slip| of Tresca friction; at least inf J.  For quadrilaterals
        and hexahedra an upper bound of the energy of the result itself, not of v; of v where
        ``moved`` > 0.
    total
        Upper bound of the energy error (force times length).
    algebraic
        Upper bound of J(u) - J_h: the part that further iterations on this mesh would remove, and
        the energy needed to remove penetration between the nodes.
    per_cell
        The contribution of each cell to ``total``, nonnegative up to rounding.
    admissible
        The stress on the mesh of ``state``, at the vertices of the parts of each cell: (triangles,
        9, 3) in-plane coordinates ((xx + yy)/2, (xx - yy)/2^(1/2), 2^(1/2) xy), or (tetrahedra,
        16, 6) with the mean stress and the five coordinates of the deviator.  For bodies of
        revolution r times the mean stress and three coordinates, at nodes of the triangles of
        ``RevolutionData.cut``.
    pressure
        The contact pressure P >= 0 of the admissible stress, at the vertices of the contact facets.
    moved
        Largest change of the displacement to remove penetration of the obstacle (length).
    oscillation
        The part of ``total`` due to loads that vary inside elements (data oscillation).
    given
        The problem of the result if ``state`` is a function on another mesh, otherwise None.
    sprung
        The displacement w (length), at the vertices of the facets with springs of stiffness K: the
        admissible stress has the traction g - K w there; shape (facets, N, N).
    """

    state: State = field(repr=False)
    energy: float
    total: float
    algebraic: float
    per_cell: np.ndarray = field(repr=False)
    admissible: np.ndarray = field(repr=False)
    pressure: np.ndarray = field(repr=False)
    moved: float = 0.0
    oscillation: float = 0.0
    given: Problem | None = field(default=None, repr=False)
    sprung: np.ndarray | None = field(default=None, repr=False)

    @property
    def problem(self) -> Problem:
        """The problem of the result."""
        return self.state.discrete.problem if self.given is None else self.given

    @cached_property
    def sampled(self) -> list[str]:
        """Names of the data that are known from samples only; empty if the bound is proved."""
        return sampled_data(self.problem)

    @property
    def guaranteed(self) -> bool:
        """Whether the bound is proved: all data are polynomials on elements, or numbers.

        Polynomials are numbers, coordinates, finite element functions, and their sums and products.
        For other functions the bound depends on samples, see ``message``.
        """
        return not self.sampled

    @property
    def message(self) -> str:
        """The reasons why the bound is not guaranteed; empty if it is."""
        if self.guaranteed:
            return ""
        return f"{what_is_unseen(self.problem, None)} The bound is not proved."

    @property
    def kind(self) -> str:
        """'guaranteed' or 'not proved'."""
        return "guaranteed" if self.guaranteed else "not proved"

    @property
    def discretisation(self) -> float:
        """``total`` minus ``algebraic``: the discretisation error, reduced by refinement only."""
        return max(self.total - self.algebraic, 0.0)

    @property
    def least_energy(self) -> float:
        """J(u) - total, no more than inf J."""
        return self.energy - self.total

    @cached_property
    def strain_energy(self) -> float:
        """int 1/2 C^-1 sigma : sigma + h/2 |p|^2 + beta |p| (force times length).

        Elastic and hardening energy, and the dissipation of the step.
        """
        return self.problem.kinematics.thickness * strain_energy(self.state)

    @property
    def relative(self) -> float:
        """``total`` over the strain energy; 0 for a body without stress and without error."""
        return (
            self.total / self.strain_energy
            if self.strain_energy > 0
            else float(self.total > 0)
        )

    @property
    def stress(self) -> float:
        """Bound of (int C^-1 d : d + h |p_h - p|^2)^(1/2) for the error d of the stress.

        Its square is an energy: 2 ``total``.
        """
        return float(np.sqrt(2 * max(self.total, 0.0)))

    @property
    def strain(self) -> float:
        """Bound of the L2 norm of eps(u) - eps of the solution (length^(N/2))."""
        law = self.state.discrete.law
        size = self.problem.kinematics.size
        elastic = max((1 / law.two_mu).max(), (1 / (size * law.bulk)).max())
        least = law.least_hardening.min()
        plastic = 1 / least if least > 0 else np.inf
        return float(np.sqrt(elastic + plastic)) * self.stress

    @cached_property
    def indicators(self) -> GridFunction:
        """``per_cell`` as a piecewise constant function (force times length of each cell)."""
        result = GridFunction(L2(self.problem.mesh, order=0), name="error_indicators")
        result.vec.FV().NumPy()[:] = self.per_cell
        return result

    def __str__(self) -> str:
        if not math.isfinite(self.total):
            return f"energy error without a finite bound ({self.kind})"
        hidden = ROUNDING * self.strain_energy
        total = outward(0.0, max(self.total, hidden), 3)[1]
        part = at_most_percent(self.relative, 3)
        return (
            f"energy error at most {total}, {part} of the strain energy ({self.kind})"
        )


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
    return bound or bound_of(data_on(result.discrete), result.state)


def thickened(bound: ErrorBound, problem: Problem) -> ErrorBound:
    """The bound of a body of thickness one for a problem of another thickness."""
    t = problem.kinematics.thickness
    return replace(
        bound,
        energy=t * bound.energy,
        total=t * bound.total,
        algebraic=t * bound.algebraic,
        per_cell=t * bound.per_cell,
        oscillation=t * bound.oscillation,
        given=problem,
    )


def with_state(result: Any) -> ExactResult:
    """The result itself if it has a state, otherwise one with the same displacement."""
    if isinstance(result, ExactResult):
        return result
    state = state_of(DiscreteProblem(result.problem), result)
    return ExactResult(state, Status.STOPPED, "", History())


def solved_problem(result: object) -> Problem:
    """The problem of a result; TypeError for anything else."""
    problem = getattr(result, "problem", None)
    if not isinstance(problem, Problem):
        needed = "a result with a displacement is needed"
        raise TypeError(f"result={in_words(result)}: {needed}")
    return problem


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
    balanced = discrete_stress(own, Factors(result.discrete, "sparsecholesky"))
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
        balanced = discrete_stress(own, Factors(result.discrete, "sparsecholesky"))
    algebraic = algebraic_gap(own, *balanced) + max(state.energy - carried.energy, 0.0)
    P = pressure_on_copy(result, carried, bound_data.contact, parents)
    bound, _ = best_bound(bound_data, (state, moved, algebraic), tangent, P)
    cells = result.problem.mesh.ne
    per_cell = np.bincount(parents, bound.per_cell, minlength=cells)
    total = float(per_cell.sum())
    return replace(bound, total=total, per_cell=per_cell, given=result.problem)


def bound_of(bound_data: BoundData, state: State) -> ErrorBound:
    """The bound for a state, with factors of its own."""
    tangent = Factors(bound_data.discrete, "sparsecholesky")
    return bound_of_state(bound_data, state, tangent)


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


def bound_of_state(bound_data: BoundData, given: State, tangent: Factors) -> ErrorBound:
    """The bound for a state on the mesh of the data; ``tangent`` may be that of an earlier one."""
    return bound_and_search(bound_data, given, tangent)[0]


def bound_and_search(
    bound_data: BoundData, given: State, tangent: Factors
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
    tangent: Factors,
    pressure: np.ndarray | None,
) -> tuple[ErrorBound, Any]:
    """The same for an admissible state, with the numbers ``moved`` and ``algebraic``.

    The contact pressure at the vertices of the facets is that of the state by default.
    """
    state, moved, algebraic = given
    contact = bound_data.contact
    if pressure is None:
        pressure = contact.pressure(state.multipliers)
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


def algebraic_part(state: State, tangent: Factors) -> float:
    """Upper bound of J(u) - J_h: the same bound with a discrete stress and discrete contact."""
    return algebraic_gap(state, *discrete_stress(state, tangent))


def discrete_forces(state: State) -> np.ndarray:
    """The nodal forces (nodes, N) of loads and contact, with friction limited by its bound."""
    contact = state.discrete.contact
    pushed = contact.forces(contact.friction.projected(state.contact))
    return state.discrete.load - pushed


def strain_energy(state: State) -> float:
    """See ``ErrorBound.strain_energy``; loads and rigid motions have no part in it.

    The weights of the points contain the thickness of the problem that was solved.
    """
    discrete = state.discrete
    return discrete.points.integral(discrete.law.spent(state.at))


def discrete_stress(state: State, tangent: Factors) -> tuple[np.ndarray, float]:
    """A stress (points, c) near that of a state, in discrete equilibrium.

    The second result is what springs add to the bound.
    """
    z, moved = balanced_stress(state, tangent, discrete_forces(state))
    return z, spring_energy(state.discrete, moved)


def algebraic_gap(state: State, z: np.ndarray, sprung: float) -> float:
    """Upper bound of J(u) - J_h by a stress (points, c) in discrete equilibrium.

    ``sprung`` is what springs add to the bound.
    """
    discrete = state.discrete
    contact = discrete.contact
    forces = contact.friction.projected(state.contact)
    conjugate = conjugate_of(discrete.law)
    density = discrete.law.energy_density(state.at)
    density += conjugate.value(conjugate.completed(z[:, None]))[:, 0]
    gap = density - np.einsum("pc,pc->p", z, strain_coordinates(state))
    friction = contact.friction_work(forces, state.gaps, 0.0)
    in_the_body = discrete.points.integral(gap)
    return in_the_body + sprung + float(forces @ state.gaps + friction)


__getattr__ = old_names(__name__)
