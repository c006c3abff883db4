"""Closed form: a ring (N = 2) or spherical shell (N = 3) under internal pressure in a rigid one.

In a < r < b the displacement is u(r) e_r.  With D = u' - u/r, S = u' + (N-1) u/r and
k^2 = (N-1)/N the stress has the mean K S, K = lame_lambda + 2 lame_mu / N, and the deviator t E,
where E is the unit tensor k (e_r e_r - (I - e_r e_r)/(N-1)) and

    t = 2 mu k D                            elastic, |t| <= beta,
    t = 2 mu_t k D - c                      where the body yields; internal pressure means t < 0,
    mu_t = mu h / (2 mu + h),   c = 2 mu beta / (2 mu + h).

Equilibrium K S' + k t' + k N t / r = 0 gives u = A r + B r^(1-N) + C r ln r with C = 0 in the
elastic part r > rho, and C = k c / (K + 2 k^2 mu_t) in the plastic one.  Outside, either the
radial stress K S + k t is zero at r = b, or the gap is closed, u(b) = psi.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import CF, CoefficientFunction, IfPos, InnerProduct, log, sqrt, x, y, z

from ngepc.checks.arguments import require_number
from ngepc.model.material import Material

BISECTIONS = 80

Radius = float | CoefficientFunction
"""A radius or a function of it: a number, or a coefficient."""


@dataclass(frozen=True)
class _Part:
    """u = A r + B r^(1-N) + C r ln r where t = 2 mu k D - c."""

    N: int
    bulk: float
    mu: float
    c: float
    A: float
    B: float
    C: float = 0.0

    @property
    def k(self) -> float:
        """|dev eps| over the difference of radial and hoop strain."""
        return math.sqrt((self.N - 1) / self.N)

    def over_r(self, r: Radius, logarithm: Radius) -> Radius:
        """U / r, from r and ln r."""
        return self.A + self.B * r ** (-self.N) + self.C * logarithm

    def shear(self, r: np.ndarray | float) -> np.ndarray | float:
        """D = u' - u/r."""
        return self.C - self.N * self.B * r ** (-self.N)

    def radial_stress(self, r: float) -> float:
        """K S + k t."""
        volume = self.N * self.over_r(r, math.log(r)) + self.shear(r)
        return self.bulk * volume + self.k * (
            2 * self.mu * self.k * self.shear(r) - self.c
        )


