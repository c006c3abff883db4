"""Projection onto the displacements that supports and closed or sticking contact rows allow.

Rows that slip with Coulomb's law push obliquely: their tangential force is a part of the normal
one.  Forces are then projected along what the rows push, displacements onto what they leave free.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.linalg import splu

from ngepc.discretisation.body import DiscreteBody
from ngepc.linalg.descent import Linear
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.friction import TINY, FrictionCone, matrix_of_rows

PARALLEL = 1e-8
"""Normals at a node that are closer count as one."""

STIFFEST = 100.0
"""Forces turn towards a slip at most so many times as fast as c would have it."""


class Rubbing(NamedTuple):
    """What rows do along their tangents: stick, or slip with t = bound + slant n + k slip.

    Closed rows, and with Tresca's law the open ones as well.

    ``sticks`` tells which tangents are held, (m, d) as are bound and slant; the stiffness k, sparse
    (m d, m d), turns forces towards the slip.
    """

    sticks: np.ndarray
    bound: np.ndarray
    slant: np.ndarray
    stiffness: csr_matrix

    @classmethod
    def by(
        cls,
        cone: FrictionCone,
        active: np.ndarray,
        free: np.ndarray,
        y: np.ndarray,
        c: np.ndarray,
    ) -> Rubbing:
        """The linearised law of closed rows at y = x - c g; c is (m,), free tangents (m, d)."""
        slips, direction, bound, trial_size = cone.slipping(y)
        rubs = cone.rubs(active)
        m = len(c)
        slope = cone.slope(y, active)

        # Rows that slip against a bound which does not grow with the pressure.
        capped = rubs & slips & ~cone.grows(y[:m])
        dragged = np.where(capped, bound, 0.0)[:, None] * direction

        # Along a tangent dt = G (dt + c ds) with G = bound / trial_size: dt = c G / (1 - G) ds.
        beyond = np.maximum(trial_size - bound, np.maximum(bound / STIFFEST, TINY))
        stiffness = np.where(slips, c * trial_size / beyond, 0.0)
        turns = matrix_of_rows(stiffness[:, None, None] * slope)

        sticks = (rubs & ~slips)[:, None] & free
        return cls(sticks, dragged, slope[:, 1:, 0], turns[m:, m:])


class Closed:
    """The displacements that keep supports and closed contact rows, and the projection onto them.

    ``active`` tells which rows are closed, ``rubbing`` what they do along their tangents, None
    without friction.  ``numbers`` are the held rows among all forces, the tangents last;
    ``slanted`` says that rows push obliquely, so that the projection is no orthogonal one.
    FactorisationError if the closed rows are dependent.
    """

    def __init__(
        self, body: DiscreteBody, active: np.ndarray, rubbing: Rubbing | None = None
    ) -> None:
        self.free = body.free.ravel().astype(float)
        rows = body.contact.rows
        m = len(active)
        nothing = np.zeros((m, 0))
        sticks, bound, slant, stiffness = rubbing or (
            *[nothing] * 3,
            csr_matrix((0, 0)),
        )
        self._bound = bound.ravel()
        self._stiffness = stiffness
        self._m = m
        self._tangential = T = rows.tangential[: sticks.size]
        places = np.arange(slant.size), np.arange(m + 1) * slant.shape[1]
        self._slant = csr_matrix((slant.ravel(), *places), shape=(m, slant.size))
        self.slanted = bool(slant.any())
        self._springs = (T.T @ stiffness @ T).tocsr()
        closed = np.flatnonzero(active)
        sticking = np.flatnonzero(sticks)
        self.numbers = np.append(closed, m + sticking)
        of_tangents = np.repeat(rows.nodes, sticks.shape[1])
        self._nodes = np.append(rows.nodes[closed], of_tangents[sticking])
        normal = rows.normal[closed]
        held = T[sticking]
        self.rows = vstack([normal, held]).multiply(self.free).tocsr()
        pushed = vstack([normal + self._slant[closed] @ T, held])
        self._pushed = pushed.multiply(self.free).T.tocsr()
        try:
            gram = (self.rows @ self._pushed).tocsc()
            self._solve = splu(gram).solve if gram.shape[0] else np.copy
        except RuntimeError as error:
            raise FactorisationError(
                "contact rows of one node are dependent"
            ) from error

    def moved(self, amounts: np.ndarray) -> np.ndarray:
        """A displacement of nodes at the held rows that moves these by some amounts."""
        return self._pushed @ self._solve(amounts)

    def stiffened(self, multiply: Linear) -> Linear:
        """A stiffness with that of the tangents that slip."""
        if not self._springs.nnz:
            return multiply
        return lambda x: multiply(x) + self._springs @ x

    def slipping(self, gaps: np.ndarray) -> np.ndarray:
        """Nodal forces of the rows that slip, without their normal forces and further slip."""
        return self._tangential.T @ self._dragged(gaps)

    def forces(self, imbalance: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        """The forces of all rows with these gaps: those held balance nodal forces best."""
        x = np.zeros(len(gaps))
        m = self._m
        x[self.numbers] = self._solve(self.rows @ imbalance)
        x[m:] += x[:m] @ self._slant + self._dragged(gaps)
        return x

    def _dragged(self, gaps: np.ndarray) -> np.ndarray:
        return self._bound - self._stiffness @ gaps[self._m :]

    def project(self, x: np.ndarray) -> np.ndarray:
        """The part of a displacement, or of nodal forces, that supports and rows leave free."""
        x = self.free * x
        return x - self.moved(self.rows @ x)

    def pins(self, N: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of closed rows and the projections onto what they leave free there, (k, N, N).

        Rows over several nodes pin their own one.
        """
        rows, count = self.rows, self.rows.shape[0]
        nodes, which = np.unique(self._nodes, return_inverse=True)
        columns = N * self._nodes[:, None] + np.arange(N)
        normals = np.asarray(rows[np.arange(count)[:, None], columns].todense())
        gram = np.zeros((len(nodes), N, N))
        np.add.at(gram, which, normals[:, :, None] * normals[:, None, :])
        sizes, vectors = np.linalg.eigh(gram)
        left = (sizes <= PARALLEL * sizes[:, -1:]).astype(float)
        return nodes, np.einsum("kan,kn,kbn->kab", vectors, left, vectors)
