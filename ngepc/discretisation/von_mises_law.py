"""von Mises' law: the deviatoric stress stays in a ball, with radial return in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ngepc.discretisation.law import SOFTEST, Law, Return
from ngepc.discretisation.moduli import Moduli


class VonMisesLaw(Law):
    """The sphere |s| <= beta(g) with g = |p|: p and w are multiples of s."""

    def measured(self, s: np.ndarray) -> np.ndarray:
        """See ``Law``."""
        return np.sqrt(np.einsum("pd,pd->p", s, s))

    def gained_at(self, s: np.ndarray, modulus: np.ndarray) -> np.ndarray:
        """See ``Law``: M g + beta(g) = |s|."""
        return self.resistance.gained_at(self.measured(s), modulus)

    def flow(
        self, s: np.ndarray, modulus: np.ndarray, gained: np.ndarray
    ) -> np.ndarray:
        """See ``Law``."""
        size = self.measured(s)
        return (gained / np.where(size > 0, size, 1.0))[:, None] * s

    def _filled(self, at: Return, modulus: np.ndarray) -> Return:
        slope = self.resistance.slope(at.gained)
        slope = np.where(at.yields, slope / (modulus + slope), 0.0)
        direction = at.trial / np.where(at.size > 0, at.size, 1.0)[:, None]
        return replace(at, slope=slope, direction=direction, normal=direction)

    def yielding_part(self, at: Return) -> np.ndarray:
        """See ``Law``: w = r s / max(r, |s|)."""
        return (at.radius / np.maximum(at.size, at.radius))[:, None] * at.trial

    def moved(self, at: Return, w: np.ndarray, ds: np.ndarray) -> np.ndarray:
        """See ``Law``: from |s| w = r(|s|) s where s yields."""
        size = np.maximum(at.size, at.radius)[:, None]
        direction = at.direction
        along = np.einsum("pd,pd->p", direction, ds)
        scaled = at.radius[:, None] * (at.trial + ds)
        moved = (scaled - along[:, None] * w) / size
        moved += (at.slope * along)[:, None] * direction
        return np.where(at.yields[:, None], moved, at.trial + ds)

    def flow_change(self, at: Return, ds: np.ndarray) -> np.ndarray:
        """See ``Law``: p = g d, and g' = d . s' / (M + beta'(g))."""
        direction = at.direction
        share = at.gained / np.where(at.size > 0, at.size, 1.0)
        grows = 1 / (self.modulus + self.resistance.slope(at.gained))
        along = (grows - share) * np.einsum("pd,pd->p", direction, ds)
        change = share[:, None] * ds + along[:, None] * direction
        return np.where(at.yields[:, None], change, 0.0)

    def closed_moduli(self, at: Return, w: np.ndarray) -> Moduli:
        """See ``Law``.

        Where s yields  dw = (r ds + (r' |s| d - w) (d . ds)) / |s|  with d = s/|s|.  The part of w
        along s is kept, as at least r' |s|: the moduli stay below 2 mu_2.
        """
        two_mu = self.two_mu
        h = self.hardening
        size = np.maximum(at.size, at.radius)
        direction = at.direction
        part = two_mu / (two_mu + h)
        across = np.where(at.yields, part * (h + two_mu * at.radius / size), two_mu)
        along = np.maximum(np.einsum("pd,pd->p", direction, w), at.slope * size)
        along = np.minimum(along, at.radius)
        kept = np.where(self.hardens(at), 1.0, 1 - SOFTEST)
        extra = kept * part * two_mu * (at.slope - along / size)
        extra = np.where(at.yields, extra, 0.0)
        return Moduli(self.bulk, across, extra, direction)
