"""Enumeration of the states of a few contact rows in the plane: open, sticking, slipping.

With the state of each row given, Coulomb's law is a linear system for the forces x = (n, t) of the
rows, whose gaps are g = g_0 + S x.  Solving it for all states finds every equilibrium of an
elastic body; there are 4 states for each row, 6 with a limit F of friction.

Rows are eliminated one after the other, so that systems with the same first states share the work.
Going back, a combination of states is given up at the first row whose conditions do not hold.
"""

from __future__ import annotations

import numpy as np

MOST_STATES = 6**8  # that are enumerated: 8 rows with a limit, 10 without
CHUNK = 4096  # systems that are solved together
TOLERANCE = 1e-9  # fraction of the largest force by which a condition may be missed
GIVEN_UP = 1e-6
"""The same fraction while rows are eliminated, which is less accurate than a whole system."""
SINGULAR = 1e-10
"""Part of its terms below which a determinant counts as zero."""

OPEN = 0
STICK = 1
TIED = 2
SLIP, LIMIT = 3, 5  # with t = b; one more for t = -b
STATES = LIMIT + 2


def states_of_rows(cap: np.ndarray, tied: np.ndarray) -> list[list[int]]:
    """The states that each row may have, from its limit F (inf if there is none)."""
    found = []
    for limit, is_tied in zip(cap, tied, strict=True):
        if is_tied:
            found.append([TIED])
        elif np.isinf(limit):
            found.append([OPEN, STICK, SLIP, SLIP + 1])
        else:
            found.append([OPEN, STICK, SLIP, SLIP + 1, LIMIT, LIMIT + 1])
    return found


def can_be_enumerated(cap: np.ndarray, tied: np.ndarray) -> bool:
    """Whether the states of these rows are few enough."""
    counts = [len(states) for states in states_of_rows(cap, tied)]
    return float(np.prod(counts, dtype=float)) <= MOST_STATES


