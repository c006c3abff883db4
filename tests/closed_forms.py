"""Closed forms for homogeneous states and for the thick ring, with all regularisation terms.

``Law`` is the scalar law that one material point follows when everything points one way.  The
dual method solves, with s = |dev sigma - alpha_2|, |q| = s - h p,

    p = gamma_q [|q| - beta]_+ + |q| / tau,      tau = gamma_T L^2,

the second term from the L2 part of the H^1 product for q (no gradient in a homogeneous state).
The exact law is p = [s - beta]_+ / h.
"""

import math
from dataclasses import dataclass

from ngsolve import CF, IfPos, log, sqrt, x, y
from scipy.optimize import brentq


@dataclass(frozen=True)
class Law:
    """beta and h of a material point; gamma_q and 1/tau of the regularisation."""

    beta: float
    h: float
    gamma_q: float | None = None
    inverse_tau: float = 0.0

    @classmethod
    def of(cls, problem, regularisation=None):
        if regularisation is None:
            return cls(problem.beta, problem.material.effective_hardening)
        h = problem.material.effective_hardening
        weights = regularisation.weights
        tau = weights.tichonov * regularisation.units.length**2
        return cls(problem.beta, h, weights.plastic, 1 / tau)

    def plastic_strain(self, s, two_mu=0.0):
        """p for a stress s that falls by ``two_mu`` p: 0 when stress-driven."""
        if self.gamma_q is None:
            return max(s - self.beta, 0.0) / (self.h + two_mu)
        stiff, small = self.h + two_mu, self.inverse_tau
        elastic = small * s / (1 + small * stiff)
        if s - stiff * elastic <= self.beta:
            return elastic
        G = self.gamma_q
        return (G * (s - self.beta) + small * s) / (1 + stiff * (G + small))


@dataclass(frozen=True)
class Ring:
    """A ring a < r < b under internal pressure in two dimensions: 2 x 2 tensors.

    With D = u' - u/r and S = u' + u/r the radial stress is (lambda + mu) S + tau, where
    tau = mu D or, where the body yields, mu_t D - c.  Equilibrium gives u = A r + B/r + C r ln r
    with C = 0 in the elastic part r > rho and C = c / (lambda + mu + mu_t) in the plastic one.
    """

    lame_lambda: float
    mu: float
    beta: float
    h: float
    a: float = 1.0
    b: float = 2.0

    @property
    def bulk(self):
        return self.lame_lambda + self.mu

    def elastic(self, rho):
        """(A, B) outside rho, where the yield condition holds and the outside is free."""
        B = self.beta * rho**2 / (2 * math.sqrt(2) * self.mu)
        return self.mu * B / (self.bulk * self.b**2), B

    def plastic(self, rho):
        """(A, B, C) inside rho, with the displacement and the radial stress of the outside."""
        mu_t = self.mu * self.h / (2 * self.mu + self.h)
        c = math.sqrt(2) * self.mu * self.beta / (2 * self.mu + self.h)
        C = c / (self.bulk + mu_t)
        A_e, B_e = self.elastic(rho)
        # u and u' are continuous: D is, because tau is, and u is.
        u, slope = A_e * rho + B_e / rho, A_e - B_e / rho**2
        rest, rest_slope = u - C * rho * math.log(rho), slope - C * (math.log(rho) + 1)
        return (rest / rho + rest_slope) / 2, (rest * rho - rest_slope * rho**2) / 2, C

    def inner_pressure(self, rho):
        """The pressure at r = a for which the body yields up to rho >= a."""
        A, B, C = self.plastic(rho)
        mu_t = self.mu * self.h / (2 * self.mu + self.h)
        c = math.sqrt(2) * self.mu * self.beta / (2 * self.mu + self.h)
        S, D = 2 * A + C * (2 * math.log(self.a) + 1), C - 2 * B / self.a**2
        return -(self.bulk * S + mu_t * D - c)

    def radius(self, pressure):
        """Rho for a pressure; a where the whole ring is elastic."""
        if pressure <= self.inner_pressure(self.a):
            return self.a
        return brentq(
            lambda r: self.inner_pressure(r) - pressure, self.a, self.b, xtol=1e-14
        )

    def displacement(self, pressure):
        """u as a coefficient, a vector."""
        r, rho = sqrt(x * x + y * y), self.radius(pressure)
        if rho == self.a:
            B = pressure / (2 * self.mu * (1 / self.a**2 - 1 / self.b**2))
            return (self.mu * B / (self.bulk * self.b**2) + B / r**2) * CF((x, y))
        (A_e, B_e), (A, B, C) = self.elastic(rho), self.plastic(rho)
        outside, inside = A_e + B_e / r**2, A + B / r**2 + C * log(r)
        return IfPos(r - rho, outside, inside) * CF((x, y))

    def plastic_size(self, pressure):
        """|p|_F as a coefficient."""
        r, rho = sqrt(x * x + y * y), self.radius(pressure)
        _, B, C = self.plastic(rho)
        s = math.sqrt(2) * self.mu * (2 * B / r**2 - C)
        return IfPos(r - rho, 0.0, (s - self.beta) / (2 * self.mu + self.h))


@dataclass(frozen=True)
class Sphere:
    """A shell a < r < b under internal pressure, with linear hardening.

    With s = sigma_theta - sigma_r and D = eps_theta - eps_r equilibrium (sigma_r' = 2 s/r) and
    compatibility (eps_theta' = -D/r) give  D + 2 s/(3 K) = C/r^3,  where D = s/(2 mu) + 3 g/2 with
    p = g diag(-1, 1/2, 1/2), and s = s_Y + 3 h g/2 where it yields, s_Y = (3/2)^(1/2) beta.
    """

    lame_lambda: float
    mu: float
    beta: float
    h: float
    a: float = 1.0
    b: float = 2.0

    @property
    def three_K(self):
        return 3 * self.lame_lambda + 2 * self.mu

    @property
    def k(self):
        return 1 / (2 * self.mu) + 2 / self.three_K

    @property
    def s_Y(self):
        return math.sqrt(1.5) * self.beta

    @property
    def soft(self):
        return self.h * self.k / (1 + self.h * self.k)

    def difference(self, c, r):
        """s at r for a shell that yields up to c."""
        elastic = self.s_Y * (c / r) ** 3
        return elastic if r >= c else self.s_Y + self.soft * (elastic - self.s_Y)

    def pressure(self, c):
        """The pressure with which the shell yields up to c."""
        outer = 2 / 3 * (1 - (c / self.b) ** 3)
        inner = 2 * math.log(c / self.a) * (1 - self.soft)
        inner += self.soft * 2 / 3 * ((c / self.a) ** 3 - 1)
        return self.s_Y * (outer + inner)

    def end_displacement(self, c, r):
        """u at r = a or r = b."""
        s, sigma_r = self.difference(c, r), 0.0 if r == self.b else -self.pressure(c)
        trace = (3 * sigma_r + 2 * s) / self.three_K
        return r / 3 * (trace + self.k * self.s_Y * (c / r) ** 3 - 2 * s / self.three_K)
