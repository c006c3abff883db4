"""Linear equations between named arrays, applied forwards or transposed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

INHERITED = ("initial", "parts", "back", "alpha_1", "beta", "accumulated", "start")
"""History variables that a step passes to the next one, as "next_initial" and so on."""

STENCIL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
"""Weights of a central difference of fourth order, by the multiple of the step."""

Block = float | np.ndarray | tuple[Callable, Callable]
"""A block of an equation: a number, factors (points,), vectors (points, d) that multiply a scalar,
or a linear map and its transpose.
"""


class Data(dict):
    """Name -> change of an array of a time step, or derivative by it; missing arrays are zero.

    - Shape (points,): two_mu, bulk, hardening, beta (at the start of the step), radius (beta(g) for
      the same g), hardened (int_0^g beta for the same g), gained (g), alpha_1, accumulated (PEEQ),
      kinematic (k), isotropic (k_1 H sigma_y), mean (the mean stress), volume (tr eps).
    - Shape (points, d): back, initial, trial (s), p, stress, strain.
    - Shape (points, d, d): form (Hill's A).
    - Sub-element k of an overlay has "share k", "two_mu k", "p k" and so on; parts (points, n d)
      are the p_0 of all sub-elements.
    - Shape (nodes, N): load, springs, values, start (u_0), u.
    - Contact: gaps and contact (n,); cap (F), coefficient (mu) and bound (b) of friction (m,).
    - shape: the motion of the vertices.
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
    """Equations (name, of, block), in order: add block times array ``of`` to array ``name``.

    The transpose goes from the last equation to the first, with transposed blocks.
    """

    def forward(self, data: Data) -> Data:
        """Apply the equations: the changes of the data, and of the arrays computed from them."""
        data = Data(data)
        for name, of, block in self:
            if of in data:
                data[name] = data[name] + _times(block, data[of], 0)
        return data

    def backward(self, by: Data) -> Data:
        """Apply the transpose: derivatives by the data, from derivatives by computed arrays."""
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
