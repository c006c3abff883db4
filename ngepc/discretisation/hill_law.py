"""Hill's ellipsoid at the points: (s . A s)^(1/2) <= beta(g), with kinematic hardening k.

Isotropic hardening enlarges the ellipsoid by g: beta(g) gains (H sigma_y)^2 k_1 g, which is no part
of the modulus h = k here, and the law of hardening and of the rate.

The plastic strain is p = g A n with n . A n = 1, and g = (p . A^-1 p)^(1/2).  With r = beta(g)

    (r + M g A) n = s,    w = r n = s - M p,

one equation for g, whose left side decreases with g,

    s . G A G s = 1,    G = (r + M g A)^-1.

Changes of p with s are T = g A G + (r - g r') b b' / D with b = G A n, D = b . (r' n + M A n).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ngepc.discretisation.law import AT_POINTS, SOFTEST, Law, Return
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.resistance import EXACT
from ngepc.model.data import ProblemData

STEPS = 100  # largest number of Newton and bisection steps for g


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A matrix times a vector at each point."""
    return np.einsum("pij,pj->pi", matrix, vector)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The scalar product at each point."""
    return np.einsum("pd,pd->p", a, b)


class HillLaw(Law):
    """The ellipsoid (s . A s)^(1/2) <= beta(g)."""

    form: np.ndarray  # A in coordinates of deviators, shape (points, d, d)
    is_radial = False
    at_points = (*AT_POINTS, "form", "_values", "_vectors")

    def __init__(self, problem: ProblemData, points: Points) -> None:
        super().__init__(problem, points)
        material = problem.material
        self.hardening = points.at(material.hardening)
        grows = points.at(material.isotropic_hardening)
        self.resistance = replace(self.resistance, linear=grows)
        self.form = material.hill.form(points.kinematics.basis, points.at)
        self._values, self._vectors = np.linalg.eigh(self.form)

    def _stretched(self, modulus: np.ndarray, gained: np.ndarray) -> np.ndarray:
        """The eigenvalues of G^-1, shape (points, d)."""
        r = self.resistance.bound(gained)
        return r[:, None] + (modulus * gained)[:, None] * self._values

    def _turned(self, s: np.ndarray) -> np.ndarray:
        """Coordinates along the axes of the ellipsoid."""
        return np.einsum("pji,pj->pi", self._vectors, s)

    def measured(self, s: np.ndarray) -> np.ndarray:
        """See ``Law``."""
        return np.sqrt((self._values * self._turned(s) ** 2).sum(axis=1))

    def gained_at(self, s: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """See ``Law``: Newton's method within brackets that bisection halves."""
        size = self.measured(s)
        along = self._values * self._turned(s) ** 2
        low = self.resistance.gained_at(size, modulus * self._values[:, -1])
        high = self.resistance.gained_at(size, modulus * self._values[:, 0])
        unbounded = ~np.isfinite(high)
        low = np.where(unbounded, 0.0, low)
        high = np.where(unbounded, 0.0, high)
        g = low
        for _ in range(STEPS):
            stretched = self._stretched(modulus, g)
            excess = np.sqrt((along / stretched**2).sum(axis=1)) - 1
            low = np.where(excess >= 0, np.maximum(low, g), low)
            high = np.where(excess <= 0, np.minimum(high, g), high)
            done = (np.abs(excess) <= EXACT) | (high - low <= EXACT * high)
            if done.all():
                break
            growth = self.resistance.slope(g)[:, None] + modulus[:, None] * self._values
            norm = np.where(excess > -1, 1 + excess, 1.0)  # a stress of zero is done
            slope = (along / stretched**3 * growth).sum(axis=1) / norm
            newton = g + excess / np.where(slope > 0, slope, 1.0)
            good = (low < newton) & (newton < high)
            g = np.where(done, g, np.where(good, newton, 0.5 * (low + high)))
        return np.where(unbounded, np.inf, g)

    def _normal(
        self, s: np.ndarray, modulus: np.ndarray, gained: np.ndarray
    ) -> np.ndarray:
        """n = G s, shape (points, d)."""
        stretched = self._stretched(modulus, gained)
        return np.einsum("pij,pj->pi", self._vectors, self._turned(s) / stretched)

    def flow(
        self, s: np.ndarray, modulus: np.ndarray, gained: np.ndarray
    ) -> np.ndarray:
        """See ``Law``."""
        return gained[:, None] * _times(self.form, self._normal(s, modulus, gained))

    def _filled(self, at: Return, modulus: np.ndarray) -> Return:
        size = np.where(at.size > 0, at.size, 1.0)[:, None]
        normal = self._normal(at.trial, modulus, at.gained)
        normal = np.where(at.yields[:, None], normal, at.trial / size)
        return replace(at, direction=_times(self.form, normal), normal=normal)

    def yielding_part(self, at: Return) -> np.ndarray:
        """See ``Law``."""
        w = at.radius[:, None] * at.normal
        return np.where(at.yields[:, None], w, at.trial)

    def _linear(self, at: Return) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """G, b and D where s yields."""
        M = self.modulus
        stretched = self._stretched(M, at.gained)
        scaled = self._vectors / stretched[:, None, :]
        G = np.matmul(scaled, self._vectors.swapaxes(1, 2))
        b = _times(G, at.direction)
        grown = self.resistance.slope(at.gained)[:, None] * at.normal
        D = _dot(b, grown + M[:, None] * at.direction)
        return G, b, np.where(at.yields, D, 1.0)

    def moved(self, at: Return, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """See ``Law``: from (r + M g A) w = r s where s yields."""
        G, b, D = self._linear(at)
        dg = _dot(b, ds) / D
        dr = self.resistance.slope(at.gained) * dg
        right = at.radius[:, None] * (at.trial + ds) + dr[:, None] * (at.trial - w)
        right -= (self.modulus * dg)[:, None] * _times(self.form, w)
        return np.where(at.yields[:, None], _times(G, right), at.trial + ds)

    def flow_change(self, at: Return, ds: np.ndarray) -> np.ndarray:
        """See ``Law``: T s'."""
        G, b, D = self._linear(at)
        kept = at.radius - at.gained * self.resistance.slope(at.gained)
        change = at.gained[:, None] * _times(self.form, _times(G, ds))
        change += (kept * _dot(b, ds) / D)[:, None] * b
        return np.where(at.yields[:, None], change, 0.0)

    def closed_moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """See ``Law``: dw = r G ds - part M (r - g r') b (b . ds) / D, the part of w along n."""
        two_mu = self.two_mu
        M = self.modulus
        G, b, D = self._linear(at)
        part = np.clip(_dot(at.direction, w) / at.radius, 0.0, 1.0)
        part = np.where(self.hardens(at), part, (1 - SOFTEST) * part)
        kept = at.radius - at.gained * self.resistance.slope(at.gained)
        change = at.radius[:, None, None] * G
        share = part * M * kept / D
        change = change - share[:, None, None] * b[:, :, None] * b[:, None, :]
        count, d = at.trial.shape
        coupling = np.zeros((count, 1 + d, 1 + d))
        scale = np.where(at.yields, two_mu**2 / M, 0.0)
        coupling[:, 1:, 1:] = scale[:, None, None] * change
        across = np.where(at.yields, two_mu * self.hardening / M, two_mu)
        zero = np.zeros(count)
        return Moduli(self.bulk, across, zero, np.zeros((count, d)), coupling)
