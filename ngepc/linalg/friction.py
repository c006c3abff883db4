"""The laws of contact and friction as small dense problems for the forces of rows.

The forces x = (n, t) of m rows with d tangents each stand one after the other, all n first.  With
the gaps g = (open gap, minus slip) that they cause, and any c > 0, contact with friction reads

    n = [n - c g_n]_+,   t = the point of |t| <= b closest to t - c g_t.

In Tresca's law the bound b = F is given, whether the row is closed or open.  In Coulomb's law it
is b(n) = min(mu n, F), with F infinite unless a limit is given, so that an open row has no
friction.  Semismooth Newton on these sets solves it; without tangents, d = 0, it is a linear
complementarity problem, which block principal pivoting solves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from ngepc.linalg.box import TINY, in_box
from ngepc.linalg.contact_states import can_be_enumerated, equilibria
from ngepc.linalg.row_blocks import add_to_rows, of_rows
from ngepc.linalg.secants import Compliance

SOFT = (0.3, 0.03)
"""c times the compliance of a row; a second value is tried if Newton's method cycles."""

STEPS = 30  # Newton steps with each c
PROXIMAL_STEPS = 60  # at most, where Newton's method alone fails in a convex problem
SHORTEST = 1e-3  # the shortest step length

ROUNDED = 2e-15
"""Newton's method ends at a residual below this fraction of the largest force: rounding."""

EXACT = 1e-13
SETTLED = 1e-10
"""It also ends at steps below these fractions: at once, or if the residual no longer falls."""


