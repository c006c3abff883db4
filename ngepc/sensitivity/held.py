"""The linear system of derivatives: the tangent of the stress, and contact that keeps its sides.

    K u + C' y = force   at the free components,      R u - D y = shift   for the rows.

C = R without friction and with Tresca's; otherwise the transposed system is another one.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import LinearOperator, gmres

from ngepc.discretisation.stiffness import Stiffness
from ngepc.local.factors import SOLVER_ERRORS, TangentError
from ngepc.local.system import State
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.radial import RadialDerivative

PENALTY = 1e6
"""Stiffness of a row's spring over that of its vertex: each refinement gains so much."""

REFINEMENTS = 12
"""Most corrections of a solution."""

ACCURATE = 1e-13
"""Relative residual at which corrections end."""

ACCEPTED = 1e-9
"""Relative residual above which the solution is refused."""

INNER = 1e-11
"""Relative residual of the forces of the rows, found by GMRES."""

MOST, ROUNDS = 200, 5
"""Most iterations before a restart, and most restarts."""


class HeldSystem:
    """The system at a state, factorised once; K is the derivative of the radial return there.

    Rows that belong to one vertex enter the matrix as springs.  Where C = R and all rows do, each
    correction gains the factor ``PENALTY``; otherwise the forces of the rows are found by GMRES
    with one back-substitution per iteration.

    Parameters
    ----------
    state
        The solution.
    contact
        Contact with its sides; None for those of the solution.

    Raises
    ------
    TangentError
        If the tangent cannot be factorised.
    """

    def __init__(self, state: State, contact: LinearContact | None = None) -> None:
        discrete = state.discrete
        self.discrete, self.free = discrete, discrete.supports.free
        self.contact = LinearContact(state) if contact is None else contact
        self.moduli = RadialDerivative(state).moduli
        self.back_substitutions = 0
        stiffness = discrete.stiffness.another()
        stiffness.fill(self.moduli)
        rows = self.contact.rows
        self.stiff = rows.power(2) @ discrete.stiffness_diagonal.ravel()
        self.spring = self._add_springs(stiffness)
        try:
            self._inverse = stiffness.matrix.Inverse(inverse="sparsecholesky")
        except SOLVER_ERRORS as error:
            raise TangentError(f"the tangent could not be factorised: {error}") from error
        self._right, self._left = (stiffness.matrix.CreateColVector() for _ in range(2))
        self.by_springs = self.contact.symmetric and bool((self.spring > 0).all())

    def _add_springs(self, stiffness: Stiffness) -> np.ndarray:
        """Add c r r' to the block of a row's vertex; c, shape (k,), 0 where it has several."""
        rows, N = self.contact.rows, self.free.shape[1]
        node = rows.indices // N
        first, last = (f.reduceat(node, rows.indptr[:-1]) for f in (np.minimum, np.maximum))
        single = np.flatnonzero(first == last)
        entries, values = rows[single].tocoo(), np.zeros((len(single), N))
        values[entries.row, entries.col % N] = entries.data
        places = stiffness.diagonal_places(first[single])
        stiffest = PENALTY * np.trace(stiffness.entries[places], axis1=1, axis2=2)
        spring = np.zeros(rows.shape[0])
        spring[single] = 1 / (self.contact.soft[single] + 1 / stiffest)
        blocks = spring[single, None, None] * values[:, :, None] * values[:, None, :]
        np.add.at(stiffness.entries, places, blocks)
        spring[single] += self.contact.gripped[single]  # these springs are in the matrix already
        return spring

    def back(self, forces: np.ndarray) -> np.ndarray:
        """One back-substitution, flat."""
        self.back_substitutions += 1
        self._right.FV().NumPy()[:] = forces
        self._left.data = self._inverse * self._right
        return self._left.FV().NumPy().copy()

    def internal(self, u: np.ndarray) -> np.ndarray:
        """K u at all components, shape (nodes, N)."""
        volume, e = self.discrete.points.strain(u)
        forces = self.discrete.points.forces(self.moduli.bulk * volume, self.moduli(e))
        return forces + self.discrete.supports.pull(u)

    def solve(self, force: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (nodes, N), zero where held, and y, shape (k,).

        Raises
        ------
        TangentError
            If corrections do not converge: the tangent is singular, or rows are dependent.
        """
        side = _Side(self, self.contact.forces, self.contact.rows)
        return self._refined(side, force, shift)[:2]

    def solve_transposed(
        self, force: np.ndarray, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same for the transposed system, C and R exchanged, and K u at all components."""
        return self._refined(_Side(self, self.contact.rows, self.contact.forces), force, shift)

    def _refined(
        self, side: _Side, force: np.ndarray, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        force = np.where(self.free, force, 0.0)
        u, y, inner = np.zeros_like(force), np.zeros(len(shift)), np.zeros_like(force)
        missing, apart, relative = force, shift, np.inf
        scale = self._size(force, shift)
        for _ in range(REFINEMENTS if scale > 0 else 0):
            du, change = side.correction(missing.ravel(), apart)
            u, y = u + du.reshape(u.shape), y + change
            inner = self.internal(u)
            pushed = (side.forces.T @ y).reshape(u.shape)
            missing = np.where(self.free, force - inner - pushed, 0.0)
            apart = shift + self.contact.soft * y - side.rows @ u.ravel()
            before, relative = relative, self._size(missing, apart) / scale
            if relative <= ACCURATE or relative > 0.5 * before:
                break
        if scale > 0 and not relative <= ACCEPTED:
            raise TangentError(f"the derivative system is singular: residual {relative:.2g} left")
        return u, y, inner

    def _size(self, forces: np.ndarray, distances: np.ndarray) -> float:
        """Norm of forces and of distances of rows times their stiffness."""
        return float(np.linalg.norm(forces) + np.linalg.norm(self.stiff * distances))


class _Side:
    """One of the two systems: A u + C~' y = force + c R' shift, C~ = C - c D R, A with springs."""

    def __init__(self, system: HeldSystem, forces: csr_matrix, rows: csr_matrix) -> None:
        self.system, self.forces, self.rows = system, forces, rows

    def correction(self, force: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u and y up to rounding of large answers."""
        system, contact = self.system, self.system.contact
        spring, soft = system.spring, contact.soft
        if system.by_springs:
            u = system.back(force + self.rows.T @ (spring * shift))
            return u, spring * (self.rows @ u - shift)
        kept, transposed = diags(spring * soft) @ contact.rows, self.rows is not contact.rows
        left = self.forces if transposed else self.forces - kept
        right = self.rows - kept if transposed else self.rows
        if not transposed:
            force = force + contact.rows.T @ (spring * shift)
        u = system.back(force)
        y = self._forces(left.T.tocsr(), right, right @ u - shift)
        u = u - system.back(left.T @ y)
        return u, y + spring * (contact.rows @ u) if transposed else y

    def _forces(self, left: csr_matrix, right: csr_matrix, apart: np.ndarray) -> np.ndarray:
        """y with (right A^-1 left + D) y = apart."""
        system, soft = self.system, self.system.contact.soft
        scale = np.where(system.spring > 0, system.spring, 1 / (soft + 1 / system.stiff))

        def product(v: np.ndarray) -> np.ndarray:
            y = scale * v.ravel()
            return right @ system.back(left @ y) + soft * y

        count = len(apart)
        operator = LinearOperator((count, count), matvec=product, dtype=float)
        found, _ = gmres(operator, apart, rtol=INNER, restart=min(count, MOST), maxiter=ROUNDS)
        return scale * found
