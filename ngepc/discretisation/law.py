"""The radial law at the integration points: von Mises plasticity with convex hardening.

With the coordinates e of dev eps(u) at a point, what the step starts from, and the bound beta(g) of
the law of hardening at |p| = g,

    s = 2 mu_2 (e - p_0) - dev alpha_2          the trial stress,
    p = g s / |s|,  (2 mu_2 + h) g + beta(g) = |s| or g = 0     the plastic strain gained,
    w = s - (2 mu_2 + h) p                      the yielding part of s,  w = -q  with q of (3.8),

so that |w| <= r(|s|), the bound beta(g) that |s| leads to.  Linear hardening is in h, with a beta
that stays.  The deviatoric stress is 2 mu_2 (e - p_0 - p) = (h s + 2 mu_2 w) / (2 mu_2 + h) + dev
alpha_2, and the density of J(u, p) smallest over p is differentiable in e.  Only w is not linear in
s: where s yields, |s| w = r(|s|) s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve import Trace

from ngepc.discretisation.points import Moduli, Points
from ngepc.model.hardening import HardeningLaw
from ngepc.model.material import PEEQ
from ngepc.model.problem import Problem, as_scalar

ROUNDING = 1e-9
"""Part of beta by which |s| has to exceed beta before a point counts as yielding.

