"""Linear equations between named arrays, done forwards or transposed backwards, and the law's own.

With s = 2 mu_2 (e - p_0) - dev alpha_2 and p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|, changes obey

    p' = A s' - (beta' + |p| (2 mu_2 + h)') / (2 mu_2 + h) s/|s|      where s yields, otherwise 0,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress,

with the symmetric A that belongs to the moduli of the law: 2 mu_2 (Id - 2 mu_2 A).  A step leaves

    p_0 + p,    dev alpha_2 + k p,    alpha_1 + k_1 H sigma_y |p|    and, with friction, u_0 = u

to the next one, whose beta grows with alpha_1 by H sigma_y.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.discretisation.points import Moduli
from ngepc.local.system import State

INHERITED = ("initial", "back", "alpha_1", "beta", "start")
"""What a step leaves to the next one, there as "next_initial" and so on."""

Block = float | np.ndarray | tuple[Callable, Callable]
"""A factor, factors (points,), vectors (points, d) of a scalar, or a linear map and its transpose.
"""


class Data(dict):
    """Name -> change of an array of a time step, or the derivative by it; a missing one is zero.

    At the points two_mu, bulk, hardening, beta, alpha_1, kinematic (k), isotropic (k_1 H sigma_y),
    mean (the stress) and volume of shape (points,), back, initial, trial (s), p, stress and strain
    of shape (points, d).  load, springs, values, start (u_0) and u of shape (nodes, N); gaps and
    contact of shape (n,), cap (F), coefficient (mu) and bound (b) of friction (m,); shape, the
    motion of the vertices.
    """

    __array_ufunc__ = None  # an array in front multiplies all

    def __missing__(self, name: str) -> float:
        return 0.0

    def __add__(self, other: Data) -> Data:
        return Data(
            {name: self[name] + other[name] for name in dict.fromkeys([*self, *other])}
        )

    def __rmul__(self, factor: float | np.ndarray) -> Data:
        return Data(
            {name: (factor * np.transpose(value)).T for name, value in self.items()}
        )

    def paired(self, change: Data) -> float:
        """The derivative in the direction of a change."""
        return float(
            sum(
                np.vdot(self[name], change[name])
                for name in self.keys() & change.keys()
            )
        )


class Tape(list):
    """Equations (name, of, block): the array ``name`` gains block times the array ``of``, in order.

    The transpose is the same from the last to the first, with transposed blocks.
    """

    def forward(self, data: Data) -> Data:
        """The data and what follows from them."""
        data = Data(data)
        for name, of, block in self:
            if of in data:
                data[name] = data[name] + _times(block, data[of], 0)
        return data

    def backward(self, by: Data) -> Data:
        """The derivatives by all data, from those by some that follow from them."""
        by = Data(by)
        for name, of, block in reversed(self):
            if name in by:
                by[of] = by[of] + _times(block, by[name], 1)
        return by


def _times(block: Block, v: np.ndarray, way: int) -> np.ndarray:
    if isinstance(block, tuple):
        return block[way](v)
    if np.ndim(block) == 2:
        return np.einsum("pd,pd->p", block, v) if v.ndim == 2 else block * v[:, None]
    return (block * v.T).T


def radial_return(state: State, moduli: Moduli) -> Tape:
    """The equations above at a state; ``state.at.yields`` decides where s yields."""
    law = state.discrete.law
    at = state.at
    discrete = state.discrete
    material = discrete.problem.material
    points = discrete.points
    two_mu = law.two_mu[:, None]
    lost = (
        np.where(at.yields, -1 / (law.two_mu + law.hardening), 0.0)[:, None]
        * at.direction
    )
    softer = at.gained[:, None] * lost
    growth = points.at(material.scalar_growth)[:, None] * at.direction
    sharper = points.at(material.yield_stress * material.hardening_modulus)

    def plastic(s: np.ndarray) -> np.ndarray:
        """A s."""
        return (s - moduli(s) / two_mu) / two_mu

    return Tape(
        [
            ("trial", "strain", law.two_mu),
            ("trial", "initial", -law.two_mu),
            ("trial", "back", -1.0),
            ("trial", "two_mu", (at.trial + law.back) / two_mu),
            ("p", "trial", (plastic, plastic)),
            ("p", "two_mu", softer),
            ("p", "hardening", softer),
            ("p", "beta", lost),
            ("stress", "strain", law.two_mu),
            ("stress", "initial", -law.two_mu),
            ("stress", "p", -law.two_mu),
            ("stress", "two_mu", law.stress(at)[1] / two_mu),
            ("mean", "volume", law.bulk),
            ("mean", "bulk", state.volume),
            ("next_initial", "initial", 1.0),
            ("next_initial", "p", 1.0),
            ("next_back", "back", 1.0),
            ("next_back", "p", points.at(material.hardening)),
            ("next_back", "kinematic", at.plastic_strain),
            ("next_alpha_1", "alpha_1", 1.0),
            ("next_alpha_1", "p", growth),
            ("next_alpha_1", "isotropic", at.gained),
            ("next_beta", "next_alpha_1", sharper),
            ("next_start", "u", 1.0),
        ]
    )
