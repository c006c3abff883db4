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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from ngepc.linalg.contact_states import can_be_enumerated, equilibria
from ngepc.linalg.secants import Compliance

PATIENCE = 10  # exchanges without progress before steps that descend take over

SOFT = (0.3, 0.03)
"""c times the compliance of a row; a second value is tried if Newton's method cycles."""

STEPS = 30  # Newton steps with each c
PROXIMAL_STEPS = 60  # at most, where Newton's method alone fails in a convex problem
SHORTEST = 1e-3  # the shortest step length
ROUNDING = 1e-13  # of displacements of rows, where forces come from steps that descend
DESCENTS = 20  # the largest number of such steps, relative to that of forces
TINY = float(np.finfo(float).tiny)  # in place of zero in a denominator

ROUNDED = 2e-15
"""Newton's method ends at a residual below this fraction of the largest force: rounding."""

EXACT = 1e-13
SETTLED = 1e-10
"""It also ends at steps below these fractions: at once, or if the residual no longer falls."""

DIFFERENT = 1e-6  # fraction of the largest force by which two solutions differ

FACTORS = (0.5, 0.8, 1.25, 2.0)
"""Coefficients and loads of neighbouring problems, relative, where searches start."""

SHIFTS = (1.0, 0.1, -0.1, -1.0)
"""Gaps and slips of neighbouring problems, relative to the largest one."""

SOFT_ENOUGH = 10.0
SOFTER = 1e5
"""Factors by which springs of floating parts are softer than in Newton's steps: in a search, where
small problems of a pressed block are not solved with softer ones; and where states are tried."""

RELEASES = 3
"""How often springs of a floating part are released, each time to about 1e-4 of their force."""

STARTS = 5 + 2 * len(FACTORS) + 2 * len(SHIFTS)
"""How many there are."""


def in_box(
    W: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    low: np.ndarray | float = 0.0,
    high: np.ndarray | float = np.inf,
) -> tuple[np.ndarray, bool]:
    """The change of the forces x after which they minimise a quadratic between two bounds.

    A ``SmallProblem``: w = gaps + W (x - forces) with W positive definite is the gradient, and
    w >= 0 where x = low, w <= 0 where x = high, w = 0 between them.  Close to the solution the
    forces to start from keep cancellation out of the result.  Whether the change is exact.
    """
    low = np.broadcast_to(np.asarray(low, dtype=float), forces.shape)
    high = np.broadcast_to(np.asarray(high, dtype=float), forces.shape)
    found = exchanged(W, gaps, forces, low, high)
    if found is None:
        return lowered_in_box(W, gaps, forces, low, high)
    return found, True


