"""Krylov methods under a projection: conjugate gradients, and GMRES where it is oblique."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.local.closed import Linear
from ngepc.local.factors import TangentError

RESTART = 60
"""Directions that minimal residuals keep."""


def conjugate_gradients(
    multiply: Linear,
    precondition: Linear,
    dot: Callable[[np.ndarray, np.ndarray], float],
    project: Linear,
    right: np.ndarray,
    start: np.ndarray,
    tolerance: float,
    most: int,
) -> tuple[np.ndarray, int]:
    """Projected conjugate gradients (Gould, Hribar, Nocedal 2001): the solution and its iterations.

    Raises
    ------
    TangentError
        If ``most`` iterations do not do, or the matrix or the preconditioner is indefinite.
    """
    moved = dot(start, start) > 0
    x, r = start, project(right - multiply(start) if moved else right)
    direction, before = np.zeros_like(r), 1.0
    for iteration in range(most):
        if np.sqrt(dot(r, r)) <= tolerance:
            return x, iteration
        z = project(precondition(r))
        now = dot(r, z)
        direction = z + (now / before if iteration else 0.0) * direction
        image = project(multiply(direction))
        curvature = dot(direction, image)
        if not (now > 0 and curvature > 0):
            raise TangentError("the multigrid preconditioner is not positive definite")
        x, r, before = x + now / curvature * direction, r - now / curvature * image, now
    raise TangentError(f"conjugate gradients did not converge in {most} iterations")


def minimal_residuals(
    multiply: Linear,
    precondition: Linear,
    dot: Callable[[np.ndarray, np.ndarray], float],
    project: Linear,
    right: np.ndarray,
    start: np.ndarray,
    tolerance: float,
    most: int,
) -> tuple[np.ndarray, int]:
    """The same where the projection is oblique: restarted GMRES (Saad and Schultz 1986).

    Raises
    ------
    TangentError
        If ``most`` iterations do not do.
    """
    x, iterations = start, 0
    while iterations < most:
        r = project(right - multiply(x))
        size = np.sqrt(dot(r, r))
        if size <= tolerance:
            return x, iterations
        basis, H, left = [r / size], np.zeros((RESTART + 1, RESTART)), size
        while left > 0.9 * tolerance and len(basis) <= min(RESTART, most - iterations):
            k, image = len(basis), project(multiply(project(precondition(basis[-1]))))
            for j, known in enumerate(basis):
                H[j, k - 1] = dot(known, image)
                image = image - H[j, k - 1] * known
            H[k, k - 1] = np.sqrt(dot(image, image))
            goal = size * np.eye(k + 1)[0]
            y = np.linalg.lstsq(H[: k + 1, :k], goal, rcond=None)[0]
            left = np.linalg.norm(H[: k + 1, :k] @ y - goal)
            basis.append(image / (H[k, k - 1] or 1.0))
        iterations += len(y)
        x = x + project(precondition(np.tensordot(y, basis[:-1], 1)))
    raise TangentError(f"minimal residuals did not converge in {most} iterations")
