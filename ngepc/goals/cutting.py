"""Upper bounds of integrals of the Phi of ``supremum`` over the cells, on pieces that are cut.

A law has upper bounds of means over pieces, and estimates of these.  Pieces are cut, cells into
their parts first, until the bounds exceed the integrals by a small part of them.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.polynomials import worth_keeping
from ngepc.bounds.simplices import of_cells
from ngepc.goals.pieces import SPLIT, child_coefficients
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_laws import SearchedLaw

LEVELS = {3: 3, 4: 2, 6: 3, 9: 4, 16: 3, 18: 4}
"""Most levels of cutting, by the number of coefficients on the first pieces."""
WORTH = {3: 0.015, 4: 0.015, 6: 0.06, 9: 0.015, 16: 0.015, 18: 0.06}
"""What bounds may exceed the integrals by, as a part of them."""


def potential_integrals(
    law: ScaledLaw | SearchedLaw,
    pulled: np.ndarray,
    w: np.ndarray,
    volume: np.ndarray,
    rest: np.ndarray,
    cell: np.ndarray,
) -> np.ndarray:
    """Integrals over the cells of Phi from above, on some of them, and of a ``rest`` on all.

    Parameters
    ----------
    law, pulled, w
        The law on some cells; the coefficients (n, k, d) of q/(2 mu_2), and those of w or, where
        it is constant on cells, (n, 1, d).
    volume
        Volumes of these cells, (n,).
    rest
        Integrals over all cells, (cells,).
    cell
        The numbers of those where Phi is wanted, (n,).
    """
    result = rest.copy()
    last = LEVELS[pulled.shape[1]]
    for level in range(last + 1):
        bound, estimate = volume * law.means(pulled, w)
        total = float(result.sum() + estimate.sum())
        if not np.isfinite(total):
            # where Phi is infinite cuts do not help
            return np.full(len(result), np.inf)
        kept = worth_keeping(bound - estimate, WORTH[pulled.shape[1]] * total)
        if level == last:
            kept[:] = True
        result += np.bincount(cell[kept], bound[kept], minlength=len(result))
        if kept.all():
            break
        cut = np.flatnonzero(~kept)
        count = len(SPLIT[pulled.shape[1]])
        parents = np.tile(cut, count)
        pulled = child_coefficients(of_cells(pulled, cut))
        w = (
            of_cells(w, parents)
            if w.shape[1] == 1
            else child_coefficients(of_cells(w, cut))
        )
        law = law.of_points(parents)
        volume = volume[parents] / count
        cell = cell[parents]
    return result
