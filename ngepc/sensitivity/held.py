"""The linear system of derivatives: the tangent of the stress, with the closed contact rows held.

K u + N' lambda = force   at the free components,      N u = shift   for the closed rows.
"""

from __future__ import annotations

import numpy as np

from ngepc.discretisation.stiffness import Stiffness
from ngepc.local.factors import SOLVER_ERRORS, TangentError
from ngepc.local.system import State

PENALTY = 1e6
"""Stiffness of a held row over that of its vertex: each refinement gains so much."""

REFINEMENTS = 12
"""Most corrections of a solution."""

ACCURATE = 1e-13
"""Relative residual at which corrections end."""

ACCEPTED = 1e-9
"""Relative residual above which the solution is refused."""


class HeldSystem:
    """The system at a state, factorised once; K is the derivative of the radial return there.

    Rows of displacements of order one belong to one vertex and enter the matrix as springs, with
    corrections that converge to lambda in a few back-substitutions.  Rows of order two couple the
    nodes of neighbouring facets: they cost one back-substitution each.

    Parameters
    ----------
    state
        The solution, with ``on_sphere`` dual variables.
    held
        Numbers of the closed contact rows.

    Raises
    ------
    TangentError
        If the tangent cannot be factorised, or closed rows are dependent.
    """

    def __init__(self, state: State, held: np.ndarray) -> None:
        discrete = state.discrete
        self.discrete, self.held = discrete, held
        self.moduli = discrete.law.moduli(state.at, state.yielding)
        free = discrete.supports.free
        self.rows = discrete.rows.normal[held].multiply(free.ravel()[None, :]).tocsr()
        self.back_substitutions = 0
        stiffness = discrete.stiffness.another()
        stiffness.fill(self.moduli)
        springs = discrete.problem.order == 1
        self._spring = self._add_springs(stiffness) if springs else np.zeros(len(held))
        try:
            self._inverse = stiffness.matrix.Inverse(inverse="sparsecholesky")
        except SOLVER_ERRORS as error:
            raise TangentError(f"the tangent could not be factorised: {error}") from error
        self._right, self._left = (stiffness.matrix.CreateColVector() for _ in range(2))
        self._columns = np.zeros((0, free.size)) if springs else self._answers()

    def _add_springs(self, stiffness: Stiffness) -> np.ndarray:
        """Add c n n' to the block of each held row's vertex; c, shape (held,)."""
        rows, free = self.discrete.rows, self.discrete.supports.free
        vertices = rows.vertices[self.held]
        normals = np.where(free[vertices], rows.normals[self.held], 0.0)
        places = stiffness.diagonal_places(vertices)
        spring = PENALTY * np.trace(stiffness.entries[places], axis1=1, axis2=2)
        blocks = spring[:, None, None] * normals[:, :, None] * normals[:, None, :]
        np.add.at(stiffness.entries, places, blocks)
        return spring

    def _answers(self) -> np.ndarray:
        """K^-1 N' of the held rows, shape (held, nodes N)."""
        dense = self.rows.toarray()
        return np.array([self._back(row) for row in dense]).reshape(dense.shape)

    def _back(self, forces: np.ndarray) -> np.ndarray:
        self.back_substitutions += 1
        self._right.FV().NumPy()[:] = forces.ravel()
        self._left.data = self._inverse * self._right
        return self._left.FV().NumPy().copy()

    def _correction(self, force: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not len(self._columns):
            u = self._back(force + self.rows.T @ (self._spring * shift))
            return u, self._spring * (self.rows @ u - shift)
        u = self._back(force)
        multipliers = np.linalg.solve(self.rows @ self._columns.T, self.rows @ u - shift)
        return u - multipliers @ self._columns, multipliers

    def internal(self, u: np.ndarray) -> np.ndarray:
        """K u at all components, shape (nodes, N)."""
        volume, e = self.discrete.points.strain(u)
        forces = self.discrete.points.forces(self.moduli.bulk * volume, self.moduli(e))
        return forces + self.discrete.supports.pull(u)

    def solve(self, force: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (nodes, N), zero where held, and the forces of all rows (m,), zero where open.

        Raises
        ------
        TangentError
            If corrections do not converge: the tangent is singular, or rows are dependent.
        """
        free, shift = self.discrete.supports.free, shift[self.held]
        force = np.where(free, force, 0.0)
        u, multipliers = np.zeros_like(force), np.zeros(len(self.held))
        missing, apart, relative = force, shift, np.inf
        scale = self._size(force, shift)
        if scale == 0:
            return u, np.zeros(len(self.discrete.rows))
        for _ in range(REFINEMENTS):
            du, change = self._correction(missing.ravel(), apart)
            u, multipliers = u + du.reshape(u.shape), multipliers + change
            inner = self.internal(u) + (self.rows.T @ multipliers).reshape(u.shape)
            missing, apart = np.where(free, force - inner, 0.0), shift - self.rows @ u.ravel()
            before, relative = relative, self._size(missing, apart) / scale
            if relative <= ACCURATE or relative > 0.5 * before:
                break
        if not relative <= ACCEPTED:
            raise TangentError(f"the derivative system is singular: residual {relative:.2g} left")
        result = np.zeros(len(self.discrete.rows))
        result[self.held] = multipliers
        return u, result

    def _size(self, forces: np.ndarray, distances: np.ndarray) -> float:
        """Norm of forces and of distances of held rows times their stiffness."""
        stiffness = self.rows.power(2) @ self.discrete.stiffness_diagonal.ravel()
        return float(np.linalg.norm(forces) + np.linalg.norm(stiffness * distances))
