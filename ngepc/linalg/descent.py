"""Krylov methods as iterators: the caller decides when to stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

KEPT = 60  # directions of minimal residuals, with their images

Linear = Callable[[np.ndarray], np.ndarray]
Dot = Callable[[np.ndarray, np.ndarray], float]


def conjugate_gradients(
    multiply: Linear, precondition: Linear, right: np.ndarray, dot: Dot = np.vdot
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Iterates from zero for A x = right: x, the residual right - A x, the decrease of the energy.

    The iteration ends if a preconditioned residual or a curvature is not positive: the solution is
    reached, or one of the two matrices is not positive definite.
    """
    x = np.zeros_like(right)
    r = right
    direction = np.zeros_like(right)
    before = np.inf
    while (now := float(dot(r, z := precondition(r)))) > 0:
        direction = z + now / before * direction
        image = multiply(direction)
        curvature = float(dot(direction, image))
        if not curvature > 0:
            return
        length = now / curvature
        before = now
        x = x + length * direction
        r = r - length * image
        yield x, r, length * now / 2


def conjugate_gradients_by_pairs(
    pair_of: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], right: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    """The same where a preconditioned residual z and its image A z are found together.

    Yields x and the decrease of the energy; x changes with the next step.  Images of directions
    are sums of those of z.
    """
    x = np.zeros_like(right)
    r = right.copy()
    direction = np.zeros_like(right)
    image = np.zeros_like(right)
    before = np.inf
    while True:
        z, of_z = pair_of(r)
        now = float(np.vdot(r, z))
        if not now > 0:
            return
        direction *= now / before
        direction += z
        image *= now / before
        image += of_z
        curvature = float(np.vdot(direction, image))
        if not curvature > 0:
            return
        length = now / curvature
        before = now
        x += np.multiply(length, direction, out=z)
        yield x, length * now / 2
        r -= np.multiply(length, image, out=of_z)


def minimal_residuals(
    multiply: Linear, precondition: Linear, right: np.ndarray, dot: Dot
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """The same for A without symmetry: x, right - A x, and what |right - A x|^2 loses.

    Generalised conjugate residuals (Eisenstat, Elman, Schultz, SIAM J. Numer. Anal. 20, 1983) with
    restarts: the steps of GMRES, by shorter recursions that keep twice as much.
    """
    x = np.zeros_like(right)
    r = right
    known = []
    while True:
        direction = precondition(r)
        image = multiply(direction)
        for other, its in known:
            share = dot(its, image)
            direction = direction - share * other
            image = image - share * its
        size = float(np.sqrt(dot(image, image)))
        if not size > 0:
            return
        direction = direction / size
        image = image / size
        length = dot(image, r)
        x = x + length * direction
        r = r - length * image
        known = [*known, (direction, image)] if len(known) < KEPT else []
        yield x, r, length**2