@dataclass(frozen=True, kw_only=True)
class PressedShell:
    """One step from the virgin state, purely elastic or elastoplastic with an elastic outside.

    Parameters
    ----------
    material
        Material whose data are numbers.
    N
        2 for a ring with 2 x 2 tensors, 3 for a spherical shell.
    inner, outer
        Radii a < b (length).
    pressure
        Internal pressure P >= 0 (stress).
    gap
        psi >= 0, distance to the rigid ring outside (length); infinite without one.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or the whole shell yields.
    """

    material: Material
    N: int
    pressure: float
    gap: float = math.inf
    inner: float = 1.0
    outer: float = 2.0

    def __post_init__(self) -> None:
        if self.N not in (2, 3):
            raise ValueError(f"N={self.N!r}: 2 or 3 is needed")
        require_number("inner", self.inner, 0, strict=True)
        require_number("outer", self.outer, self.inner, strict=True)
        require_number("pressure", self.pressure, 0)
        if self.gap != math.inf:
            require_number("gap", self.gap, 0)
        if self._pressure_for(self.outer) <= self.pressure:
            raise ValueError(f"pressure={self.pressure!r}: the whole shell yields")

    @cached_property
    def plastic_radius(self) -> float:
        """Rho: the shell yields in a < r < rho; a where it stays elastic (length)."""
        low, high = self.inner, self.outer
        if self._pressure_for(low) >= self.pressure:
            return low
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            below = self._pressure_for(middle) < self.pressure
            low, high = (middle, high) if below else (low, middle)
        return low

    @property
    def contact_pressure(self) -> float:
        """Minus the radial stress at r = b (stress), zero where the gap is open."""
        if float(self.displacement(self.outer)) < self.gap:
            return 0.0
        return max(0.0, -self._solution[0].radial_stress(self.outer))

    def displacement(self, r: np.ndarray | float) -> np.ndarray:
        """U(r) for radii in [a, b] (length)."""
        r = np.asarray(r, dtype=float)
        outside, inside = (r * part.over_r(r, np.log(r)) for part in self._solution)
        return np.where(r > self.plastic_radius, outside, inside)

    def plastic_strain(self, r: np.ndarray | float) -> np.ndarray:
        """|p|_F for radii in [a, b] (1)."""
        r = np.asarray(r, dtype=float)
        two_mu, inside = 2 * self.material.lame_mu, self._solution[1]
        excess = -two_mu * inside.k * inside.shear(r) - self.material.yield_stress
        strain = excess / (two_mu + self.material.effective_hardening)
        return np.where(r > self.plastic_radius, 0.0, np.maximum(strain, 0.0))

    @property
    def displacement_vector(self) -> CoefficientFunction:
        """U(r) e_r in the coordinates x, y(, z), N components (length)."""
        X = CF((x, y, z)[: self.N])
        r = sqrt(InnerProduct(X, X))
        outside, inside = (part.over_r(r, log(r)) for part in self._solution)
        return IfPos(r - self.plastic_radius, outside, inside) * X

    @property
    def _bulk(self) -> float:
        return self.material.lame_lambda + 2 * self.material.lame_mu / self.N

    @cached_property
    def _solution(self) -> tuple[_Part, _Part]:
        """The elastic part outside rho, and the part inside."""
        if self.plastic_radius > self.inner:
            return self._yielding(self.plastic_radius)
        unit = self._elastic(1.0)
        free = self._elastic(-self.pressure / unit.radial_stress(self.inner))
        if self.outer * free.over_r(self.outer, 0.0) > self.gap:
            rest, unit = self._held(0.0), self._held(1.0)
            base = rest.radial_stress(self.inner)
            free = self._held(
                (-self.pressure - base) / (unit.radial_stress(self.inner) - base)
            )
        return free, free

    def _pressure_for(self, rho: float) -> float:
        """The internal pressure for which the shell yields in a < r < rho."""
        return -self._yielding(rho)[1].radial_stress(self.inner)

    def _yielding(self, rho: float) -> tuple[_Part, _Part]:
        """The parts outside and inside rho, where |t| = beta and u and u' are continuous."""
        m, N, bulk = self.material, self.N, self._bulk
        k = math.sqrt((N - 1) / N)
        B = m.yield_stress * rho**N / (2 * m.lame_mu * k * N)
        outside = self._elastic(B)
        if self.outer * outside.over_r(self.outer, 0.0) > self.gap:
            outside = self._held(B)
        stiffness = 2 * m.lame_mu + m.effective_hardening
        mu_t = m.lame_mu * m.effective_hardening / stiffness
        c = 2 * m.lame_mu * m.yield_stress / stiffness
        C = k * c / (bulk + 2 * k**2 * mu_t)
        B = (C - outside.shear(rho)) * rho**N / N
        A = outside.over_r(rho, 0.0) - B * rho ** (-N) - C * math.log(rho)
        return outside, _Part(N, bulk, mu_t, c, A, B, C)

    def _elastic(self, B: float) -> _Part:
        """The elastic part with B whose outside is free."""
        m, N, bulk = self.material, self.N, self._bulk
        A = 2 * m.lame_mu * (N - 1) / N * B * self.outer ** (-N) / bulk
        return _Part(N, bulk, m.lame_mu, 0.0, A, B)

    def _held(self, B: float) -> _Part:
        """The elastic part with B and u(b) = psi."""
        A = self.gap / self.outer - B * self.outer ** (-self.N)
        return _Part(self.N, self._bulk, self.material.lame_mu, 0.0, A, B)
