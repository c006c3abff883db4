"""The stress that nearly minimises the dual functional among those with given tractions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.airy import AirySpace, Pair, TwoLevels, inner
from ngepc.bounds.conjugate import Conjugate

SHORTEST = 1e-3
"""Shortest step length."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How hard to look for the best stress.

    Parameters
    ----------
    newton
        Newton steps after the tangent at the discrete stress.
    gain
        Conjugate gradients stop at a step that gains less than this part of the bound.
    steps
        Most of these steps, for each tangent.
    """

    newton: int = 1
    gain: float = 0.02
    steps: int = 12


def tightened(
    space: AirySpace,
    conjugate: Conjugate,
    z: np.ndarray,
    discrete: np.ndarray,
    rest: float,
    effort: Effort,
) -> np.ndarray:
    """In-plane stresses at the midpoints, shape (nt, 9, 3), with a smaller dual functional.

    Parameters
    ----------
    z
        The admissible stress to start from, shape (nt, 9, 3).
    discrete
        The stress of the discrete solution, shape (nt, 3).
    rest
        The bound less int phi*(z).
    """
    precondition = TwoLevels(space)
    every, centre = np.arange(len(z)), discrete[:, None]
    at = conjugate.completed(centre)
    H, K = conjugate.compliance(at, every), np.empty((len(z), 12, 12))
    space.fill(K, every, lambda part: H[part])
    precondition.update(K)
    strain = conjugate.gradient(at) + np.matmul(z - centre, H[:, 0])
    model = energy(space, conjugate, centre) + 0.5 * product(space, z - centre, strain)
    z = z + change(precondition, K, strain, max(rest + model, 0.0), effort)
    for _ in range(effort.newton):
        at = conjugate.completed(z)
        yields = np.flatnonzero((at.over > 0).any(axis=1))
        space.fill(K, yields, lambda part, at=at: conjugate.compliance(at.of(part), part))
        precondition.smooth(K)
        bound = max(rest + float(weights(space) @ conjugate.value(at).mean(axis=1)), 0.0)
        step = change(precondition, K, conjugate.gradient(at), bound, effort)
        z = descended(space, conjugate, z, step)
    return z


def change(
    precondition: TwoLevels, K: np.ndarray, strain: np.ndarray, bound: float, effort: Effort
) -> np.ndarray:
    """The change of the stress that makes the strains d phi*/dz (nt, 9, 3) more compatible."""
    space = precondition.space
    right = tuple(-v for v in space.gathered(space.forces(strain)))
    x = conjugate_gradients(precondition, K, right, bound, effort)
    return space.stress(space.local(*x))


def conjugate_gradients(
    precondition: TwoLevels, K: np.ndarray, right: Pair, bound: float, effort: Effort
) -> Pair:
    """Unknowns that nearly solve K x = right; each step lowers the bound."""
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
    return tuple(x)


def descended(
    space: AirySpace, conjugate: Conjugate, z: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """Z plus the longest of the parts 1, 1/2, 1/4, ... of the step that lowers the energy."""
    here, length = energy(space, conjugate, z), 1.0
    while length > SHORTEST:
        if energy(space, conjugate, z + length * step) <= here:
            return z + length * step
        length /= 2
    return z


def energy(space: AirySpace, conjugate: Conjugate, z: np.ndarray) -> float:
    """int phi*(z) by the mean over the points, shape (nt, points, 3)."""
    return float(weights(space) @ conjugate.value(conjugate.completed(z)).mean(axis=1))


def product(space: AirySpace, z: np.ndarray, strain: np.ndarray) -> float:
    """The integral of stress times strain, both (nt, 9, 3)."""
    return float(weights(space) @ np.einsum("tqc,tqc->t", z, strain)) / 9


def weights(space: AirySpace) -> np.ndarray:
    """The areas of the triangles."""
    return space.triangles.area
