"""Guaranteed brackets of the contact force and of displacements, from energies at nearby data.

The least energy E is concave in loads and convex in motions of the obstacle.  Its derivatives
are the goals: for loads plus t times a load with the work l, and gaps less t,

    -dE/dt = l(u),        dE/dt = int P  on contact,

and slopes of chords bound slopes of tangents: with upper and lower bounds of energies

    (L(-t) - U(0)) / t  <=  l(u)  <=  (U(0) - L(t)) / t,
    (L(0) - U(-t)) / t  <=  int P <=  (U(t) - L(0)) / t.

The width falls as the square root of the energy error: the goal itself is far more accurate.

The gap between two bodies is that of the mesh and has no nearby values, and an obstacle cannot come
nearer where a support holds the normal displacement: the bracket of these forces is the interval of
``goal_bound``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.bound import error_bound
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.outcome import ErrorBound
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import ROUNDING, in_words, interval_in_words
from ngepc.discretisation.loads import applied_forces
from ngepc.goals.best_lambda import LEAST
from ngepc.goals.ends import SOLVED
from ngepc.goals.goal_bound import goal_bound
from ngepc.goals.one_mesh import TOLERANCE
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.exact import solve_exactly
from ngepc.local.result import ExactResult
from ngepc.model.data import Vector
from ngepc.model.features import require_covered
from ngepc.model.problem import Problem

COVERS = BOUNDED - {"axisymmetric"}
"""Features that brackets cover."""

PASSES = 3  # largest number of lengths that are tried on each side
MOST_STEPS = 100  # Newton steps of each solve
NEAR = 1.3  # lengths within this factor of the best one are accepted


@dataclass(frozen=True)
class Bracket:
    """Bounds of a quantity of the continuous solution.

    Parameters
    ----------
    lower, upper
        Its bounds.
    discrete
        The quantity of the result.
    guaranteed
        Whether the bracket is proved; False if data are known from samples only.
    message
        Why it is not guaranteed; empty if it is.
    """

    lower: float
    upper: float
    discrete: float
    guaranteed: bool = True
    message: str = ""

    @property
    def relative(self) -> float:
        """Half the width over the size of ``discrete``."""
        half = (self.upper - self.lower) / 2
        return half / abs(self.discrete) if self.discrete else math.inf

    def __str__(self) -> str:
        kind = "guaranteed" if self.guaranteed else "not proved"
        return interval_in_words(self.lower, self.upper, kind)


@one_blas_thread
def contact_force_bracket(result: ExactResult) -> Bracket:
    """Bounds of the integral of the contact pressure (force).

    Parameters
    ----------
    result
        A result of ``semismooth_newton`` without gamma; its problem is solved two to six times
        more, from there, but for two bodies and at supports, see ``goal_bound``.

    Raises
    ------
    TypeError, ValueError, RuntimeError
        As ``error_bound``, for problems without contact, and where the solver fails or nothing
        moves on this mesh.
    """
    require_instance("result", result, ExactResult, "a result without gamma")
    problem = result.problem
    force = float(result.contact_force)
    require_covered(problem, "a bracket of a contact force", COVERS)
    if problem.contact_pairs or "contact at a clamp" in problem.features:
        found = goal_bound(result, "contact_force")
        return Bracket(*found.interval, force, found.guaranteed, found.message)
    if not problem.contact_names:
        raise ValueError("contact=None: a contact force needs contact")

    def moved(t: float) -> Problem:
        """The problem with the obstacle nearer by t."""
        return replace(
            problem, gap={name: gap - t for name, gap in problem.gaps.items()}
        )

    here = error_bound(result)
    size = float(np.abs(result.state.u).max())
    lower, upper, message = slopes(
        result, here, moved, lambda a, b: b.energy - a.least_energy, force, size
    )
    return Bracket(max(lower, 0.0), upper, force, not message, message)


@one_blas_thread
def displacement_bracket(
    result: ExactResult,
    traction: Mapping[str, Vector] | None = None,
    body_force: Vector | None = None,
) -> Bracket:
    """Bounds of the work that a load would do: a mean displacement for a load with resultant one.

    Parameters
    ----------
    result
        As for ``contact_force_bracket``.
    traction, body_force
        The load g and f, as those of a ``Problem``: the quantity is int g . u + int f . u.

    Raises
    ------
    TypeError, ValueError, RuntimeError
        As ``error_bound``, for loads that are not legal, and where the solver fails or nothing
        moves on this mesh.
    """
    require_instance("result", result, ExactResult, "a result without gamma")
    problem = result.problem
    u = result.state.u
    require_covered(problem, "a bracket", COVERS)
    load = replace(problem, traction=traction, body_force=body_force, pressure=None)
    forces = applied_forces(load, result.discrete.supports.scalar)
    if not np.any(forces):
        raise ValueError(f"traction={in_words(traction)}: a load is needed")
    size = float(np.abs(forces).sum() * np.abs(u).max())

    def loaded(t: float) -> Problem:
        """The problem with t times the load on top."""
        g = dict(problem.tractions)
        f = problem.f
        for name, value in load.tractions.items():
            g[name] = t * value + g[name] if name in g else t * value
        if load.f is not None:
            f = t * load.f if f is None else t * load.f + f
        return replace(problem, traction=g, pressure=None, body_force=f)

    here = error_bound(result)
    work = float(np.vdot(forces, u))
    large = here.strain_energy / size if size > 0 else 0.0
    lower, upper, message = slopes(
        result, here, loaded, lambda a, b: a.energy - b.least_energy, work, large
    )
    return Bracket(lower, upper, work, not message, message)


def slopes(
    result: ExactResult,
    here: ErrorBound,
    problem_at: Callable[[float], Problem],
    rise: Callable[[ErrorBound, ErrorBound], float],
    slope: float,
    length: float,
) -> tuple[float, float, str]:
    """The largest lower and the smallest upper slope of chords, and the message of their bounds.

    ``problem_at(t)`` is the problem with the parameter changed by t.  ``rise(here, there)`` is an
    upper bound of the change of the energy along a chord, from the error bounds at its ends;
    ``here`` is the bound of the result.  ``slope`` is an estimate of the derivative, ``length`` an
    upper limit for t.  Without strain and error the solution is known, and so is the derivative.
    """
    energy = here.strain_energy
    total = max(here.total, LEAST * energy)
    if total == 0:
        return slope, slope, here.message
    longest = min(2 * energy / abs(slope), length) if slope else length
    first = math.sqrt(total / energy) * longest if energy > 0 else 0.0
    if not first > 0:
        raise RuntimeError(
            "no bracket: the displacements of this mesh are all zero, a finer one is needed"
        )
    found = []
    unseen = here.message
    for sign in (-1.0, 1.0):
        best = math.inf
        t = first
        for _ in range(PASSES):
            moved = problem_at(sign * t)
            given = moved, result, TOLERANCE, MOST_STEPS, "sparsecholesky", None
            near = solve_exactly(*given).or_interrupted()
            if near.status not in SOLVED:
                raise RuntimeError(f"no bracket: {near.message}")
            there = error_bound(near)
            unseen = there.message or unseen
            rounding = ROUNDING * (energy + there.strain_energy)
            risen = rise(here, there) + rounding
            best = min(best, risen / t)
            curved = risen - sign * slope * t - total
            wanted = t * math.sqrt(total / curved) if curved > 0 else 4 * t
            if max(wanted / t, t / wanted) < NEAR:
                break
            t = min(max(wanted, t / 16), 4 * t)
        found.append(sign * best)
    return found[0], found[1], unseen