def exchanged(
    W: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray | None:
    """See ``in_box``: all forces on the wrong side of a bound change sides at once.

    None if that stops making progress (Judice and Pires, Comput. Oper. Res. 19, 1992).
    """
    at_low = forces <= low
    at_high = (forces >= high) & ~at_low
    movable = low < high
    fewest = len(gaps) + 1
    patience = PATIENCE
    slack = 1e-14 * max(np.abs(gaps).max(initial=0.0), TINY)
    while patience > 0:
        free = ~(at_low | at_high)
        change = np.where(free, 0.0, np.where(at_high, high, low) - forces)
        change[free] = -np.linalg.solve(W.block(free), (gaps + W @ change)[free])
        if not np.isfinite(change).all():
            return None
        w = gaps + W @ change
        x = np.where(free, forces + change, 0.0)
        rounding = 1e-14 * np.abs(x).max(initial=0.0)
        below = free & (x < low - rounding)
        above = free & (x > high + rounding)
        leaves = movable & ((at_low & (w < -slack)) | (at_high & (w > slack)))
        wrong = below | above | leaves
        count = np.count_nonzero(wrong)
        if count == 0:
            change = np.where(free & (x <= low), low - forces, change)
            return np.where(free & (x >= high), high - forces, change)
        patience = PATIENCE if count < fewest else patience - 1
        fewest = min(fewest, count)
        at_low = (at_low & ~wrong) | (below & wrong)
        at_high = (at_high & ~wrong) | (above & wrong)
    return None


def lowered_in_box(
    W: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """See ``in_box``: by steps that lower the quadratic, so that none comes back.

    Some forces are held at their bounds.  The others go where they minimise the quadratic, cut off
    at their bounds if that lowers it, else as far as the first bound that they meet; those that
    have met one are held, too.  At a minimum the one is released that the gradient pulls inwards
    most (Nocedal and Wright, Numerical Optimization, 2006, section 16.5).
    """
    x = np.clip(forces, low, high)
    caused = W @ (x - forces)
    held = (x <= low) | (x >= high)
    for _ in range(DESCENTS * len(forces)):
        w = gaps + caused
        free = ~held
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(W.block(free), w[free])
        if not np.isfinite(step).all():
            break
        ahead = x + step
        x = cut_off_at_bounds(W, w, x, step, low, high)
        whole = np.array_equal(x, ahead)
        caused = W @ (x - forces)
        held |= (x <= low) | (x >= high)
        if whole:
            w = gaps + caused
            slack = ROUNDING * max(np.abs(gaps).max(), np.abs(caused).max())
            falls = (w < -slack) & (x < high)
            grows = (w > slack) & (x > low)
            inwards = held & (falls | grows)
            if not inwards.any():
                return x - forces, True
            held[np.argmax(np.where(inwards, w**2 / W.diagonal, 0.0))] = False
    return x - forces, False


def cut_off_at_bounds(
    W: Compliance,
    w: np.ndarray,
    x: np.ndarray,
    step: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """The point x + step inside the bounds, if it lowers the quadratic with gradient w at x.

    Else, if that is another one, the point where the first force meets a bound.
    """
    nearer = np.clip(x + step, low, high)
    moved = nearer - x
    if np.array_equal(nearer, x + step) or moved @ (w + W @ moved / 2) < 0:
        return nearer
    return up_to_the_first_bound(x, step, low, high)


def up_to_the_first_bound(
    x: np.ndarray, step: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """The point of x + t step, t >= 0, where the first force meets a bound, exactly there."""
    ahead = np.where(step > 0, high, low)
    moves = step != 0
    lengths = np.full(len(x), np.inf)
    lengths[moves] = (ahead[moves] - x[moves]) / step[moves]
    shortest = lengths.min()
    return np.where(lengths <= shortest, ahead, x + shortest * step)


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

    def with_forces(self, closed: np.ndarray) -> np.ndarray:
        """Numbers of the forces of the rows that friction acts on, from those that are closed."""
        return self.numbers(np.flatnonzero(self.with_friction(closed)))

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
        for start, soft in product((lambda: zero, lambda: _stuck(W, gaps)), SOFT):
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
        chosen = self.with_forces(closed)
        blocks, J = equation.linearised(y, closed, chosen)
        right = of_rows(blocks, np.diag(equation.c[chosen]))
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

    def other_forces(
        self,
        S: np.ndarray,
        gaps: np.ndarray,
        forces: np.ndarray,
        sizes: np.ndarray | None = None,
        rigid: np.ndarray | None = None,
    ) -> np.ndarray | None:
        """Other forces that meet the law with the compliance S, None if none is found.

        All states are tried where the cone is ``enumerable``, else ``starts``.  ``sizes`` are the
        compliances that differences are judged by, by default the diagonal of S.  ``rigid`` C
        (n, k) are motions of floating parts, which springs with the compliance C C' hold; here
        they are made softer.
        """
        sizes = S.diagonal() if sizes is None else sizes
        rigid = np.zeros((len(forces), 0)) if rigid is None else rigid
        rigid = rigid * (SOFTER if self.enumerable else SOFT_ENOUGH) ** 0.5
        S = S + rigid @ rigid.T
        if self.enumerable:
            found = self.equilibria(S, gaps, forces, sizes)
        else:
            found = self._from_starts(S, gaps, forces, rigid)
        for other in found:
            apart = other - forces
            if apart @ S @ apart > DIFFERENT**2 * (sizes @ forces**2):
                return other  # forces on held tangents do no work: they are no other equilibrium
        return None

    def _from_starts(
        self, S: np.ndarray, gaps: np.ndarray, forces: np.ndarray, rigid: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Solutions from each of the starts that has one.

        Springs that hold a floating part are no part of the body: their force is removed again, in
        several passes.
        """
        W = Compliance.of(S)
        passes = RELEASES if rigid.size else 1
        for start in self.starts(W, gaps, forces):
            x = start
            there = gaps + S @ (start - forces)
            carried = rigid.T @ (start - forces)
            for _ in range(passes):
                change, exact = self(W, there, x)
                if not exact:
                    break
                x = x + change
                carried = carried + rigid.T @ change
                there = there + S @ change + rigid @ carried
            if exact:
                yield x

    def starts(
        self, W: Compliance, gaps: np.ndarray, forces: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Where other solutions are searched from, ``STARTS`` of them.

        No contact, all rows sticking, all slips reversed, all friction at its bound; solutions with
        other coefficients; solutions with other loads: more or less of it, rows that are pressed
        or lifted, dragged one way or the other.
        """
        n, t = self.split(forces)
        stuck = forces + _stuck(W, gaps)
        bounds = np.tile(self.bound(stuck[: len(n)])[:, None], self.d)
        pressing = np.maximum(n, stuck[: len(n)])
        yield np.zeros_like(forces)
        yield self.projected(stuck)
        for tangents in (-t, bounds, -bounds):
            yield self.projected(np.append(pressing, tangents))
        for factor in FACTORS:
            other = replace(self, coefficient=factor * self.coefficient)
            yield self.projected(forces + other(W, gaps, forces)[0])
        unloaded = gaps - W @ forces
        size = np.abs(unloaded).max(initial=0.0)
        normal = np.arange(len(gaps)) < len(n)
        moved = [(factor - 1) * unloaded for factor in FACTORS]
        moved += [shift * size * normal for shift in SHIFTS]
        moved += [shift * size * ~normal for shift in SHIFTS]
        for change in moved:
            yield self.projected(forces + self(W, gaps + change, forces)[0])


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
        chosen = law.with_forces(closed)
        following = -self.forces
        following[chosen] = change[chosen]
        following[opened] = -self.forces[opened]
        if not np.array_equal(following, change):
            trial = self.at(following)
        y = self.forces + following - trial.slack

        _, J = self.linearised(y, closed, chosen)
        residual = trial.slack.copy()
        residual[m:] += trial.beyond[m:]
        residual[opened] = 0.0
        try:
            following[chosen] -= np.linalg.solve(J, residual[chosen])
        except np.linalg.LinAlgError:
            return None
        return following - change if np.isfinite(following).all() else None

    def linearised(
        self, y: np.ndarray, closed: np.ndarray, chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The slope D of the projection at y for the ``chosen`` forces, and Id - D + D c W."""
        law = self.law
        blocks = law.slope(y, closed)[law.with_friction(closed)]
        J = of_rows(blocks, self.c[chosen, None] * self.W.block(chosen))
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


def of_rows(blocks: np.ndarray, A: np.ndarray) -> np.ndarray:
    """``matrix_of_rows`` times a dense matrix: sparse products take longer for few rows."""
    m, size = blocks.shape[:2]
    n = A[:m, None]
    t = A[m:].reshape(m, size - 1, A.shape[1])
    parts = np.matmul(blocks, np.concatenate([n, t], axis=1))
    return np.concatenate([parts[:, 0], parts[:, 1:].reshape(A[m:].shape)])


def add_to_rows(A: np.ndarray, blocks: np.ndarray) -> None:
    """Add ``matrix_of_rows`` to a dense matrix."""
    m, size = blocks.shape[:2]
    tangents = np.arange(m, m * size).reshape(m, size - 1)
    places = np.concatenate([np.arange(m)[:, None], tangents], axis=1)
    A[places[:, :, None], places[:, None, :]] += blocks


def matrix_of_rows(blocks: np.ndarray) -> csr_matrix:
    """The matrix (n, n) with these blocks of the forces of each row, (m, 1 + d, 1 + d)."""
    m, size = blocks.shape[:2]
    places = np.arange(m * size).reshape(m, size)
    order = np.append(places[:, 0], places[:, 1:])
    parts = blocks, np.arange(m), np.arange(m + 1)
    found = bsr_matrix(parts, shape=(m * size,) * 2).tocsr()[order][:, order]
    found.eliminate_zeros()
    return found


def _stuck(W: Compliance, gaps: np.ndarray) -> np.ndarray:
    """The change of the forces after which all rows are closed and stick."""
    return -np.linalg.lstsq(W.block(np.arange(len(gaps))), gaps, rcond=None)[0]
