"""Conjugate gradients step by step: who takes the steps says when they have done enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

Linear = Callable[[np.ndarray], np.ndarray]


def conjugate_gradients(
    multiply: Linear,
    precondition: Linear,
    right: np.ndarray,
    dot: Callable[[np.ndarray, np.ndarray], float] = np.vdot,
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Steps from zero towards the solution of A x = right: x, right - A x, the energy gained.

    They end where a preconditioned residual or a curvature is not positive, that is with the
    solution or because one of the two matrices is not positive definite.
    """
    x, r, direction, before = np.zeros_like(right), right, np.zeros_like(right), np.inf
    while (now := float(dot(r, z := precondition(r)))) > 0:
        direction = z + now / before * direction
        image = multiply(direction)
        curvature = float(dot(direction, image))
        if not curvature > 0:
            return
        length, before = now / curvature, now
        x, r = x + length * direction, r - length * image
        yield x, r, length * now / 2
