"""A solution linearised: the tangent of the stress, and contact that keeps its sides.

    K u + R' x = force   at the free components,      x - (G + F) x - k G R u = given   for rows.

With z and w from the transposed system for F_u and F_x, a functional F changes with the data m by

    dF/dm = F_m - z . r_m + w . given_m + (F_u - K z - R' zeta) . values_m,      zeta = - k G w,

for the prescribed values of the held components: one solve for any number of parameters.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, eye
from scipy.sparse.linalg import LinearOperator, gmres

from ngepc.discretisation.stiffness import Stiffness
from ngepc.linalg.direct import SOLVER_ERRORS, FactorisationError
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


class TangentError(FactorisationError):
    """A derivative that does not exist, or that no sides of biactive rows and points give."""


class LinearStep:
    """The system at a state, factorised once; K is the derivative of the radial return there.

    Rows that belong to one vertex enter the matrix as springs k L G, L = (Id - G + G / PENALTY)^-1:

        u = (K + R' k L G R)^-1 (force - R' L given),    x = L (given + k G R u)

    misses the solution by 1 / PENALTY only.  Where F = 0 and all rows are such, it is repeated with
    what is left; otherwise it is the preconditioner of GMRES.

    By default contact has the sides of the solution.  TangentError if there are no factors.
    """

    def __init__(self, state: State, contact: LinearContact | None = None) -> None:
        self.state, self.discrete, self.radial = state, state.discrete, RadialDerivative(state)
        self.contact = contact = LinearContact(state) if contact is None else contact
        self._free = state.discrete.free.ravel()
        stiffness = state.discrete.stiffness.another()
        stiffness.fill(self.radial.moduli)
        self._soften = self._with_springs(stiffness)
        square = eye(len(contact.kept), format="csr") - contact.kept_part - contact.follows
        blocks = contact.rows.T.tocsr(), contact.by_closed_at @ contact.rows, square
        lower, upper, turned = (block.T.tocsr() for block in blocks)
        self._blocks = {False: (*blocks, 1.0), True: (upper, lower, turned, contact.stiffness)}
        try:
            self._inverse = stiffness.matrix.Inverse(inverse="sparsecholesky")
        except SOLVER_ERRORS as error:
            raise TangentError(f"the tangent could not be factorised: {error}") from error
        self._right, self._left = (stiffness.matrix.CreateColVector() for _ in range(2))

    def _with_springs(self, stiffness: Stiffness) -> csr_matrix:
        """Add the springs of rows that belong to one vertex; L, shape (n, n)."""
        contact, (nodes, N) = self.contact, self.discrete.free.shape
        R, kept = contact.rows, contact.kept
        row = np.repeat(np.arange(R.shape[0]), np.diff(R.indptr))
        pairs = np.unique(row * nodes + R.indices // N)
        single = np.bincount(pairs // nodes, minlength=R.shape[0]) <= 1
        soften = 1 / (1 - kept + kept / np.where(single, PENALTY, 1.0))
        springs = diags(np.where(single, contact.stiffness * kept * soften, 0.0)) @ contact.along
        blocks = (R.T @ springs @ R).tobsr((N, N))
        stiffness.entries[stiffness.diagonal_places(blocks.indices)] += blocks.data
        self._by_springs = not contact.follows.count_nonzero() and bool(
            (single | (kept == 0)).all()
        )
        grip = contact.conditions.springs(contact.stiffness) / contact.stiffness
        identity = eye(R.shape[0], format="csr")
        return identity + diags(soften + grip - 1) @ contact.along  # grips are in the matrix

    def forward(self, data: Data) -> Data:
        """The changes of the solution with its data, and these."""
        discrete, points = self.discrete, self.discrete.points
        moved = np.zeros_like(self.state.u) + data["values"]
        known = self.radial.forward(moved, data)
        force = data["load"] - points.forces(known["mean"], known["stress"])
        force = force - discrete.supports.pull(moved)
        u, x = self.solve(force, self.contact.given(data, moved))
        return data + Data(u=u + moved, contact=x) + self.radial.forward(u + moved, data)

    def reverse(self, by: Data) -> Data:
        """The derivative of a functional by all data, from that by the solution and the data."""
        discrete, points = self.discrete, self.discrete.points
        force = np.zeros_like(self.state.u) + by["u"]
        if not by.keys().isdisjoint(("p", "stress", "mean")):
            direct = self.radial.reverse(by)
            force = force + points.forces(direct["volume"], direct["strain"])
        on_contact = np.zeros(len(discrete.contact)) + by["contact"]
        z, w = self.solve(force, on_contact, transposed=True)
        zeta, found = self.contact.slopes(w)
        support = force - self.internal(z) - discrete.contact.forces(zeta)
        found += Data(load=z, values=np.where(discrete.free, 0.0, support))
        volume, e = points.strain(z)
        found += self.radial.reverse(by + Data(stress=-e, mean=-volume))
        return found + by.without(*SOLUTION)

    def internal(self, u: np.ndarray) -> np.ndarray:
        """K u at all components, shape (nodes, N)."""
        volume, e = self.discrete.points.strain(u)
        moduli = self.radial.moduli
        forces = self.discrete.points.forces(moduli.bulk * volume, moduli(e))
        return forces + self.discrete.supports.pull(u)

    def solve(
        self, force: np.ndarray, given: np.ndarray, *, transposed: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """u (nodes, N), zero where held, and x, shape (n,), of the system or its transpose.

        TangentError if corrections do not converge: the tangent is singular, or rows are dependent.
        """
        *_, scale = self._blocks[transposed]
        right = np.append(np.where(self._free, force.ravel(), 0.0), scale * given)
        x, left, relative, size = np.zeros_like(right), right, np.inf, np.linalg.norm(right)
        for _ in range(REFINEMENTS if size > 0 else 0):
            x = x + self._correction(left, transposed)
            left = right - self._product(x, transposed)
            before, relative = relative, np.linalg.norm(left) / size
            if relative <= ACCURATE or relative > 0.5 * before:
                break
        if size > 0 and not relative <= ACCEPTED:
            raise TangentError(f"the derivative system is singular: residual {relative:.2g} left")
        return x[: force.size].reshape(force.shape), x[force.size :]

    def _product(self, x: np.ndarray, transposed: bool) -> np.ndarray:
        """The left sides of the system, that of the rows in units of force."""
        upper, lower, square, scale = self._blocks[transposed]
        u, forces = np.split(x, [len(self._free)])
        pushed = self.internal(u.reshape(self.state.u.shape)).ravel() + upper @ forces
        pushed = np.where(self._free, pushed, 0.0)
        return np.append(pushed, scale * (lower @ u + square @ forces))

    def _answer(self, right: np.ndarray, transposed: bool) -> np.ndarray:
        """The solution up to what springs miss, by one back-substitution."""
        upper, lower, _, scale = self._blocks[transposed]
        force, given = np.split(right, [len(self._free)])
        forces = self._soften @ (given / scale)
        self._right.FV().NumPy()[:] = force - upper @ forces
        self._left.data = self._inverse * self._right
        u = self._left.FV().NumPy().copy()
        return np.append(u, forces - self._soften @ (lower @ u))

    def _correction(self, right: np.ndarray, transposed: bool) -> np.ndarray:
        """The solution up to rounding of large answers."""
        if self._by_springs:
            return self._answer(right, transposed)

        def product(r: np.ndarray) -> np.ndarray:
            """What the answer makes of the left sides."""
            return self._product(self._answer(r, transposed), transposed)

        operator = LinearOperator((len(right), len(right)), product, dtype=float)
        found, _ = gmres(operator, right, rtol=INNER, restart=MOST, maxiter=ROUNDS)
        return self._answer(found, transposed)
