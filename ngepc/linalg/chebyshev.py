"""Chebyshev's polynomial as the smoother of a level: products alone, and no order of unknowns.

Adams, Brezina, Hu, Tuminaro, J. Comput. Phys. 188 (2003).  With the diagonal D of a symmetric
matrix A, or with its diagonal blocks, x moves to x + q(D^-1 A) D^-1 (right - A x).  The error is
multiplied by 1 - t q(t), the polynomial that is smallest on an interval of eigenvalues t of D^-1 A,
the upper part of them: it is a polynomial of Chebyshev.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from ngepc.linalg.descent import Dot, Linear

DEGREE = 4
"""Products with A of a smoothing step, one less from zero."""

LEAST = 0.03
"""Lower end of the interval, as a part of the upper one."""

BEYOND = 1.1
"""Upper end over the estimated largest eigenvalue: estimates are up to 2 percent too small."""

LANCZOS = 10
"""Steps of Lanczos' method for the largest eigenvalue."""


class Chebyshev:
    """A smoothing step in place; it is symmetric, so that it serves before and after a correction.

    ``multiply`` is A times a vector, ``divide`` D^-1 times a vector, new arrays.  The largest
    eigenvalue is estimated from a ``start``, a vector of random numbers.
    """

    def __init__(
        self, multiply: Linear, divide: Linear, start: np.ndarray, dot: Dot = np.vdot
    ) -> None:
        self._multiply = multiply
        self._divide = divide
        upper = BEYOND * largest_eigenvalue(multiply, divide, start, dot)
        lower = LEAST * upper
        self._middle = (upper + lower) / 2
        self._half = (upper - lower) / 2

    def __call__(self, x: np.ndarray, right: np.ndarray) -> None:
        """Move x towards the solution of A x = right."""
        self._move(x, right - self._multiply(x))

    def from_zero(self, x: np.ndarray, right: np.ndarray) -> None:
        """The same for an x that is zero: one product less."""
        self._move(x, right.copy())

    def _move(self, x: np.ndarray, left: np.ndarray) -> None:
        """Move x by the polynomial of the residual ``left``, which changes."""
        step = self._divide(left)
        step /= self._middle
        x += step
        ratio = self._middle / self._half
        before = 1 / ratio
        for _ in range(DEGREE - 1):
            left -= self._multiply(step)
            now = 1 / (2 * ratio - before)
            change = self._divide(left)
            change *= 2 * now / self._half
            step *= now * before
            step += change
            x += step
            before = now


def largest_eigenvalue(
    multiply: Linear,
    divide: Linear,
    start: np.ndarray,
    dot: Dot = np.vdot,
    steps: int = LANCZOS,
) -> float:
    """An estimate from below of the largest eigenvalue of D^-1 A.

    Lanczos' method for a random vector, by the numbers of conjugate gradients.
    """
    r = start
    direction = np.zeros_like(start)
    shares = [0.0]
    lengths = [1.0]
    before = np.inf
    for _ in range(steps):
        z = divide(r)
        now = float(dot(r, z))
        if not now > 0:
            break
        share = now / before
        direction = z + share * direction
        image = multiply(direction)
        curvature = float(dot(direction, image))
        if not curvature > 0:
            break
        shares.append(share)
        lengths.append(now / curvature)
        r = r - lengths[-1] * image
        before = now
    diagonal = [
        1 / length + share / earlier
        for length, share, earlier in zip(
            lengths[1:], shares[1:], lengths[:-1], strict=True
        )
    ]
    beside = [
        sqrt(share) / length
        for share, length in zip(shares[2:], lengths[1:-1], strict=True)
    ]
    return float(eigvalsh_tridiagonal(np.array(diagonal), np.array(beside)).max())
