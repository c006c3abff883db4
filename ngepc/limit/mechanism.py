"""The mechanism of an upper bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Mechanism:
    """An admissible velocity that does unit power with the loads that grow.

    Parameters
    ----------
    values
        Bernstein coefficients of the velocity on each cell, (nc, n, N).
    degree
        Degree of these polynomials; that of strain rates is one less.
    strain
        Bernstein coefficients of the strain rate's coordinates on each cell, (nc, m, s).
    dissipated
        The dissipation of each cell.
    slips
        Bernstein coefficients of the velocity of the first cell relative to the second on each
        facet, (nf, m, N); zero where velocities are continuous.
    slipped
        The dissipation of the slips on each facet.
    factor
        The upper bound of the load factor.
    """

    values: np.ndarray
    degree: int
    strain: np.ndarray
    dissipated: np.ndarray
    slips: np.ndarray
    slipped: np.ndarray
    factor: float
