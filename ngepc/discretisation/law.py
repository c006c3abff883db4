"""The radial law at the integration points: von Mises plasticity with linear hardening.

With the coordinates e of dev eps(u) at a point, and what the step starts from,

    s = 2 mu_2 (e - p_0) - dev alpha_2          the trial stress,
    p = [|s| - beta]_+ / (2 mu_2 + h) s / |s|   the plastic strain gained (Moreau's theorem),
    w = beta s / max(beta, |s|)                 the yielding part of s,  w = -q  with q of (3.8),

the deviatoric stress is 2 mu_2 (e - p_0 - p) = (h s + 2 mu_2 w) / (2 mu_2 + h) + dev alpha_2, and
the density of J(u, p) smallest over p is differentiable in e.  Only w is not linear in s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.discretisation.points import Moduli, Points
from ngepc.model.problem import Problem, as_scalar

ROUNDING = 1e-9
"""Part of beta by which |s| has to exceed beta before a point counts as yielding.

A load step starts with |s| = beta, up to rounding, wherever the last one has yielded; these points
count as elastic, so that unloading needs one Newton step.
"""


@dataclass(frozen=True, eq=False)
class Return:
    """The law at one strain.

    Parameters
    ----------
    trial, size, direction
        s (points, d), |s| (points,) and s/|s| (points, d).
    yields
        Boolean, shape (points,): |s| > beta.
    gained
        |p|, shape (points,).
    """

    trial: np.ndarray
    size: np.ndarray
    direction: np.ndarray
    yields: np.ndarray
    gained: np.ndarray

    @property
    def plastic_strain(self) -> np.ndarray:
        """p in coordinates, shape (points, d)."""
        return self.gained[:, None] * self.direction


class Law:
    """Material and history of a problem at the integration points.

    Parameters
    ----------
    problem
        Data of the time step.
    points
        The integration points.

    Attributes
    ----------
    bulk, two_mu, hardening, beta
        mu_1 + 2 mu_2/size, 2 mu_2, h and the yield bound (stress), shape (points,).
    back, initial
        dev alpha_2 (stress) and p_0 (1) in coordinates, shape (points, d).
    """

    def __init__(self, problem: Problem, points: Points) -> None:
        kinematics, material = points.kinematics, problem.material
        self.two_mu = points.at(2 * material.lame_mu)
        self.bulk = points.at(material.lame_lambda) + self.two_mu / kinematics.size
        self.hardening = points.at(problem.effective_hardening)
        self.beta = points.at(as_scalar(problem.beta))
        self.back = self.initial = np.zeros((len(points), kinematics.d))
        if problem.initial_hardening is not None:
            self.back = points.at(kinematics.coordinates(problem.alpha_0[1]))
        if problem.initial_plastic_strain is not None:
            self.initial = points.at(kinematics.coordinates(problem.p_0))

    def returned(self, e: np.ndarray) -> Return:
        """The law at the coordinates ``e`` of dev eps, shape (points, d)."""
        s = self.two_mu[:, None] * (e - self.initial) - self.back
        size = np.sqrt(np.einsum("pd,pd->p", s, s))
        yields = size > (1 + ROUNDING) * self.beta
        gained = np.where(yields, (size - self.beta) / (self.two_mu + self.hardening), 0.0)
        return Return(s, size, s / np.where(size > 0, size, 1.0)[:, None], yields, gained)

    def stress(self, at: Return) -> np.ndarray:
        """dev sigma in coordinates, shape (points, d), without the cancellation of e and p."""
        h, two_mu = self.hardening, self.two_mu
        size = np.maximum(at.size, self.beta)
        kept = np.where(at.yields, (h + two_mu * self.beta / size) / (two_mu + h), 1.0)
        return kept[:, None] * at.trial + self.back

    def energy_density(self, volume: np.ndarray, at: Return) -> np.ndarray:
        """The density of J without the loads, smallest over p (2.14), shape (points,)."""
        two_mu, M, m = self.two_mu, self.two_mu + self.hardening, at.size
        b = np.minimum(m, self.beta)
        shape = m * m * self.hardening / (two_mu * M) + b * (2 * m - b) / M
        history = np.einsum("pd,pd->p", self.back, self.back + 2 * at.trial) / two_mu
        history -= two_mu * np.einsum("pd,pd->p", self.initial, self.initial)
        return 0.5 * (self.bulk * volume * volume + shape + history)

    def yielding_part(self, at: Return) -> np.ndarray:
        """w = beta s / max(beta, |s|), shape (points, d)."""
        return (self.beta / np.maximum(at.size, self.beta))[:, None] * at.trial

    def linearised(self, at: Return, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """w + dw for a change ds of s, from |s| w = beta s linearised at (s, w) where s yields."""
        size, along = np.maximum(at.size, self.beta), np.einsum("pd,pd->p", at.direction, ds)
        moved = (self.beta[:, None] * (at.trial + ds) - along[:, None] * w) / size[:, None]
        return np.where(at.yields[:, None], moved, at.trial + ds)

    def projected(self, w: np.ndarray) -> np.ndarray:
        """w projected onto |w| <= beta."""
        length = np.sqrt(np.einsum("pd,pd->p", w, w))
        return (self.beta / np.maximum(length, self.beta))[:, None] * w

    def moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """The tangent of the stress with w kept as a variable of its own, made symmetric.

        Where s yields  dw = (beta ds - w (s/|s| . ds)) / |s|.  The part of w along s is kept: with
        w = beta s/|s| this is the derivative of the radial return.
        """
        two_mu, h, size = self.two_mu, self.hardening, np.maximum(at.size, self.beta)
        part = two_mu / (two_mu + h)
        across = np.where(at.yields, part * (h + two_mu * self.beta / size), two_mu)
        along = np.clip(np.einsum("pd,pd->p", at.direction, w), 0.0, self.beta)
        extra = np.where(at.yields, -part * two_mu * along / size, 0.0)
        return Moduli(self.bulk, across, extra, at.direction)

    def dual_variable(self, at: Return) -> np.ndarray:
        """q = h p - dev sigma + dev alpha_2 = -w of (3.8), shape (points, d)."""
        return -self.yielding_part(at)
