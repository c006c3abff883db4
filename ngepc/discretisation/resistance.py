"""The resistance to plastic strain in a time step: the bound beta(g) at |p| = g, its integral.

A step that gains the plastic strain p dissipates or stores int_0^g beta(t) dt with g = |p|, a
convex function of g, since beta does not decrease.  Everything that depends on the amount of
plastic strain alone belongs here: the yield stress, what isotropic hardening has added to it before
the step, what the law of hardening adds within it, and the overstress at the rate g / duration.
Linear kinematic hardening does not: it is the modulus h of ``discretisation.law``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.model.hardening import HardeningLaw
from ngepc.model.tensile import PEEQ
from ngepc.model.viscosity import RateLaw

ENDLESS = 1e6  # largest |p| in a search without an upper bound

FIRST = 1e-3
"""Start of brackets for |p|, which are doubled: huge ones would lose digits of energies."""

EXACT = 4 * np.finfo(float).eps
"""Fraction of a stress to which equations at the points are solved."""


@dataclass(frozen=True, eq=False)
class Resistance:
    """beta(g) at the integration points, arrays of shape (points,).

    Parameters
    ----------
    beta
        beta(0), the yield bound at the beginning of the step (stress).
    isotropic
        The law of hardening with its data at the points; None for a constant bound.
    accumulated
        PEEQ at the beginning of the step (1).
    rate
        The law of the rate with its data at the points; None without.
    duration
        The length of the time step (time), for the rate.
    linear
        Slope of linear isotropic hardening that is not part of the modulus h (stress).
    """

    beta: np.ndarray
    isotropic: HardeningLaw | None
    accumulated: np.ndarray
    rate: RateLaw | None = None
    duration: float | None = None
    linear: np.ndarray | float = 0.0

    @property
    def is_constant(self) -> bool:
        """Whether beta(g) = beta(0)."""
        without = self.isotropic is None and self.rate is None
        return without and not np.any(self.linear)

    def of(self, points: np.ndarray | slice) -> Resistance:
        """The same at some of the points."""

        def at_points(value: float | np.ndarray) -> float | np.ndarray:
            """A datum at the chosen points."""
            return value[points] if np.ndim(value) else value

        return replace(
            self,
            beta=self.beta[points],
            isotropic=None if self.isotropic is None else self.isotropic.at(at_points),
            accumulated=self.accumulated[points],
            rate=None if self.rate is None else self.rate.at(at_points),
            linear=at_points(self.linear),
        )

    def with_law(self, isotropic: HardeningLaw | None) -> Resistance:
        """The same with other data of the law, beta(0) kept."""
        return replace(self, isotropic=isotropic)

    def with_rate(self, rate: RateLaw | None) -> Resistance:
        """The same with other data of the rate."""
        return replace(self, rate=rate)

    def bound(self, gained: np.ndarray) -> np.ndarray:
        """beta(g) for |p| = g (stress), shape (points,)."""
        bound = self.beta + self.linear * gained
        if self.isotropic is not None:
            before = self.isotropic.stress(self.accumulated)
            after = self.isotropic.stress(self.accumulated + PEEQ * gained)
            bound = bound + PEEQ * (after - before)
        if self.rate is not None:
            bound = bound + PEEQ * self.rate.stress(PEEQ * gained / self.duration)
        return bound

    def slope(self, gained: np.ndarray) -> np.ndarray:
        """beta'(g) >= 0 (stress), shape (points,)."""
        slope = self.linear + np.zeros_like(gained)
        if self.isotropic is not None:
            x = self.accumulated + PEEQ * gained
            slope = slope + PEEQ**2 * self.isotropic.slope(x)
        if self.rate is not None:
            by_rate = self.rate.slope(PEEQ * gained / self.duration)
            slope = slope + PEEQ**2 / self.duration * by_rate
        return slope

    @property
    def growth(self) -> np.ndarray:
        """d beta(0) / d PEEQ at the beginning of the step (stress), shape (points,)."""
        if self.isotropic is None:
            return np.zeros_like(self.beta)
        return PEEQ * self.isotropic.slope(self.accumulated)

    def by_accumulated(self, gained: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of ``bound`` and ``energy`` by PEEQ at the start, for the same beta(0)."""
        if self.isotropic is None:
            return np.zeros_like(gained), np.zeros_like(gained)
        law = self.isotropic
        before = self.accumulated
        after = before + PEEQ * gained
        slope = law.slope(before)
        of_bound = PEEQ * (law.slope(after) - slope)
        of_energy = law.stress(after) - law.stress(before) - slope * PEEQ * gained
        return of_bound, of_energy

    def energy(self, gained: np.ndarray) -> np.ndarray:
        """int_0^g beta for |p| = g (energy per volume), shape (points,)."""
        return self.beta * gained + self.hardened(gained)

    def hardened(self, gained: np.ndarray) -> np.ndarray:
        """The part of ``energy`` beyond beta(0) g (energy per volume), shape (points,)."""
        energy = 0.5 * self.linear * gained**2
        more = PEEQ * gained
        law = self.isotropic
        if law is not None:
            before = self.accumulated
            stored = law.energy(before + more) - law.energy(before)
            energy = energy + stored - law.stress(before) * more
        if self.rate is not None:
            energy = energy + self.duration * self.rate.energy(more / self.duration)
        return energy

    def slopes(
        self, fewest: np.ndarray, most: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of beta' between two g from below and above (stress), shapes (points,)."""
        zero = np.zeros_like(fewest)
        least = self.linear + zero
        largest = self.linear + zero
        if self.isotropic is not None:
            first = self.accumulated + PEEQ * fewest
            last = self.accumulated + PEEQ * most
            slowest, fastest = self.isotropic.slopes(first, last)
            least = least + PEEQ**2 * slowest
            largest = largest + PEEQ**2 * fastest
        if self.rate is not None:
            each = PEEQ / self.duration
            slowest, fastest = self.rate.slopes(each * fewest, each * most)
            least = least + PEEQ * each * slowest
            largest = largest + PEEQ * each * fastest
        return least, largest

    def _start(self, over: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Where Newton's method for ``gained_at`` begins (points,).

        Zero, but where the slope of an overstress may be infinite: there what the rate alone gains
        under the stress ``over`` beyond the bound.
        """
        if self.rate is None:
            return np.zeros_like(over)
        with np.errstate(over="ignore"):
            by_rate = self.duration / PEEQ * self.rate.rate(over / PEEQ)
        return np.fmin(by_rate, high)

    def gained_at(self, size: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """The g >= 0 with modulus g + beta(g) = size, 0 where size <= beta, inf for none (points,).

        Newton's method within brackets that bisection halves where it is slow.
        """
        over = np.maximum(size - self.beta, 0.0)
        high = np.where(modulus > 0, over / np.where(modulus > 0, modulus, 1), ENDLESS)
        if self.is_constant:
            return high
        low = np.zeros_like(size)
        g = self._start(over, high)
        before = np.inf
        exact = EXACT * np.maximum(size, self.beta)
        for _ in range(100):
            excess = modulus * g + self.bound(g) - size
            low = np.where(excess <= 0, g, low)
            high = np.where(excess >= 0, g, high)
            done = (np.abs(excess) <= exact) | (over == 0)
            if done.all():
                break
            steep = np.maximum(modulus + self.slope(g), exact / ENDLESS)
            newton = g - excess / steep
            good = (low < newton) & (newton <= high) & (np.abs(excess) < 0.5 * before)
            middle = np.minimum(0.5 * (low + high), 2 * low + FIRST)
            g = np.where(done, g, np.where(good, newton, middle))
            before = np.abs(excess)
        return np.where((modulus > 0) | (g < 0.99 * ENDLESS), g, np.inf)
