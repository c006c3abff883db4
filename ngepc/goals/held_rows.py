"""Displacements of the tangent problem with contact rows that are held at given values.

The forces of the rows are found with a matrix W that is near their compliance S = R K^-1 R': each
product with S takes a solve with the factors of K, and teaches W, see ``secants``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.discretisation.factors import Factors
from ngepc.linalg.secants import Compliance

SPARE = 3
"""Passes beyond the number of held rows."""
CUTS = 20
"""Most passes until no more forces are cut off."""
ROUNDING = 1e-10
"""Relative excess of a force that does not count."""


@dataclass(frozen=True, eq=False)
class Held:
    """A solution of the tangent problem with contact rows that are held, and those not.

    ``z`` (nodes, N) are displacements, ``forces`` (rows,) what the rows do to them.
    """

    z: np.ndarray
    forces: np.ndarray


class HeldRows:
    """Solutions with held rows, for the ``matrix`` R (rows, nodes N) and the factors of a tangent.

    ``tolerance`` is that of the values of held rows, relative to the displacements.
    """

    def __init__(
        self,
        matrix: csr_matrix,
        tangent: Factors,
        compliance: Compliance,
        tolerance: float,
    ) -> None:
        self.matrix = matrix
        self._tangent = tangent
        self._compliance = compliance
        self.tolerance = tolerance

    def held(
        self,
        start: Held,
        chosen: np.ndarray,
        values: np.ndarray,
        tolerance: float | None = None,
    ) -> Held:
        """``start`` with other forces of the ``chosen`` rows (as booleans), which have ``values``.

        The step along each change of the forces is the best one, as with conjugate gradients.
        ``tolerance`` replaces the usual one.
        """
        found = start
        places = np.flatnonzero(chosen)
        for _ in range(len(places) + SPARE if len(places) else 0):
            off = self.matrix[places] @ found.z.ravel() - values[places]
            size = max(np.abs(found.z).max(), np.abs(values).max())
            if np.abs(off).max() <= (tolerance or self.tolerance) * size:
                break
            change = np.zeros(len(found.forces))
            change[places] = np.linalg.solve(self._compliance.block(places), off)
            moved = self._moved(change, found)
            work = float(change @ moved.forces)
            step = float(change[places] @ off) / work if work > 0 else 1.0
            found = Held(found.z - step * moved.z, found.forces + step * change)
        return found

    def _moved(self, change: np.ndarray, like: Held) -> Held:
        """What a change of the forces does: to displacements, and to the rows; W learns it."""
        answer = self._tangent.solve((self.matrix.T @ change).reshape(like.z.shape))
        moved = self.matrix @ answer.ravel()
        self._compliance.learn_anyway(change, moved)
        return Held(answer, moved)

    def limited(self, start: Held, held: np.ndarray, most: np.ndarray) -> np.ndarray:
        """Forces (rows,) of at most ``most`` near those of ``start``.

        The rows ``held`` (as booleans) whose forces are not cut off keep their values as W predicts
        them, without a solve: a rough solution is enough.
        """
        forces = start.forces
        left = held.copy()
        for _ in range(CUTS):
            more = left & (np.abs(forces) > most * (1 + ROUNDING))
            if not more.any():
                break
            left &= ~more
            change = np.where(more, np.clip(forces, -most, most) - forces, 0.0)
            places = np.flatnonzero(left)
            moved = (self._compliance @ change)[places]
            change[places] = np.linalg.solve(self._compliance.block(places), -moved)
            forces = forces + change
        return np.clip(forces, -most, most)
