"""Sub-elements in parallel at the points: radial laws that share the elasticity.

With the shares w_i of ``Material.overlay`` a point has the density

    bulk/2 (tr e)^2 + sum_i w_i (mu |dev e - p_i,0 - p_i|^2 + k_i |p_i|),

and the best p_i do not depend on each other: the stress, the energy and the moduli are sums over
the sub-elements, each a radial law with w_i 2 mu and w_i k_i.  Newton's variable w is one for each
of them, the gain of the plastic strain is p = sum_i w_i p_i.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np

from ngepc.discretisation.law import ROUNDING, Law, Return
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.resistance import EXACT, Resistance
from ngepc.discretisation.von_mises_law import VonMisesLaw
from ngepc.model.data import ProblemData

NEVER = 1e80  # bound, in units of 2 mu, of the sub-element that does not yield
STEPS = 60  # largest number of Newton steps for the strain of a stress
SHORTEST = 2.0**-20  # step length of Newton's method for that
DECREASE = 1e-4  # part of the decrease predicted by the slope that a step must reach


@dataclass(frozen=True, eq=False)
class OverlayReturn(Return):
    """The law at one strain, and each of its sub-elements there."""

    parts: tuple[Return, ...] = ()


class OverlayLaw(Law):
    """Sub-elements that share the strain; ``size`` compares the one that is closest to yielding."""

    is_radial = False
    shares: tuple[float, ...]
    elastic_share: float  # of the sub-element that does not yield
    parts: tuple[VonMisesLaw, ...]

    def __init__(self, problem: ProblemData, points: Points) -> None:
        super().__init__(problem, points)
        overlay = problem.material.overlay
        self.shares = overlay.shares
        self.elastic_share = overlay.elastic_share
        bounds = list(overlay.bounds)
        if overlay.elastic_share:
            self.shares = (*self.shares, overlay.elastic_share)
            bounds.append(NEVER * float(self.two_mu.max()))
        radial = VonMisesLaw(problem, points)
        bounded = zip(self.shares, bounds, strict=True)
        self.parts = tuple(_part(radial, *one) for one in bounded)
        given = problem.initial_hardening
        if given is not None and len(given.dims) == 1:
            self.start_parts(points.at(given))

    def of(self, points: np.ndarray | slice) -> OverlayLaw:
        """See ``Law``: the sub-elements at these points."""
        other = super().of(points)
        other.parts = tuple(part.of(points) for part in self.parts)
        return other

    def start_parts(self, plastic_strains: np.ndarray) -> None:
        """Start from these plastic strains of the sub-elements, (points, n d)."""
        for part, strain in zip(self.parts, self.split(plastic_strains), strict=True):
            part.initial = strain

    def carry(self, arrays: Mapping[str, np.ndarray], beta: np.ndarray) -> None:
        """See ``Law``."""
        super().carry(arrays, beta)
        self.start_parts(arrays["parts"])

    def own_memory(self, at: OverlayReturn | None = None) -> dict[str, np.ndarray]:
        """See ``Law``: the plastic strains of the sub-elements."""
        strains = [part.initial for part in self.parts]
        if at is not None:
            gained = [one.plastic_strain for one in at.parts]
            strains = [one + more for one, more in zip(strains, gained, strict=True)]
        return {"parts": np.hstack(strains)}

    def split(self, stack: np.ndarray) -> list[np.ndarray]:
        """The parts of an array that belong to the sub-elements, shape (points, d) each."""
        return np.split(stack, len(self.parts), axis=1)

    @property
    def least_hardening(self) -> np.ndarray:
        """See ``Law``: that of the sub-element that does not yield, 0 without."""
        return self.two_mu * self.elastic_share / (1 - self.elastic_share)

    def spent(self, at: OverlayReturn) -> np.ndarray:
        """See ``Law``: elastic energies and dissipation of the sub-elements."""
        mean = self.bulk * at.volume
        energy = mean**2 / (2 * self.bulk)
        for part, one in zip(self.parts, at.parts, strict=True):
            stress = part.stress(one)[1]
            square = np.einsum("pd,pd->p", stress, stress)
            energy = energy + square / (2 * part.two_mu) + part.beta * one.gained
        return energy

    def lost(self, at: OverlayReturn) -> np.ndarray:
        """See ``Law``."""
        both = zip(self.parts, at.parts, strict=True)
        return sum(part.beta * one.gained for part, one in both)

    # the yield surfaces

    def measured(self, s: np.ndarray) -> np.ndarray:
        """See ``Law``: |s|, of a body without a history."""
        return np.sqrt(np.einsum("pd,pd->p", s, s))

    def gained_at(self, s: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """See ``Law``: not defined, a stress alone does not determine the plastic strains."""
        raise NotImplementedError("sub-elements have no single measure of a stress")

    def flow(
        self, s: np.ndarray, modulus: np.ndarray, gained: np.ndarray
    ) -> np.ndarray:
        """See ``gained_at``."""
        raise NotImplementedError("sub-elements have no single measure of a stress")

    def _returned(self, volume: np.ndarray, e: np.ndarray) -> OverlayReturn:
        parts = tuple(part._returned(volume, e) for part in self.parts)
        return self._summed(volume, e, parts)

    def _summed(
        self, volume: np.ndarray, e: np.ndarray, parts: tuple[Return, ...]
    ) -> OverlayReturn:
        """The return of the point from those of its sub-elements."""
        bounds = [part.beta for part in self.parts]
        filled = [one.size / k for one, k in zip(parts, bounds, strict=True)]
        weighted = zip(self.shares, parts, strict=True)
        p = sum(share * one.plastic_strain for share, one in weighted)
        gained = np.sqrt(np.einsum("pd,pd->p", p, p))
        direction = p / np.where(gained > 0, gained, 1.0)[:, None]
        s = self.two_mu[:, None] * (e - self.initial)
        size = self.beta * np.max(filled, axis=0)
        yields = np.any([one.yields for one in parts], axis=0)
        slope = np.zeros_like(size)
        known = (volume, e, s, size, yields, gained, self.beta, slope)
        return OverlayReturn(*known, direction, direction, parts)

    def _filled(self, at: Return, modulus: np.ndarray) -> Return:
        return at

    def with_sides(self, at: OverlayReturn, *yields: np.ndarray) -> OverlayReturn:
        """See ``Law``: the plastic points of each sub-element."""
        each = zip(self.parts, at.parts, yields, strict=True)
        parts = tuple(part.with_sides(one, sides) for part, one, sides in each)
        return self._summed(at.volume, at.deviator, parts)

    def yielding_part(self, at: OverlayReturn) -> np.ndarray:
        """See ``Law``: those of the sub-elements, (points, n d)."""
        both = zip(self.parts, at.parts, strict=True)
        return np.hstack([part.yielding_part(one) for part, one in both])

    def projected(self, w: np.ndarray, at: OverlayReturn) -> np.ndarray:
        """See ``Law``."""
        each = zip(self.parts, self.split(w), at.parts, strict=True)
        return np.hstack([part.projected(v, one) for part, v, one in each])

    def moved(self, at: OverlayReturn, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """See ``Law``."""
        each = zip(self.parts, at.parts, self.split(w), self.shares, strict=True)
        return np.hstack(
            [part.moved(one, v, share * ds) for part, one, v, share in each]
        )

    def flow_change(self, at: OverlayReturn, ds: np.ndarray) -> np.ndarray:
        """See ``Law``: the change of sum w_i p_i."""
        each = zip(self.parts, at.parts, self.shares, strict=True)
        return sum(
            share * part.flow_change(one, share * ds) for part, one, share in each
        )

    def closed_moduli(self, at: OverlayReturn, w: np.ndarray) -> Moduli:
        """See ``Law``: the sum of those of the sub-elements."""
        count, d = at.trial.shape
        across = np.zeros(count)
        coupling = np.zeros((count, 1 + d, 1 + d))
        for part, one, v in zip(self.parts, at.parts, self.split(w), strict=True):
            own = part.closed_moduli(one, v)
            along = own.direction
            across = across + own.across
            rank_one = own.extra[:, None, None] * along[:, :, None] * along[:, None, :]
            coupling[:, 1:, 1:] += rank_one
        zero = np.zeros(count)
        return Moduli(self.bulk, across, zero, np.zeros((count, d)), coupling)

    def hardens(self, at: OverlayReturn) -> np.ndarray:
        """See ``Law``: true while a sub-element is elastic."""
        return ~np.all([one.yields for one in at.parts], axis=0)

    def close_to_yielding(self, at: OverlayReturn, part: float) -> np.ndarray:
        """See ``Law``: one of the sub-elements is."""
        both = zip(self.parts, at.parts, strict=True)
        return np.any([law.close_to_yielding(one, part) for law, one in both], axis=0)

    # the potential

    def stress(self, at: OverlayReturn) -> tuple[np.ndarray, np.ndarray]:
        """See ``Law``."""
        both = zip(self.parts, at.parts, strict=True)
        return self.bulk * at.volume, sum(part.stress(one)[1] for part, one in both)

    def energy_density(self, at: OverlayReturn) -> np.ndarray:
        """See ``Law``."""
        both = zip(self.parts, at.parts, strict=True)
        shape = sum(part.energy_density(one) for part, one in both)
        return 0.5 * self.bulk * at.volume**2 + shape

    def complementary_density(
        self, pressure: np.ndarray, stress: np.ndarray
    ) -> np.ndarray:
        """See ``Law``: the sum of conjugates where the stress is best shared.

        Every split of the stress among the sub-elements gives an upper bound of the conjugate.
        Newton's method finds the strain of the stress, and with it the best split; what is missing
        goes to the sub-elements that do not yield.
        """
        at = self.at_stress(stress)
        missing = stress - self.stress(at)[1]
        both = zip(self.parts, at.parts, strict=True)
        loose = [np.where(one.yields, 0.0, part.two_mu) for part, one in both]
        whole = sum(loose)
        lost = np.abs(missing).max(axis=1) > EXACT * np.abs(stress).max(axis=1)
        shape = np.where((whole == 0) & lost, np.inf, 0.0)
        whole = np.where(whole > 0, whole, 1.0)
        for part, one, more in zip(self.parts, at.parts, loose, strict=True):
            own = part.stress(one)[1] + (more / whole)[:, None] * missing
            total = own + part.two_mu[:, None] * part.initial
            allowed = part.measured(own) <= (1 + ROUNDING) * part.beta
            square = np.einsum("pd,pd->p", total, total)
            shape = shape + np.where(allowed, 0.5 * square / part.two_mu, np.inf)
        free = pressure * self.swelling + np.sum(stress * self.distortion, axis=1)
        return 0.5 * pressure**2 / self.bulk + shape + free

    def strained(self, stress: np.ndarray) -> np.ndarray:
        """See ``Law``: nearly, by Newton's method."""
        return self.at_stress(stress).deviator

    def at_stress(self, stress: np.ndarray) -> OverlayReturn:
        """The return with nearly this deviatoric stress: Newton's method with line search."""
        volume = np.zeros(len(stress))
        two_mu = self.two_mu[:, None]
        e = stress / two_mu + sum(
            share * part.initial
            for share, part in zip(self.shares, self.parts, strict=True)
        )
        precise = EXACT * np.abs(stress).max(axis=1)
        for _ in range(STEPS):
            at = self._returned(volume, e)
            missing = stress - self.stress(at)[1]
            done = np.abs(missing).max(axis=1) <= precise
            if done.all():
                break
            moduli = self.closed_moduli(at, self.yielding_part(at))
            tangent = moduli.coupling[:, 1:, 1:].copy()
            tangent += moduli.across[:, None, None] * np.eye(e.shape[1])
            step = np.linalg.solve(tangent, missing[:, :, None])[:, :, 0]
            step[done] = 0.0
            e = e + self._length(at, stress, missing, step)[:, None] * step
        return at

    def _length(
        self,
        at: OverlayReturn,
        stress: np.ndarray,
        missing: np.ndarray,
        step: np.ndarray,
    ) -> np.ndarray:
        """The step length at which the energy minus the work of the stress decreases enough."""
        volume = at.volume
        start = self.energy_density(at) - np.einsum("pd,pd->p", stress, at.deviator)
        rate = np.einsum("pd,pd->p", missing, step)
        rounding = ROUNDING * np.abs(start)
        length = np.ones(len(start))
        while True:
            e = at.deviator + length[:, None] * step
            there = self.energy_density(self._returned(volume, e))
            there -= np.einsum("pd,pd->p", stress, e)
            long = there > start - DECREASE * length * rate + rounding
            long &= length > SHORTEST
            if not long.any():
                return length
            length = np.where(long, 0.5 * length, length)


def _part(radial: VonMisesLaw, share: float, bound: float) -> VonMisesLaw:
    """The sub-element with a share of the elasticity, without hardening."""
    part = copy(radial)
    zero = np.zeros_like(radial.two_mu)
    part.bulk = zero
    part.two_mu = share * radial.two_mu
    part.hardening = zero
    beta = np.full_like(zero, share * bound)
    part.resistance = Resistance(beta, None, zero)
    part.across = None
    part.back = np.zeros_like(radial.back)
    return part
