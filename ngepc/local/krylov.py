"""Krylov methods under a projection: conjugate gradients, and GMRES where it is oblique."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ngepc.local.closed import Linear
from ngepc.local.factors import TangentError

RESTART = 60
"""Directions that minimal residuals keep."""


@dataclass(frozen=True, eq=False)
class Projected:
    """A linear system on what a projection leaves free.

    Both methods take the right side, where to start, the norm of the residual that may be left and
    the most iterations; they return the solution and its iterations, or raise TangentError.
    """

    multiply: Linear
    precondition: Linear
    dot: Callable[[np.ndarray, np.ndarray], float]
    project: Linear

    def conjugate_gradients(
        self, right: np.ndarray, start: np.ndarray, tolerance: float, most: int
    ) -> tuple[np.ndarray, int]:
        """For positive definite matrices and preconditioners (Gould, Hribar, Nocedal 2001)."""
        moved = self.dot(start, start) > 0
        x, r = start, self.project(right - self.multiply(start) if moved else right)
        direction, before = np.zeros_like(r), 1.0
        for iteration in range(most):
            if np.sqrt(self.dot(r, r)) <= tolerance:
                return x, iteration
            z = self.project(self.precondition(r))
            now = self.dot(r, z)
            direction = z + (now / before if iteration else 0.0) * direction
            image = self.project(self.multiply(direction))
            curvature = self.dot(direction, image)
            if not (now > 0 and curvature > 0):
                raise TangentError("the multigrid preconditioner is not positive definite")
            x, r, before = x + now / curvature * direction, r - now / curvature * image, now
        raise TangentError(f"conjugate gradients did not converge in {most} iterations")

    def minimal_residuals(
        self, right: np.ndarray, start: np.ndarray, tolerance: float, most: int
    ) -> tuple[np.ndarray, int]:
        """Where the projection is oblique: restarted GMRES (Saad and Schultz 1986)."""
        x, iterations = start, 0
        while iterations < most:
            r = self.project(right - self.multiply(x))
            size = np.sqrt(self.dot(r, r))
            if size <= tolerance:
                return x, iterations
            basis, H, left = [r / size], np.zeros((RESTART + 1, RESTART)), size
            while left > 0.9 * tolerance and len(basis) <= min(RESTART, most - iterations):
                k, image = (
                    len(basis),
                    self.project(self.multiply(self.project(self.precondition(basis[-1])))),
                )
                for j, known in enumerate(basis):
                    H[j, k - 1] = self.dot(known, image)
                    image = image - H[j, k - 1] * known
                H[k, k - 1] = np.sqrt(self.dot(image, image))
                goal = size * np.eye(k + 1)[0]
                y = np.linalg.lstsq(H[: k + 1, :k], goal, rcond=None)[0]
                left = np.linalg.norm(H[: k + 1, :k] @ y - goal)
                basis.append(image / (H[k, k - 1] or 1.0))
            iterations += len(y)
            x = x + self.project(self.precondition(np.tensordot(y, basis[:-1], 1)))
        raise TangentError(f"minimal residuals did not converge in {most} iterations")
