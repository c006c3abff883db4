"""The law of the material at the integration points: one potential of the strain of a time step.

With the strain of a point, the history, and the plastic strain p gained in the step, the density of
(2.14) is

    bulk/2 (tr e)^2 + mu_2 |dev e - p_0 - p|^2 + dev alpha_2,0 : p + h/2 |p|^2 + int_0^g beta,

in which g measures p, |p| for von Mises, and ``Resistance`` is beta.  phi(e), the density smallest
over p, is the potential: it is convex, its derivative is the stress, the derivative of that the
moduli.  With the trial stress s and the modulus M,

    s = 2 mu_2 (dev e - p_0) - dev alpha_2,0,    M = 2 mu_2 + h,    w = s - M p,

w = -q with q of (3.8) is the part of s that is left on the yield surface, and

    dev sigma = 2 mu_2 (dev e - p_0 - p) = (h s + 2 mu_2 w) / M + dev alpha_2,0.

A law has to know its yield surface: the measure of s that is compared with beta, which p and w
belong to s, and how w changes.  ``laws.law_of`` chooses it.  Exact method, bounds and derivatives
use the methods of ``Law`` and the fields of ``Return`` only.  Newton's method has w as a variable
of its own (``local.system``).

Where a component of the strain is free, eps_zz in plane stress, the potential is smallest over it
too: ``returned`` finds it, ``moduli`` are those of the others (``across`` is its direction).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from ngsolve import Trace

from ngepc._deprecated import old_names
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.resistance import EXACT, Resistance
from ngepc.model.data import ProblemData
from ngepc.model.material import Material, split_hardening

ROUNDING = 1e-9
"""Fraction of beta by which |s| has to exceed beta before a point counts as yielding.

