"""One step of the primal-dual Newton method: tangent, contact, step length.

With w = -q a variable of its own, the conditions at a point that yields,

    2 mu_2 (dev eps(u) - p) = stress(s, w),    |s| w = beta s,

are linearised together.  Elimination of w point by point leaves an elasticity-like matrix in u that
is symmetric and positive definite for every w with |w| <= beta (``Law.moduli``).  Contact is kept
exact in each step: u + du minimises Newton's model over N u <= gaps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.linalg.complementarity import solve_complementarity
from ngepc.linalg.linesearch import Bracket
from ngepc.local.factors import Tangent, TangentError
from ngepc.local.system import EPSILON, State

FLATNESS = 0.2
"""The line search ends where |phi'(t)| <= FLATNESS |phi'(0)|."""

EVALUATIONS = 40
"""Most trials of a line search."""

NOISE = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""


@dataclass(frozen=True, eq=False)
class Target:
    """Where Newton's model is smallest: the change of u, and contact there.

    Parameters
    ----------
    change
        du, shape (nodes, N).
    multipliers, active
        lambda >= 0 of the rows at u + du, and lambda > 0.
    """

    change: np.ndarray
    multipliers: np.ndarray
    active: np.ndarray


def newton_target(here: State, tangent: Tangent) -> Target:
    """Factorise the tangent at a state and minimise Newton's model over N u <= gaps.

    Raises
    ------
    TangentError
        If the linear solver gives up, or contact rows are dependent.
    """
    discrete, rows = here.discrete, here.discrete.rows
    tangent.update(discrete.law.moduli(here.at, here.yielding))
    free = tangent.solve(-here.imbalance)
    if not len(rows):
        return Target(free, here.multipliers, here.active)

    def answer(row: int) -> np.ndarray:
        unit = np.zeros(len(rows))
        unit[row] = 1.0
        return rows.displacement(tangent.solve(rows.forces(unit)))

    found = solve_complementarity(
        answer, here.open_gap - rows.displacement(free), here.active, here.multipliers
    )
    if found is None:
        raise TangentError("the contact conditions of neighbouring nodes are dependent")
    change = free - tangent.solve(rows.forces(found.change))
    return Target(change, found.values, found.values > 0)


@dataclass(frozen=True, eq=False)
class Line:
    """The states u + t du with their energies' slope; strains are affine in t.

    Parameters
    ----------
    here, target
        Where the step starts and where it points.
    """

    here: State
    target: Target

    def __post_init__(self) -> None:
        points = self.here.discrete.points
        volume, e = points.strain(self.target.change)
        object.__setattr__(self, "_strain_change", (volume, e))
        load = self.here.discrete.load - self._held_forces()
        object.__setattr__(self, "_work", float(np.vdot(load, self.target.change)))

    def _held_forces(self) -> np.ndarray:
        """Contact forces of rows that stay closed along the step: they do no work."""
        held = np.where(self.target.active, self.here.multipliers, 0.0)
        return self.here.discrete.rows.forces(held)

    def slope(self, t: float) -> float:
        """d/dt of J(u + t du)."""
        discrete, (volume, e) = self.here.discrete, self._strain_change
        at = discrete.law.returned(self.here.deviator + t * e)
        stress = discrete.law.stress(at)
        mean = discrete.law.bulk * (self.here.volume + t * volume) * volume
        return discrete.points.integral(mean + np.einsum("pd,pd->p", stress, e)) - self._work

    @property
    def noise(self) -> float:
        """What rounding leaves of a slope, also where du is nothing but rounding of u itself."""
        terms = NOISE * np.abs(self.target.change) + 2 * EPSILON * np.abs(self.here.u)
        return float(np.vdot(np.abs(self.here.internal_forces), terms))

    def state(self, t: float) -> State:
        """The state at u + t du, with w and lambda moved along."""
        here, discrete = self.here, self.here.discrete
        u = here.u + t * self.target.change
        multipliers = here.multipliers + t * (self.target.multipliers - here.multipliers)
        if t == 1.0:
            multipliers = self.target.multipliers
        ds = discrete.law.two_mu[:, None] * self._strain_change[1]
        moved = discrete.law.linearised(here.at, here.yielding, ds)
        yielding = discrete.law.projected(here.yielding + t * (moved - here.yielding))
        return discrete.state(u, yielding, multipliers, self.target.active)


def step_length(line: Line) -> tuple[float, int] | None:
    """A step length near the minimum of J along the line, at most 1, and the trials before it.

    None if J does not fall along the line beyond rounding.
    """
    slope_0, noise = line.slope(0.0), line.noise
    bracket = Bracket(slope_0, 1.0)
    for trials in range(EVALUATIONS):
        t = bracket.trial
        slope = line.slope(t)
        if abs(slope) <= max(-FLATNESS * slope_0, noise) or (slope <= 0 and t == 1.0):
            return t, trials
        if slope_0 >= 0:
            return None
        bracket.narrow(slope)
    return (bracket.low, EVALUATIONS) if bracket.low > 0 else None
