"""The laws of contact and friction between the forces of rows and the gaps that they cause.

The forces x = (n, t) of m rows with d tangents each stand one after the other, all n first.  With
the gaps g = (open gap, minus slip) and any c > 0, contact with friction reads

    n = [n - c g_n]_+,   t = the point of |t| <= b closest to t - c g_t.

In Tresca's law the bound b = F is given, whether the row is closed or open.  In Coulomb's law it
is b(n) = min(mu n, F), with F infinite unless a limit is given, so that an open row has no
friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ngepc.linalg.box import TINY


@dataclass(frozen=True, eq=False)
class FrictionLaw:
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
