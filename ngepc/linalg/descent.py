"""Krylov methods step by step: who takes the steps says when they have done enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

KEPT = 60  # directions of minimal residuals, with their images

Linear = Callable[[np.ndarray], np.ndarray]
Dot = Callable[[np.ndarray, np.ndarray], float]


def conjugate_gradients(
    multiply: Linear, precondition: Linear, right: np.ndarray, dot: Dot = np.vdot
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


def minimal_residuals(
    multiply: Linear, precondition: Linear, right: np.ndarray, dot: Dot
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The same for A without symmetry: x, right - A x, and what |right - A x|^2 loses.

    Generalised conjugate residuals (Eisenstat, Elman, Schultz, SIAM J. Numer. Anal. 20, 1983) with
    restarts: the steps of GMRES, by shorter recursions that keep twice as much.
    """
    x, r, known = np.zeros_like(right), right, []
    while True:
        direction = precondition(r)
        image = multiply(direction)
        for other, its in known:
            share = dot(its, image)
            direction, image = direction - share * other, image - share * its
        size = float(np.sqrt(dot(image, image)))
        if not size > 0:
            return
        direction, image = direction / size, image / size
        length = dot(image, r)
        x, r = x + length * direction, r - length * image
        known = [*known, (direction, image)] if len(known) < KEPT else []
        yield x, r, length**2
