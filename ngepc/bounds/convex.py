"""The dual density of laws whose plastic part is convex, but no function of one number.

These are Hill's ellipsoid and sub-elements in parallel.  With the mean part m and the deviatoric
coordinates d of the stress

    phi*(sigma) = m^2 / (2 bulk) + |d + 2 mu_2 p_0|^2 / (4 mu_2) + F(d).

F is convex: phi is the infimum over p of an elastic energy of e - p and a convex function of p, so
that phi* is the sum of the two conjugates.  For sub-elements with shares w_i and bounds k_i that
convex function is the minimum of

    sum_i w_i (mu |p_i - p|^2 + k_i |p_i|)    over all p_i with sum_i w_i p_i = p,

a minimum over linear constraints of a function that is convex in all variables.  Hence the mean of
F over a part is at most the mean of its values at the coefficients of d there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.bounds.conjugate import R6, THIN, ZETA_STEPS, Conjugate
from ngepc.bounds.polynomials import RULE, WEIGHTS
from ngepc.discretisation.law import SOFTEST, Law


class Strained(NamedTuple):
    """A stress with its component along the third direction, and its strain.

    ``mean`` m, ``deviator`` d, ``over`` positive where it yields, shapes (...) and (..., d);
    ``strain`` the deviator of the strain, ``stiffness`` the tangent there, (..., d, d).
    """

    mean: np.ndarray
    deviator: np.ndarray
    over: np.ndarray
    strain: np.ndarray
    stiffness: np.ndarray


class ConvexConjugate(Conjugate):
    """phi* on cells with constant material data, evaluated by the law itself."""

    def __init__(self, law: Law, each: int = 1) -> None:
        super().__init__(law, each)
        self.law = law.of(np.s_[::each])
        self.law.swelling = (
            0.0  # the strains of bounds are those beyond the initial ones
        )
        self.law.distortion = 0.0

    def of(self, cells: np.ndarray | slice) -> ConvexConjugate:
        """phi* on some of the cells."""
        part = super().of(cells)
        part.law = self.law.of(cells)
        return part

    def _at(self, count: int) -> Law:
        """The law with each cell repeated, for so many points of it."""
        return self.law.of(np.repeat(np.arange(len(self.bulk)), count))

    def completed(self, z: np.ndarray) -> Strained:
        """See ``Conjugate``: zeta by Newton steps from the elastic one."""
        if self.whole:
            return self._strained(z[..., 0], z[..., 1:])
        if self.thin:
            all_of_it = np.matmul(z, THIN.T)
            return self._strained(all_of_it[..., 0], all_of_it[..., 1:])
        bulk = self.bulk[:, None]
        stiff = 1 / (6 * bulk) + 1 / self.two_mu[:, None]
        wanted = z[..., 0] / (R6 * bulk) + self.offset[:, None]
        zeta = (wanted - self.initial[..., 1]) / stiff
        for step in range(ZETA_STEPS + 1):
            d = np.stack([z[..., 1], zeta, z[..., 2]], axis=-1)
            at = self._strained(z[..., 0] - zeta / R6, d)
            if step == ZETA_STEPS or not at.over.any():
                return at
            slope = zeta / (6 * bulk) + at.strain[..., 1] - wanted
            growth = 1 / (6 * bulk) + self.deviatoric_compliance(at)[..., 1, 1]
            zeta = zeta - slope / growth

    def _strained(self, m: np.ndarray, d: np.ndarray) -> Strained:
        """The strain of a stress and the tangent there."""
        law = self._at(d.shape[1])
        e = law.strained(d.reshape(-1, self.d))
        at = law._returned(np.zeros(len(e)), e)
        moduli = law.closed_moduli(at, law.yielding_part(at))
        stiffness = moduli.deviatoric()
        stiffness = stiffness + SOFTEST * law.two_mu[:, None, None] * np.eye(self.d)
        over = at.yields.astype(float).reshape(m.shape)
        shape = (*d.shape, self.d)
        return Strained(m, d, over, e.reshape(d.shape), stiffness.reshape(shape))

    def sought(self, at: Strained) -> np.ndarray:
        """See ``Conjugate``: d . e - phi(e), which is finite."""
        law = self._at(at.deviator.shape[1])
        e = at.strain.reshape(-1, self.d)
        zero = np.zeros(len(e))
        stored = law.energy_density(law._returned(zero, e)).reshape(at.mean.shape)
        work = np.einsum("tqd,tqd->tq", at.deviator, at.strain)
        value = at.mean**2 / (2 * self.bulk[:, None]) + work - stored
        return self._with_offset(value, at)

    def value(self, at: Strained) -> np.ndarray:
        """See ``Conjugate``: an upper bound, exact for Hill's ellipsoid."""
        law = self._at(at.deviator.shape[1])
        d = at.deviator.reshape(-1, self.d)
        value = law.complementary_density(at.mean.ravel(), d).reshape(at.mean.shape)
        return self._with_offset(value, at)

    def _with_offset(self, value: np.ndarray, at: Strained) -> np.ndarray:
        """Less zeta times the offset in plane strain."""
        if self.whole or self.thin:
            return value
        return value - self.offset[:, None] * at.deviator[..., 1]

    def deviatoric_strain(self, at: Strained) -> np.ndarray:
        """See ``Conjugate``."""
        return at.strain

    def deviatoric_compliance(self, at: Strained) -> np.ndarray:
        """See ``Conjugate``."""
        return np.linalg.inv(at.stiffness)

    def mean_and_deviator(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See ``Conjugate``."""
        at = self.completed(z)
        return at.mean, at.deviator

    def shifted(self, d: np.ndarray) -> np.ndarray:
        """See ``Conjugate``: d itself."""
        return d

    def may_yield(self, s: np.ndarray) -> np.ndarray:
        """See ``Conjugate``: F may differ from zero in an elastic body with a history."""
        return np.ones(s.shape[:2], dtype=bool)

    def _plastic(
        self, s: np.ndarray, volume: np.ndarray, cell: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean of F at the coefficients, and a quadrature rule."""
        bound = volume * self._plastic_part(s, cell).mean(axis=1)
        inside = self._plastic_part(np.matmul(RULE[s.shape[1]], s), cell)
        inside = np.where(np.isfinite(inside), inside, 0.0)
        return bound, np.minimum(volume * (inside @ WEIGHTS[s.shape[1]]), bound)

    def _sharper(
        self, s: np.ndarray, volume: np.ndarray, cell: np.ndarray
    ) -> np.ndarray:
        """See ``Conjugate``: there is none."""
        return np.full(len(s), np.inf)

    def _plastic_part(self, d: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """F of deviators (parts, k, d)."""
        k = d.shape[1]
        law = self.law.of(np.repeat(cell, k))
        flat = d.reshape(-1, self.d)
        whole = law.complementary_density(np.zeros(len(flat)), flat).reshape(-1, k)
        two_mu = self.two_mu[cell, None]
        initial = self.initial[cell]
        total = d + two_mu[..., None] * initial
        return whole - np.einsum("tkd,tkd->tk", total, total) / (2 * two_mu)


def conjugate_of(law: Law, each: int = 1) -> Conjugate:
    """phi* of a law."""
    kind = Conjugate if law.is_radial else ConvexConjugate
    return kind(law, each)
