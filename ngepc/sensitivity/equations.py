"""Linear equations between named arrays, applied forwards or transposed; those of the law.

With the trial stress s = 2 mu_2 (e - p_0) - dev alpha_2 and M = 2 mu_2 + h the plastic strain p of
a step is smallest for

    M/2 |p|^2 - s : p + int_0^g beta,    g the measure of p, n = dg/dp,

so that changes obey, where s yields and with the derivative T of p by s,

    p' = T (s' - M' p - beta(g)' n),       beta(g)' that at the same g,
    s' = (2 mu_2)' (e - p_0) + 2 mu_2 (e' - p_0') - dev alpha_2',
    tau' = (2 mu_2)' (e - p_0 - p) + 2 mu_2 (e' - p_0' - p'),         tau the deviatoric stress.

Where a component z of the strain is free, its change is what leaves it without stress.  A step
leaves

    p_0 + p,   dev alpha_2 + k p,   alpha_1 + k_1 H sigma_y g,   PEEQ   and, with friction, u_0 = u

to the next one, whose beta grows with alpha_1 by H sigma_y and with PEEQ by the law.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.local.system import State
from ngepc.model.material import PEEQ

INHERITED = ("initial", "back", "alpha_1", "beta", "accumulated", "start")
"""History variables that a step passes on, named "next_initial" and so on."""

STENCIL = {
    -2: 1 / 12,
    -1: -8 / 12,
    1: 8 / 12,
    2: -1 / 12,
}  # central difference of fourth order
"""Weights of a central difference of fourth order, by the multiple of the step."""

Block = float | np.ndarray | tuple[Callable, Callable]
"""A factor, factors (points,), vectors (points, d) of a scalar, or a linear map and its transpose.
"""


class Data(dict):
    """Name -> change of an array of a time step, or the derivative by it; a missing one is zero.

    At the points two_mu, bulk, hardening, beta (that at the start of the step), radius (beta(g) for
    the same g), hardened (int_0^g beta for the same g), gained (g), alpha_1, accumulated (PEEQ),
    kinematic (k), isotropic (k_1 H sigma_y), mean (the stress) and volume of shape (points,), back,
    initial, trial (s), p, stress and strain of shape (points, d).  load, springs, values, start
    (u_0) and u of shape (nodes, N); gaps and contact of shape (n,), cap (F), coefficient (mu) and
    bound (b) of friction (m,); shape, the motion of the vertices.
    """

    __array_ufunc__ = None  # so that array * data uses __rmul__

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
        """The data, and the arrays that follow from them."""
        data = Data(data)
        for name, of, block in self:
            if of in data:
                data[name] = data[name] + _times(block, data[of], 0)
        return data

    def backward(self, by: Data) -> Data:
        """The derivatives by all data, from those by arrays that follow from them."""
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


def equations_of_law(state: State) -> Tape:
    """The equations above at a state; ``state.at.yields`` decides where s yields."""
    law = state.discrete.law
    at = state.at
    two_mu = law.two_mu[:, None]
    normal = np.where(at.yields[:, None], at.normal, 0.0)
    resistance = law.resistance
    sooner, dearer = resistance.by_accumulated(at.gained)

    def flow(s: np.ndarray) -> np.ndarray:
        """T s."""
        return law.flow_change(at, s)

    lost = -flow(normal)
    softer = -flow(at.plastic_strain)
    _, stress = law.stress(at)
    return Tape(
        [
            ("beta", "accumulated", resistance.growth),
            ("radius", "beta", 1.0),
            ("radius", "accumulated", sooner),
            ("hardened", "beta", at.gained),
            ("hardened", "accumulated", dearer),
            ("trial", "strain", law.two_mu),
            ("trial", "initial", -law.two_mu),
            ("trial", "back", -1.0),
            ("trial", "two_mu", (at.trial + law.back) / two_mu),
            ("p", "trial", (flow, flow)),
            ("p", "two_mu", softer),
            ("p", "hardening", softer),
            ("p", "radius", lost),
            ("stress", "strain", law.two_mu),
            ("stress", "initial", -law.two_mu),
            ("stress", "p", -law.two_mu),
            ("stress", "two_mu", stress / two_mu),
            ("mean", "volume", law.bulk),
            ("mean", "bulk", state.volume),
            *_free_component(state),
            *_left_behind(state, normal),
        ]
    )


def _free_component(state: State) -> list[tuple]:
    """The equations of the free component of the strain, whose stress stays zero."""
    law = state.discrete.law
    at = state.at
    if law.across is None:
        return []
    moduli = law.closed_moduli(at, law.yielding_part(at))
    across = np.broadcast_to(law.across, at.trial.shape)
    pulled = law.two_mu[:, None] * across
    moved = law.flow_change(at, pulled)
    return [
        ("normal", "mean", 1.0),
        ("normal", "stress", (lambda s: s @ law.across, lambda n: n[:, None] * across)),
        ("free", "normal", -1 / law.stiffness_across(moduli)),
        ("volume", "free", 1.0),
        ("strain", "free", across),
        ("trial", "free", pulled),
        ("p", "free", moved),
        ("stress", "free", pulled - law.two_mu[:, None] * moved),
        ("mean", "free", law.bulk),
    ]


def _left_behind(state: State, normal: np.ndarray) -> list[tuple]:
    """The equations of the history variables for the next step."""
    at = state.at
    points = state.discrete.points
    material = state.discrete.problem.material
    growth = points.at(material.scalar_growth)
    sharper = points.at(material.yield_stress * material.hardening_modulus)
    measured = (
        lambda p: np.einsum("pd,pd->p", normal, p),
        lambda g: normal * g[:, None],
    )
    return [
        ("gained", "p", measured),
        ("next_initial", "initial", 1.0),
        ("next_initial", "p", 1.0),
        ("next_back", "back", 1.0),
        ("next_back", "p", points.at(material.hardening)),
        ("next_back", "kinematic", at.plastic_strain),
        ("next_alpha_1", "alpha_1", 1.0),
        ("next_alpha_1", "gained", growth),
        ("next_alpha_1", "isotropic", at.gained),
        ("next_beta", "next_alpha_1", sharper),
        ("next_accumulated", "accumulated", 1.0),
        ("next_accumulated", "gained", PEEQ),
        ("next_start", "u", 1.0),
    ]