A load step starts with |s| = beta, up to rounding, wherever the last one has yielded; these points
count as elastic, so that unloading needs one Newton step.
"""

SOFTEST = 1e-8  # part of the elastic modulus in tangents where a law does not harden
UNREACHED = 1.0  # finite value in place of an infinite |p| while a stress is searched
SEARCHES = 100  # largest number of Newton and bisection steps for a free component of the strain

AT_POINTS = ("bulk", "two_mu", "hardening", "back", "initial", "swelling", "distortion")
"""Arrays of every law that have one row for each point, beside ``resistance``."""


@dataclass(frozen=True, eq=False)
class Return:
    """The law at one strain; arrays have shape (points,) unless said otherwise."""

    volume: np.ndarray  # tr of the strain beyond the initial one, with free components
    deviator: np.ndarray  # the coordinates of its deviator, shape (points, d)
    trial: np.ndarray  # s, shape (points, d)
    size: np.ndarray  # the measure of s, |s| for von Mises
    yields: np.ndarray  # size > beta
    gained: np.ndarray  # g, |p| for von Mises
    radius: np.ndarray  # beta(g), beta where it does not yield
    slope: np.ndarray  # d radius / d size, 0 where it does not yield
    direction: np.ndarray  # of the flow, p = g direction, shape (points, d)
    normal: np.ndarray  # dg/dp, w = radius normal where it yields, shape (points, d)

    @property
    def plastic_strain(self) -> np.ndarray:
        """p in coordinates, shape (points, d)."""
        return self.gained[:, None] * self.direction


class Law(ABC):
    """Material and history of a problem at the integration points, arrays of shape (points,)."""

    material: Material  # its data as ``finer.seen_problem`` has them
    bulk: np.ndarray  # mu_1 + 2 mu_2/size (stress)
    two_mu: np.ndarray  # 2 mu_2 (stress)
    hardening: np.ndarray  # h (stress)
    resistance: Resistance  # beta
    back: np.ndarray  # dev alpha_2,0 (stress) in coordinates, shape (points, d)
    initial: np.ndarray  # p_0 in coordinates, shape (points, d)
    swelling: np.ndarray | float  # tr eps_0, subtracted from strains; 0 without
    distortion: np.ndarray | float  # dev eps_0 in coordinates; 0 without
    across: np.ndarray | None  # deviator of a unit of the free strain, None without
    at_points: ClassVar[tuple[str, ...]] = AT_POINTS  # names of the arrays
    is_radial: ClassVar[bool] = True  # p and w are multiples of s

    def __init__(self, problem: ProblemData, points: Points) -> None:
        kinematics = points.kinematics
        material = problem.material
        self.material = material
        self.two_mu = points.at(2 * material.lame_mu)
        self.bulk = points.at(material.lame_lambda) + self.two_mu / kinematics.size
        self.hardening = points.at(material.effective_hardening)
        law = None if material.law is None else material.law.at(points.at)
        beta = points.at(problem.beta)
        accumulated = points.at(problem.initial_accumulated or 0.0)
        rate = None if problem.rate is None else problem.rate.at(points.at)
        duration = problem.duration
        self.resistance = Resistance(beta, law, accumulated, rate, duration)
        self.back = self.initial = np.broadcast_to(0.0, (len(points), kinematics.d))
        back_stress = split_hardening(problem.initial_hardening)[1]
        if back_stress is not None:
            self.back = points.coordinates(back_stress)
        if problem.initial_plastic_strain is not None:
            self.initial = points.coordinates(problem.p_0)
        self.swelling = 0.0
        self.distortion = 0.0
        if problem.initial_strain is not None:
            self.swelling, self.distortion = self.initial_parts(problem, points)
        self.across = kinematics.across if kinematics.thin else None

    @property
    def beta(self) -> np.ndarray:
        """The yield bound at the beginning of the step (stress)."""
        return self.resistance.beta

    @property
    def modulus(self) -> np.ndarray:
        """M = 2 mu_2 + h (stress)."""
        return self.two_mu + self.hardening

    @property
    def elastic_moduli(self) -> Moduli:
        """The moduli where nothing yields."""
        zero = np.zeros_like(self.two_mu)
        direction = np.zeros((len(zero), self.back.shape[1]))
        return self.condensed(Moduli(self.bulk, self.two_mu, zero, direction))

    def of(self, points: np.ndarray | slice) -> Law:
        """The law at some of the points, in the order of their numbers."""
        other = copy(self)
        for name in self.at_points:
            value = getattr(self, name)
            if np.ndim(value):
                setattr(other, name, value[points])
        other.resistance = self.resistance.of(points)
        return other

    # the yield surface, defined by subclasses

    @abstractmethod
    def measured(self, s: np.ndarray) -> np.ndarray:
        """The measure of stresses s to be compared with beta, shape (points,)."""

    @abstractmethod
    def gained_at(self, s: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """The g whose p and w = s - modulus p are those of s, inf where there is none."""

    @abstractmethod
    def _filled(self, at: Return, modulus: np.ndarray) -> Return:
        """The return with slope, direction and normal that belong to trial and gained."""

    @abstractmethod
    def yielding_part(self, at: Return) -> np.ndarray:
        """w of a return; equal to s at elastic points, shape (points, d)."""

    def projected(self, w: np.ndarray, at: Return) -> np.ndarray:
        """w, shortened to the yield surface with the present radius where it is beyond."""
        return (at.radius / np.maximum(self.measured(w), at.radius))[:, None] * w

    @abstractmethod
    def moved(self, at: Return, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """w + dw for a change ds of s, by the linearised equation of w and s."""

    @abstractmethod
    def flow_change(self, at: Return, ds: np.ndarray) -> np.ndarray:
        """The derivative of p by s, a symmetric map, zero at elastic points."""

    @abstractmethod
    def closed_moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """The symmetrised tangent of the stress with w as an independent variable.

        It lies between zero and the elastic moduli, and is the derivative of the stress for the
        w of ``yielding_part``.  No component of the strain is free.
        """

    # the potential

    def returned(self, volume: np.ndarray, e: np.ndarray) -> Return:
        """The law at a strain beyond the initial one: its trace, and dev e (points, d).

        The energy is convex in a free component z: Newton's method with bisection.
        """
        if self.across is None:
            return self._returned(volume, e)
        z = np.zeros(len(volume))
        low = np.full_like(z, -np.inf)
        high = np.full_like(z, np.inf)
        strains = np.abs(e).max(axis=1) + np.abs(self.initial).max(axis=1)
        largest = self.bulk * np.abs(volume) + self.two_mu * strains
        for _ in range(SEARCHES):
            at = self._returned(volume + z, e + z[:, None] * self.across)
            mean, stress = self.stress(at)
            excess = mean + stress @ self.across
            low = np.where(excess <= 0, z, low)
            high = np.where(excess >= 0, z, high)
            terms = largest + (self.bulk + self.two_mu) * np.abs(z)
            done = np.abs(excess) <= EXACT * (terms + np.abs(stress).max(axis=1))
            if done.all():
                break
            moduli = self.closed_moduli(at, self.yielding_part(at))
            newton = z - excess / self.stiffness_across(moduli)
            inside = (low < newton) & (newton < high)
            bounded = np.isfinite(low + high)
            middle = np.where(bounded, 0.5 * (low + high), newton)
            z = np.where(done, z, np.where(inside, newton, middle))
        return at

    def _returned(self, volume: np.ndarray, e: np.ndarray) -> Return:
        """The law at a strain that is known in all components."""
        s = self.two_mu[:, None] * (e - self.initial) - self.back
        size = self.measured(s)
        yields = size > (1 + ROUNDING) * self.beta
        gained = np.where(yields, self.gained_at(s, self.modulus), 0.0)
        radius = self.resistance.bound(gained)
        zero = np.zeros_like(s)
        at = Return(volume, e, s, size, yields, gained, radius, zero[:, 0], zero, zero)
        return self._filled(at, self.modulus)

    def stress(self, at: Return) -> tuple[np.ndarray, np.ndarray]:
        """The factor of tr eps in sigma : eps, and dev sigma in coordinates (points, d).

        The formula avoids the cancellation of e and p.
        """
        w = self.yielding_part(at)
        h = self.hardening[:, None]
        two_mu = self.two_mu[:, None]
        deviator = np.where(
            at.yields[:, None], (h * at.trial + two_mu * w) / (two_mu + h), at.trial
        )
        return self.bulk * at.volume, deviator + self.back

    def energy_density(self, at: Return) -> np.ndarray:
        """phi, the density of J without the loads, smallest over p (2.14), shape (points,)."""
        two_mu = self.two_mu
        M = self.modulus
        w = self.yielding_part(at)
        trial_square = np.einsum("pd,pd->p", at.trial, at.trial)
        yielding_square = np.einsum("pd,pd->p", w, w)
        shape = trial_square * self.hardening / (two_mu * M) + yielding_square / M
        shape += 2 * self.resistance.energy(at.gained)
        history = np.einsum("pd,pd->p", self.back, self.back + 2 * at.trial) / two_mu
        history -= two_mu * np.einsum("pd,pd->p", self.initial, self.initial)
        return 0.5 * (self.bulk * at.volume * at.volume + shape + history)

    def complementary_density(
        self, pressure: np.ndarray, stress: np.ndarray
    ) -> np.ndarray:
        """phi*, the conjugate of ``energy_density`` at a stress, shape (points,); it may be inf.

        phi is taken as a function of the total strain, with the initial strain.  ``pressure`` is
        the factor of tr eps in sigma : eps (points,), ``stress`` dev sigma in coordinates (points,
        d).
        """
        s = stress - self.back
        g = self.gained_at(s, self.hardening)
        reached = np.where(g < np.inf, g, 0.0)
        p = self.flow(s, self.hardening, reached)
        work = np.einsum("pd,pd->p", s, p)
        stored = 0.5 * self.hardening * np.einsum("pd,pd->p", p, p)
        flow = work - stored - self.resistance.energy(reached)
        total = stress + self.two_mu[:, None] * self.initial
        shape = 0.5 * np.einsum("pd,pd->p", total, total) / self.two_mu
        free = pressure * self.swelling + np.sum(stress * self.distortion, axis=1)
        plastic = np.where(g < np.inf, flow, np.inf)
        return 0.5 * pressure**2 / self.bulk + shape + plastic + free

    def strained(self, stress: np.ndarray) -> np.ndarray:
        """dev e beyond the initial strain, (points, d), of a stress in the same coordinates.

        It is the derivative of ``complementary_density`` by the stress.  Where that is infinite
        the plastic strain is taken as ``UNREACHED``.
        """
        s = stress - self.back
        g = self.gained_at(s, self.hardening)
        reached = np.where(g < np.inf, g, UNREACHED)
        elastic = stress / self.two_mu[:, None] + self.initial
        return elastic + self.flow(s, self.hardening, reached)

    @abstractmethod
    def flow(
        self, s: np.ndarray, modulus: np.ndarray, gained: np.ndarray
    ) -> np.ndarray:
        """The p of s with this measure and modulus, shape (points, d)."""

    def moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """``closed_moduli`` of the components of the strain that are not free."""
        return self.condensed(self.closed_moduli(at, w))

    def linearised(
        self, at: Return, w: np.ndarray, volume: np.ndarray, e: np.ndarray
    ) -> np.ndarray:
        """w + dw for a change of the strain, its trace and its deviator."""
        if self.across is not None:
            _, e = self.with_free_component(self.closed_moduli(at, w), volume, e)
        return self.moved(at, w, self.two_mu[:, None] * e)

    # free components of the strain

    def stiffness_across(self, moduli: Moduli) -> np.ndarray:
        """The modulus of the free component in its own direction, (points,)."""
        n = np.broadcast_to(self.across, moduli.direction.shape)
        return moduli.bulk + moduli(n) @ self.across

    def with_free_component(
        self, moduli: Moduli, volume: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """A change of strain, completed by the free component for which its stress stays zero."""
        if self.across is None:
            return volume, e
        n = np.broadcast_to(self.across, e.shape)
        stress = moduli.bulk * volume + np.einsum("pd,pd->p", moduli(n), e)
        z = -stress / self.stiffness_across(moduli)
        return volume + z, e + z[:, None] * self.across

    def condensed(self, moduli: Moduli) -> Moduli:
        """The moduli of the other components where one is free, a Schur complement."""
        if self.across is None:
            return moduli
        n = np.broadcast_to(self.across, moduli.direction.shape)
        column = np.column_stack([moduli.bulk, moduli(n)])
        taken = column[:, :, None] * column[:, None, :]
        taken /= self.stiffness_across(moduli)[:, None, None]
        own = 0.0 if moduli.coupling is None else moduli.coupling
        return replace(moduli, coupling=own - taken)

    # further quantities of a law

    @property
    def least_hardening(self) -> np.ndarray:
        """A modulus h with which phi is at least as convex as with linear hardening, (points,)."""
        return self.hardening

    def spent(self, at: Return) -> np.ndarray:
        """Elastic energy, energy of hardening and dissipation of the step, (points,)."""
        mean, stress = self.stress(at)
        p = at.plastic_strain
        shape = np.einsum("pd,pd->p", stress, stress) / self.two_mu
        elastic = (mean**2 / self.bulk + shape) / 2
        hardened = self.hardening / 2 * np.einsum("pd,pd->p", p, p)
        plastic = hardened + self.resistance.energy(at.gained)
        return elastic + plastic

    def lost(self, at: Return) -> np.ndarray:
        """beta g, the dissipation of the step (energy per volume), (points,)."""
        return self.beta * at.gained

    def own_memory(self, at: Return | None = None) -> dict[str, np.ndarray]:
        """Additional history of this law, now or after a return: name -> array."""
        return {}

    def carry(self, arrays: Mapping[str, np.ndarray], beta: np.ndarray) -> None:
        """Take the history of an earlier step, with a new bound beta(0)."""
        self.initial = arrays["plastic_strain"]
        self.back = arrays["back_stress"]
        accumulated = arrays["accumulated"]
        self.resistance = replace(self.resistance, beta=beta, accumulated=accumulated)

    @staticmethod
    def initial_parts(
        problem: ProblemData, points: Points
    ) -> tuple[np.ndarray, np.ndarray]:
        """The trace of the initial strain and the coordinates of its deviator."""
        return points.at(Trace(problem.eps_0)), points.coordinates(problem.eps_0)

    def beyond_initial(
        self, volume: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """A strain minus the initial strain, the argument of ``returned``."""
        return volume - self.swelling, e - self.distortion

    def flowing(self, at: Return) -> np.ndarray:
        """g where there is no hardening left, 0 elsewhere (points,)."""
        return np.where(self.hardens(at), 0.0, at.gained)

    def hardens(self, at: Return) -> np.ndarray:
        """Whether the stress still grows with s beyond the yield surface (points,)."""
        slope = self.hardening + self.resistance.slope(at.gained)
        return slope > SOFTEST * self.two_mu

    def with_sides(self, at: Return, yields: np.ndarray) -> Return:
        """The same return with given plastic points ``yields``: one side of a kink."""
        return self._filled(replace(at, yields=yields), self.modulus)

    def close_to_yielding(self, at: Return, part: float) -> np.ndarray:
        """Whether the measure of s differs from beta by less than a part of it (points,)."""
        return np.abs(at.size - self.beta) <= part * self.beta


__getattr__ = old_names(__name__)
