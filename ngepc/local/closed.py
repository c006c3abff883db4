"""What supports and closed contact rows leave free, and the projection onto it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from ngepc.discretisation.balance import Frame
from ngepc.local.factors import TangentError

PARALLEL = 1e-8
"""Normals at a node that are closer count as one."""


class Closed:
    """The displacements that keep supports and closed contact rows, and the projection onto them.

    Parameters
    ----------
    frame
        What has the supports and the contact rows.
    active
        Boolean, shape (m,): closed rows.

    Raises
    ------
    TangentError
        If the closed rows are dependent.
    """

    def __init__(self, frame: Frame, active: np.ndarray) -> None:
        self.free = frame.free.ravel().astype(float)
        self.rows = frame.contact.rows.normal[np.flatnonzero(active)].multiply(self.free).tocsr()
        self._transposed = self.rows.T.tocsr()
        if self.rows.shape[0]:
            try:
                self._gram = splu((self.rows @ self._transposed).tocsc())
            except RuntimeError as error:
                raise TangentError("contact rows of one node are dependent") from error

    def moved(self, amounts: np.ndarray) -> np.ndarray:
        """The smallest displacement that moves the closed rows by these amounts."""
        if not self.rows.shape[0]:
            return np.zeros(len(self.free))
        return self._transposed @ self._gram.solve(amounts)

    def forces(self, imbalance: np.ndarray) -> np.ndarray:
        """The forces of the closed rows that balance nodal forces best."""
        return self._gram.solve(self.rows @ imbalance) if self.rows.shape[0] else np.zeros(0)

    def project(self, x: np.ndarray) -> np.ndarray:
        """The part of a displacement, or of nodal forces, that supports and rows leave free."""
        x = self.free * x
        return x - self.moved(self.rows @ x)

    def pins(self, N: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of closed rows and the projections onto what they leave free there, (k, N, N).

        Rows over several nodes pin the one where they are largest.
        """
        largest = _largest(self.rows)
        nodes, which = np.unique(largest // N, return_inverse=True)
        normals = np.zeros((len(largest), N))
        for c in range(N):
            normals[:, c] = np.asarray(
                self.rows[np.arange(len(largest)), (largest // N) * N + c]
            ).ravel()
        gram = np.zeros((len(nodes), N, N))
        np.add.at(gram, which, normals[:, :, None] * normals[:, None, :])
        sizes, vectors = np.linalg.eigh(gram)
        left = (sizes <= PARALLEL * sizes[:, -1:]).astype(float)
        return nodes, np.einsum("kan,kn,kbn->kab", vectors, left, vectors)


def _largest(rows: csr_matrix) -> np.ndarray:
    """The column of the largest entry of each row."""
    if not rows.shape[0]:
        return np.zeros(0, dtype=int)
    return np.asarray(abs(rows).argmax(axis=1)).ravel()
