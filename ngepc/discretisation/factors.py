"""The factors of the tangent by a direct solver of NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import Any

import numpy as np
from ngsolve import BaseMatrix, BaseVector
from scipy.sparse import diags

from ngepc.discretisation.body import DiscreteBody, Iterate
from ngepc.discretisation.contact_step import EXAMINED
from ngepc.discretisation.stiffness import Stiffness
from ngepc.linalg.cores import threads_of_ngsolve
from ngepc.linalg.direct import FROM_LOWER_TRIANGLE, SOLVER_ERRORS, FactorisationError
from ngepc.model.processes import require_whole

LOST = 1e-3
"""Relative residual of a solve after which numbers are eliminated one by one, not in blocks.

NGSolve inverts the N x N blocks on the diagonal as they are.  Where a nearly incompressible body
flows they are so badly conditioned that nothing may be left: Poisson's ratio 0.4999, h/mu = 2e-6,
residuals of 4 instead of 1e-5.  One by one takes three times as long and loses nothing.
"""


LARGE = 20_000
"""Free components from which on NGSolve's threads are used: starting them takes some 0.2 ms."""


class Factors:
    """A tangent whose factors are computed again for each state, on one sparsity pattern.

    ``name`` is NGSolve's name of a direct solver, ``stiffness`` assembles the tangents (by default
    that of the body), ``moduli`` are those of the present factors, and ``back_substitutions``
    counts the solves with them.
    """

    linear_iterations = 0
    examined = EXAMINED
    moduli: Any = None

    def __init__(
        self, body: DiscreteBody, name: str, stiffness: Stiffness | None = None
    ) -> None:
        problem = body.problem
        require_whole(f"inverse={name!r} and all that needs factors", problem.mesh)
        self._body = body
        self._free = body.free
        if stiffness is not None:
            self._stiffness = stiffness
        self._name = name
        self._inverse = None
        self.back_substitutions = 0
        self._in_blocks = name in FROM_LOWER_TRIANGLE
        in_facets = not problem.contact_pairs
        self.stiffened = self._stiffened if in_facets else None
        self._held: Factors | None = None  # with springs of the contact rows
        self._springs: np.ndarray | None = None  # their stiffness
        self._large = int(body.free.sum()) >= LARGE

    @cached_property
    def _stiffness(self) -> Stiffness:
        return self._body.stiffness

    @cached_property
    def _matrix(self) -> BaseMatrix:
        return self._stiffness.matrix()

    @cached_property
    def _right(self) -> BaseVector:
        return self._matrix.CreateColVector()

    @cached_property
    def _left(self) -> BaseVector:
        return self._matrix.CreateColVector()

    @cached_property
    def _given(self) -> np.ndarray:
        """View of the right side, (nodes, N)."""
        return self._right.FV().NumPy().reshape(self._free.shape)

    @cached_property
    def _found(self) -> np.ndarray:
        """View of the solution, (nodes, N)."""
        return self._left.FV().NumPy().reshape(self._free.shape)

    def linearise(self, here: Iterate) -> None:
        """Take the tangent at a state."""
        self.update(here.moduli)

    def update(self, moduli: Any) -> None:
        """Assemble and factorise; FactorisationError if the direct solver gives up."""
        self._stiffness.values(moduli, self._entries)
        self.moduli = moduli
        self._factorise()

    @property
    def _entries(self) -> np.ndarray:
        """View of the blocks of the tangent."""
        return self._stiffness.entries(self._matrix)

    def _stiffened(self, springs: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """``solve`` with springs of the contact rows, each of which belongs to one facet."""
        if self._held is None or not np.array_equal(springs, self._springs):
            R = self._body.contact.matrix
            stiffness = self._stiffness.with_added((R.T @ diags(springs) @ R).tocsr())
            if self._held is None:
                self._held = Factors(self._body, self._name, stiffness)
            self._held._stiffness = stiffness
            self._springs = springs
        held = self._held
        held._entries[:] = self._entries
        held._stiffness.completed(held._entries)
        held._factorise()
        return held.solve

    def _threads(self) -> AbstractContextManager:
        """NGSolve's threads, for large bodies if cores are free."""
        return threads_of_ngsolve() if self._large else nullcontext()

    def _factorise(self) -> None:
        self.back_substitutions = 0
        try:
            if not self._in_blocks:
                whole = self._stiffness.whole(self._matrix)
                self._inverse = whole.Inverse(inverse=self._name)
            elif self._inverse is None:
                self._inverse = self._matrix.Inverse(inverse=self._name)
            else:
                self._inverse.Update()
        except SOLVER_ERRORS as error:
            raise FactorisationError(
                f"{self._name} could not factorise the tangent: {error}"
            ) from error

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements, zero where held, that answer nodal forces; both (nodes, N).

        FactorisationError if they are not finite.
        """
        self.back_substitutions += 1
        self._given[:] = self._body.supports.kept(forces)
        with self._threads():
            self._inverse.Mult(self._right, self._left)
        if self.back_substitutions == 1 and self._in_blocks:
            rest = (self._right - self._matrix * self._left).Evaluate()
            if not rest.Norm() <= LOST * self._right.Norm():  # also if it is NaN
                self._in_blocks = False
                self._factorise()
                self._inverse.Mult(self._right, self._left)
                self.back_substitutions = 1
        u = self._body.supports.kept(self._found)
        if not np.isfinite(u).all():
            raise FactorisationError(f"{self._name} found a singular tangent")
        return u

    def multiply(self, u: np.ndarray) -> np.ndarray:
        """The tangent times displacements that vanish where held, both (nodes, N)."""
        self._given[:] = u
        self._left.data = self._matrix * self._right
        return self._found.copy()


def tangent_of(
    body: DiscreteBody, inverse: str | Any, stiffness: Stiffness | None = None
) -> Any:
    """The tangent for a solver of ``NewtonOptions``; ``stiffness`` as of ``Factors``."""
    if isinstance(inverse, str):
        return Factors(body, inverse, stiffness)
    return inverse.tangent(body, stiffness or body.stiffness)
