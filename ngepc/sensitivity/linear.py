"""A solution linearised: the tangent of the stress, and contact that keeps its sides.

    K u + C' y = force   at the free components,      R u - D y = shift   for the rows.

C = R without friction and with Tresca's; otherwise the transposed system is another one.  With the
multipliers z, zeta of the transposed system K z + R' zeta = F_u, C z - D zeta = E' F_x, a
functional F changes with the data m by

    dF/dm = F_m - z . r_m + zeta . shift_m + (F_u - K z - R' zeta) . values_m,

for the prescribed values of the held components, and e . (F_x - R z) per change of a bound: one
solve for any number of parameters.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import LinearOperator, gmres

from ngepc.discretisation.stiffness import Stiffness
from ngepc.local.factors import SOLVER_ERRORS, TangentError
from ngepc.local.system import State
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.radial import SOLUTION, Data, RadialDerivative

PENALTY = 1e6
"""Stiffness of a row's spring over that of its vertex: each refinement gains so much."""

REFINEMENTS = 12
"""Most corrections of a solution."""

ACCURATE = 1e-13
"""Relative residual at which corrections end."""

ACCEPTED = 1e-9
"""Relative residual above which the solution is refused."""

INNER = 1e-8
"""Part of the residual that a correction by GMRES leaves."""

MOST, ROUNDS = 200, 5
"""Most iterations before a restart, and most restarts."""


