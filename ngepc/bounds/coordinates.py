"""Coordinates of strains and stresses in bounds, whose product is sigma : eps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.bounds.conjugate import R6
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem, State


class Displaced(NamedTuple):
    """Displacements (nodes, N) with the trace and deviator of their strains, as of ``Points``."""

    u: np.ndarray
    trace: np.ndarray
    deviator: np.ndarray

    @classmethod
    def of(cls, discrete: DiscreteProblem, u: np.ndarray) -> Displaced:
        """Displacements with their strains."""
        return cls(u, *discrete.points.strain(u))

    def stress_change(self, tangent: Factors) -> np.ndarray:
        """The change of stress (points, c) for these changes of displacements."""
        return stress_coordinates(*tangent.moduli.stress(self.trace, self.deviator))


def strain_coordinates(state: State) -> np.ndarray:
    """Coordinates (nt, c) of the strain of a state, whose product with stresses is sigma : eps.

    In plane stress the in-plane trace is used in place of the trace.
    """
    volume = state.volume
    if state.discrete.law.across is not None:
        volume = 2 * volume / 3 + R6 / 3 * state.deviator[:, 1]
    return stress_coordinates(volume, state.deviator, 0.0)


def stress_coordinates(
    mean: np.ndarray, deviator: np.ndarray, plane: float = 1.0
) -> np.ndarray:
    """Coordinates (nt, c) of ``Conjugate`` from the mean part and deviatoric coordinates.

    In plane strain the in-plane trace takes ``plane`` times what sigma_zz differs from the mean.
    """
    if deviator.shape[1] != 3:
        return np.concatenate([mean[:, None], deviator], axis=1)
    first = mean + plane * deviator[:, 1] / R6
    return np.stack([first, deviator[:, 0], deviator[:, 2]], axis=1)
