"""Projection of approximate solutions onto the solutions of linear equations."""

from __future__ import annotations

import numpy as np
from ngsolve import BaseVector
from scipy.sparse import csr_matrix, diags, tril

from ngepc.linalg.direct import from_entries

REGULAR = 1e-9
"""Regularisation relative to the squares of the rows, as rows may be dependent."""

ROUNDS = 8
"""Largest number of corrections; each reduces the residual to a small part."""


class Projection:
    """Projection onto the x with ``equations x = values``; rows may be dependent.

    Parameters
    ----------
    equations, values
        Matrix (m, n) and right side, which must be consistent.
    """

    def __init__(self, equations: csr_matrix, values: np.ndarray) -> None:
        size = np.sqrt(np.asarray(equations.multiply(equations).sum(axis=1)).ravel())
        scale = 1 / np.where(size > 0, size, 1.0)
        self._rows = csr_matrix(diags(scale) @ equations)
        self._values = scale * values
        square = tril(self._rows @ self._rows.T + REGULAR * diags(np.ones(len(scale))))
        lower = square.tocoo()
        matrix = from_entries(lower.row, lower.col, lower.data, *lower.shape)
        self._inverse = matrix.Inverse(inverse="sparsecholesky")
        self._right = BaseVector(len(scale))
        self._found = BaseVector(len(scale))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """The residual of the equations, with rows scaled to length one."""
        return self._values - self._rows @ x

    def change(self, x: np.ndarray) -> np.ndarray:
        """Nearly the smallest change after which x satisfies the equations."""
        self._right.FV().NumPy()[:] = self.residual(x)
        self._found.data = self._inverse * self._right
        return self._rows.T @ self._found.FV().NumPy()

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """The projection of x, up to rounding."""
        change = self.change(x)
        for _ in range(ROUNDS):
            x = x + change
            last = change
            change = self.change(x)
            if np.abs(change).max() > 0.1 * np.abs(last).max():
                break
        return x
