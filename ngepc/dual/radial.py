"""The radial law behind (6.1): ([|q| - t]^+)^2 / 2 with its gradient and Newton derivative.

With s = |q| - t, rho = s / |q| and d = q / |q| they are, where s > 0 and else zero,

    s^2 / 2,        rho q,        rho Id + (1 - rho) d d^T.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ngsolve import IfPos

T = TypeVar("T")
"""A coefficient or an array."""

TINY = 1e-290
"""What is added to |q|: q / |q| is zero at q = 0."""


class RadialLaw:
    """The three functions as scalars that multiply q, Id and d d^T.

    Parameters
    ----------
    size
        |q|, a coefficient or an array.
    threshold
        t > 0.
    where
        (condition, value, 0.0) -> the value where the condition is positive.
    """

    def __init__(
        self, size: T, threshold: T | float, where: Callable[[T, T, float], T] = IfPos
    ) -> None:
        self.size, self._threshold, self._where = size + TINY, threshold, where
        self.excess = size - threshold

    @property
    def density(self) -> T:
        """([s]^+)^2 / 2."""
        return self._where(self.excess, self.excess * self.excess / 2, 0.0)

    @property
    def slope(self) -> T:
        """[rho]^+: the gradient is that times q, the first part of the derivative times Id."""
        return self._where(self.excess, self.excess / self.size, 0.0)

    @property
    def across(self) -> T:
        """1 - rho where s > 0: the second part of the derivative is that times d d^T."""
        return self._where(self.excess, self._threshold / self.size, 0.0)
