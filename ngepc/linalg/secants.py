"""Contact problems whose compliance is expensive: each product with it takes a solve.

S = R K^-1 R' maps forces x of rows R to their displacements: they change the gaps from g to
g + S (x - x_0).  The conditions that forces and gaps have to meet are solved with a secant matrix W
instead of S; one true product with the change of the forces then gives the true gaps and teaches W.
Every product that is not the last one is a new direction, so that it ends after at most as many as
there are rows, and in practice after about as many as the conjugate gradient method needs.

As long as no row changes its state (open, sticking, slipping) the conditions are linear: minimal
residuals solve them for the true S, which leaves few problems with W.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

SPANNED = 1e-12
"""A force is known if a smaller part of its work is outside the span of known forces."""

ROUNDING = 3e-14  # relative size of rounding in a product S force
FIRST = 3e-2  # part of the slack below which the first change counts as rounding
LEFT = 1e-3  # part of the residual at which minimal residuals end
RESTARTS = 4  # largest number of products, relative to the number of rows
SMALLEST = 1e-140  # displacement below which squares of forces may underflow

NEAR = 1e-8
GROWN = 1e4
"""Forces that miss by less than the first part of the gaps are taken, where later ones miss by more
than the second factor: rounding errors of the products hide all that is new."""


class Compliance:
    """An approximation W of S, symmetric positive definite, with W v = S v for known products.

    It starts as diag + C C', with a positive diagonal (length per force) and ``columns`` C (n, k),
    and learns by BFGS updates with forces that are made S-orthogonal, so that all products since
    ``restart`` stay exact.  What earlier tangents have taught it is kept as a guess.
    """

    def __init__(self, diagonal: np.ndarray, columns: np.ndarray | None = None) -> None:
        self._matrix = np.diag(diagonal)
        if columns is not None:
            self._matrix += columns @ columns.T
        self.restart()

    @classmethod
    def of(cls, S: np.ndarray) -> Compliance:
        """W = S, known from the start; a force that moves nothing has the largest diagonal."""
        sizes = S.diagonal()
        W = cls(np.where(sizes > 0, 0.0, sizes.max(initial=0.0)))
        W._matrix += (S + S.T) / 2
        return W

    def __getstate__(self) -> np.ndarray:
        """W; what it has learned is a guess for others."""
        return self._matrix

    def __setstate__(self, matrix: np.ndarray) -> None:
        self._matrix = matrix
        self.restart()

    def __matmul__(self, forces: np.ndarray) -> np.ndarray:
        return self._matrix @ forces

    @property
    def diagonal(self) -> np.ndarray:
        """The diagonal of W."""
        return self._matrix.diagonal()

    def block(self, chosen: np.ndarray) -> np.ndarray:
        """Rows and columns of W for some of the forces, a copy."""
        return self._matrix[np.ix_(chosen, chosen)]

    def plus(self, diagonal: np.ndarray) -> Compliance:
        """W and a diagonal, which has learned nothing."""
        other = Compliance(diagonal)
        other._matrix += self._matrix
        return other

    def with_springs(self, springs: np.ndarray | None) -> Compliance:
        """W, or W and springs of rows (n,) (length per force)."""
        return self if springs is None else self.plus(springs)

    def copy(self) -> Compliance:
        """The same W, which has learned nothing and learns for itself."""
        return self.plus(np.zeros(len(self._matrix)))

    def forget(self) -> None:
        """Keep the diagonal alone."""
        self._matrix = np.diag(self.diagonal)
        self.restart()

    def restart(self) -> None:
        """Start with a new tangent K: known products become a guess."""
        self._known = 0
        self._forces = np.empty_like(self._matrix)  # S-orthonormal, then what is unused
        self._answers = np.empty_like(self._matrix)  # S times them

    def learn(self, force: np.ndarray, answer: np.ndarray) -> bool:
        """Update W such that W force = answer = S force; False if that holds already."""
        known = self._known
        if known == len(force):
            return False
        work = force @ answer
        v = self._forces[:known]
        Sv = self._answers[:known]
        for _ in range(2 if known else 0):  # one pass leaves rounding errors
            shares = v @ answer
            force = force - shares @ v
            answer = answer - shares @ Sv
        size = force @ answer
        if not size > max(SPANNED * work, 0.0):
            return False
        scale = 1 / math.sqrt(size)
        new = self._forces[known] = scale * force
        image = self._answers[known] = scale * answer
        self._known = known + 1
        guess = self._matrix @ new
        self._matrix += np.outer(image, image)
        self._matrix -= np.outer(guess, guess / (new @ guess))
        return True

    def learn_anyway(self, force: np.ndarray, answer: np.ndarray) -> None:
        """The same, at the cost of earlier products: their rounding errors may hide this one."""
        if not self.learn(force, answer):
            self.restart()
            self.learn(force, answer)


SmallProblem = Callable[[Compliance, np.ndarray, np.ndarray], tuple[np.ndarray, bool]]
"""(W, gaps, forces) -> the change of the forces that meets the conditions, whether to rounding."""

Response = Callable[[Compliance, np.ndarray, np.ndarray], np.ndarray]
"""(W, gaps, forces) that meet the conditions -> A (n, n): they still do with forces less A g if the
gaps grow by g and no row changes its state."""

Product = Callable[[np.ndarray], np.ndarray]


def solve_by_secants(
    small: SmallProblem,
    product: Product,
    compliance: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    slack: float,
    response: Response | None = None,
    left: float = LEFT,
    *,
    springs: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Forces that meet the conditions of contact with the gaps they cause, from those given (n,).

    ``product`` maps d to S d.  The second array has the parts of all d that it was called with;
    these parts add up to the change of the forces.  Changes of the gaps below ``slack`` (length)
    need no further product; the first one is made unless it is rounding, so that none of several
    calls leaves the gaps as they were.  Where soft springs hold a part, rounding errors of its
    motion may be larger than that: when errors grow again, the nearest forces are returned.  With
    ``response`` there are few small problems: between them minimal residuals go on to a part
    ``left`` of the residual.  ``springs`` (n,) are compliances added to W where rows are dependent;
    they resist changes of the forces alone.  None without a solution, or for NaN or infinity.
    """
    compliance.restart()
    parts = np.zeros(0)
    near = NEAR * np.abs(gaps).max(initial=0.0)
    nearest = Nearest(np.inf, forces, parts)
    for number in range(RESTARTS * (len(gaps) + 3)):
        found = small_change(small, compliance, gaps, forces, near, springs)
        if found is None:
            return None
        change, exact, predicted, size = found
        if exact and size <= slack * (1 if number else FIRST):
            return np.where(forces + change == 0, 0.0, forces), parts
        answer = product(change)
        compliance.learn_anyway(change, answer)
        gaps = gaps + answer
        forces = forces + change
        parts = np.append(parts, 1.0)
        # the rounding error of the product stays in the gaps
        slack = max(slack, ROUNDING * float(np.abs(answer).max()))
        off = answer - predicted
        error = float(np.abs(off).max(initial=0.0))
        if exact and error <= slack:
            return forces, parts  # the conditions are met with the gaps predicted
        if exact and error < nearest.error:
            nearest = Nearest(error, forces, parts)
        if nearest.error < near and not error <= GROWN * nearest.error:
            return nearest.of_products(len(parts))
        if response is not None and exact:
            A = response(compliance.with_springs(springs), gaps - off, forces)
            more = in_same_state(A, product, compliance, gaps, slack, left, springs)
            gaps, forces, parts = more.added_to(gaps, forces, parts)
        if not np.isfinite(gaps).all():
            return None
    return None


