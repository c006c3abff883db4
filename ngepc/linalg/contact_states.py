"""Enumeration of the states of a few contact rows in the plane: open, sticking, slipping.

With the state of each row given, Coulomb's law is a linear system for the forces x = (n, t) of the
rows, whose gaps are g = g_0 + S x.  Solving it for all states finds every equilibrium of an
elastic body; there are 4 states for each row, 6 with a limit F of friction.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

MOST_STATES = 4**8  # that are enumerated: 8 rows
CHUNK = 4096  # systems that are solved together
TOLERANCE = 1e-9  # fraction of the largest force by which a condition may be missed

OPEN = 0
STICK = 1
TIED = 2
SLIP, LIMIT = 3, 5  # with t = b; one more for t = -b


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
    tables = _Tables(S, gaps, forces, coefficient, cap, sizes)
    found = [np.zeros((0, len(gaps)))]
    for states in _chunks(states_of_rows(cap, tied)):
        x = tables.solved(states)
        found.append(x[tables.hold(states, x)])
    return np.vstack(found)


def _chunks(choices: list[list[int]]) -> Iterator[np.ndarray]:
    """All combinations of the states of rows, shape (at most CHUNK, m) each."""
    counts = [len(states) for states in choices]
    total = int(np.prod(counts))
    for start in range(0, total, CHUNK):
        numbers = np.arange(start, min(start + CHUNK, total))
        digits = np.unravel_index(numbers, counts)
        columns = [np.array(s)[d] for s, d in zip(choices, digits, strict=True)]
        yield np.column_stack(columns)


class _Tables:
    """The two equations of each row in each of its states, and the inequalities that must hold."""

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
        unit = np.eye(2 * m)
        self._left = np.zeros((LIMIT + 2, m, 2, 2 * m))
        self._right = np.zeros((LIMIT + 2, m, 2))
        for state in (STICK, TIED, SLIP, SLIP + 1, LIMIT, LIMIT + 1):
            self._left[state, :, 0] = self._S[:m]
            self._right[state, :, 0] = -self._gaps[:m]
            self._left[state, :, 1] = unit[m:]
        self._left[OPEN, :, 0] = unit[:m]
        self._left[OPEN, :, 1] = unit[m:]
        self._left[STICK, :, 1] = self._S[m:]
        self._right[STICK, :, 1] = -self._gaps[m:]
        for sign, state in ((1, SLIP), (-1, SLIP + 1)):
            self._left[state, :, 1] -= sign * mu[:, None] * unit[:m]
        self._right[LIMIT, :, 1] = self._cap
        self._right[LIMIT + 1, :, 1] = -self._cap

    def solved(self, states: np.ndarray) -> np.ndarray:
        """The forces in each of some states (k, m), NaN where a system is singular: (k, 2 m)."""
        k, m = states.shape
        rows = np.arange(m)
        A = self._left[states, rows].reshape(k, 2 * m, 2 * m)
        b = self._right[states, rows].reshape(k, 2 * m)
        try:
            return np.linalg.solve(A, b[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return np.array([_solution(*system) for system in zip(A, b, strict=True)])

    def hold(self, states: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Whether the forces (k, 2 m) meet all conditions of their states, (k,)."""
        n, t = np.split(forces, 2, axis=1)
        gaps = self._gaps + forces @ self._S.T
        open_gap, back = np.split(gaps, 2, axis=1)
        pressed = self._mu * n
        bound = np.minimum(pressed, self._unlimited)
        size = np.abs(forces).max(axis=1, keepdims=True)
        rounding = TOLERANCE * np.maximum(size, self._scale)
        rests = (n >= -rounding) & (np.abs(t) <= bound + rounding)
        slips = (n >= -rounding) & (pressed <= self._unlimited + rounding)
        limited = pressed >= self._cap - rounding
        forward = back <= rounding
        backward = back >= -rounding
        conditions = [
            (OPEN, open_gap >= -rounding),
            (STICK, rests),
            (TIED, np.ones_like(rests)),
            (SLIP, slips & forward),
            (SLIP + 1, slips & backward),
            (LIMIT, limited & forward),
            (LIMIT + 1, limited & backward),
        ]
        with_state = [states == state for state, _ in conditions]
        met = np.select(with_state, [holds for _, holds in conditions])
        return met.all(axis=1) & np.isfinite(forces).all(axis=1)


def _solution(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The solution of one system, NaN if it is singular."""
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        return np.full(len(b), np.nan)
