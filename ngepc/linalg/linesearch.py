"""Step length rules for a convex energy along a descent direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Protocol

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Declared

ROUNDING = 1e-13  # part of the terms of an energy that rounding may change
SMALLEST = 1e-12  # shorter steps count as failure
IN_A_ROW = 3  # trials on one side of a zero after which secants are taken to creep
FLATNESS = 0.05  # ``nearly_flat`` ends where |phi'(t)| <= FLATNESS |phi'(0)|
EVALUATIONS = 40  # largest number of trials of ``nearly_flat``


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step length, the energy there, and the trials before it."""

    length: float
    energy: float
    halvings: int


class Descent(Protocol):
    """A convex function phi of the step length alpha, with phi'(0) < 0."""

    energy: Callable[[float], float]  # phi
    derivative: Callable[[float], float]  # phi'
    energy_0: float  # phi(0)
    slope_0: float  # phi'(0)
    magnitude: float
    """Size of the terms that phi is summed from, which its rounding follows."""

    def is_rounding(self, change: float) -> bool:
        """Whether a change of phi of this size may be nothing but rounding."""
        return abs(change) <= ROUNDING * self.magnitude


class LineSearch(Protocol):
    """A rule for the step length."""

    def search(self, phi: Descent) -> Step | None:
        """The accepted step length, None if there is none."""
        ...


@dataclass(frozen=True, kw_only=True)
class Armijo(Declared):
    """phi(alpha) <= phi(0) + slope alpha phi'(0), halving from alpha = 1 to 1e-12 (Remark 6.10).

    Energies that differ by less than their rounding errors cannot decide.  There the slope
    decides, phi'(alpha) <= (1 - 2 slope) |phi'(0)|, which is the same rule for a parabola.

    Parameters
    ----------
    slope
        Fraction of the predicted decrease asked for, in (0, 1/2).

    Raises
    ------
    TypeError, ValueError
        If it is out of its range.
    """

    slope: Annotated[float, Check(require_number, least=0, strict=True, below=0.5)] = (
        1e-4
    )

    def search(self, phi: Descent) -> Step | None:
        """The first accepted step length, None if all are refused; see ``LineSearch``."""
        alpha = 1.0
        halvings = 0
        while alpha >= SMALLEST:
            value = phi.energy(alpha)
            enough = value <= phi.energy_0 + self.slope * alpha * phi.slope_0
            if not enough and phi.is_rounding(value - phi.energy_0):
                enough = phi.derivative(alpha) <= (1 - 2 * self.slope) * abs(
                    phi.slope_0
                )
            if enough:
                return Step(length=alpha, energy=value, halvings=halvings)
            alpha = alpha / 2
            halvings = halvings + 1
        return None


@dataclass(frozen=True)
class FullSteps:
    """No globalisation: always alpha = 1, for comparison with ``Armijo``."""

    def search(self, phi: Descent) -> Step:
        """alpha = 1."""
        return Step(length=1.0, energy=phi.energy(1.0), halvings=0)


def nearly_flat(
    slope: Callable[[float], float], noise: float
) -> tuple[float, int] | None:
    """A step length near the minimum of a convex phi, at most 1, and the trials before it.

    ``slope`` is phi', ``noise`` its rounding error; None if phi falls by rounding errors only.
    The zero of the slope is found by safeguarded secant steps.  The slope may jump, for example
    where a soft plastic element becomes elastic: secants then approach the jump from one side in
    tiny steps.  After many trials in a row below the zero the next trial is the middle of the
    bracket; after many above it, a point near the lower end, because the zero may be tiny.  NaN
    counts as above.
    """
    slope_0 = at_low = slope(0.0)
    low = 0.0
    high = 1.0
    at_high = math.nan
    t = 1.0
    row = 0
    for trials in range(EVALUATIONS):
        here = slope(t)
        flat = abs(here) <= max(-FLATNESS * slope_0, noise)
        if flat and here > noise:  # it may be flat far beyond the minimum too
            flat = slope(t / 2) <= 0
        if flat or (here <= 0 and t == 1.0):
            return t, trials
        if slope_0 >= 0:
            return None
        if here < 0:
            low = t
            at_low = here
            row = min(row, 0) - 1
        else:
            high = t
            at_high = here
            row = max(row, 0) + 1
        width = high - low
        if row > IN_A_ROW:
            t = low + width / 10
        elif not math.isfinite(at_high) or row < -IN_A_ROW:
            t = low + width / 2
        else:
            secant = low - at_low * width / (at_high - at_low)
            t = min(max(secant, low + width / 10), high - width / 10)
    return (low, EVALUATIONS) if low > 0 else None
