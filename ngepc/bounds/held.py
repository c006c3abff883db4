"""Contact pressures that balance the loads on parts that contact alone holds.

A stress in equilibrium exists only if the loads l and the pressure P do no work on the rigid
motions z of such a part: l(z) = int P [z . n], with the jump [z . n] of two bodies.  A given P is
changed to P (1 + [y . n]) with the rigid motion y that makes this true.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.data import BoundData
from ngepc.local.system import State

PASSES = 2
"""The second pass removes rounding errors of the first."""
BALANCED = 1e-9
"""Largest work on a rigid motion that is left, relative to the sum of all forces."""
UNDETERMINED = 1e-10
"""Relative size of motions without a normal component on contact."""


def holding_pressure(bound_data: BoundData, state: State, P: np.ndarray) -> np.ndarray:
    """A pressure near P (contact facets, N) that holds all floating parts.

    RuntimeError where no such pressure is nonnegative, or none holds them.
    """
    motions = state.discrete.floating.motions
    if not motions.shape[2]:
        return P
    contact = bound_data.contact
    N = contact.N
    along = np.stack([contact.along(z)[:, :N] for z in np.moveaxis(motions, 2, 0)])
    _, forces = bound_data.loads(state, np.zeros_like(P))
    wanted = np.einsum("ni,nik->k", forces, motions)

    def works(pressure: np.ndarray) -> np.ndarray:
        """The works of a pressure on the motions."""
        moments = contact.moments(pressure[:, :, None])[:, :N, 0]
        return np.einsum("ea,kea->k", moments, along)

    for _ in range(PASSES):
        matrix = np.stack([works(P * jump) for jump in along], axis=1)
        missing = wanted - works(P)
        change = np.linalg.lstsq(matrix, missing, rcond=UNDETERMINED)[0]
        factor = 1 + np.einsum("k,kea->ea", change, along)
        if factor[P > 0].min(initial=0.0) < 0:
            raise RuntimeError(
                "the contact pressure cannot be made to balance the loads of a part that contact "
                "alone holds: a bound needs a finer mesh"
            )
        P = P * np.maximum(factor, 0.0)
    left = np.abs(wanted - works(P)).max()
    if left > BALANCED * np.abs(forces).sum():
        raise RuntimeError(
            "the contact pressure does not balance the loads of a part that contact alone holds"
        )
    return P
