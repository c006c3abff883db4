"""The stress that nearly minimises the dual functional among those with given tractions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.conjugate import Completed, Conjugate
from ngepc.bounds.held import Pair
from ngepc.bounds.levels import TwoLevels, inner

SHORTEST = 1e-3
"""Shortest step length."""


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
        Conjugate gradients stop at a step that gains less than this part of the bound.
    steps
        Most of these steps, for each tangent.
    """

    newton: int = 1
    trust: float = 0.03
    gain: float = 0.02
    steps: int = 12


@dataclass(frozen=True, eq=False)
class Dual:
    """int [phi*(sigma) - sigma : eps(u)] for stresses at the edge midpoints of sub-triangles.

    Parameters
    ----------
    space, conjugate
        The Airy functions, and phi*.
    strain
        eps(u) in in-plane coordinates, shape (nt, 3).
    """

    space: AirySpace
    conjugate: Conjugate
    strain: np.ndarray

    def value(self, z: np.ndarray, at: Completed) -> float:
        """The integral for stresses (nt, points, 3), by the mean over the points."""
        density = self.conjugate.value(at) - np.einsum("tqc,tc->tq", z, self.strain)
        return float(self.space.triangles.area @ density.mean(axis=1))

    def gradient(self, at: Completed) -> np.ndarray:
        """Strains (nt, points, 3)."""
        return self.conjugate.gradient(at) - self.strain[:, None]


def tightened(
    dual: Dual, z: np.ndarray, discrete: np.ndarray, rest: float, effort: Effort
) -> np.ndarray:
    """In-plane stresses at the midpoints, shape (nt, 9, 3), with a smaller dual functional.

    Parameters
    ----------
    dual
        What is to be small.
    z
        The admissible stress to start from, shape (nt, 9, 3).
    discrete
        The stress of the discrete solution, shape (nt, 3).
    rest
        The bound less the value of ``dual``.
    """
    space, conjugate = dual.space, dual.conjugate
    precondition = TwoLevels(space)
    every, centre = np.arange(len(z)), discrete[:, None]
    at = conjugate.completed(centre)
    H, K = conjugate.compliance(at, every), np.empty((len(z), 12, 12))
    space.fill(K, every, lambda part: H[part])
    precondition.update(K)
    moved = np.matmul(z - centre, H[:, 0])
    first = dual.gradient(at)
    model = dual.value(centre, at) + product(space, z - centre, first + moved / 2)
    step, promised = change(precondition, K, first + moved, rest + model, effort)
    z = z + step
    for _ in range(effort.newton):
        at = conjugate.completed(z)
        value = dual.value(z, at)
        if rest + value - promised <= effort.trust * (rest + value):
            break
        yields = np.flatnonzero((at.over > 0).any(axis=1))
        space.fill(K, yields, lambda part, at=at: conjugate.compliance(at.of(part), part))
        precondition.smooth(K)
        step, promised = change(precondition, K, dual.gradient(at), rest + value, effort)
        z = descended(dual, z, step, value)
    return z


def change(
    precondition: TwoLevels, K: np.ndarray, strain: np.ndarray, bound: float, effort: Effort
) -> tuple[np.ndarray, float]:
    """The change of the stress for the strains d phi*/dz (nt, 9, 3), and the bound it promises."""
    space = precondition.space
    right = tuple(-v for v in space.gathered(space.forces(strain)))
    x, promised = conjugate_gradients(precondition, K, right, bound, effort)
    return space.stress(space.local(*x)), promised


def conjugate_gradients(
    precondition: TwoLevels, K: np.ndarray, right: Pair, bound: float, effort: Effort
) -> tuple[Pair, float]:
    """Unknowns that nearly solve K x = right, and the bound, which each step lowers."""
    space, r = precondition.space, [v.copy() for v in right]
    p = z = precondition(K, r)
    rz, x = inner(r, z), [np.zeros_like(v) for v in r]
    for step in range(1, effort.steps + 1):
        if not rz > 0:
            break
        Kp = space.product(K, p)
        alpha = rz / inner(p, Kp)
        for v, q, s, kq in zip(x, p, r, Kp, strict=True):
            v += alpha * q
            s -= alpha * kq
        gained = 0.5 * alpha * rz
        bound -= gained
        if step == effort.steps or gained <= effort.gain * bound:
            break
        z = precondition(K, r)
        rz, before = inner(r, z), rz
        p = tuple(a + rz / before * b for a, b in zip(z, p, strict=True))
    return tuple(x), bound


def descended(dual: Dual, z: np.ndarray, step: np.ndarray, value: float) -> np.ndarray:
    """Z plus the longest of the parts 1, 1/2, 1/4, ... of the step that lowers the value."""
    length = 1.0
    while length > SHORTEST:
        trial = z + length * step
        if dual.value(trial, dual.conjugate.completed(trial)) <= value:
            return trial
        length /= 2
    return z


def product(space: AirySpace, z: np.ndarray, strain: np.ndarray) -> float:
    """The integral of stress times strain, both (nt, 9, 3)."""
    return float(space.triangles.area @ np.einsum("tqc,tqc->t", z, strain)) / 9
