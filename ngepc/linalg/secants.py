"""Contact problems whose compliance is dear: each product with it takes a solve.

Forces x of rows change their gaps from g to g + S (x - x_0).  The conditions that forces and gaps
have to meet are solved with a secant matrix W instead of S; one true product with the change of the
forces then gives the true gaps and teaches W.  Every product that is not the last one is a new
direction, so that it ends after at most as many as there are rows, and in practice after about as
many as the conjugate gradient method needs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ngepc.linalg.compliance import Compliance

ROUNDING = 3e-14
"""Part of an answer that is rounding."""

FIRST = 3e-2
"""Part of the slack below which the first change counts as rounding."""

RESTARTS = 4
"""Products are at most so many times as many as rows."""


class SmallAnswer(NamedTuple):
    """The change of the forces that meets the conditions, and whether it does so to rounding."""

    change: np.ndarray
    exact: bool


SmallProblem = Callable[[Compliance, np.ndarray, np.ndarray], SmallAnswer]
"""(W, gaps, forces) -> the change of the forces."""


def solve_by_secants(
    small: SmallProblem,
    product: Callable[[np.ndarray], np.ndarray],
    compliance: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    slack: float,
) -> np.ndarray | None:
    """Forces that meet the conditions of contact with the gaps they cause.

    Parameters
    ----------
    small
        Solves the conditions with a known compliance.
    product
        d -> S d; called with each change of the forces, which add up to all of it.
    compliance
        W, a guess of S; it learns.
    gaps
        Gaps (length) at the forces to start from, shape (n,).
    forces
        The forces to start from, shape (n,).
    slack
        Changes of the gaps that need no further product (length); the first one is made unless it
        is rounding, so that none of several calls leaves the gaps as they were.

    Returns
    -------
    ndarray or None
        The forces; None if a number became NaN or infinite or rows are dependent.
    """
    compliance.restart()
    for number in range(RESTARTS * (len(gaps) + 3)):
        change, exact = small(compliance, gaps, forces)
        rounding = slack * (1 if number else FIRST)
        if exact and np.abs(compliance @ change).max(initial=0.0) <= rounding:
            return np.where(forces + change == 0, 0.0, forces)
        answer = product(change)
        gaps, forces = gaps + answer, forces + change
        if not np.isfinite(answer).all():
            return None
        if not compliance.learn(change, answer):  # rounding of far larger answers hides this one
            compliance.restart()
            compliance.learn(change, answer)
        slack = max(slack, ROUNDING * float(np.abs(answer).max()))  # it stays in the gaps
    return None
