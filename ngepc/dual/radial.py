"""The radial law behind (6.1): ([|q| - t]^+)^2 / 2 with its gradient and Newton derivative.

With s = |q| - t, rho = s / |q| and d = q / |q| they are, where s > 0 and else zero,

    s^2 / 2,        rho q,        rho Id + (1 - rho) d d^T.
"""

from __future__ import annotations

from ngsolve import CoefficientFunction, IfPos

TINY = 1e-290
"""What is added to |q|: q / |q| is zero at q = 0."""


class RadialLaw:
    """The three functions as scalars that multiply q, Id and d d^T; NaN where the data are NaN.

    Parameters
    ----------
    size, threshold
        |q| and t > 0.
    """

    def __init__(self, size: CoefficientFunction, threshold: CoefficientFunction | float) -> None:
        self.size, self._threshold = size + TINY, threshold
        self.excess = size - threshold
        self.inside = IfPos(self.excess, 1.0, 0.0)

    @property
    def density(self) -> CoefficientFunction:
        """([s]^+)^2 / 2."""
        return self.inside * self.excess * self.excess / 2

    @property
    def slope(self) -> CoefficientFunction:
        """[rho]^+: the gradient is that times q, the first part of the derivative times Id."""
        return self.inside * self.excess / self.size

    @property
    def across(self) -> CoefficientFunction:
        """1 - rho where s > 0: the second part of the derivative is that times d d^T."""
        return self.inside * self._threshold / self.size
