"""The yield condition of limit analysis, and the dissipation of plastic flow.

Stresses are sum_c s_c B_c with matrices B_c; strain rates have the coordinates e_c = B_c : eps.
The first ``free`` coordinates do not enter the yield condition, so that

    stresses are allowed where |(s_free, s_free+1, ...)| <= beta,
    flow has e_c = 0 for c < free and dissipates beta |(e_free, e_free+1, ...)|.

Plane strain leaves sigma_zz free: the best one is (sigma_xx + sigma_yy) / 2, and |dev sigma| is
that of the deviator in the plane, as in the law of two dimensions.  Plane stress leaves none free:
the deviator of sigma = m I has the size (2/3)^(1/2) |m|, and changes of thickness dissipate.
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
        """The matrices B_c as far as equilibrium knows them, (s, N, N)."""
        return self.tensors[:, : self.N, : self.N]

    @property
    def reading(self) -> np.ndarray:
        """The matrix (k k, s) with which flat tensors become coordinates."""
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
    """The unit matrix, so that its stress has a deviator of size one, and orthonormal deviators."""
    basis = _with_mean(TWO_DIMENSIONAL.basis)
    basis[0] *= math.sqrt(3 / 2)
    return basis


FLAT = YieldShape(_with_mean(TWO_DIMENSIONAL.basis), 1, 2)
THIN = YieldShape(_thin(), 0, 2)
ROUND = YieldShape(_with_mean(SOLID.basis), 1, 3)
LONG = YieldShape(_with_mean(PLANE_STRAIN.basis), 1, 2)
"""Plane strain with the deviator of sigma_zz, which loads that vary cannot choose anew each."""

SHAPES = {
    "plane strain": FLAT,
    "two-dimensional": FLAT,
    "plane stress": THIN,
    "solid": ROUND,
}
"""Name of a kinematics -> its yield condition."""

CYCLIC_SHAPES = {"plane strain": LONG, "two-dimensional": FLAT, "plane stress": THIN}
"""The same for loads that vary."""
