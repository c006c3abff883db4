"""The stress that nearly minimises the dual functional among those with given tractions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.airy import AirySpace, TwoLevels, conjugate_gradients
from ngepc.bounds.conjugate import Completed, Conjugate

SHORTEST = 1e-3
"""Shortest step length."""


@dataclass(frozen=True)
class Effort:
    """How hard to look for the best stress.

    Parameters
    ----------
    first, later
        Steps of conjugate gradients for the tangent at the discrete stress, and for each Newton
        step after that.
    newton
        Newton steps.
    part
        Part of its size at which a residual is small enough.
    """

    first: int = 6
    later: int = 6
    newton: int = 1
    part: float = 0.1


def tightened(
    space: AirySpace, conjugate: Conjugate, z: np.ndarray, discrete: np.ndarray, effort: Effort
) -> np.ndarray:
    """In-plane stresses at the midpoints, shape (nt, 9, 3), with a smaller dual functional.

    Parameters
    ----------
    z
        The admissible stress to start from, shape (nt, 9, 3).
    discrete
        The stress of the discrete solution, shape (nt, 3).
    """
    precondition = TwoLevels(space)
    centre = discrete[:, None]
    at = conjugate.completed(centre)
    H = conjugate.compliance(at)
    K = space.stiffness(H)
    precondition.update(K)
    strain = conjugate.gradient(at) + np.matmul(z - centre, H[:, 0].transpose(0, 2, 1))
    right = [-v for v in space.gathered(space.forces(strain))]
    change = conjugate_gradients(space, K, right, precondition, effort.first, effort.part)
    z = z + space.stress(change)
    for _ in range(effort.newton):
        at = conjugate.completed(z)
        right = [-v for v in space.gathered(space.forces(conjugate.gradient(at)))]
        K = updated(space, conjugate, at, K)
        local = conjugate_gradients(space, K, right, precondition, effort.later, effort.part)
        z = descended(space, conjugate, z, space.stress(local))
    return z


def descended(
    space: AirySpace, conjugate: Conjugate, z: np.ndarray, change: np.ndarray
) -> np.ndarray:
    """Z plus the longest of the changes 1, 1/2, 1/4, ... that lowers the dual energy."""
    weights = space.triangles.area / 9

    def energy(stress: np.ndarray) -> float:
        return float(weights @ conjugate.value(conjugate.completed(stress)).sum(axis=1))

    here, length = energy(z), 1.0
    while length > SHORTEST:
        if energy(z + length * change) <= here:
            return z + length * change
        length /= 2
    return z


def updated(
    space: AirySpace, conjugate: Conjugate, at: Completed, K: np.ndarray
) -> np.ndarray:
    """Stiffness matrices at completed stresses, those of ``K`` where nothing has yielded."""
    yields = (at.over > 0).any(axis=1)
    K = K.copy()
    K[yields] = space.stiffness(conjugate.compliance(at)[yields], yields)
    return K
