"""The conic program of the upper bound, for all classes of velocities.

Velocities are affine functions of unknowns y.  A class of velocities provides linear conditions and
parts of the dissipation; each part is a sum of weights times norms of vectors that are affine in y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack

from ngepc.limit.data import GROWS, STAYS
from ngepc.limit.repair import Projection
from ngepc.linalg.conic import ConeProgram

LIFTED = 1e-7
"""Normal speeds at an obstacle below this fraction of the largest are set to zero."""


@dataclass(frozen=True, eq=False)
class AffineRows:
    """The function rows y + offset.

    Parameters
    ----------
    rows, offset
        Matrix (m, n) and vector (m,).
    """

    rows: csr_matrix
    offset: np.ndarray

    def at(self, y: np.ndarray) -> np.ndarray:
        """Its values."""
        return self.rows @ y + self.offset


@dataclass(frozen=True, eq=False)
class DissipatedPart:
    """A sum of weights times norms of vectors with ``size`` components.

    Parameters
    ----------
    vectors
        Their components, one vector after the other.
    size
        Components of a vector.
    weights
        One for each vector, > 0.
    """

    vectors: AffineRows
    size: int
    weights: np.ndarray

    def lengths(self, y: np.ndarray) -> np.ndarray:
        """The lengths of the vectors."""
        return np.linalg.norm(self.vectors.at(y).reshape(-1, self.size), axis=1)

    def cone(self, first: int, width: int) -> tuple[csr_matrix, np.ndarray, int]:
        """The cones |vector| <= bound; unknowns from ``first`` on of ``width`` are the bounds."""
        count = len(self.weights)
        rows = self.vectors.rows.tocoo()
        size = self.size
        offset = np.zeros((count, size + 1))
        offset[:, 1:] = self.vectors.offset.reshape(count, size)
        own = np.arange(count)
        place = (size + 1) * (rows.row // size) + 1 + rows.row % size
        where = (
            np.concatenate([place, (size + 1) * own]),
            np.concatenate([rows.col, first + own]),
        )
        entries = np.concatenate([rows.data, np.ones(count)])
        matrix = csr_matrix((entries, where), shape=(offset.size, width))
        return matrix, offset.ravel(), size + 1


@dataclass(frozen=True, eq=False)
class Flow:
    """Conditions, power and dissipation of velocities.

    Parameters
    ----------
    none
        Rows that must vanish: free coordinates of strain rates, and held components.
    push
        Speeds into obstacles, which must not be positive.
    power
        Power of the growing and of the constant loads.
    parts
        The parts of the dissipation.
    moves
        Whether the load is a motion of supports; otherwise the growing loads do unit power.
    """

    none: AffineRows
    push: AffineRows
    power: tuple[AffineRows, AffineRows]
    parts: list[DissipatedPart]
    moves: bool

    @property
    def equations(self) -> tuple[csr_matrix, np.ndarray]:
        """The equations for y: vanishing rows, and unit power of the growing loads."""
        if self.moves:
            return self.none.rows, -self.none.offset
        grows = self.power[GROWS]
        rows = vstack([self.none.rows, grows.rows], format="csr")
        return rows, np.append(-self.none.offset, 1 - grows.offset)

    def program(self) -> ConeProgram:
        """The conic program of the smallest dissipation; its unknowns are y, then the norms."""
        equations, values = self.equations
        width = equations.shape[1]
        lengths = sum(len(part.weights) for part in self.parts)
        cones = []
        first = width
        for part in self.parts:
            cones.append(part.cone(first, width + lengths))
            first += len(part.weights)

        def widened(rows: csr_matrix) -> csr_matrix:
            """Rows with zero columns for the lengths."""
            return csr_matrix(hstack([rows, csr_matrix((rows.shape[0], lengths))]))

        staying = -self.power[STAYS].rows.toarray()[0]
        cost = np.concatenate([staying, *(part.weights for part in self.parts)])
        above = widened(-self.push.rows)
        return ConeProgram(
            cost, widened(equations), values, above, self.push.offset, cones
        )

    def admissible(self, solution: np.ndarray) -> np.ndarray:
        """The admissible y nearest to a solution of the program, up to rounding."""
        rows, values = self.equations
        y = solution[: rows.shape[1]]
        scale = LIFTED * float(np.abs(y).max())
        while True:
            active = self.push.at(y) > -scale
            equations = vstack([rows, self.push.rows[active]], format="csr")
            right = np.concatenate([values, -self.push.offset[active]])
            y = Projection(equations, right)(y)
            if not (self.push.at(y)[~active] > 0).any():
                return y
