"""Contact problems whose compliance is expensive: each product with it takes a solve.

S = R K^-1 R' maps forces x of rows R to their displacements: they change the gaps from g to
g + S (x - x_0).  The conditions that forces and gaps have to meet are solved with a secant matrix W
instead of S; one true product with the change of the forces then gives the true gaps and teaches W.
Every product that is not the last one is a new direction, so that it ends after at most as many as
there are rows, and in practice after about as many as the conjugate gradient method needs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

SPANNED = 1e-12
"""A force is known if a smaller part of its work is outside the span of known forces."""

ROUNDING = 3e-14  # relative size of rounding in a product S force
FIRST = 3e-2  # part of the slack below which the first change counts as rounding
RESTARTS = 4  # largest number of products, relative to the number of rows


class Compliance:
    """An approximation W of S, symmetric positive definite, with W v = S v for known products.

    It starts as diag + C C', with a positive diagonal (length per force) and ``columns`` C (n, k),
    and learns by BFGS updates with forces that are made S-orthogonal, so that all products since
    ``restart`` stay exact.  What earlier tangents have taught it is kept as a guess.
    """

    def __init__(self, diagonal: np.ndarray, columns: np.ndarray | None = None) -> None:
        self._diagonal = diagonal  # W = diag + columns diag(signs) columns'
        self._columns = np.zeros((len(diagonal), 0)) if columns is None else columns
        self._signs = np.ones(self._columns.shape[1])
        self.restart()

    @classmethod
    def of(cls, S: np.ndarray) -> Compliance:
        """W = S, known from the start; a force that moves nothing has the largest diagonal."""
        S = S + np.diag(np.where(S.diagonal() > 0, 0.0, S.diagonal().max(initial=0.0)))
        W = cls(np.zeros(len(S)))
        sizes, vectors = np.linalg.eigh((S + S.T) / 2)
        W._columns = vectors * np.sqrt(np.abs(sizes))
        W._signs = np.sign(sizes)
        return W

    def __matmul__(self, forces: np.ndarray) -> np.ndarray:
        return self._diagonal * forces + self._columns @ (
            self._signs * (forces @ self._columns)
        )

    @property
    def diagonal(self) -> np.ndarray:
        """The diagonal of W."""
        return self._diagonal + (self._columns**2) @ self._signs

    def block(self, chosen: np.ndarray) -> np.ndarray:
        """Rows and columns of W for some of the forces, dense."""
        columns = self._columns[chosen]
        return np.diag(self._diagonal[chosen]) + (columns * self._signs) @ columns.T

    def plus(self, diagonal: np.ndarray) -> Compliance:
        """W and a diagonal, which has learned nothing."""
        other = Compliance(self._diagonal + diagonal)
        other._columns = self._columns
        other._signs = self._signs
        return other

    def restart(self) -> None:
        """Start with a new tangent K: known products become a guess."""
        self._learned: list[tuple[np.ndarray, np.ndarray]] = []
        if self._columns.shape[1] > 2 * len(self._diagonal):
            self._condense()

    def _condense(self) -> None:
        """Write W as C C' with as many columns as there are forces."""
        try:
            factor = np.linalg.cholesky(self.block(np.arange(len(self._diagonal))))
        except np.linalg.LinAlgError:  # rounding
            return
        self._diagonal = np.zeros(len(factor))
        self._columns = factor
        self._signs = np.ones(len(factor))

    def learn(self, force: np.ndarray, answer: np.ndarray) -> bool:
        """Update W such that W force = answer = S force; False if that holds already."""
        work = force @ answer
        for v, Sv in self._learned:
            share = v @ answer
            force = force - share * v
            answer = answer - share * Sv
        size = force @ answer
        if not size > SPANNED * work:
            return False
        v = force / np.sqrt(size)
        Sv = answer / np.sqrt(size)
        guess = self @ v
        self._columns = np.column_stack([self._columns, Sv, guess / np.sqrt(v @ guess)])
        self._signs = np.append(self._signs, [1.0, -1.0])
        self._learned.append((v, Sv))
        return True


SmallProblem = Callable[[Compliance, np.ndarray, np.ndarray], tuple[np.ndarray, bool]]
"""(W, gaps, forces) -> the change of the forces that meets the conditions, whether to rounding."""


def solve_by_secants(
    small: SmallProblem,
    product: Callable[[np.ndarray], np.ndarray],
    compliance: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    slack: float,
) -> np.ndarray | None:
    """Forces that meet the conditions of contact with the gaps they cause, from those given (n,).

    ``product`` maps d to S d; it is called with each change of the forces, which add up to all of
    it.  Changes of the gaps below ``slack`` (length) need no further product; the first one is made
    unless it is rounding, so that none of several calls leaves the gaps as they were.  None if a
    number became NaN or infinite or rows are dependent.
    """
    compliance.restart()
    for number in range(RESTARTS * (len(gaps) + 3)):
        change, exact = small(compliance, gaps, forces)
        rounding = slack * (1 if number else FIRST)
        if exact and np.abs(compliance @ change).max(initial=0.0) <= rounding:
            return np.where(forces + change == 0, 0.0, forces)
        answer = product(change)
        gaps = gaps + answer
        forces = forces + change
        if not np.isfinite(answer).all():
            return None
        # rounding errors of far larger earlier products hide this one
        if not compliance.learn(change, answer):
            compliance.restart()
            compliance.learn(change, answer)
        # the rounding error of the product stays in the gaps
        slack = max(slack, ROUNDING * float(np.abs(answer).max()))
    return None