def small_change(
    small: SmallProblem,
    compliance: Compliance,
    gaps: np.ndarray,
    forces: np.ndarray,
    near: float,
    springs: np.ndarray | None,
) -> tuple[np.ndarray, bool, np.ndarray, float] | None:
    """The change of the forces by the small problem, whether it is solved, and what gaps it opens.

    These are by W, shape (n,); the last number is the size of the largest.

    If it is not solved, and its best change moves gaps by less than ``near``, W would learn nothing
    from a product: the small problem is tried with the diagonal alone.  None if that fails as well.
    """
    for _ in range(2):
        W = compliance.with_springs(springs)
        change, exact = small(W, gaps, forces)
        predicted = W @ change
        size = float(np.abs(predicted).max(initial=0.0))
        if exact or size > near:
            return change, exact, predicted, size
        compliance.forget()
    return None


class Nearest(NamedTuple):
    """Forces that meet the conditions but for an error of the gaps."""

    error: float  # the largest one (length)
    forces: np.ndarray
    parts: np.ndarray  # of the products so far

    def of_products(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """The forces, and the parts of this number of products, the last of which are unused."""
        return self.forces, np.pad(self.parts, (0, count - len(self.parts)))


class Combination(NamedTuple):
    """A change of the forces: parts (k,) of forces (k, n) with the answers (k, n)."""

    parts: np.ndarray
    forces: np.ndarray
    answers: np.ndarray

    def added_to(
        self, gaps: np.ndarray, forces: np.ndarray, parts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gaps, forces and parts of products after this change."""
        return (
            gaps + self.parts @ self.answers,
            forces + self.parts @ self.forces,
            np.append(parts, self.parts),
        )


def in_same_state(
    A: np.ndarray,
    product: Product,
    W: Compliance,
    gaps: np.ndarray,
    slack: float,
    left: float,
    springs: np.ndarray | None = None,
) -> Combination:
    """The change d of the forces with A (gaps + S d) = 0, by minimal residuals; W learns S.

    With ``springs`` S + springs in place of S: where rows are dependent S d may be rounding alone.

    It ends where W times the residual, a length, is below ``slack`` or a part ``left`` of that at
    the beginning.
    """
    right = -A @ gaps
    rest = right
    enough = max(slack, left * np.abs(W @ rest).max(initial=0.0), SMALLEST)
    n = len(gaps)
    forces = np.empty((n, n))
    answers = np.empty((n, n))
    images = np.empty((n, n))  # A S times the forces, made orthonormal
    triangle = np.zeros((n, n))  # the images in these coordinates
    tried = 0
    independent = 0
    while tried < n and np.abs(W @ rest).max() > enough:
        d = rest / math.sqrt(rest @ rest)
        answer = product(d)
        forces[tried] = d
        answers[tried] = answer
        tried += 1
        image = A @ (answer if springs is None else answer + springs * d)
        before = images[:independent]
        for _ in range(2):  # one pass leaves rounding errors
            shares = before @ image
            triangle[:independent, independent] += shares
            image = image - shares @ before
        size = math.sqrt(image @ image)
        if not size > 0:
            break
        image /= size
        triangle[independent, independent] = size
        images[independent] = image
        independent += 1
        rest = rest - (image @ rest) * image
        W.learn_anyway(d, answer)
    chosen = slice(independent)
    parts = np.zeros(tried)
    parts[chosen] = np.linalg.solve(triangle[chosen, chosen], images[chosen] @ right)
    return Combination(parts, forces[:tried], answers[:tried])
