"""The best stress in two dimensions: equilibrated, then tightened by Airy functions."""

from __future__ import annotations

import numpy as np

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.conjugate import TO_PLANE
from ngepc.bounds.element import STRESS_MAP, rows_at
from ngepc.bounds.equilibration import corner_forces, mean_moments
from ngepc.bounds.fans import Fans
from ngepc.bounds.setting import Setting
from ngepc.bounds.tightening import Dual, Effort, tightened
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State

FROM_PLANE = np.linalg.inv(TO_PLANE)


class PlaneSetting(Setting):
    """``Setting`` on triangles."""

    airy, effort = AirySpace, Effort()

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        self.space, self.fans = self.airy(self.boundary), Fans(self.boundary)
        self._start = rows_at(self.space.rule.shares, STRESS_MAP)

    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, again at points, and its P."""
        moments, forces = self.loads(state, P)
        stress = self.balanced(state, tangent, self.carried_forces() - forces)
        z = self.admissible(stress, moments)
        dual = Dual(self.space, self.conjugate, self.strain(state))
        rest = self.phi(state).sum() + self.contact_gaps(state, P).sum()
        z = tightened(dual, self.cells, z, self.centre(stress), float(rest), self.effort)
        return self.space.at_nodes(z), z, P

    def means(self, stress: np.ndarray) -> np.ndarray:
        """The means on the triangles, shape (nt, 3), of stresses at the points."""
        return stress

    def centre(self, stress: np.ndarray) -> np.ndarray:
        """Stresses at the points as one or all of each triangle, (nt, ., 3)."""
        return stress[:, None]

    def wished(self, stress: np.ndarray) -> np.ndarray:
        """Moments (ne, 2, 2) of the mean tractions of both triangles."""
        return mean_moments(self.cells, tensors(stress))

    def admissible(self, stress: np.ndarray, moments: np.ndarray) -> np.ndarray:
        """The stress of Johnson and Mercier at the points of ``space``, shape (nt, points, 3).

        It is made of one in equilibrium against hat functions, in-plane coordinates (points, 3),
        and of the moments of the given tractions, (ne, 2, 2).
        """
        t = self.cells
        needed = corner_forces(t, tensors(self.means(stress))) - self.carried.nodal
        mu = self.fans.repaired(self.wished(stress), needed, moments)
        around = t.per_triangle(mu).reshape(-1, 6, 2)
        moments = np.matmul(around, t.inverse.transpose(0, 2, 1)).reshape(-1, 12)
        data = np.concatenate([moments, self.carried.inner], axis=1)
        return self.space.in_plane(data @ self._start.T)


def tensors(z: np.ndarray) -> np.ndarray:
    """The 2 x 2 matrices of in-plane coordinates (..., 3)."""
    v = z @ FROM_PLANE.T
    return np.stack([v[..., [0, 2]], v[..., [2, 1]]], axis=-2)
