"""Isotropic hardening laws: the flow stress R of a bar over its accumulated plastic strain PEEQ.

A law is the convex potential of its free energy,  E(x) = int_0^x R,  with R = E' and the slope R'.
The radius of the yield surface is (2/3)^(1/2) R at x = PEEQ, and |p| = (3/2)^(1/2) PEEQ.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from ngsolve import CoefficientFunction, IfPos, Mesh, exp

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_datum,
    require_field,
    require_number,
)
from ngepc.checks.declared import Declared, NotNegativeDatum, PositiveDatum
from ngepc.checks.kinds import require_sequence
from ngepc.checks.sentences import in_words

Value = float | np.ndarray | CoefficientFunction
"""A number, values at points, or a coefficient: laws take each and give the same kind."""

STRAINS = np.concatenate([[0.0], np.geomspace(1e-6, 10.0, 71)])
"""Values of PEEQ at which laws are looked at."""


class Potential(Declared, ABC):
    """A convex function of one number x >= 0, with numbers or coefficients as its data."""

    @abstractmethod
    def energy(self, x: Value) -> Value:
        """The integral of ``stress`` from 0 to x, convex."""

    @abstractmethod
    def stress(self, x: Value) -> Value:
        """The derivative of ``energy`` (stress), which never falls."""

    @abstractmethod
    def slope(self, x: Value) -> Value:
        """The derivative of ``stress``, from the right where that has a kink."""

    def slopes(self, first: Value, last: Value) -> tuple[Value, Value]:
        """Bounds of R' on [first, last] from below and above, for guaranteed bounds.

        By default 0 and inf, which hold for every law; sharper values make error bounds tighter.
        """
        return 0.0, np.inf

    @property
    def data(self) -> list[Coefficient]:
        """All numbers and coefficients of the law."""
        several = (v if isinstance(v, tuple) else (v,) for v in vars(self).values())
        return [one for values in several for one in values]

    def at(self, values: Callable[[Coefficient], np.ndarray]) -> Potential:
        """The law with the values of its data at some points."""
        other = copy(self)
        for name, given in vars(self).items():
            several = isinstance(given, tuple)
            vars(other)[name] = tuple(map(values, given)) if several else values(given)
        return other


@dataclass(frozen=True, eq=False)
class HardeningLaw(Potential):
    """A potential; one's own law is a frozen dataclass with numbers or coefficients as fields.

    ``energy`` is E(x) = int_0^x R (energy per volume), ``stress`` R(x) > 0, ``slope`` R'(x) >= 0.
    """


@dataclass(frozen=True, eq=False)
class Voce(HardeningLaw):
    """R = yield_stress + saturation (1 - exp(-rate x)).

    Parameters
    ----------
    yield_stress
        R at x = 0, of a bar (stress), > 0.
    saturation
        The limit of R - R(0) for large x (stress), >= 0.
    rate
        Rate of saturation (1), > 0.
    """

    yield_stress: PositiveDatum
    saturation: NotNegativeDatum
    rate: PositiveDatum

    def energy(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        part = (1 - _exp(-self.rate * x)) * (self.saturation / self.rate)
        return (self.yield_stress + self.saturation) * x - part

    def stress(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return self.yield_stress + self.saturation * (1 - _exp(-self.rate * x))

    def slope(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return self.saturation * self.rate * _exp(-self.rate * x)

    def slopes(self, first: Value, last: Value) -> tuple[Value, Value]:
        """See ``HardeningLaw``: the slope falls."""
        return self.slope(last), self.slope(first)


@dataclass(frozen=True, eq=False)
class Swift(HardeningLaw):
    """R = yield_stress (1 + x / offset)^exponent.

    Parameters
    ----------
    yield_stress
        R at x = 0, of a bar (stress), > 0.
    offset
        eps_0 > 0 (1); K = yield_stress / offset^exponent in R = K (eps_0 + x)^exponent.
    exponent
        n >= 0 (1).
    """

    yield_stress: PositiveDatum
    offset: PositiveDatum
    exponent: NotNegativeDatum

    def energy(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        n = self.exponent + 1
        return self.yield_stress * self.offset / n * ((1 + x / self.offset) ** n - 1)

    def stress(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return self.yield_stress * (1 + x / self.offset) ** self.exponent

    def slope(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return self.exponent / (self.offset + x) * self.stress(x)

    def slopes(self, first: Value, last: Value) -> tuple[Value, Value]:
        """See ``HardeningLaw``: the slope falls, or grows where the exponent exceeds one."""
        one = self.slope(first)
        other = self.slope(last)
        return np.minimum(one, other), np.maximum(one, other)


@dataclass(frozen=True, eq=False)
class Tabulated(HardeningLaw):
    """R is linear between given points and constant beyond the last; one point: no hardening.

    Parameters
    ----------
    plastic_strain
        Increasing numbers x, the first one 0 (1).
    stress_there
        R at each of them (stress), numbers or coefficients > 0 that do not fall.
    """

    plastic_strain: Sequence[float]
    stress_there: Sequence[Coefficient]

    def __post_init__(self) -> None:
        given = self.plastic_strain
        there = self.stress_there
        require_sequence("plastic_strain", given, "numbers")
        require_sequence("stress_there", there, "numbers")
        x = tuple(require_number("plastic_strain", value) for value in given)
        if not x or x[0] != 0 or not all(a < b for a, b in pairwise(x)):
            raise ValueError(
                f"plastic_strain={in_words(given)}: increasing numbers from 0 on are needed"
            )
        if len(there) != len(x):
            raise ValueError(
                f"stress_there={in_words(there)}: {len(x)} values are needed, one for each x"
            )
        R = tuple(
            require_datum("stress_there", value, 0, strict=True) for value in there
        )
        numbers = [value for value in R if is_number(value)]
        if any(a > b for a, b in pairwise(numbers)):
            raise ValueError(
                f"stress_there={in_words(there)}: stresses that do not fall are needed"
            )
        vars(self).update(plastic_strain=x, stress_there=R)

    def energy(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        bends = (c / 2 * _from_zero(x - k, x - k) ** 2 for k, c in self._bends)
        return self.stress_there[0] * x + sum(bends)

    def stress(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return self.stress_there[0] + sum(
            c * _from_zero(x - k, x - k) for k, c in self._bends
        )

    def slope(self, x: Value) -> Value:
        """See ``HardeningLaw``."""
        return 0.0 * x + sum(_from_zero(x - k, c) for k, c in self._bends)

    def slopes(self, first: Value, last: Value) -> tuple[Value, Value]:
        """See ``HardeningLaw``: those of all lines that the interval touches."""
        least = self.slope(first)
        most = least
        for k in self.plastic_strain:
            inside = (first <= k) & (k <= last)
            here = self.slope(k + 0.0 * first)
            least = np.where(inside, np.minimum(least, here), least)
            most = np.where(inside, np.maximum(most, here), most)
        return least, most

    @property
    def _bends(self) -> list[tuple]:
        """The points where the slope changes, and its jumps there."""
        points = zip(self.plastic_strain, self.stress_there, strict=True)
        slopes = [(d - b) / (c - a) for (a, b), (c, d) in pairwise(points)]
        gains = (after - before for before, after in pairwise([0.0, *slopes, 0.0]))
        return list(zip(self.plastic_strain, gains, strict=True))


def check_law(law: HardeningLaw, mesh: Mesh) -> None:
    """Accept a flow stress that is finite, positive and not decreasing."""
    there = law.at(lambda value: require_field("law", value, mesh))
    before = 0.0
    for x in STRAINS:
        stress = there.stress(x)
        if not (
            np.min(stress) > 0 and np.min(stress - before) >= -1e-12 * np.max(stress)
        ):
            found = f"the flow stress at PEEQ = {x:g} is {np.min(stress):g}"
            needed = (
                "positive values that never fall are needed (softening is not covered)"
            )
            raise ValueError(f"law={in_words(law)}: {found}: {needed}")
        before = stress


def _exp(x: Value) -> Value:
    """The exponential of coefficients and arrays."""
    return exp(x) if isinstance(x, CoefficientFunction) else np.exp(x)


def _from_zero(x: Value, value: Value) -> Value:
    """``value`` where x >= 0, 0 elsewhere."""
    of_space = isinstance(x, CoefficientFunction)
    return IfPos(-x, 0.0, value) if of_space else np.where(x >= 0, value, 0.0)
