"""Forces between two bounds that minimise a quadratic: block pivoting, then steps that descend."""

from __future__ import annotations

import numpy as np

from ngepc.linalg.secants import Compliance

PATIENCE = 10  # exchanges without progress before steps that descend take over
ROUNDING = 1e-13  # of displacements of rows, where forces come from steps that descend
DESCENTS = 20  # the largest number of such steps, relative to that of forces
TINY = float(np.finfo(float).tiny)  # in place of zero in a denominator


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
