"""The stress that nearly minimises the dual functional among those with given tractions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.conjugate import Completed, Conjugate
from ngepc.bounds.levels import TwoLevels
from ngepc.bounds.triangles import Triangles

SHORTEST = 1e-3
"""Shortest step length."""

PORTION = 1000
"""Triangles whose matrices are made at once: they stay in the processor's cache."""

LOCALLY = 0.5
"""Share of the gain at which Newton steps stop: where little yields they cost little."""

RINGS = 9
"""Newton steps change the stress where it yields and in so many rings of triangles around."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How hard to look for the best stress.

    Parameters
    ----------
    newton
        Most Newton steps after the tangent at the discrete stress.
    trust
        None is done where the bound exceeds what the tangent promised by less than this part.
    gain
        Conjugate gradients stop at a step that gains less than this part of the bound, in Newton
        steps less than half of it.
    steps
        Most of these steps, for each tangent.
    """

    newton: int = 2
    trust: float = 0.03
    gain: float = 0.05
    steps: int = 12


@dataclass(frozen=True, eq=False)
class Dual:
    """int [phi*(sigma) - sigma : eps(u)] for stresses at the points of ``space``.

    Parameters
    ----------
    space, conjugate
        The Airy functions, and phi*.
    strain
        eps(u) in in-plane coordinates at one point or all of them, shape (nt, ., 3).
    """

    space: AirySpace
    conjugate: Conjugate
    strain: np.ndarray

    def of(self, chosen: np.ndarray | slice) -> Dual:
        """The integral over some of the triangles."""
        return Dual(self.space.of(chosen), self.conjugate.of(chosen), self.strain[chosen])

    def value(self, z: np.ndarray, at: Completed) -> float:
        """The integral for stresses (nt, points, 3), by the rule."""
        density = self.conjugate.value(at) - (z * self.strain).sum(axis=2)
        return float(self.space.area @ (density * self.space.weights).sum(axis=1))

    def gradient(self, at: Completed) -> np.ndarray:
        """Strains (nt, points, 3)."""
        return self.conjugate.gradient(at) - self.strain

    def stiffness(self, at: Completed) -> np.ndarray:
        """The matrices of the Airy functions on each triangle, (nt, n, n)."""
        n = self.space.unknowns.shape[1]
        K = np.empty((len(self.strain), n, n))
        for first in range(0, len(K), PORTION):
            part = slice(first, first + PORTION)
            K[part] = self.space.of(part).stiffness(self.conjugate.of(part).compliance(at.of(part)))
        return K


def tightened(
    dual: Dual,
    triangles: Triangles,
    z: np.ndarray,
    centre: np.ndarray,
    rest: float,
    effort: Effort,
) -> np.ndarray:
    """In-plane stresses at the points, shape (nt, points, 3), with a smaller dual functional.

    Parameters
    ----------
    dual, triangles
        What is to be small, and where.
    z
        The admissible stress to start from, shape (nt, points, 3).
    centre
        The stress of the discrete solution at one point or all of them, shape (nt, ., 3).
    rest
        The bound less the value of ``dual``.
    """
    system, at = TwoLevels(dual.space, triangles), dual.conjugate.completed(centre)
    first, H = dual.gradient(at), dual.conjugate.compliance(at)
    moved = np.matmul((z - centre)[:, :, None], H)[:, :, 0]
    model = dual.value(centre, at) + dual.space.product(z - centre, first + moved / 2)
    K = dual.stiffness(at)
    system.update(K, slice(None))
    right = -dual.space.forces(first + moved)
    x, promised = system.solve(right, rest + model, effort.gain, effort.steps)
    z = z + dual.space.stress(x)
    for _ in range(effort.newton):
        at = dual.conjugate.completed(z)
        value = dual.value(z, at)
        yields = np.flatnonzero((at.over > 0).any(axis=1))
        if not len(yields) or rest + value - promised <= effort.trust * (rest + value):
            break
        K[yields] = dual.of(yields).stiffness(at.of(yields))
        there = triangles.around(yields, RINGS)
        near, here = dual.of(there), at.of(there)
        system.update(K[there], there)
        right = -near.space.forces(near.gradient(here))
        x, promised = system.solve(right, rest + value, LOCALLY * effort.gain, effort.steps)
        z[there] = descended(near, z[there], near.space.stress(x), here)
    return z


def descended(dual: Dual, z: np.ndarray, step: np.ndarray, at: Completed) -> np.ndarray:
    """Z plus the longest of the parts 1, 1/2, 1/4, ... of the step that lowers the value."""
    length, value = 1.0, dual.value(z, at)
    while length > SHORTEST:
        trial = z + length * step
        if dual.value(trial, dual.conjugate.completed(trial)) <= value:
            return trial
        length /= 2
    return z
