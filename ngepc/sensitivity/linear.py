"""The linearised problem at a solution: the tangent of the stress, and contact with fixed status.

    K u + R' x = force   at the free components,      x - G x - G k R u = given   for rows.

With z and w from the transposed system for F_u and F_x, a functional F changes with the data m by

    dF/dm = F_m - z . r_m + w . given_m,

one solve for any number of parameters.  Prescribed values of held components change r through
strains, springs and rows, and F through its dependence on u at these components.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, eye
from scipy.sparse.linalg import LinearOperator, gmres

from ngepc.discretisation.factors import Factors
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.row_blocks import matrix_of_rows
from ngepc.local.system import State
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.equations import Data, Tape
from ngepc.sensitivity.law_equations import equations_of_law

PENALTY = 1e6  # spring over the stiffness of the vertex; a correction gains this factor
REFINEMENTS = 12  # largest number of corrections of a solution
ACCURATE = 1e-13  # relative residual at which corrections end
ACCEPTED = 1e-9  # largest relative residual that is accepted
INNER = 1e-8
MOST = 200
ROUNDS = 5  # GMRES: residual, iterations before a restart, restarts


class TangentError(FactorisationError):
    """Raised if a derivative does not exist, or no consistent status of biactive rows is found."""


class LinearStep:
    """The system at a state, factorised once; K is the derivative of the stress there.

    Rows that belong to one vertex enter the matrix as springs k L G, L = (Id - G + G / PENALTY)^-1,
    where G lacks the part of friction that follows the normal force:

        u = (K + R' k L G R)^-1 (force - R' L given),    x = L (given + k G R u)

    has a relative error of 1 / PENALTY.  It is used for iterative refinement if all rows belong to
    one vertex and no friction follows the normal force, otherwise as preconditioner of GMRES.

    By default the rows have the status of the solution.  FactorisationError if K has no factors.
    """

    def __init__(self, state: State, contact: LinearContact | None = None) -> None:
        self.state = state
        self.discrete = state.discrete
        self.contact = contact = LinearContact(state) if contact is None else contact
        self.moduli = state.with_radial_return().moduli
        self.tape = Tape([*equations_of_law(state), *contact.given()])
        k = contact.stiffness
        # and all rows
        self._free = np.append(self.discrete.free.ravel(), np.ones(len(k)))
        springs, soften = self._springs()
        stiffness = self.discrete.stiffness.with_added(self.discrete.added + springs)
        self._factors = Factors(self.discrete, "sparsecholesky", stiffness)
        square = (eye(len(k), format="csr") - contact.slope).tocsr()
        upper = contact.rows.T.tocsr()
        lower = contact.pushed @ contact.rows
        per_k = diags(1 / k)
        turned = lower.T, diags(k) @ contact.rows, diags(k) @ square.T, soften @ per_k
        # the system (K, upper; lower, square), its transpose with rows in units of force, and L
        self._ways = (
            (upper, lower, square, soften),
            tuple(block.tocsr() for block in turned),
        )
        self._factors.update(self.moduli)

    def _springs(self) -> tuple[csr_matrix, csr_matrix]:
        """Springs of rows that belong to one vertex, u flattened node by node; L, shape (n, n)."""
        contact = self.contact
        nodes, N = self.discrete.free.shape
        R = contact.rows
        G = contact.blocks.copy()
        k = contact.stiffness
        follows = G[:, 1:, 0].any()
        G[:, 1:, 0] = 0.0
        row = np.repeat(np.arange(R.shape[0]), np.diff(R.indptr))
        pairs = np.unique(row * nodes + R.indices // N)
        normal, tangential = contact.law.split(
            np.bincount(pairs // nodes, minlength=len(k)) <= 1
        )
        single = normal & tangential.all(axis=1)
        penalty = np.where(single, PENALTY, 1.0)[:, None, None]
        soften = np.linalg.inv(np.eye(G.shape[1]) - G + G / penalty)
        single = np.append(single, np.repeat(single, contact.law.d))
        springs = R.T @ diags(np.where(single, k, 0.0)) @ matrix_of_rows(G @ soften) @ R
        reached = single | (np.diff(contact.slope.indptr) == 0)
        self._by_springs = not follows and reached.all()
        return springs, matrix_of_rows(soften) + diags(
            contact.conditions.springs(k) / k
        )

    def forward(self, data: Data) -> Data:
        """Changes of the solution, added to the changes ``data`` of the data."""
        known = self.tape.forward(self.with_supports(data))
        force = known["load"] - known["springs"]
        force = force - self.discrete.points.forces(known["mean"], known["stress"])
        u, x = self.solve(force, np.zeros(len(self.discrete.contact)) + known["given"])
        u = u + data["values"]
        return self.tape.forward(data + self._strain(u) + Data(u=u, contact=x))

    def with_supports(self, data: Data) -> Data:
        """``data`` with the strains and spring forces that the motion of the supports causes."""
        u = np.zeros_like(self.state.u) + data["values"]
        return (
            data + self._strain(u) + Data(u=u, springs=self.discrete.supports.pull(u))
        )

    def reverse(self, by: Data) -> Data:
        """The derivative of a functional by all data, from that by the solution and the data.

        If supports move, pair the result with data ``with_supports``.
        """
        discrete = self.discrete
        weights = self.discrete.points.weights
        direct = self.tape.backward(by)
        force = np.zeros_like(self.state.u) + direct["u"]
        if "strain" in direct or "volume" in direct:
            strain = np.zeros_like(self.state.deviator) + direct["strain"]
            density = (np.zeros(len(weights)) + direct["volume"]) / weights
            force = force + discrete.points.forces(density, strain / weights[:, None])
        z, w = self.solve(
            force, np.zeros(len(discrete.contact)) + by["contact"], transposed=True
        )
        strained = -weights * self._strain(z)
        stress = Data(mean=strained["volume"], stress=strained["strain"], given=w)
        return self.tape.backward(by + stress + Data(load=z, springs=-z))

    def _strain(self, u: np.ndarray) -> Data:
        volume, strain = self.discrete.points.strain(u)
        return Data(volume=volume, strain=strain)

    def internal(self, u: np.ndarray) -> np.ndarray:
        """K u at all components, shape (nodes, N)."""
        points = self.discrete.points
        forces = points.forces(*self.moduli.stress(*points.strain(u)))
        return forces + self.discrete.supports.pull(u)

    def solve(
        self, force: np.ndarray, given: np.ndarray, *, transposed: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """u (nodes, N), zero where held, and x, shape (n,), of the system or its transpose.

        TangentError if corrections do not converge: the tangent is singular, or rows are dependent.
        """
        blocks = self._ways[transposed]
        scale = self.contact.stiffness if transposed else 1.0
        free = self._free
        right = self._free * np.append(force.ravel(), scale * given)
        x = np.zeros_like(right)
        left = right
        relative = 1.0
        size = np.linalg.norm(right)
        operator = LinearOperator(
            (len(right),) * 2,
            lambda r: free * self._product(blocks, self._answer(blocks, r)),
            dtype=float,
        )
        sure = False
        for _ in range(REFINEMENTS if size > 0 else 0):
            if not self._by_springs:
                left, _ = gmres(
                    operator, left, rtol=INNER, restart=MOST, maxiter=ROUNDS
                )
            x = x + self._answer(blocks, left)
            if sure:
                break
            left = right - free * self._product(blocks, x)
            before = relative
            relative = np.linalg.norm(left) / size
            if relative <= ACCURATE or relative > 0.5 * before:
                break
            # the next correction reduces the residual by at least the same factor
            sure = relative**2 / before <= ACCURATE
        if size > 0 and not (sure or relative <= ACCEPTED):
            raise TangentError(
                f"the derivative system is singular: residual {relative:.2g} left"
            )
        return x[: force.size].reshape(force.shape), x[force.size :]

    def _product(self, blocks: tuple[csr_matrix, ...], x: np.ndarray) -> np.ndarray:
        u, forces = np.split(x, [self.state.u.size])
        upper, lower, square, _ = blocks
        pushed = self.internal(u.reshape(self.state.u.shape)).ravel() + upper @ forces
        return np.append(pushed, lower @ u + square @ forces)

    def _answer(self, blocks: tuple[csr_matrix, ...], right: np.ndarray) -> np.ndarray:
        """An approximate solution by one back-substitution with springs for the rows."""
        force, given = np.split(right, [self.state.u.size])
        upper, lower, _, soften = blocks
        forces = soften @ given
        pushed = (force - upper @ forces).reshape(self.state.u.shape)
        try:
            u = self._factors.solve(pushed).ravel()
        except FactorisationError as error:
            raise TangentError(f"the derivative does not exist: {error}") from error
        return np.append(u, forces - soften @ (lower @ u))
