"""The linear complementarity problem of contact: block principal pivoting."""

import numpy as np

from ngepc.linalg.compliance import Compliance
from ngepc.linalg.secants import SmallAnswer

_PATIENCE = 10
"""Exchanges without progress before those of Murty's rule take over."""


def exchange(
    W: Compliance, gaps: np.ndarray, forces: np.ndarray, tied: np.ndarray | None = None
) -> SmallAnswer:
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
    tied
        Boolean, shape (m,): indices with w = 0 and x of either sign; None for none.

    Returns
    -------
    SmallAnswer
        Inexact if a number became NaN or infinite or the exchanges did not end.
    """
    tied = np.zeros(len(gaps), dtype=bool) if tied is None else tied
    active = (forces > 0) | tied
    fewest, patience = len(gaps) + 1, _PATIENCE
    slack = 1e-14 * max(np.abs(gaps).max(initial=0.0), np.finfo(float).tiny)
    for _ in range(100 + 20 * len(gaps)):
        change = np.where(active, 0.0, -forces)
        change[active] = -np.linalg.solve(W.block(active), (gaps + W @ change)[active])
        if not np.isfinite(change).all():
            break
        w, x = gaps + W @ change, np.where(active, forces + change, 0.0)
        wrong = np.where(active, x < -1e-14 * np.abs(x).max(initial=0.0), w < -slack)
        wrong &= ~tied
        count = np.count_nonzero(wrong)
        if count == 0:
            return SmallAnswer(np.where((x > 0) | tied, change, -forces), True)
        fewest, patience = (count, _PATIENCE) if count < fewest else (fewest, patience - 1)
        if patience > 0:
            active ^= wrong
        else:
            active[np.flatnonzero(wrong)[-1]] ^= True
    return SmallAnswer(change, False)
