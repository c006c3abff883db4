"""Laws of the rate: the overstress of a bar above its yield stress during plastic flow.

A law is a convex potential of the rate x of PEEQ (1/time), the power dissipated beyond the yield
stress: Phi(x) = int_0^x of the overstress.  In an implicit Euler step of length dt that gains the
plastic strain p the rate is x = (2/3)^(1/2) |p| / dt, and the step costs dt Phi(x) more: again a
convex function of |p|, so that each step is a minimum problem as without a rate.

    linear      overstress K x          Bingham, Perzyna with exponent 1
    power       overstress K x^(1/n)    Perzyna, x = ((sigma - R)/K)^n

With a yield stress near zero the power law is Norton's creep, x = A sigma^n with A = K^(-n).

P. Perzyna, Adv. Appl. Mech. 9 (1966); F. H. Norton, The Creep of Steel at High Temperatures (1929).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from ngsolve import CoefficientFunction, IfPos, Mesh

from ngepc.checks.arguments import Coefficient, is_number, require_field, require_number
from ngepc.checks.declared import Check, PositiveDatum
from ngepc.checks.sentences import in_words
from ngepc.model.hardening import Potential, Value

SLOWEST = 1e-250
"""Rate in place of zero where the slope of the overstress would be infinite."""

RATES = np.geomspace(1e-40, 1e40, 161)
"""Rates at which laws are checked, whatever the unit of time is."""

Exponent = Annotated[float, Check(require_number, least=1, most=50)]


class RateLaw(Potential):
    """A potential of the rate x of PEEQ; a law of your own is a frozen dataclass.

    ``energy`` is Phi(x) (power per volume), ``stress`` the overstress of a bar, 0 at x = 0, and
    ``slope`` its derivative, finite.
    """

    @abstractmethod
    def rate(self, overstress: Value) -> Value:
        """The rate x >= 0 at which ``stress`` is this overstress >= 0."""

    def at(self, values: Callable[[Coefficient], np.ndarray]) -> RateLaw:
        """See ``Potential``; numbers stay numbers, for derivatives of powers at zero."""

        def at_points(value: Coefficient) -> Coefficient | np.ndarray:
            """A datum at the points, numbers as they are."""
            return value if is_number(value) else values(value)

        return super().at(at_points)


@dataclass(frozen=True, eq=False)
class Norton(RateLaw):
    """The overstress K x^(1/n) of a bar at a rate x of PEEQ: power laws of Perzyna and Norton.

    Parameters
    ----------
    overstress
        K > 0, at the rate 1 (stress); in x = A sigma^n it is A^(-1/n).
    exponent
        n in [1, 50]; 1 for a linear law.
    """

    overstress: PositiveDatum
    exponent: Exponent = 1.0

    def energy(self, x: Value) -> Value:
        """See ``RateLaw``."""
        power = 1 / self.exponent + 1
        return self.overstress / power * x**power

    def stress(self, x: Value) -> Value:
        """See ``RateLaw``."""
        return self.overstress * x ** (1 / self.exponent)

    def rate(self, overstress: Value) -> Value:
        """See ``RateLaw``."""
        return (overstress / self.overstress) ** self.exponent

    def slope(self, x: Value) -> Value:
        """See ``RateLaw``."""
        x = _at_least(x, SLOWEST)
        return self.overstress / self.exponent * x ** (1 / self.exponent - 1)

    def slopes(self, first: Value, last: Value) -> tuple[Value, Value]:
        """See ``RateLaw``: the slope falls."""
        return self.slope(last), self.slope(first)


def check_rate(law: RateLaw, mesh: Mesh) -> None:
    """Accept an overstress that is finite, 0 at rest and not decreasing."""
    at_points = law.at(lambda value: require_field("rate", value, mesh))
    before = at_points.stress(0.0)
    if np.abs(before).max() > 0:
        raise ValueError(f"rate={in_words(law)}: no overstress is needed at the rate 0")
    for x in RATES:
        with np.errstate(over="ignore"):
            stress = at_points.stress(x)
        if np.max(stress) == np.inf:
            break  # an overstress beyond all numbers: no step reaches such rates
        if not np.min(stress - before) >= -1e-12 * np.max(stress):
            found = f"the overstress at the rate {x:g} is {np.min(stress):g}"
            raise ValueError(
                f"rate={in_words(law)}: {found}: values that never fall are needed"
            )
        before = stress


def _at_least(x: Value, least: float) -> Value:
    """The larger one of x and a number."""
    of_space = isinstance(x, CoefficientFunction)
    return IfPos(x - least, x, least) if of_space else np.maximum(x, least)
