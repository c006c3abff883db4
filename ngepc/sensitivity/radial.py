"""The derivative of the radial law with respect to the strain and to its data, both ways.

With s = 2 mu_2 (e - p_0) - dev alpha_2 and p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|, changes obey

    p' = A s' - (beta' + |p| (2 mu_2 + h)') / (2 mu_2 + h) s/|s|      where s yields, otherwise 0,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress,

with the symmetric A that belongs to the moduli of the law: 2 mu_2 (Id - 2 mu_2 A).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ngepc.discretisation.points import Points
from ngepc.local.system import State

Data = Mapping[str, np.ndarray]
"""Name of discrete data -> its change, or the derivative with respect to it.

two_mu, bulk, hardening, beta, kinematic (k) and isotropic (k_1 H sigma_y) of shape (points,), back
and initial of shape (points, d); load, values and start (u_0) of shape (nodes, N); gaps, cap (F)
and coefficient (mu) of friction of shape (m,).  A name that is missing means zero.  When the mesh
moves there are strain and volume, the changes of the strains of the same displacements, origin of
shape (m, N - 1), what the rows would slip by, and shape, the motion of the vertices.
"""

DENSITIES = (
    *("two_mu", "bulk", "hardening", "beta", "kinematic", "isotropic"),
    *("back", "initial", "strain", "volume"),
)
"""Data at the points: derivatives with respect to them lack the weights of the points."""


class RadialDerivative:
    """The formulas above at a state; ``state.at.yields`` decides which one holds at a point."""

    def __init__(self, state: State) -> None:
        self.state, self.law, self.at = state, state.discrete.law, state.at
        self.two_mu = self.law.two_mu[:, None]
        self.elastic = self.law.stress(self.at) / self.two_mu
        self.total = (self.at.trial + self.law.back) / self.two_mu
        self.moduli = self.law.moduli(self.at, self.law.yielding_part(self.at))
        soft = self.law.two_mu + self.law.hardening
        self._compliance = np.where(self.at.yields, 1 / soft, 0.0)

    def _along(self, v: np.ndarray) -> np.ndarray:
        return np.einsum("pd,pd->p", self.at.direction, v)

    def _plastic(self, v: np.ndarray) -> np.ndarray:
        """A v."""
        return (v - self.moduli(v) / self.two_mu) / self.two_mu

    def strain(self, u: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """The changes of tr eps and dev eps with a change of u, and with the mesh."""
        volume, e = self.state.discrete.points.strain(u)
        return volume + data.get("volume", 0.0), e + data.get("strain", 0.0)

    def _trial(self, e: np.ndarray, data: Data) -> np.ndarray:
        """s'."""
        ds = self.two_mu * (e - data.get("initial", 0.0)) - data.get("back", 0.0)
        return ds + np.reshape(data.get("two_mu", 0.0), (-1, 1)) * self.total

    def overshoot(self, e: np.ndarray, data: Data) -> np.ndarray:
        """The change of |s| - beta, shape (points,)."""
        return self._along(self._trial(e, data)) - data.get("beta", 0.0)

    def forward(self, u: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The changes of p, of the deviatoric stress (points, d) and of the mean one (points,)."""
        gained, softer = self.at.gained, data.get("two_mu", 0.0)
        volume, e = self.strain(u, data)
        lost = data.get("beta", 0.0) + gained * (softer + data.get("hardening", 0.0))
        p = self._plastic(self._trial(e, data))
        p = p - (self._compliance * lost)[:, None] * self.at.direction
        elastic = e - data.get("initial", 0.0) - p
        stress = np.reshape(softer, (-1, 1)) * self.elastic + self.two_mu * elastic
        return p, stress, self.law.bulk * volume + data.get("bulk", 0.0) * self.state.volume

    def reverse(self, p: np.ndarray, stress: np.ndarray, mean: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of p . p' + stress . tau' + mean mean' by data and strain.

        Densities: of integrals, the weights of the points are left out.
        """
        on_p = p - self.two_mu * stress
        on_s = self._plastic(on_p)
        lost = -self._compliance * self._along(on_p)
        strain = self.two_mu * (on_s + stress)
        softer = np.einsum("pd,pd->p", on_s, self.total) + self.at.gained * lost
        return {
            "strain": strain,
            "initial": -strain,
            "back": -on_s,
            "two_mu": softer + np.einsum("pd,pd->p", stress, self.elastic),
            "hardening": self.at.gained * lost,
            "beta": lost,
            "volume": self.law.bulk * mean,
            "bulk": mean * self.state.volume,
        }


def summed(one: Data, other: Data) -> dict[str, np.ndarray]:
    """The sum, name by name."""
    return {
        name: one.get(name, 0.0) + other.get(name, 0.0) for name in dict.fromkeys([*one, *other])
    }


def paired(points: Points, slopes: Data, change: Data) -> float:
    """The derivative in the direction of a change of the data."""
    result = 0.0
    for name in slopes.keys() & change.keys():
        product = slopes[name] * change[name]
        if name in DENSITIES:
            result += points.integral(product.reshape(len(points), -1).sum(axis=1))
        else:
            result += float(product.sum())
    return result
