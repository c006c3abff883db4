"""The derivative of the radial law with respect to the strain and to its data, both ways.

With s = 2 mu_2 (e - p_0) - dev alpha_2 and p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|, changes obey

    p' = A s' - (beta' + |p| (2 mu_2 + h)') / (2 mu_2 + h) s/|s|      where s yields, otherwise 0,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress,

with the symmetric A that belongs to the moduli of the law: 2 mu_2 (Id - 2 mu_2 A).  A step leaves

    p_0 + p,    dev alpha_2 + k p,    alpha_1 + k_1 H sigma_y |p|    and, with friction, u_0 = u

to the next one, whose beta grows with alpha_1 by H sigma_y.
"""

from __future__ import annotations

import numpy as np

from ngepc.discretisation.points import Points
from ngepc.local.system import State

SOLUTION = ("u", "p", "stress", "mean", "contact")
"""What a step solves for, and its stress."""

INHERITED = ("initial", "back", "alpha_1", "beta", "start")
"""What a step leaves to the next one."""


class Data(dict):
    """Name -> change of an array of a time step, or the derivative by it; a missing one is zero.

    At the points two_mu, bulk, hardening, beta, alpha_1, kinematic (k), isotropic (k_1 H sigma_y),
    mean (the stress) and volume of shape (points,), back, initial, p, stress and strain of shape
    (points, d): derivatives by them are densities, without the weights of the points.  load,
    values, start (u_0) and u of shape (nodes, N); gaps, cap (F) and coefficient (mu) of friction
    (m,), origin of the slip (m, d), contact (n,); shape, the motion of the vertices.
    """

    POINTWISE = frozenset(
        (
            *("two_mu", "bulk", "hardening", "beta", "alpha_1", "kinematic", "isotropic"),
            *("mean", "volume", "back", "initial", "p", "stress", "strain"),
        )
    )

    def __missing__(self, name: str) -> float:
        return 0.0

    def __add__(self, other: Data) -> Data:
        return Data({name: self[name] + other[name] for name in dict.fromkeys([*self, *other])})

    def __rmul__(self, rate: float) -> Data:
        return Data({name: rate * value for name, value in self.items()})

    def without(self, *names: str) -> Data:
        """The others."""
        return Data({name: value for name, value in self.items() if name not in names})

    def paired(self, change: Data, points: Points) -> float:
        """The derivative in the direction of a change."""
        result = 0.0
        for name in self.keys() & change.keys():
            product = self[name] * change[name]
            if name in self.POINTWISE:
                result += points.integral(product.reshape(len(points), -1).sum(axis=1))
            else:
                result += float(np.sum(product))
        return result


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

    def _rates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """How beta grows with alpha_1, dev alpha_2 with p (points, 1), and alpha_1 with |p|."""
        material, at = self.state.discrete.problem.material, self.state.discrete.points.at
        sharper = material.yield_stress * material.hardening_modulus
        back = at(material.hardening)[:, None]
        return at(sharper), back, at(material.scalar_growth)

    def trial(self, u: np.ndarray, data: Data) -> tuple[np.ndarray, ...]:
        """The changes of tr eps and dev eps with u and the mesh, and of s."""
        volume, e = self.state.discrete.points.strain(u)
        volume, e = volume + data["volume"], e + data["strain"]
        s = self.two_mu * (e - data["initial"]) - data["back"]
        return volume, e, s + np.reshape(data["two_mu"], (-1, 1)) * self.total

    def overshoot(self, u: np.ndarray, data: Data) -> tuple[np.ndarray, float]:
        """The change of |s| - beta (points,), and the size of an elastic change of s."""
        _, e, s = self.trial(u, data)
        return self._along(s) - data["beta"], np.abs(self.two_mu * e).max()

    def forward(self, u: np.ndarray, data: Data) -> Data:
        """The changes of p, of the deviatoric stress and of the mean one."""
        gained, softer = self.at.gained, data["two_mu"]
        volume, e, s = self.trial(u, data)
        lost = self._compliance * (data["beta"] + gained * (softer + data["hardening"]))
        p = self._plastic(s) - lost[:, None] * self.at.direction
        stress = self.two_mu * (e - data["initial"] - p)
        stress = stress + np.reshape(softer, (-1, 1)) * self.elastic
        mean = self.law.bulk * volume + data["bulk"] * self.state.volume
        return Data(p=p, stress=stress, mean=mean)

    def reverse(self, by: Data) -> Data:
        """The transpose: derivatives by data and strain from those by p, stress and mean."""
        stress, mean = by["stress"] + np.zeros_like(self.elastic), by["mean"]
        on_p = by["p"] - self.two_mu * stress
        on_s, lost = self._plastic(on_p), -self._compliance * self._along(on_p)
        strain = self.two_mu * (on_s + stress)
        softer = np.einsum("pd,pd->p", on_s, self.total) + self.at.gained * lost
        return Data(
            strain=strain,
            initial=-strain,
            back=-on_s,
            two_mu=softer + np.einsum("pd,pd->p", stress, self.elastic),
            hardening=self.at.gained * lost,
            beta=lost,
            volume=self.law.bulk * mean,
            bulk=mean * self.state.volume,
        )

    def left(self, change: Data) -> Data:
        """The changes of what is left to the next step."""
        sharper, back, growth = self._rates()
        p, at = change["p"], self.at
        by_k = np.reshape(change["kinematic"], (-1, 1)) * at.plastic_strain
        scalar = change["isotropic"] * at.gained + growth * self._along(p)
        alpha_1 = change["alpha_1"] + scalar
        return Data(
            initial=change["initial"] + p,
            back=change["back"] + back * p + by_k,
            alpha_1=alpha_1,
            beta=sharper * alpha_1,
            start=change["u"],
        )

    def returned(self, later: Data) -> Data:
        """The transpose: derivatives by p, u and data from those by what is left."""
        if not later:
            return later
        sharper, back, growth = self._rates()
        alpha_1 = later["alpha_1"] + sharper * later["beta"]
        on_size = (growth * alpha_1)[:, None] * self.at.direction
        return Data(
            initial=later["initial"],
            back=later["back"],
            alpha_1=alpha_1,
            p=later["initial"] + back * later["back"] + on_size,
            u=later["start"],
            kinematic=np.einsum("pd,pd->p", later["back"], self.at.plastic_strain),
            isotropic=alpha_1 * self.at.gained,
        )