@dataclass(frozen=True, eq=False)
class FrictionCone:
    """The laws |t| <= min(mu n, F), and |t| <= F where mu = inf, of m rows with d tangents each."""

    cap: np.ndarray  # F (force), inf where there is none, shape (m,)
    coefficient: np.ndarray  # mu >= 0, inf for Tresca's law, shape (m,)
    tied: np.ndarray
    """Boolean: rows that stay closed, normal forces of either sign, shape (m,)."""
    d: int  # tangents of a row, 0 without friction
    independent: bool = True
    """Whether no more forces act at a node than it has components."""

    @cached_property
    def given(self) -> np.ndarray:
        """Whether the bound is given, as in Tresca's law, boolean of shape (m,)."""
        return np.isinf(self.coefficient)

    @cached_property
    def _slope(self) -> np.ndarray:
        """Mu, zero where the bound is given, shape (m,)."""
        return np.where(self.given, 0.0, self.coefficient)

    def bound(self, n: np.ndarray) -> np.ndarray:
        """b(n), shape (m,)."""
        by_pressure = np.minimum(self.cap, self._slope * np.maximum(n, 0.0))
        return np.where(self.given, self.cap, by_pressure)

    def grows(self, n: np.ndarray) -> np.ndarray:
        """Whether b(n) = mu n, shape (m,)."""
        return (self._slope * n < self.cap) & ~self.given

    def growth(self, n: np.ndarray) -> np.ndarray:
        """b'(n), shape (m,): mu where b(n) = mu n, else zero."""
        return np.where(self.grows(n), self._slope, 0.0)

    def with_friction(self, closed: np.ndarray) -> np.ndarray:
        """The rows that friction acts on, from those that are closed, boolean of shape (m,)."""
        return closed | self.given

    @cached_property
    def is_convex(self) -> bool:
        """Whether all bounds are given: the forces minimise a convex energy."""
        return bool((self.given | self.tied).all())

    @property
    def is_box(self) -> bool:
        """Whether the forces are those between two bounds each, see ``box``."""
        return self.d == 0 or (self.d == 1 and self.is_convex)

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the largest forces where all bounds are given and d is at most 1."""
        most = np.tile(np.where(self.tied, 0.0, self.cap), self.d)
        least_normal = np.where(self.tied, -np.inf, 0.0)
        largest_normal = np.full(len(self.cap), np.inf)
        return np.append(least_normal, -most), np.append(largest_normal, most)

    def sizes(self, t: np.ndarray) -> np.ndarray:
        """Norms of tangential forces, (m, d) -> (m,)."""
        return np.abs(t[:, 0]) if self.d == 1 else np.linalg.norm(t, axis=1)

    def slipping(self, y: np.ndarray) -> tuple[np.ndarray, ...]:
        """What rows do by a trial force y = x - c g, all of shape (m,) but for the direction.

        Whether they slip; e = y_t / |y_t|, zero with y_t, shape (m, d); b(y_n); |y_t|.
        """
        n, t = self.split(y)
        b = self.bound(n)
        size = self.sizes(t)
        return (
            (size > b) | (b <= 0),
            t / np.where(size > 0, size, 1.0)[:, None],
            b,
            size,
        )

    def projected(self, y: np.ndarray) -> np.ndarray:
        """The point of |t| <= b(n) closest to y_t, with n = [y_n]_+; both stacked."""
        n, t = self.split(y)
        size = self.sizes(t)
        bound = self.bound(n)
        slips = size > bound
        share = np.where(slips, bound / np.where(slips, size, 1.0), 1.0)
        n = np.where(self.tied, n, np.maximum(n, 0.0))
        return np.append(n, share[:, None] * t)

    def slope(
        self, y: np.ndarray, closed: np.ndarray, slips: np.ndarray | None = None
    ) -> np.ndarray:
        """The derivative of ``projected``, blocks of the forces (n, t) of rows, (m, 1 + d, 1 + d).

        Closed rows have dn = dy_n.  Where friction acts dt = dy_t for rows that stick, else
        b/|y_t| (Id - e e') dy_t + b' e dy_n: by default those that slip by y.
        """
        beyond, e, b, size = self.slipping(y)
        with_friction = self.with_friction(closed)
        slips = with_friction & (beyond if slips is None else slips)
        growth = np.where(slips, self.growth(y[: len(b)]), 0.0)
        kept = np.where(slips, b, with_friction) / np.where(
            slips, np.maximum(size, TINY), 1.0
        )
        e_e = np.where(slips[:, None, None], e[:, :, None] * e[:, None, :], 0.0)
        blocks = np.zeros((len(b), 1 + self.d, 1 + self.d))
        blocks[:, 0, 0], blocks[:, 1:, 0] = closed, growth[:, None] * e
        blocks[:, 1:, 1:] = kept[:, None, None] * (np.eye(self.d) - e_e)
        return blocks

    def of(self, rows: np.ndarray) -> FrictionCone:
        """The law of some rows."""
        law = self.cap[rows], self.coefficient[rows], self.tied[rows]
        return FrictionCone(*law, self.d, self.independent)

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Normal (m,) and tangential parts (m, d) of forces or gaps."""
        m = len(self.cap)
        return x[:m], x[m:].reshape(m, self.d)

    @cached_property
    def rubs(self) -> np.ndarray:
        """The rows that friction can act on; the bound of others is zero, boolean (m,)."""
        return (self.cap > 0) & (self.coefficient > 0)

    def with_forces(self, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From the rows that are closed: those that friction acts on, and numbers of forces.

        All forces of these rows come first, then normal forces of closed rows without friction.
        """
        rows = np.flatnonzero(self.with_friction(closed) & self.rubs)
        smooth = np.flatnonzero(closed & ~self.rubs)
        return rows, np.append(self.numbers(rows), smooth)

    def numbers(self, rows: np.ndarray) -> np.ndarray:
        """Numbers of the forces of some rows, n first."""
        tangents = len(self.cap) + self.d * rows[:, None] + np.arange(self.d)
        return np.append(rows, tangents)

    def __call__(
        self, W: Compliance, gaps: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """The ``SmallProblem`` of ``secants``; where Newton's method fails the best that it saw."""
        if self.is_box:
            change, exact = in_box(W, gaps, forces, *self.box)
            if exact or self.d == 0:
                return change, exact
        compliance = self._along(W)
        best = (np.inf, np.zeros_like(forces))
        zero = np.zeros_like(forces)
        for start, soft in product((lambda: zero, lambda: stuck_change(W, gaps)), SOFT):
            equation = _Equation(self, W, gaps, forces, soft / compliance)
            left, change, exact = equation.solved(start())
            if exact:
                return change, True
            best = min(best, (left / soft, change), key=lambda found: found[0])
        if self.enumerable:
            S = W.block(np.arange(len(gaps)))
            for found in self.equilibria(S, gaps, forces, S.diagonal())[:1]:
                equation = _Equation(self, W, gaps, forces, SOFT[0] / compliance)
                _, change, exact = equation.solved(found - forces)
                if exact:
                    return change, True
        if self.is_convex:
            equation = _Equation(self, W, gaps, forces, SOFT[0] / compliance)
            return equation.approached(self.projected(forces) - forces)
        return self.projected(forces + best[1]) - forces, False

    def response(
        self, W: Compliance, gaps: np.ndarray, forces: np.ndarray
    ) -> np.ndarray:
        """The ``Response`` of ``secants``."""
        equation = _Equation(self, W, gaps, forces, SOFT[0] / self._along(W))
        y = forces - equation.c * gaps
        closed = (y[: len(self.cap)] > 0) | self.tied
        rows, chosen = self.with_forces(closed)
        blocks, J = equation.linearised(y, closed, rows, chosen)
        right = np.diag(equation.c[chosen])
        rubbing = slice(blocks.shape[0] * blocks.shape[1])
        right[rubbing] = of_rows(blocks, right[rubbing])
        A = np.zeros((len(gaps), len(gaps)))
        A[np.ix_(chosen, chosen)] = np.linalg.solve(J, right)
        return A

    def _along(self, W: Compliance) -> np.ndarray:
        """The compliance of each force, the same for all tangents of a row."""
        n, t = self.split(W.diagonal)
        return np.append(n, np.repeat(t.mean(axis=1), self.d))

    def follows(
        self, forces: np.ndarray, gaps: np.ndarray, touching: float
    ) -> np.ndarray:
        """b' e at a solution, (m, d), with |s + r| >= |s| + e.r for the slip s of a row and all r.

        That is e = t/b where friction acts, else the direction of the slip.
        """
        n, t = self.split(forces)
        slip = -self.split(gaps)[1]
        b = self.bound(n)
        size = np.linalg.norm(slip, axis=1)
        moves = (
            np.where(size > touching, 1 / np.where(size > 0, size, 1.0), 0.0)[:, None]
            * slip
        )
        e = np.where((b > 0)[:, None], t / np.where(b > 0, b, 1.0)[:, None], moves)
        return self.growth(n)[:, None] * e

    @property
    def enumerable(self) -> bool:
        """Whether all states of the rows can be tried: Coulomb's law on few rows in the plane.

        States do not determine forces that depend on each other.
        """
        by_pressure = self.d == 1 and not self.given.any() and self.independent
        return by_pressure and can_be_enumerated(self.cap, self.tied)

    def equilibria(
        self, S: np.ndarray, gaps: np.ndarray, forces: np.ndarray, sizes: np.ndarray
    ) -> np.ndarray:
        """All forces that meet the law of an ``enumerable`` cone, (count, n), nearest first.

        ``gaps`` are those that ``forces`` leave, ``sizes`` the compliances that gaps are judged by.
        """
        law = self.coefficient, self.cap, self.tied
        found = equilibria(S, gaps, forces, *law, sizes)
        apart = found - forces
        return found[np.argsort(np.einsum("ki,ij,kj->k", apart, S, apart))]


class _Trial(NamedTuple):
    """The equation at a change of the forces."""

    slack: np.ndarray  # c g
    beyond: np.ndarray  # x - c g minus its projection
    left: float  # norm of the residual, x minus this projection


@dataclass(frozen=True, eq=False)
class _Equation:
    """x = projected(x - c g) for changes of the forces x, with g = gaps + W change."""

    law: FrictionCone
    W: Compliance
    gaps: np.ndarray
    forces: np.ndarray
    c: np.ndarray

    def at(self, change: np.ndarray) -> _Trial:
        """The slack and the residual at a change."""
        slack = self.c * (self.gaps + self.W @ change)
        x = self.forces + change
        y = x - slack
        nearest = self.law.projected(y)
        missing = x - nearest
        return _Trial(slack, y - nearest, math.sqrt(missing @ missing))

    def step(self, change: np.ndarray, trial: _Trial) -> np.ndarray | None:
        """One semismooth Newton step; None if its matrix is singular.

        Rows without friction that open lose all forces, rows with it their normal ones.
        """
        law = self.law
        m = len(law.cap)
        closed = (self.forces + change - trial.slack)[:m] > 0
        closed |= law.tied
        opened = np.flatnonzero(~closed)
        rows, chosen = law.with_forces(closed)
        following = -self.forces
        following[chosen] = change[chosen]
        following[opened] = -self.forces[opened]
        if not np.array_equal(following, change):
            trial = self.at(following)
        y = self.forces + following - trial.slack

        _, J = self.linearised(y, closed, rows, chosen)
        residual = trial.slack.copy()
        residual[m:] += trial.beyond[m:]
        residual[opened] = 0.0
        try:
            following[chosen] -= np.linalg.solve(J, residual[chosen])
        except np.linalg.LinAlgError:
            return None
        return following - change if np.isfinite(following).all() else None

    def linearised(
        self, y: np.ndarray, closed: np.ndarray, rows: np.ndarray, chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The slope D of the projection at y, and Id - D + D c W for the ``chosen`` forces.

        Blocks of D are those of the ``rows`` with friction; other closed rows have D = 1.
        """
        law = self.law
        blocks = law.slope(y, closed)[rows]
        J = self.c[chosen, None] * self.W.block(chosen)
        rubbing = slice(blocks.shape[0] * blocks.shape[1])
        J[rubbing] = of_rows(blocks, J[rubbing])
        add_to_rows(J, np.eye(1 + law.d) - blocks)
        return blocks, J

    def solved(self, change: np.ndarray) -> tuple[float, np.ndarray, bool]:
        """The smallest residual of Newton's method, the change there, and whether it converged.

        Steps are shortened until they lower the residual; where none does, a full step ends cycles.
        """
        # the start is left out, as no product with a zero change is needed
        best = (np.inf, change, False)
        trial = self.at(change)
        scale = np.abs(self.forces).max(initial=0.0)
        for _ in range(STEPS):
            step = self.step(change, trial)
            if step is None:
                break
            before = trial.left
            length, trial = self._shortened(change, step, max(before, ROUNDED * scale))
            left = trial.left
            change = change + length * step
            x = self.forces + change
            moved = np.abs(step).max(initial=0.0)
            size = max(scale, np.abs(x).max(initial=0.0))
            settled = moved <= SETTLED * size and left > before / 2
            if left <= ROUNDED * size or moved <= EXACT * size or settled:
                exact = change + (self.law.projected(x) - x)
                return left, np.where(x == 0, -self.forces, exact), True
            best = min(best, (left, change, False), key=lambda found: found[0])
        return best

    def _shortened(
        self, change: np.ndarray, step: np.ndarray, before: float
    ) -> tuple[float, _Trial]:
        """The length of a step that ends below a residual, else 1, and the equation there."""
        whole = self.at(change + step)
        length = 1.0
        found = whole
        while length > SHORTEST and not found.left < before:
            length /= 2
            found = self.at(change + length * step)
        return (length, found) if found.left < before else (1.0, whole)

    def approached(self, change: np.ndarray) -> tuple[np.ndarray, bool]:
        """The same where all bounds are given, by proximal points: Newton's method may cycle.

        The forces minimise a convex energy then.  Springs of a ``part`` of the compliance pull
        them to where they were, and are made softer as often as Newton's method converges
        (Rockafellar, SIAM J. Control Optim. 14, 1976).
        """
        part = 1.0
        for _ in range(PROXIMAL_STEPS):
            springs = part * self.W.diagonal
            problem = replace(
                self, W=self.W.plus(springs), gaps=self.gaps - springs * change
            )
            _, found, exact = problem.solved(change)
            part *= 0.1 if exact else 5.0
            if not exact:
                continue
            change = found
            _, found, exact = self.solved(change)
            if exact:
                return found, True
        return change, False


def stuck_change(W: Compliance, gaps: np.ndarray) -> np.ndarray:
    """The change of the forces after which all rows are closed and stick."""
    return -np.linalg.lstsq(W.block(np.arange(len(gaps))), gaps, rcond=None)[0]