class LinearStep:
    """The system at a state, factorised once; K is the derivative of the radial return there.

    Rows that belong to one vertex enter the matrix as springs c = 1 / (D + 1 / stiff), so that

        u = (K + R' c R)^-1 (force + R' c shift),    y = c (R u - shift)

    misses the solution by 1 / stiff only.  Where C = R and all rows are such, it is repeated with
    what is left; otherwise it is the preconditioner of GMRES.

    By default contact has the sides of the solution.  TangentError if there are no factors.
    """

    def __init__(self, state: State, contact: LinearContact | None = None) -> None:
        self.state, discrete = state, state.discrete
        self.discrete, self.free = discrete, discrete.supports.free
        self.contact = LinearContact(state) if contact is None else contact
        self.radial = RadialDerivative(state)
        stiffness = discrete.stiffness.another()
        stiffness.fill(self.radial.moduli)
        rows, soft = self.contact.rows, self.contact.soft
        self._stiff = rows.power(2) @ discrete.stiffness_diagonal.ravel()
        self._spring = self._add_springs(stiffness)
        held = self._spring > 0
        self._by_springs = self.contact.symmetric and bool(held.all())
        self._answer_of_rows = np.where(held, self._spring, 1 / (soft + 1 / self._stiff))
        try:
            self._inverse = stiffness.matrix.Inverse(inverse="sparsecholesky")
        except SOLVER_ERRORS as error:
            raise TangentError(f"the tangent could not be factorised: {error}") from error
        self._right, self._left = (stiffness.matrix.CreateColVector() for _ in range(2))

    def _add_springs(self, stiffness: Stiffness) -> np.ndarray:
        """Add c r r' to the block of a row's vertex; c, shape (k,), 0 where it has several."""
        rows, N = self.contact.rows, self.free.shape[1]
        node = rows.indices // N
        first, last = (f.reduceat(node, rows.indptr[:-1]) for f in (np.minimum, np.maximum))
        stiff = 1 / (self.contact.soft + 1 / (PENALTY * self._stiff))
        spring = np.where(first == last, stiff, 0.0)
        blocks = (rows.T @ diags(spring) @ rows).tobsr((N, N))
        stiffness.entries[stiffness.diagonal_places(blocks.indices)] += blocks.data
        return spring + self.contact.gripped  # these springs are in the matrix already

    def forward(self, data: Data) -> Data:
        """The changes of the solution with its data, and these."""
        discrete, contact = self.discrete, self.contact
        moved = np.zeros_like(self.state.u) + data["values"]
        known, pushed = self.radial.forward(moved, data), contact.pushed(data)
        force = data["load"] - discrete.points.forces(known["mean"], known["stress"])
        force = force - discrete.supports.pull(moved) - discrete.contact.forces(pushed)
        u, y = self.solve(force, contact.shift(data, moved))
        u = u + moved
        found = Data(u=u, contact=contact.given @ y + pushed)
        return data + found + self.radial.forward(u, data)

    def reverse(self, by: Data) -> Data:
        """The derivative of a functional by all data, from that by the solution and the data."""
        discrete, contact, points = self.discrete, self.contact, self.discrete.points
        force = np.zeros_like(self.state.u) + by["u"]
        if not by.keys().isdisjoint(("p", "stress", "mean")):
            direct = self.radial.reverse(by)
            force = force + points.forces(direct["volume"], direct["strain"])
        on_contact = np.zeros(len(discrete.contact)) + by["contact"]
        z, y = self.solve(force, contact.given.T @ on_contact, transposed=True)
        zeta, (volume, e) = contact.chosen @ y, points.strain(z)
        support = force - self.internal(z) - discrete.contact.forces(zeta)
        found = Data(load=z, values=np.where(self.free, 0.0, support))
        found += self.radial.reverse(by + Data(stress=-e, mean=-volume))
        found += contact.slopes(zeta, on_contact - discrete.contact.displacement(z))
        return found + by.without(*SOLUTION)

    def internal(self, u: np.ndarray) -> np.ndarray:
        """K u at all components, shape (nodes, N)."""
        volume, e = self.discrete.points.strain(u)
        moduli = self.radial.moduli
        forces = self.discrete.points.forces(moduli.bulk * volume, moduli(e))
        return forces + self.discrete.supports.pull(u)

    def solve(
        self, force: np.ndarray, shift: np.ndarray, *, transposed: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """u (nodes, N), zero where held, and y, shape (k,); ``transposed`` exchanges C and R.

        TangentError if corrections do not converge: the tangent is singular, or rows are dependent.
        """
        pair = self.contact.forces, self.contact.rows
        forces, rows = reversed(pair) if transposed else pair
        force = np.where(self.free, force, 0.0)
        u, y, left = np.zeros_like(force), np.zeros(len(shift)), (force, shift)
        scale, relative = self._size(*left), np.inf
        for _ in range(REFINEMENTS if scale > 0 else 0):
            du, dy = self._correction(forces, rows, *left)
            u, y = u + du, y + dy
            pushed, apart = self._product(forces, rows, u, y)
            left = force - pushed, shift - apart
            before, relative = relative, self._size(*left) / scale
            if relative <= ACCURATE or relative > 0.5 * before:
                break
        if scale > 0 and not relative <= ACCEPTED:
            raise TangentError(f"the derivative system is singular: residual {relative:.2g} left")
        return u, y

    def _product(
        self, forces: csr_matrix, rows: csr_matrix, u: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The left sides of the equations."""
        pushed = self.internal(u) + (forces.T @ y).reshape(u.shape)
        return np.where(self.free, pushed, 0.0), rows @ u.ravel() - self.contact.soft * y

    def _answer(self, force: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The solution up to what springs miss, by one back-substitution."""
        rows = self.contact.rows
        self._right.FV().NumPy()[:] = force.ravel() + rows.T @ (self._spring * shift)
        self._left.data = self._inverse * self._right
        u = self._left.FV().NumPy().copy()
        return u.reshape(force.shape), self._answer_of_rows * (rows @ u - shift)

    def _correction(
        self, forces: csr_matrix, rows: csr_matrix, force: np.ndarray, shift: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The solution for what is left, up to rounding of large answers."""
        if self._by_springs:
            return self._answer(force, shift)
        count, stiff = force.size, self._stiff

        def answer(r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """By springs, for forces and forces of rows in one vector."""
            return self._answer(r[:count].reshape(force.shape), r[count:] / stiff)

        def product(r: np.ndarray) -> np.ndarray:
            """What the answer makes of the left sides."""
            pushed, apart = self._product(forces, rows, *answer(r))
            return np.append(pushed, stiff * apart)

        right = np.append(force, stiff * shift)
        operator = LinearOperator((len(right), len(right)), matvec=product, dtype=float)
        found, _ = gmres(operator, right, rtol=INNER, restart=MOST, maxiter=ROUNDS)
        return answer(found)

    def _size(self, forces: np.ndarray, distances: np.ndarray) -> float:
        """Norm of forces and of distances of rows times their stiffness."""
        return float(np.linalg.norm(forces) + np.linalg.norm(self._stiff * distances))
