"""The radial law behind (6.1): ([|q| - t]^+)^2 / 2 with its gradient and Newton derivative.

With s = |q| - t, rho = s / |q| and d = q / |q| they are, where s > 0 and else zero,

    s^2 / 2,        rho q,        rho Id + (1 - rho) d d^T.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ngsolve import CoefficientFunction, IfPos

T = TypeVar("T")
"""A coefficient or an array."""

TINY = 1e-290
"""What is added to |q|: q / |q| is zero at q = 0."""


def is_positive(s: CoefficientFunction) -> CoefficientFunction:
    """1 where s > 0, else 0."""
    return IfPos(s, 1.0, 0.0)


class RadialLaw:
    """The three functions as scalars that multiply q, Id and d d^T; NaN where the data are NaN.

    Parameters
    ----------
    size
        |q|, a coefficient or an array.
    threshold
        t > 0.
    indicator
        1 where its argument is positive, else 0.
    """

    def __init__(
        self, size: T, threshold: T | float, indicator: Callable[[T], T] = is_positive
    ) -> None:
        self.size, self._threshold = size + TINY, threshold
        self.excess = size - threshold
        self.inside = indicator(self.excess)

    @property
    def density(self) -> T:
        """([s]^+)^2 / 2."""
        return self.inside * self.excess * self.excess / 2

    @property
    def slope(self) -> T:
        """[rho]^+: the gradient is that times q, the first part of the derivative times Id."""
        return self.inside * self.excess / self.size

    @property
    def across(self) -> T:
        """1 - rho where s > 0: the second part of the derivative is that times d d^T."""
        return self.inside * self._threshold / self.size