def equilibria(
    S: np.ndarray,
    gaps: np.ndarray,
    forces: np.ndarray,
    coefficient: np.ndarray,
    cap: np.ndarray,
    tied: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """All forces that meet Coulomb's law |t| <= min(mu n, F), shape (count, 2 m).

    ``S`` (2 m, 2 m) is the compliance of the rows, ``gaps`` (2 m,) are those with some ``forces``,
    first the normal ones of all rows, then minus their slips.  A gap counts as none if it is small
    beside what the largest force moves with the compliances ``sizes`` (2 m,).  The same forces may
    occur several times, from different states.
    """
    laws = _Laws(S, gaps, forces, coefficient, cap, sizes)
    states = laws.possible(states_of_rows(cap, tied))
    found = [np.zeros((0, len(gaps)))]
    for first in range(0, len(states), CHUNK):
        some = states[first : first + CHUNK]
        x = laws.solved(some)
        found.append(x[laws.hold(some, x)])
    return np.vstack(found)


class _Laws:
    """The two equations of each row in each of its states, and the inequalities that must hold.

    With the forces x and the gaps g of a row the equations are B x + G g = r, G diagonal.  Gaps are
    scaled by the stiffness of their row, so that all are forces.
    """

    def __init__(
        self,
        S: np.ndarray,
        gaps: np.ndarray,
        forces: np.ndarray,
        mu: np.ndarray,
        cap: np.ndarray,
        sizes: np.ndarray,
    ) -> None:
        m = len(mu)
        diagonal = S.diagonal()
        held = diagonal <= 0  # forces that move nothing
        stiffness = 1 / np.where(held, sizes.max(), np.where(held, 1.0, sizes))
        self._mu = mu
        self._cap = np.where(np.isinf(cap), 0.0, cap)
        self._unlimited = np.where(np.isinf(cap), np.inf, cap)
        self._S = stiffness[:, None] * (S + np.diag(np.where(held, diagonal.max(), 0)))
        self._gaps = stiffness * gaps - self._S @ forces  # without forces, as forces
        self._scale = max(np.abs(forces).max(), np.abs(stiffness * gaps).max())
        self._B = np.zeros((STATES, m, 2, 2))
        self._G = np.zeros((STATES, 2))
        self._r = np.zeros((STATES, m, 2))
        self._B[OPEN] = np.eye(2)
        self._G[STICK] = 1.0
        self._G[TIED:, 0] = 1.0
        self._B[TIED:, :, 1, 1] = 1.0
        self._B[SLIP, :, 1, 0] = -mu
        self._B[SLIP + 1, :, 1, 0] = mu
        self._r[LIMIT, :, 1] = self._cap
        self._r[LIMIT + 1, :, 1] = -self._cap

    def solved(self, states: np.ndarray) -> np.ndarray:
        """The forces in each of some states (k, m), NaN where a system is singular: (k, 2 m)."""
        k, m = states.shape
        rows = np.arange(m)
        of_rows = np.stack([rows, m + rows], axis=1)
        G = self._G[states]
        B = self._B[states, rows]
        A = G[..., None] * self._S[of_rows]
        for force in (0, 1):
            own = of_rows[:, force]
            A[:, rows, :, own] += B[..., force].swapaxes(0, 1)
        b = self._r[states, rows] - G * self._gaps[of_rows]
        A = A.reshape(k, 2 * m, 2 * m)
        b = b.reshape(k, 2 * m)
        try:
            return np.linalg.solve(A, b[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return np.array([_solution(*system) for system in zip(A, b, strict=True)])

    def hold(self, states: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Whether the forces (k, 2 m) meet all conditions of their states, (k,)."""
        x = np.stack(np.split(forces, 2, axis=1), axis=2)
        gaps = self._gaps + forces @ self._S.T
        gaps = np.stack(np.split(gaps, 2, axis=1), axis=2)
        size = np.abs(forces).max(axis=1, keepdims=True)
        rounding = TOLERANCE * np.maximum(size, self._scale)
        met = self._met(np.arange(len(self._mu)), states, x, gaps, rounding)
        return met.all(axis=1) & np.isfinite(forces).all(axis=1)

    def _met(
        self,
        rows: np.ndarray,
        states: np.ndarray,
        x: np.ndarray,
        gaps: np.ndarray,
        rounding: np.ndarray,
    ) -> np.ndarray:
        """Whether forces and gaps (k, rows, 2) meet the inequalities of the states (k, rows)."""
        n = x[..., 0]
        t = x[..., 1]
        open_gap = gaps[..., 0]
        back = gaps[..., 1]
        pressed = self._mu[rows] * n
        unlimited = self._unlimited[rows]
        bound = np.minimum(pressed, unlimited)
        pushes = n >= -rounding
        slips = pushes & (pressed <= unlimited + rounding)
        limited = pressed >= self._cap[rows] - rounding
        forward = back <= rounding
        backward = back >= -rounding
        conditions = [
            (OPEN, open_gap >= -rounding),
            (STICK, pushes & (np.abs(t) <= bound + rounding)),
            (TIED, np.ones_like(pushes)),
            (SLIP, slips & forward),
            (SLIP + 1, slips & backward),
            (LIMIT, limited & forward),
            (LIMIT + 1, limited & backward),
        ]
        with_state = [states == state for state, _ in conditions]
        return np.select(with_state, [met for _, met in conditions], default=False)

    def possible(self, choices: list[list[int]]) -> np.ndarray:
        """The states (k, m) that may hold: for no row is it clear that a condition is missed."""
        m = len(choices)
        by_row = np.arange(2 * m).reshape(2, m).T.ravel()
        S = self._S[np.ix_(by_row, by_row)]
        with np.errstate(invalid="ignore", over="ignore"):
            return self._possible(choices, S[None], self._gaps[by_row][None])[1]

    def _possible(
        self, choices: list[list[int]], S: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which of some systems has which states and forces in the last rows.

        ``S`` (K, 2 R, 2 R) and ``gaps`` (K, 2 R) are left after the elimination of the rows
        before; numbers of systems (q,), states (q, R), forces (q, 2 R).
        """
        row = len(choices) - len(S[0]) // 2
        states = np.array(choices[row])
        offset, slope = self._own_forces(row, states, S, gaps)
        if row == len(choices) - 1:
            system = np.arange(len(offset))
            later = np.zeros((len(offset), 0), dtype=int)
            x = np.zeros((len(offset), 0))
        else:
            system, later, x = self._in_pieces(choices, S, gaps, offset, slope)
        before, state = np.divmod(system, len(states))
        state = states[state]
        own = offset[system] + np.einsum("qab,qb->qa", slope[system], x)
        x = np.concatenate([own, x], axis=1)
        there = gaps[before, :2] + np.einsum("qab,qb->qa", S[before, :2], x)
        rounding = GIVEN_UP * np.maximum(np.abs(x).max(axis=1), self._scale)
        kept = self._met(row, state, own, there, rounding)
        kept |= ~np.isfinite(x).all(axis=1)
        states = np.column_stack([state, later])
        return before[kept], states[kept], x[kept]

    def _own_forces(
        self, row: int, states: np.ndarray, S: np.ndarray, gaps: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces c + D x of the first of the remaining rows, with the forces x of the others.

        c (K states, 2), D (K states, 2, 2 R - 2).
        """
        G = self._G[states]
        own = S[:, None, :2, :2]
        others = S[:, None, :2, 2:]
        inverse = _inverses(self._B[states, row] + G[..., None] * own)
        right = self._r[states, row] - G * gaps[:, None, :2]
        offset = (inverse * right[..., None, :]).sum(axis=-1)
        slope = -inverse @ (G[..., None] * others)
        count = len(S) * len(states)
        return offset.reshape(count, 2), slope.reshape(count, 2, len(S[0]) - 2)

    def _in_pieces(
        self,
        choices: list[list[int]],
        S: np.ndarray,
        gaps: np.ndarray,
        offset: np.ndarray,
        slope: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same for the systems without the first row, not too many at once."""
        found = []
        each = len(offset) // len(S)
        for first in range(0, len(offset), CHUNK):
            some = slice(first, first + CHUNK)
            before = np.arange(len(offset))[some] // each
            column = S[before, 2:, :2]
            rest = S[before, 2:, 2:] + column @ slope[some]
            moved = gaps[before, 2:] + np.einsum("kab,kb->ka", column, offset[some])
            system, states, x = self._possible(choices, rest, moved)
            found.append((first + system, states, x))
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))


def _inverses(matrix: np.ndarray) -> np.ndarray:
    """The inverses of matrices (..., 2, 2), NaN where they are singular."""
    a = matrix[..., 0, 0]
    b = matrix[..., 0, 1]
    c = matrix[..., 1, 0]
    d = matrix[..., 1, 1]
    determinant = a * d - b * c
    small = np.abs(determinant) <= SINGULAR * (np.abs(a * d) + np.abs(b * c))
    determinant = np.where(small, np.nan, determinant)
    adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(matrix.shape)
    return adjugate / determinant[..., None, None]


def _solution(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The solution of one system, NaN if it is singular."""
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        return np.full(len(b), np.nan)
