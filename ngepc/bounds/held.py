"""Contact pressures that balance the loads on parts that contact alone holds.

A stress in equilibrium exists only if the loads l and the pressure P do no work on the rigid
motions z of such a part: l(z) = int P [z . n], with the jump [z . n] of two bodies.  A given P is
changed to P (1 + [y . n]) with the rigid motion y that makes this true.

The pressure pi of an adjoint also has |pi| <= lambda P.  The nearest one, with the squares of
changes divided by P, is pi + P [y . n], cut off at -lambda P and lambda P.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.contact import ContactFacets
from ngepc.bounds.data import BoundData
from ngepc.local.system import State

PASSES = 2
"""The second pass removes rounding errors of the first."""
BALANCED = 1e-9
"""Largest work on a rigid motion that is left, relative to the sum of all forces."""
UNDETERMINED = 1e-10
"""Relative size of motions without a normal component on contact."""
ROUNDED = 1e-13
"""The work that the pressure of an adjoint leaves, relative to the works of its parts."""
NEWTON_STEPS = 30
SHORTEST = 1e-6
"""Shortest step of Newton's method, relative to the full one."""


class RigidWorks:
    """The works of contact pressures on the rigid motions of parts that contact alone holds.

    ``along`` (motions, facets, N) are the jumps [z . n] of the motions at the vertices.
    """

    def __init__(self, contact: ContactFacets, motions: np.ndarray) -> None:
        self._contact = contact
        N = contact.N
        each = np.moveaxis(motions, 2, 0)
        self.along = np.stack([contact.along(z)[:, :N] for z in each])

    def of(self, P: np.ndarray) -> np.ndarray:
        """The works of a pressure (facets, N) on the motions, (motions,)."""
        N = self._contact.N
        moments = self._contact.moments(P[:, :, None])[:, :N, 0]
        return np.einsum("ea,kea->k", moments, self.along)

    def size_of(self, P: np.ndarray) -> float:
        """The largest sum of the sizes of the works of its parts on a motion."""
        N = self._contact.N
        moments = self._contact.moments(np.abs(P)[:, :, None])[:, :N, 0]
        return float(np.einsum("ea,kea->k", moments, np.abs(self.along)).max())

    def matrix(self, P: np.ndarray) -> np.ndarray:
        """The works of P [y . n] on the motions for each motion y, (motions, motions)."""
        return np.stack([self.of(P * jump) for jump in self.along], axis=1)

    def change(self, weight: np.ndarray, missing: np.ndarray) -> np.ndarray:
        """[y . n] (facets, N) such that ``weight`` [y . n] does the ``missing`` works."""
        matrix = self.matrix(weight)
        y = np.linalg.lstsq(matrix, missing, rcond=UNDETERMINED)[0]
        return np.einsum("k,kea->ea", y, self.along)


def holding_pressure(bound_data: BoundData, state: State, P: np.ndarray) -> np.ndarray:
    """A pressure near P (contact facets, N) that holds all floating parts.

    RuntimeError where no such pressure is nonnegative, or none holds them.
    """
    motions = state.discrete.floating.motions
    if not motions.shape[2]:
        return P
    works = RigidWorks(bound_data.contact, motions)
    _, forces = bound_data.loads(state, np.zeros_like(P))
    wanted = np.einsum("ni,nik->k", forces, motions)
    for _ in range(PASSES):
        factor = 1 + works.change(P, wanted - works.of(P))
        if factor[P > 0].min(initial=0.0) < 0:
            raise RuntimeError(
                "the contact pressure cannot be made to balance the loads of a part that contact "
                "alone holds: a bound needs a finer mesh"
            )
        P = P * np.maximum(factor, 0.0)
    left = np.abs(wanted - works.of(P)).max()
    if left > BALANCED * (np.abs(forces).sum() + works.size_of(P)):
        raise RuntimeError(
            "the contact pressure does not balance the loads of a part that contact alone holds"
        )
    return P


def pressure_of_works(
    works: RigidWorks, P: np.ndarray, wanted: np.ndarray
) -> np.ndarray:
    """P (1 + [y . n]) that does the ``wanted`` works (motions,); P where that is negative."""
    for _ in range(PASSES):
        factor = 1 + works.change(P, wanted - works.of(P))
        if factor[P > 0].min(initial=0.0) < 0:
            break
        P = P * np.maximum(factor, 0.0)
    return P


def limited_pressure(
    works: RigidWorks, pi: np.ndarray, most: np.ndarray, wanted: np.ndarray
) -> np.ndarray | None:
    """A pressure near ``pi`` (facets, N) of at most a size that does the wanted works (motions,).

    Newton's method for the jump [y . n], damped; None where it finds no such pressure.
    """

    def at(jump: np.ndarray) -> np.ndarray:
        """The pressure for [y . n]."""
        return np.clip(pi + most * jump, -most, most)

    jump = np.zeros_like(pi)
    missing = wanted - works.of(at(jump))
    for _ in range(NEWTON_STEPS):
        size = np.abs(missing).max()
        if size <= ROUNDED * (works.size_of(at(jump)) + np.abs(wanted).max()):
            return at(jump)
        free = np.abs(pi + most * jump) < most
        step = works.change(most * free, missing)
        length = 1.0
        while length > SHORTEST:
            left = wanted - works.of(at(jump + length * step))
            if np.abs(left).max() < (1 - length / 2) * size:
                break
            length /= 2
        else:
            return None
        jump = jump + length * step
        missing = left
    return None
