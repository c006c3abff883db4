"""The derivative of the radial law with respect to the strain and to its data, both ways.

With s = 2 mu_2 (e - p_0) - dev alpha_2 and p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|, changes obey

    p' = A s' - (beta' + |p| (2 mu_2 + h)') / (2 mu_2 + h) s/|s|      where s yields, otherwise 0,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress,

with the symmetric A = |p|/|s| Id + (1/(2 mu_2 + h) - |p|/|s|) d (x) d, d = s/|s|.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ngepc.discretisation.law import Law, Return

Data = Mapping[str, np.ndarray]
"""Name of discrete data -> its change, or the derivative with respect to it.

two_mu, bulk, hardening, beta, kinematic (k) and isotropic (k_1 H sigma_y) of shape (points,), back
and initial of shape (points, d); load, values and start (u_0) of shape (nodes, N); gaps, cap (F)
and coefficient (mu) of friction of shape (m,).  A name that is missing means zero.  When the mesh
moves there are strain and volume, the changes of the strains of the same displacements, origin of
shape (m, N - 1), what the rows would slip by, and shape, the motion of the vertices.
"""


class RadialDerivative:
    """The formulas above at the strain of a state.

    Parameters
    ----------
    law
        Its data.
    at
        The law at a strain; ``at.yields`` decides which formula holds at a point.
    """

    def __init__(self, law: Law, at: Return) -> None:
        self.law, self.at = law, at
        self.elastic = law.stress(at) / law.two_mu[:, None]
        self.total = (at.trial + law.back) / law.two_mu[:, None]
        self._compliance = np.where(at.yields, 1 / (law.two_mu + law.hardening), 0.0)
        self._across = at.gained / np.where(at.size > 0, at.size, 1.0)

    def _along(self, v: np.ndarray) -> np.ndarray:
        return np.einsum("pd,pd->p", self.at.direction, v)

    def _plastic(self, v: np.ndarray) -> np.ndarray:
        """A v."""
        along = (self._compliance - self._across) * self._along(v)
        return self._across[:, None] * v + along[:, None] * self.at.direction

    def trial(self, e: np.ndarray, data: Data) -> np.ndarray:
        """The change of s with a change ``e`` of the strain and a change of the data."""
        two_mu = self.law.two_mu[:, None]
        ds = two_mu * (e - data.get("initial", 0.0)) - data.get("back", 0.0)
        return ds + np.reshape(data.get("two_mu", 0.0), (-1, 1)) * self.total

    def overshoot(self, e: np.ndarray, data: Data) -> np.ndarray:
        """The change of |s| - beta, shape (points,)."""
        return self._along(self.trial(e, data)) - data.get("beta", 0.0)

    def forward(self, e: np.ndarray, data: Data) -> tuple[np.ndarray, np.ndarray]:
        """The changes of p and of the deviatoric stress, shapes (points, d)."""
        gained, softer = self.at.gained, data.get("two_mu", 0.0)
        lost = data.get("beta", 0.0) + gained * (softer + data.get("hardening", 0.0))
        p = self._plastic(self.trial(e, data))
        p = p - (self._compliance * lost)[:, None] * self.at.direction
        elastic = e - data.get("initial", 0.0) - p
        return p, np.reshape(softer, (-1, 1)) * self.elastic + self.law.two_mu[:, None] * elastic

    def reverse(self, p: np.ndarray, stress: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of p . p(e, data) + stress . tau(e, data), also with respect to e, "strain".

        Densities: of integrals, the weights of the points are left out.
        """
        two_mu = self.law.two_mu[:, None]
        on_p = p - two_mu * stress
        on_s = self._plastic(on_p)
        lost = -self._compliance * self._along(on_p)
        strain = two_mu * (on_s + stress)
        softer = np.einsum("pd,pd->p", on_s, self.total) + self.at.gained * lost
        return {
            "strain": strain,
            "initial": -strain,
            "back": -on_s,
            "two_mu": softer + np.einsum("pd,pd->p", stress, self.elastic),
            "hardening": self.at.gained * lost,
            "beta": lost,
        }
