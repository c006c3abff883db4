"""The linear complementarity problem of contact: principal pivoting that needs few columns."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ngepc.linalg.compliance import Compliance
from ngepc.linalg.secants import SmallAnswer

_PATIENCE = 10
"""Exchanges without progress before those of Murty's rule take over."""


class Multipliers(NamedTuple):
    """A solution x, shape (m,), and its change x - x_0 without the cancellation of both."""

    values: np.ndarray
    change: np.ndarray


def solve_complementarity(
    column: Callable[[int], np.ndarray],
    q: np.ndarray,
    start: np.ndarray,
    reference: np.ndarray,
) -> Multipliers | None:
    """Multipliers x >= 0 with w = q + W (x - x_0) >= 0 and x . w = 0, W positive definite.

    Columns are dear, each of them is a solve.  The active set x_i > 0 grows by the index with the
    most negative w_i, one at a time because each one relieves its neighbours, and loses all
    indices with x_i < 0 at once.  When that stops making progress the exchanges of Murty's rule
    follow, which end after finitely many steps for every positive definite W.

    Parameters
    ----------
    column
        Index i -> column i of W, shape (m,); called once for each i that is ever active.
    q
        Right-hand side, shape (m,).
    start
        First guess of the active set, boolean, shape (m,).
    reference
        x_0, shape (m,): close to the solution it keeps cancellation out of the result.

    Returns
    -------
    Multipliers or None
        x and x - x_0; None if a number became NaN or infinite or the exchanges did not end.
    """
    m = len(q)
    W = np.zeros((m, m))
    known = np.zeros(m, dtype=bool)
    active = start.copy()
    fewest, patience = m + 1, _PATIENCE
    slack = 1e-13 * max(np.abs(q).max(initial=0.0), np.finfo(float).tiny)
    for _ in range(100 + 20 * m):
        for i in np.flatnonzero((active | (reference != 0)) & ~known):
            W[:, i] = column(i)
            known[i] = True
        change = np.where(active, 0.0, -reference)
        w = q + W[:, known] @ change[known]
        correction = -np.linalg.solve(W[np.ix_(active, active)], w[active])
        if not np.isfinite(correction).all():
            return None
        change[active] += correction
        w += W[:, active] @ correction
        x = np.where(active, reference + change, 0.0)
        wrong = np.where(active, x < -1e-13 * np.abs(x).max(initial=0.0), w < -slack)
        count = np.count_nonzero(wrong)
        if count == 0:
            return Multipliers(np.maximum(x, 0.0), np.where(x > 0, change, -reference))
        if count < fewest:
            fewest, patience = count, _PATIENCE
        else:
            patience -= 1
        if patience <= 0:
            active[np.flatnonzero(wrong)[-1]] ^= True
        elif (wrong & active).any():
            active &= ~wrong
        else:
            active[np.where(active, np.inf, w).argmin()] = True
    return None


def exchange(W: Compliance, gaps: np.ndarray, forces: np.ndarray) -> SmallAnswer:
    """The change of the forces x after which x >= 0, w >= 0 and x . w = 0.

    w = gaps + W (x - forces) with W positive definite.  All indices on the wrong side change sides
    at once, starting from those with a force; when that stops making progress the exchanges of
    Murty's rule follow, which end after finitely many steps.

    Parameters
    ----------
    W
        The compliance.
    gaps, forces
        Gaps at the forces to start from, shape (m,); close to the solution these keep cancellation
        out of the result.

    Returns
    -------
    SmallAnswer
        Inexact if a number became NaN or infinite or the exchanges did not end.
    """
    active = forces > 0
    fewest, patience = len(gaps) + 1, _PATIENCE
    slack = 1e-14 * max(np.abs(gaps).max(initial=0.0), np.finfo(float).tiny)
    for _ in range(100 + 20 * len(gaps)):
        change = np.where(active, 0.0, -forces)
        change[active] = -np.linalg.solve(W.block(active), (gaps + W @ change)[active])
        if not np.isfinite(change).all():
            break
        w, x = gaps + W @ change, np.where(active, forces + change, 0.0)
        wrong = np.where(active, x < -1e-14 * np.abs(x).max(initial=0.0), w < -slack)
        count = np.count_nonzero(wrong)
        if count == 0:
            return SmallAnswer(np.where(x > 0, change, -forces), True)
        fewest, patience = (count, _PATIENCE) if count < fewest else (fewest, patience - 1)
        if patience > 0:
            active ^= wrong
        else:
            active[np.flatnonzero(wrong)[-1]] ^= True
    return SmallAnswer(change, False)