A load step starts with |s| = beta, up to rounding, wherever the last one has yielded; these points
count as elastic, so that unloading needs one Newton step.
"""

ENDLESS = 1e6  # |p| beyond which no |p| is looked for where nothing bounds it
SOFTEST = 1e-8  # part of the elastic modulus that tangents keep where a law does not harden at all
EXACT = (
    4 * np.finfo(float).eps
)  # part of a stress to which equations at the points are solved


@dataclass(frozen=True, eq=False)
class Return:
    """The law at one strain; all have shape (points,) but the trial stress."""

    trial: np.ndarray  # s, shape (points, d)
    size: np.ndarray  # |s|
    yields: np.ndarray  # |s| > beta
    gained: np.ndarray  # |p|
    radius: np.ndarray  # r(|s|), beta where it does not yield
    slope: np.ndarray  # r'(|s|), 0 where it does not yield

    @property
    def direction(self) -> np.ndarray:
        """The unit vector s/|s|, 0 for s = 0, shape (points, d)."""
        return self.trial / np.where(self.size > 0, self.size, 1.0)[:, None]

    @property
    def plastic_strain(self) -> np.ndarray:
        """p in coordinates, shape (points, d)."""
        return self.gained[:, None] * self.direction


class Law:
    """Material and history of a problem at the integration points, arrays of shape (points,)."""

    bulk: np.ndarray  # mu_1 + 2 mu_2/size (stress)
    two_mu: np.ndarray  # 2 mu_2 (stress)
    hardening: np.ndarray  # h (stress)
    beta: np.ndarray  # the yield bound (stress)
    back: np.ndarray  # dev alpha_2 (stress) in coordinates, shape (points, d)
    initial: np.ndarray  # p_0 in coordinates, shape (points, d)
    swelling: np.ndarray | float  # tr eps_0, to be taken off strains; 0 without
    distortion: np.ndarray | float  # dev eps_0 in coordinates; 0 without
    isotropic: HardeningLaw | None  # its data at the points
    accumulated: np.ndarray  # PEEQ where the law starts

    def __init__(self, problem: Problem, points: Points) -> None:
        kinematics = points.kinematics
        material = problem.material
        self.two_mu = points.at(2 * material.lame_mu)
        self.bulk = points.at(material.lame_lambda) + self.two_mu / kinematics.size
        self.hardening = points.at(problem.effective_hardening)
        self.beta = points.at(as_scalar(problem.beta))
        self.back = self.initial = np.broadcast_to(0.0, (len(points), kinematics.d))
        if problem.initial_hardening is not None:
            self.back = points.at(kinematics.coordinates(problem.alpha_0[1]))
        if problem.initial_plastic_strain is not None:
            self.initial = points.at(kinematics.coordinates(problem.p_0))
        self.swelling = 0.0
        self.distortion = 0.0
        if problem.initial_strain is not None:
            self.swelling = points.at(Trace(problem.eps_0))
            self.distortion = points.at(kinematics.coordinates(problem.eps_0))
        self.isotropic = None if material.law is None else material.law.at(points.at)
        self.accumulated = points.at(problem.accumulated_0)

    def returned(self, e: np.ndarray) -> Return:
        """The law at the coordinates ``e`` of dev eps, shape (points, d)."""
        s = self.two_mu[:, None] * (e - self.initial) - self.back
        size = np.sqrt(np.einsum("pd,pd->p", s, s))
        yields = size > (1 + ROUNDING) * self.beta
        M = self.two_mu + self.hardening
        gained = self.gained_at(np.where(yields, size, self.beta), M)
        slope = self._slope(gained)
        slope = np.where(yields, slope / (M + slope), 0.0)
        return Return(s, size, yields, gained, self.bound(gained), slope)

    def bound(self, gained: np.ndarray) -> np.ndarray:
        """beta(g) for |p| = g (stress), shape (points,)."""
        if self.isotropic is None:
            return self.beta
        x = self.accumulated
        there = self.isotropic
        return self.beta + PEEQ * (there.stress(x + PEEQ * gained) - there.stress(x))

    def _slope(self, gained: np.ndarray) -> np.ndarray:
        """beta'(g)."""
        if self.isotropic is None:
            return np.zeros_like(gained)
        return PEEQ**2 * self.isotropic.slope(self.accumulated + PEEQ * gained)

    def gained_at(self, size: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """The g >= 0 with modulus g + beta(g) = size, 0 where size <= beta, inf for none (points,).

        Newton's method within brackets that bisection halves where it is slow.
        """
        over = np.maximum(size - self.beta, 0.0)
        high = np.where(modulus > 0, over / np.where(modulus > 0, modulus, 1), ENDLESS)
        if self.isotropic is None:
            return high
        low = np.zeros_like(size)
        g = np.zeros_like(size)
        before = np.inf
        exact = EXACT * np.maximum(size, self.beta)
        for _ in range(100):
            excess = modulus * g + self.bound(g) - size
            low = np.where(excess <= 0, g, low)
            high = np.where(excess >= 0, g, high)
            done = (np.abs(excess) <= exact) | (over == 0)
            if done.all():
                break
            steep = modulus + self._slope(g)
            newton = g - excess / np.where(steep > 0, steep, 1.0)
            good = (low < newton) & (newton < high) & (np.abs(excess) < 0.5 * before)
            g = np.where(done, g, np.where(good, newton, 0.5 * (low + high)))
            before = np.abs(excess)
        return np.where((modulus > 0) | (g < 0.99 * ENDLESS), g, np.inf)

    def flowing(self, gained: np.ndarray) -> np.ndarray:
        """|p| where a law hardens no more, 0 elsewhere (points,)."""
        stiff = self.hardening + self._slope(gained) > SOFTEST * self.two_mu
        return np.where(stiff, 0.0, gained)

    def hardening_energy(self, gained: np.ndarray) -> np.ndarray:
        """int_0^g beta for |p| = g (energy per volume), shape (points,)."""
        if self.isotropic is None:
            return self.beta * gained
        x = self.accumulated
        more = PEEQ * gained
        there = self.isotropic
        beyond = there.energy(x + more) - there.energy(x) - there.stress(x) * more
        return self.beta * gained + beyond

    def stress(self, at: Return) -> np.ndarray:
        """dev sigma in coordinates, shape (points, d), without the cancellation of e and p."""
        h = self.hardening
        two_mu = self.two_mu
        size = np.maximum(at.size, at.radius)
        kept = np.where(at.yields, (h + two_mu * at.radius / size) / (two_mu + h), 1.0)
        return kept[:, None] * at.trial + self.back

    def energy_density(self, volume: np.ndarray, at: Return) -> np.ndarray:
        """The density of J without the loads, smallest over p (2.14), shape (points,)."""
        two_mu, M, m = self.two_mu, self.two_mu + self.hardening, at.size
        b = np.minimum(m, at.radius)
        shape = m * m * self.hardening / (two_mu * M) + b * b / M
        shape += 2 * self.hardening_energy(at.gained)
        history = np.einsum("pd,pd->p", self.back, self.back + 2 * at.trial) / two_mu
        history -= two_mu * np.einsum("pd,pd->p", self.initial, self.initial)
        return 0.5 * (self.bulk * volume * volume + shape + history)

    def complementary_density(
        self, pressure: np.ndarray, stress: np.ndarray
    ) -> np.ndarray:
        """The conjugate of ``energy_density`` at a stress, inf where none can be (points,).

        As a function of all the strain, the initial one included.  ``pressure`` is the factor of
        tr eps in sigma : eps (points,), ``stress`` dev sigma in coordinates (points, d).
        """
        size = np.linalg.norm(stress - self.back, axis=1)
        g = self.gained_at(size, self.hardening)
        reached = np.where(g < np.inf, g, 0.0)
        flow = (
            size * reached
            - 0.5 * self.hardening * reached**2
            - self.hardening_energy(reached)
        )
        total = stress + self.two_mu[:, None] * self.initial
        shape = 0.5 * np.einsum("pd,pd->p", total, total) / self.two_mu
        free = pressure * self.swelling + np.sum(stress * self.distortion, axis=1)
        return (
            0.5 * pressure**2 / self.bulk
            + shape
            + np.where(g < np.inf, flow, np.inf)
            + free
        )

    def yielding_part(self, at: Return) -> np.ndarray:
        """w = r s / max(r, |s|), -q = dev sigma - dev alpha_2 - h p of (3.8), shape (points, d)."""
        return (at.radius / np.maximum(at.size, at.radius))[:, None] * at.trial

    def linearised(self, at: Return, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """w + dw for a change ds of s, from |s| w = r(|s|) s linearised where s yields."""
        size = np.maximum(at.size, at.radius)
        direction = at.direction
        along = np.einsum("pd,pd->p", direction, ds)
        moved = (at.radius[:, None] * (at.trial + ds) - along[:, None] * w) / size[
            :, None
        ]
        moved += (at.slope * along)[:, None] * direction
        return np.where(at.yields[:, None], moved, at.trial + ds)

    def projected(self, w: np.ndarray, at: Return) -> np.ndarray:
        """w projected onto |w| <= r(|s|)."""
        length = np.sqrt(np.einsum("pd,pd->p", w, w))
        return (at.radius / np.maximum(length, at.radius))[:, None] * w

    def moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """The tangent of the stress with w kept as a variable of its own, made symmetric.

        Where s yields  dw = (r ds + (r' |s| d - w) (d . ds)) / |s|  with d = s/|s|.  The part of w
        along s is kept, as at least r' |s|: the moduli stay below 2 mu_2.  With w = r d this is
        the derivative of the radial return.
        """
        two_mu = self.two_mu
        h = self.hardening
        size = np.maximum(at.size, at.radius)
        direction = at.direction
        part = two_mu / (two_mu + h)
        across = np.where(at.yields, part * (h + two_mu * at.radius / size), two_mu)
        along = np.maximum(np.einsum("pd,pd->p", direction, w), at.slope * size)
        along = np.minimum(along, at.radius)
        kept = 1.0 if self.isotropic is None else 1 - SOFTEST
        extra = np.where(
            at.yields, kept * part * two_mu * (at.slope - along / size), 0.0
        )
        return Moduli(self.bulk, across, extra, direction)
