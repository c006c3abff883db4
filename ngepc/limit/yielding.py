"""The yield condition of limit analysis, and the dissipation of plastic flow.

Stresses are sum_c s_c B_c with matrices B_c; strain rates have the coordinates e_c = B_c : eps.
The first ``free`` coordinates do not enter the yield condition, so that

    a stress is admissible if |(s_free, s_free+1, ...)| <= beta,
    plastic flow has e_c = 0 for c < free and dissipates beta |(e_free, e_free+1, ...)|.

In plane strain sigma_zz is free: the best choice is (sigma_xx + sigma_yy) / 2, and |dev sigma| is
the norm of the in-plane deviator, as in the law of two dimensions.  In plane stress no coordinate
is free: the deviator of sigma = m I has the norm (2/3)^(1/2) |m|, and changes of thickness
dissipate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ngepc.model.kinematics import PLANE_STRAIN, SOLID, TWO_DIMENSIONAL

SLIP = 1 / math.sqrt(2)
"""Shear yield stress over beta, the dissipation per area of a unit slip."""


@dataclass(frozen=True, eq=False)
class YieldShape:
    """The yield condition of a kinematics, see above.

    Parameters
    ----------
    tensors
        The matrices B_c, shape (s, k, k), with k >= N; the first N rows and columns are those of
        the plane.
    free
        How many of them are free: 1, the mean stress, or 0.
    N
        Space dimension.
    """

    tensors: np.ndarray
    free: int
    N: int

    @property
    def basis(self) -> np.ndarray:
        """The in-plane parts of the matrices B_c, which enter equilibrium, (s, N, N)."""
        return self.tensors[:, : self.N, : self.N]

    @property
    def reading(self) -> np.ndarray:
        """The matrix (k k, s) that maps flattened tensors to coordinates."""
        return np.linalg.pinv(self.tensors.reshape(self.size, -1))

    @property
    def size(self) -> int:
        """Number of coordinates s."""
        return len(self.tensors)

    @property
    def capped(self) -> int:
        """Number of coordinates that the yield condition bounds."""
        return self.size - self.free


def _with_mean(deviators: np.ndarray) -> np.ndarray:
    """The unit matrix and orthonormal deviators."""
    return np.concatenate([np.eye(deviators.shape[1])[None], deviators])


def _thin() -> np.ndarray:
    """The unit matrix, scaled such that its deviator has norm one, and orthonormal deviators."""
    basis = _with_mean(TWO_DIMENSIONAL.basis)
    basis[0] *= math.sqrt(3 / 2)
    return basis


FLAT = YieldShape(_with_mean(TWO_DIMENSIONAL.basis), 1, 2)
THIN = YieldShape(_thin(), 0, 2)
ROUND = YieldShape(_with_mean(SOLID.basis), 1, 3)
LONG = YieldShape(_with_mean(PLANE_STRAIN.basis), 1, 2)
"""Plane strain with sigma_zz as a coordinate: it cannot be chosen anew for each varying load."""

SHAPES = {
    "plane strain": FLAT,
    "two-dimensional": FLAT,
    "plane stress": THIN,
    "solid": ROUND,
}
"""Name of a kinematics -> its yield condition."""

CYCLIC_SHAPES = {"plane strain": LONG, "two-dimensional": FLAT, "plane stress": THIN}
"""The same for loads that vary."""
