"""The compliance of constraint rows, learned from the few products that a run computes.

S = R K^-1 R' maps forces of rows R to their displacements; each product with it takes a solve with
K.  A symmetric secant matrix W stands for it in the small problems of contact.
"""

from __future__ import annotations

import numpy as np

SPANNED = 1e-12
"""A force whose part beyond those learned does a smaller share of its work is one of them."""


class Compliance:
    """W close to S, symmetric and positive definite, with W v = S v for what it has learned.

    It starts as a diagonal and learns by BFGS updates with forces that are made S-orthogonal, so
    that all products since ``restart`` stay exact.  What earlier tangents have taught it is kept
    as a guess.

    Parameters
    ----------
    diagonal
        First guess of the diagonal of S (length per force), positive, shape (n,).
    columns
        C in the first guess diag + C C', shape (n, k); None for no more than the diagonal.
    """

    def __init__(self, diagonal: np.ndarray, columns: np.ndarray | None = None) -> None:
        columns = np.zeros((len(diagonal), 0)) if columns is None else columns
        self._diagonal, self._columns = diagonal, columns  # W = diag + columns diag(signs) columns'
        self._signs = np.ones(columns.shape[1])
        self.restart()

    @classmethod
    def of(cls, S: np.ndarray) -> Compliance:
        """W = S, known from the start; a force that moves nothing has the largest diagonal."""
        S = S + np.diag(np.where(S.diagonal() > 0, 0.0, S.diagonal().max(initial=0.0)))
        W, (sizes, vectors) = cls(np.zeros(len(S))), np.linalg.eigh((S + S.T) / 2)
        W._columns, W._signs = vectors * np.sqrt(np.abs(sizes)), np.sign(sizes)
        return W

    def __matmul__(self, forces: np.ndarray) -> np.ndarray:
        return self._diagonal * forces + self._columns @ (self._signs * (forces @ self._columns))

    @property
    def diagonal(self) -> np.ndarray:
        """The diagonal of W."""
        return self._diagonal + (self._columns**2) @ self._signs

    def block(self, chosen: np.ndarray) -> np.ndarray:
        """Rows and columns of W for some of the forces, dense."""
        columns = self._columns[chosen]
        return np.diag(self._diagonal[chosen]) + (columns * self._signs) @ columns.T

    def restart(self) -> None:
        """Take note of a new tangent K: what was learned becomes a guess."""
        self._learned: list[tuple[np.ndarray, np.ndarray]] = []

    def learn(self, force: np.ndarray, answer: np.ndarray) -> bool:
        """Make W force = answer, where answer = S force; False if W knows it already."""
        work = force @ answer
        for v, Sv in self._learned:
            share = v @ answer
            force, answer = force - share * v, answer - share * Sv
        size = force @ answer
        if not size > SPANNED * work:
            return False
        v, Sv = force / np.sqrt(size), answer / np.sqrt(size)
        guess = self @ v
        self._columns = np.column_stack([self._columns, Sv, guess / np.sqrt(v @ guess)])
        self._signs = np.append(self._signs, [1.0, -1.0])
        self._learned.append((v, Sv))
        return True
