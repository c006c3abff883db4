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

    Rows that belong to one vertex enter the matrix as springs k L G, L = (Id - G + G / PENALTY)^-1:

        u = (K + R' k L G R)^-1 (force - R' L given),    x = L (given + k G R u)

    misses the solution by 1 / PENALTY only.  Where F = 0 and all rows are such, it is repeated with
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
        self.soften = self._with_springs(stiffness)
        try:
            self._inverse = stiffness.matrix.Inverse(inverse="sparsecholesky")
        except SOLVER_ERRORS as error:
            raise TangentError(f"the tangent could not be factorised: {error}") from error
        self._right, self._left = (stiffness.matrix.CreateColVector() for _ in range(2))

    def _with_springs(self, stiffness: Stiffness) -> csr_matrix:
        """Add the springs of rows that belong to one vertex; L, shape (n, n)."""
        contact, (nodes, N) = self.contact, self.free.shape
        R, kept = contact.rows, contact.kept
        row = np.repeat(np.arange(R.shape[0]), np.diff(R.indptr))
        pairs = np.unique(row * nodes + R.indices // N)
        single = np.bincount(pairs // nodes, minlength=R.shape[0]) <= 1
        penalty = np.where(single, PENALTY, 1.0)
        soften = 1 / (1 - kept + kept / penalty)
        springs = diags(np.where(single, contact.stiffness * kept * soften, 0.0)) @ contact.along
        blocks = (R.T @ springs @ R).tobsr((N, N))
        stiffness.entries[stiffness.diagonal_places(blocks.indices)] += blocks.data
        self.by_springs = not contact.follows.nnz and bool((single | (kept == 0)).all())
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
        found += Data(load=z, values=np.where(self.free, 0.0, support))
        volume, e = points.strain(z)
        found += self.radial.reverse(by + Data(stress=-e, mean=-volume))
        return found + by.without(*SOLUTION)

    def back_substituted(self, force: np.ndarray) -> np.ndarray:
        """(K + springs)^-1 force, both (nodes N,)."""
        self._right.FV().NumPy()[:] = force
        self._left.data = self._inverse * self._right
        return self._left.FV().NumPy().copy()

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
        system = Equations(self, transposed)
        right = np.append(np.where(self.free, force, 0.0), system.scale * given)
        x, left, relative = np.zeros_like(right), right, np.inf
        scale = np.linalg.norm(right)
        for _ in range(REFINEMENTS if scale > 0 else 0):
            x = x + system.correction(left)
            left = right - system.product(x)
            before, relative = relative, np.linalg.norm(left) / scale
            if relative <= ACCURATE or relative > 0.5 * before:
                break
        if scale > 0 and not relative <= ACCEPTED:
            raise TangentError(f"the derivative system is singular: residual {relative:.2g} left")
        return x[: force.size].reshape(force.shape), x[force.size :]


class Equations:
    """The system of a linearised step or its transpose, the rows' part in units of force."""

    def __init__(self, step: LinearStep, transposed: bool) -> None:
        contact, self._step, self._count = step.contact, step, step.free.size
        kept, identity = diags(contact.kept) @ contact.along, eye(len(contact.kept), format="csr")
        self._upper, self._lower = contact.rows.T.tocsr(), contact.by_closed_at @ contact.rows
        self._square, self.scale = identity - kept - contact.follows, np.ones(len(contact.kept))
        if transposed:
            self._upper, self._lower = self._lower.T.tocsr(), contact.rows
            self._square, self.scale = self._square.T.tocsr(), contact.stiffness

    def product(self, x: np.ndarray) -> np.ndarray:
        """The left sides."""
        u, forces = x[: self._count], x[self._count :]
        pushed = self._step.internal(u.reshape(self._step.free.shape)).ravel()
        pushed = np.where(self._step.free.ravel(), pushed + self._upper @ forces, 0.0)
        return np.append(pushed, self.scale * (self._lower @ u + self._square @ forces))

    def answer(self, right: np.ndarray) -> np.ndarray:
        """The solution up to what springs miss, by one back-substitution."""
        soften = self._step.soften
        forces = soften @ (right[self._count :] / self.scale)
        u = self._step.back_substituted(right[: self._count] - self._upper @ forces)
        return np.append(u, forces - soften @ (self._lower @ u))

    def correction(self, right: np.ndarray) -> np.ndarray:
        """The solution up to rounding of large answers."""
        if self._step.by_springs:
            return self.answer(right)
        shape = (len(right), len(right))
        operator = LinearOperator(shape, lambda r: self.product(self.answer(r)), dtype=float)
        found, _ = gmres(operator, right, rtol=INNER, restart=MOST, maxiter=ROUNDS)
        return self.answer(found)
