"""The best stress in two dimensions: equilibrated, then tightened by Airy functions.

For displacements of order two stresses are quadratic; those of Johnson and Mercier are affine.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.element import ELEMENTS, PAIRS
from ngepc.bounds.setting import Setting
from ngepc.bounds.tightening import Dual, Effort, tightened
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State

ON_SIDES = np.array([2 * np.eye(3)[[i, j]] + np.eye(3)[[j, i]] for i, j in PAIRS]).reshape(6, 3) / 3
"""Moments of affine functions with the hat functions of edges, over half the length."""


class PlaneSetting(Setting):
    """``Setting`` on triangles."""

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        order = self.problem.order
        self.effort = {1: Effort(), 2: Effort(gain=0.01, steps=40)}[order]
        self.space = AirySpace(self.boundary, order + 2, self.piola)
        if order == 2:
            self.weights = self.space.rule.weights

    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, again at points, and its P."""
        moments, forces = self.loads(state, P)
        stress = self.balanced(state, tangent, forces)
        dual = Dual(self.space, self.conjugate, self.strain(state))
        rest = float(self.phi(state).sum() + self.contact.gaps(state, P).sum())
        z = self.admissible(stress, moments)
        z = tightened(dual, self.cells, z, self.on_parts(stress), rest, self.effort)
        at_points = z if self.problem.order == 2 else z.mean(axis=1, keepdims=True)
        return self.space.at_nodes(z), at_points, P

    def admissible(self, stress: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The stress of Johnson and Mercier at the points of ``space``, shape (nt, points, 3).

        It is made of one in equilibrium against hat functions, in-plane coordinates (points, 3),
        with mean tractions of both triangles, and of the moments of given tractions, (ne, 2, 2).
        """
        element, size = ELEMENTS[2], self.cells.volume[:, None, None]
        slopes = self.cells.gradients * size
        mean = element.tensors(stress.reshape(len(slopes), self.each, -1).mean(axis=1))
        needed = np.matmul(slopes, mean)
        own = needed[:, :, None]  # moments inward, the same at both ends of an edge
        if self.each == 3:
            sigma = element.tensors(np.matmul(ON_SIDES, self.at_corners(stress)))
            own = np.einsum("tka,tkvab->tkvb", slopes, sigma.reshape(-1, 3, 2, 2, 2))
        own = -np.broadcast_to(own, (len(own), 3, 2, 2))
        table = np.matmul(self.space.rule.shares, element.of_data.reshape(3, 3, -1))
        return self.built(own, needed - self.carried.nodal, given, table.reshape(-1, 15))
