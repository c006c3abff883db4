"""What supports, closed and sticking contact rows leave free, and the projection onto it.

Rows that slip with Coulomb's law push obliquely: their tangential force is a part of the normal
one.  Forces are then projected along what the rows push, displacements onto what they leave free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, vstack
from scipy.sparse.linalg import splu

from ngepc.discretisation.balance import Frame
from ngepc.linalg.descent import Linear
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.friction import FrictionCone, orthogonal

PARALLEL = 1e-8
"""Normals at a node that are closer count as one."""

STIFFEST = 100.0
"""Forces turn towards a slip at most so many times as fast as c would have it."""


@dataclass(frozen=True, eq=False)
class Rubbing:
    """What closed rows do along their tangents: stick, or slip with t = bound + slant n + k slip.

    ``sticks`` tells which tangents are held, (m, d) as are bound and slant; the stiffness k, sparse
    (m d, m d), turns forces towards the slip.
    """

    sticks: np.ndarray
    bound: np.ndarray
    slant: np.ndarray
    stiffness: csr_matrix

    @classmethod
    def by(
        cls, cone: FrictionCone, active: np.ndarray, free: np.ndarray, y: np.ndarray, c: np.ndarray
    ) -> Rubbing:
        """The linearised law of closed rows at y = x - c g; c is (m,), free tangents (m, d)."""
        slips, e, b, size, grows = cone.slipping(y)
        moves = (active & slips)[:, None] * e
        turns = (active & slips)[:, None, None] * orthogonal(e)
        stiff = b * c / np.maximum(size - b, np.maximum(b / STIFFEST, np.finfo(float).tiny))
        blocks = stiff[:, None, None] * turns, np.arange(len(b)), np.arange(len(b) + 1)
        sticks = (active & ~slips)[:, None] & free
        k = bsr_matrix(blocks, shape=(moves.size,) * 2).tocsr()
        return cls(sticks, np.where(grows > 0, 0.0, b)[:, None] * moves, grows[:, None] * moves, k)

    def forces(self, n: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        """Tangential forces of the rows that slip (m d,), from the gaps of all rows."""
        return (self.bound + self.slant * n[:, None]).ravel() - self.stiffness @ gaps[len(n) :]


class Closed:
    """The displacements that keep supports and closed contact rows, and the projection onto them.

    ``active`` tells which rows are closed, ``rubbing`` what they do along their tangents, None
    without friction.  ``numbers`` are the held rows among all forces, the tangents last;
    ``slanted`` says that rows push obliquely, so that the projection is no orthogonal one.
    FactorisationError if the closed rows are dependent.
    """

    def __init__(self, frame: Frame, active: np.ndarray, rubbing: Rubbing | None = None) -> None:
        self.free, rows = frame.free.ravel().astype(float), frame.contact.rows
        self.numbers, self._rubbing = np.flatnonzero(active), rubbing
        held = pushed = rows.normal[self.numbers]
        self.slanted, self._springs, self._tangential = False, None, rows.tangential
        if rubbing is not None:
            T, m, sticking = rows.tangential, len(rows), np.flatnonzero(rubbing.sticks)
            parts = rubbing.slant[:, None], np.arange(m), np.arange(m + 1)
            slant = bsr_matrix(parts, shape=(m, rubbing.slant.size)).tocsr()
            pushed = vstack([held + slant[self.numbers] @ T, T[sticking]])
            held, self.numbers = vstack([held, T[sticking]]), np.append(self.numbers, m + sticking)
            self.slanted = bool(rubbing.slant.any())
            self._springs = (T.T @ rubbing.stiffness @ T).tocsr()
        self.rows = held.multiply(self.free).tocsr()
        self._pushed = pushed.multiply(self.free).T.tocsr()
        try:
            gram = (self.rows @ self._pushed).tocsc()
            self._solve = splu(gram).solve if gram.shape[0] else np.copy
        except RuntimeError as error:
            raise FactorisationError("contact rows of one node are dependent") from error

    def moved(self, amounts: np.ndarray) -> np.ndarray:
        """A displacement of nodes at the held rows that moves these by some amounts."""
        return self._pushed @ self._solve(amounts)

    def stiffened(self, multiply: Linear) -> Linear:
        """A stiffness with that of the tangents that slip."""
        if self._springs is None:
            return multiply
        return lambda x: multiply(x) + self._springs @ x

    def slipping(self, gaps: np.ndarray) -> np.ndarray:
        """Nodal forces of the rows that slip, without their normal forces and further slip."""
        if self._rubbing is None:
            return np.zeros(len(self.free))
        return self._tangential.T @ self._rubbing.forces(np.zeros(len(self._rubbing.slant)), gaps)

    def forces(self, imbalance: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        """The forces of all rows with these gaps: those held balance nodal forces best."""
        x = np.zeros(len(gaps))
        x[self.numbers] = self._solve(self.rows @ imbalance)
        if self._rubbing is not None:
            m = len(self._rubbing.slant)
            x[m:] += self._rubbing.forces(x[:m], gaps)
        return x

    def project(self, x: np.ndarray) -> np.ndarray:
        """The part of a displacement, or of nodal forces, that supports and rows leave free."""
        x = self.free * x
        return x - self.moved(self.rows @ x)

    def pins(self, N: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of closed rows and the projections onto what they leave free there, (k, N, N).

        Rows over several nodes pin the one where they are largest.
        """
        rows, count = self.rows, self.rows.shape[0]
        largest = np.asarray(abs(rows).argmax(axis=1)).ravel() if count else np.zeros(0, dtype=int)
        nodes, which = np.unique(largest // N, return_inverse=True)
        columns = (largest // N * N)[:, None] + np.arange(N)
        normals = np.asarray(rows[np.arange(count)[:, None], columns].todense())
        gram = np.zeros((len(nodes), N, N))
        np.add.at(gram, which, normals[:, :, None] * normals[:, None, :])
        sizes, vectors = np.linalg.eigh(gram)
        left = (sizes <= PARALLEL * sizes[:, -1:]).astype(float)
        return nodes, np.einsum("kan,kn,kbn->kab", vectors, left, vectors)
