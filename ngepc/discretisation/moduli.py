"""The tangent of a material law at the integration points: stress per strain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Moduli:
    """Stress per strain at the points: C = bulk I (x) I + across Id + extra d (x) d + coupling."""

    bulk: np.ndarray  # (stress), shape (points,), as the next two
    across: np.ndarray
    extra: np.ndarray
    direction: np.ndarray  # unit vectors d in deviatoric coordinates, shape (points, d)
    # a symmetric matrix on (tr, dev) to be added, or None, shape (points, 1 + d, 1 + d)
    coupling: np.ndarray | None = None

    def __call__(self, e: np.ndarray) -> np.ndarray:
        """The deviatoric stress of the deviatoric strain ``e``, both in coordinates."""
        along = self.extra * np.einsum("pd,pd->p", self.direction, e)
        stress = self.across[:, None] * e + along[:, None] * self.direction
        if self.coupling is None:
            return stress
        return stress + np.einsum("pij,pj->pi", self.coupling[:, 1:, 1:], e)

    def deviatoric(self) -> np.ndarray:
        """The matrix of deviatoric stress by deviatoric strain, shape (points, d, d)."""
        n = self.direction
        matrix = self.extra[:, None, None] * n[:, :, None] * n[:, None, :]
        matrix = matrix + self.across[:, None, None] * np.eye(n.shape[1])
        return matrix if self.coupling is None else matrix + self.coupling[:, 1:, 1:]

    def stress(
        self, volume: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The stress of a strain: its mean part (points,), its deviator (points, d)."""
        mean = self.bulk * volume
        deviator = self(e)
        if self.coupling is not None:
            mean = mean + self.coupling[:, 0, 0] * volume
            mean = mean + np.einsum("pj,pj->p", self.coupling[:, 0, 1:], e)
            deviator = deviator + self.coupling[:, 1:, 0] * volume[:, None]
        return mean, deviator
