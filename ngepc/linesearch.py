"""Armijo's step length rule for a convex energy along a descent direction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ngepc.validation import require_number

ROUNDING = 1e-13


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step length with the energy there and the number of halvings it took."""

    length: float
    energy: float
    halvings: int


@dataclass(frozen=True, kw_only=True)
class Armijo:
    """phi(alpha) <= phi(0) + slope alpha phi'(0), halving from alpha = 1 (Remark 6.10).

    Energies that differ by less than their rounding errors cannot decide.  There the slope
    decides, phi'(alpha) <= (1 - 2 slope) |phi'(0)|, which is the same rule for a parabola.

    Parameters
    ----------
    slope
        Fraction of the predicted decrease asked for, in (0, 1/2).
    shrink
        Factor from one trial to the next, in (0, 1).
    smallest
        Step lengths below it count as failure, in (0, 1).

    Raises
    ------
    TypeError, ValueError
        If a parameter is out of its range.
    """

    slope: float = 1e-4
    shrink: float = 0.5
    smallest: float = 1e-12

    def __post_init__(self) -> None:
        for name, most in (("slope", 0.5), ("shrink", 1.0), ("smallest", 1.0)):
            require_number(name, getattr(self, name), 0, strict=True)
            if getattr(self, name) >= most:
                raise ValueError(
                    f"{name}={getattr(self, name)!r}: a number in (0, {most:g}) is needed"
                )

    def search(
        self,
        energy: Callable[[float], float],
        derivative: Callable[[float], float],
        energy_0: float,
        slope_0: float,
        magnitude: float,
    ) -> Step | None:
        """The first accepted step length, None if all are refused.

        Parameters
        ----------
        energy, derivative
            phi and phi' as functions of alpha.
        energy_0, slope_0
            phi(0) and phi'(0) < 0.
        magnitude
            Size of the terms that phi is summed from; its rounding is ROUNDING times that.
        """
        alpha, halvings = 1.0, 0
        while alpha >= self.smallest:
            value = energy(alpha)
            if value <= energy_0 + self.slope * alpha * slope_0:
                return Step(length=alpha, energy=value, halvings=halvings)
            drowned = abs(value - energy_0) <= ROUNDING * magnitude
            if drowned and derivative(alpha) <= (1 - 2 * self.slope) * abs(slope_0):
                return Step(length=alpha, energy=value, halvings=halvings)
            alpha, halvings = alpha * self.shrink, halvings + 1
        return None


@dataclass(frozen=True)
class FullSteps:
    """No globalisation: alpha = 1 always, so that one can see what Armijo buys."""

    def search(
        self,
        energy: Callable[[float], float],
        derivative: Callable[[float], float],
        energy_0: float,
        slope_0: float,
        magnitude: float,
    ) -> Step:
        """alpha = 1."""
        return Step(length=1.0, energy=energy(1.0), halvings=0)
