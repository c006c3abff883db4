"""What an error bound consists of, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.checks.sentences import ROUNDING, at_most_percent, outward
from ngepc.discretisation.sampled import sampled_data, what_is_unseen
from ngepc.local.system import State
from ngepc.model.problem import Problem

STRESS_FREE = 1e-9
"""Stresses that are smaller, relative to those without initial strains, are rounding errors."""

RESOLVED = 1e-12
"""Strains that are smaller, relative to |u| over the size of elements, are rounding errors; and
stresses, relative to those that the loads, those on supports included, make in one element."""

NO_BOUND = (
    "The error bound is infinite: the stress in equilibrium exceeds the largest one that the "
    "hardening law reaches, at a corner for example. A curve that rises further gives a bound, "
    "unless the loads are too large for it."
)

FLOWS = (
    "The error bound is infinite, most likely on finer meshes, too: the body flows where its law "
    "does not harden, and a bound needs a stress in equilibrium that nowhere exceeds the largest "
    "one of the law. Some hardening gives a bound; confidence(result) has an estimate, "
    "limit_load(problem) the loads that the body carries."
)


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
        Upper bound of the energy error (force times length), >= 0: it and ``algebraic`` are zero
        where rounding errors make the sums negative.
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

    def __post_init__(self) -> None:
        for name in ("total", "algebraic"):
            vars(self)[name] = max(getattr(self, name), 0.0)

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
        return float(np.sqrt(2 * self.total))

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
            return why_infinite(self.state)
        hidden = ROUNDING * self.strain_energy
        total = outward(0.0, max(self.total, hidden), 3)[1]
        part = at_most_percent(self.relative, 3)
        return (
            f"energy error at most {total}, {part} of the strain energy ({self.kind})"
        )


def why_infinite(state: State) -> str:
    """Why the error bound of a state is infinite."""
    return FLOWS if state.flowing > 0 else NO_BOUND


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


def strain_energy(state: State) -> float:
    """See ``ErrorBound.strain_energy``; loads and rigid motions have no part in it.

    The weights of the points contain the thickness of the problem that was solved.
    """
    discrete = state.discrete
    return discrete.points.integral(discrete.law.spent(state.at))


def is_free_of_stress(state: State, error: float) -> bool:
    """Whether strain energy and its ``error`` are rounding errors: of eps(u), u or the loads."""
    discrete = state.discrete
    points = discrete.points
    volume, deviator = points.strain(state.u)
    squared = volume**2 / discrete.problem.kinematics.size + (deviator**2).sum(1)
    elastic = points.integral(points.at(discrete.problem.material.lame_mu) * squared)
    diagonal = discrete.stiffness_diagonal
    apart = np.sum(diagonal * state.u**2) + np.sum(discrete.load**2 / diagonal)
    rounding = STRESS_FREE**2 * elastic + RESOLVED**2 * float(apart)
    return max(strain_energy(state), error) <= rounding
