"""The mechanism of an upper bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ENCLOSED = 4.0
"""Safety factor of rounding errors that are added to the dissipation."""


@dataclass(frozen=True, eq=False)
class Mechanism:
    """An admissible velocity that does unit power with the loads that grow.

    Parameters
    ----------
    values
        Velocities at the nodes of each cell, (nc, nodes, N): its vertices, in the plane then the
        middles of the edges opposite to them.
    strain
        Coordinates of the strain rate at the vertices of each cell, (nc, N + 1, s).
    dissipated
        What each cell dissipates.
    slips
        Velocities of the second cell relative to the first at the vertices of facets, (nf, N, N);
        zero where velocities are continuous.
    slipped
        What they dissipate on each facet.
    factor
        The upper bound of the load factor.
    """

    values: np.ndarray
    strain: np.ndarray
    dissipated: np.ndarray
    slips: np.ndarray
    slipped: np.ndarray
    factor: float
