"""Projection onto the displacements that supports and closed or sticking contact rows allow.

A row of order two belongs to a node and to the ends of its edge.  It is solved for the displacement
of its own node: P u = u - E (R E)^-1 R u with the rows R and displacements E of their nodes, the
rows of vertices first, then those of edges, so that all systems are small and local.  Forces are
projected by the transpose of P.

Rows that slip with Coulomb's law push obliquely: their tangential force is a part of the normal
one.  Forces are then projected along what the rows push.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, vstack
from scipy.sparse.linalg import splu

from ngepc.discretisation.body import DiscreteBody
from ngepc.linalg.box import TINY
from ngepc.linalg.descent import Linear
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.friction import FrictionCone
from ngepc.linalg.row_blocks import matrix_of_rows

PARALLEL = 1e-8
"""Normals at a node with a smaller distance count as equal."""

STIFFEST = 100.0
"""Largest ratio of the tangential stiffness of slipping rows to c."""


class TangentialRows(NamedTuple):
    """Tangential behaviour of rows: stick, or slip with t = bound + slant n + k slip.

    Closed rows, and with Tresca's law the open ones as well.

    ``sticks`` marks the held tangents, (m, d) as are bound and slant; the stiffness k, sparse
    (m d, m d), turns forces towards the slip.
    """

    sticks: np.ndarray
    bound: np.ndarray
    slant: np.ndarray
    stiffness: csr_matrix

    @classmethod
    def none(cls, m: int) -> TangentialRows:
        """No tangents, for m rows without friction."""
        nothing = np.zeros((m, 0))
        return cls(nothing, nothing, nothing, csr_matrix((0, 0)))

    @classmethod
    def by(
        cls,
        cone: FrictionCone,
        active: np.ndarray,
        free: np.ndarray,
        y: np.ndarray,
        c: np.ndarray,
    ) -> TangentialRows:
        """The linearised law of closed rows at y = x - c g; c is (m,), free tangents (m, d)."""
        slips, direction, bound, trial_size = cone.slipping(y)
        with_friction = cone.with_friction(active)
        m = len(c)
        slope = cone.slope(y, active)

        # Rows that slip against a bound which does not grow with the pressure.
        capped = with_friction & slips & ~cone.grows(y[:m])
        dragged = np.where(capped, bound, 0.0)[:, None] * direction

        # Along a tangent dt = G (dt + c ds) with G = bound / trial_size: dt = c G / (1 - G) ds.
        beyond = np.maximum(trial_size - bound, np.maximum(bound / STIFFEST, TINY))
        stiffness = np.where(slips, c * trial_size / beyond, 0.0)
        turns = matrix_of_rows(stiffness[:, None, None] * slope)

        sticks = (with_friction & ~slips)[:, None] & free
        return cls(sticks, dragged, slope[:, 1:, 0], turns[m:, m:])


class Closed:
    """The displacements that keep supports and closed contact rows, and projections onto them.

    ``active`` marks the closed rows; ``tangential_rows`` is their behaviour along the tangents, or
    None without friction.  ``numbers`` are the held rows among all forces, the tangents last;
    ``slanted``: whether rows push obliquely, so that the tangent is not symmetric on them.
    FactorisationError if the closed rows are dependent.
    """

    def __init__(
        self,
        body: DiscreteBody,
        active: np.ndarray,
        tangential_rows: TangentialRows | None = None,
    ) -> None:
        self.free = body.free.ravel().astype(float)
        self._N = body.free.shape[1]
        contact = body.contact
        rows = contact.rows
        m = len(active)
        sticks, bound, slant, stiffness = tangential_rows or TangentialRows.none(m)
        self._processes = contact.processes
        self._bound = bound.ravel()
        self._stiffness = stiffness
        self._m = m
        tangential = rows.tangential[: sticks.size]
        self._tangential = tangential

        # The friction of a row that slips follows its normal force, one matrix row for each.
        columns = np.arange(slant.size)
        starts = np.arange(m + 1) * slant.shape[1]
        by_row = (slant.ravel(), columns, starts)
        self._slant = csr_matrix(by_row, shape=(m, slant.size))
        self.slanted = bool(slant.any())

        # The held rows: normal ones of closed rows, tangential ones of rows that stick.
        closed = np.flatnonzero(active)
        sticking = np.flatnonzero(sticks)
        self.numbers = np.append(closed, m + sticking)
        of_tangents = np.repeat(rows.nodes, sticks.shape[1])
        self._nodes = np.append(rows.nodes[closed], of_tangents[sticking])
        normal = rows.normal[closed]
        stuck = tangential[sticking]
        self.rows = vstack([normal, stuck]).multiply(self.free).tocsr()
        oblique = normal + self._slant[closed] @ tangential
        pushed = vstack([oblique, stuck]).multiply(self.free).tocsr()

        self._find_own(of_tangents)
        has_own_nodes = not body.problem.contact_pairs  # rows at the nodes of edges
        between = (self._nodes >= body.problem.mesh.nv) & has_own_nodes
        self._eliminate(pushed, between)

    def _eliminate(self, pushed: csr_matrix, between: np.ndarray) -> None:
        """Rows of vertices are eliminated first, then those of nodes ``between`` vertices."""
        at_vertices = np.flatnonzero(~between)
        self._at_vertices = EliminatedRows(self.rows, pushed, at_vertices)
        parts = (self.rows, pushed, np.flatnonzero(between))
        self._between = EliminatedRows(*parts, self._nodes, self._N)

    def _find_own(self, of_tangents: np.ndarray) -> None:
        """Which held rows and tangents, by their nodes, this process counts."""
        own = self._processes.owned(self._nodes)
        self._mine = np.zeros(len(self._nodes), dtype=bool)
        self._mine[own] = True
        self._my_tangents = np.zeros(len(of_tangents))
        self._my_tangents[self._processes.owned(of_tangents)] = 1.0

    def moved(self, amounts: np.ndarray) -> np.ndarray:
        """A displacement of nodes at the held rows that moves these by some amounts."""
        change = self._at_vertices.moved(amounts)
        return change + self._between.moved(amounts - self.rows @ change)

    def _gathered(self, forces: np.ndarray) -> np.ndarray:
        """Nodal forces to which all processes contribute, flat."""
        return self._processes.summed(forces.reshape(-1, self._N)).ravel()

    def stiffened(self, multiply: Linear) -> Linear:
        """A stiffness with that of the tangents that slip."""
        T = self._tangential
        if not self._processes.any(self._stiffness.data):
            return multiply

        def stiffer(x: np.ndarray) -> np.ndarray:
            """The stiffness times x, with that of the tangents."""
            return multiply(x) + self._dragging(self._stiffness @ (T @ x))

        return stiffer

    def slipping(self, gaps: np.ndarray) -> np.ndarray:
        """Nodal forces of the rows that slip, without their normal forces and further slip."""
        return self._dragging(self._dragged(gaps))

    def _dragging(self, along: np.ndarray) -> np.ndarray:
        """Nodal forces of forces along the tangents of all rows."""
        return self._gathered(self._tangential.T @ (self._my_tangents * along))

    def forces(self, imbalance: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        """The forces of all rows with these gaps: those held balance nodal forces."""
        x = np.zeros(len(gaps))
        m = self._m
        x[self.numbers] = self._balancing(imbalance)[0]
        x[m:] += x[:m] @ self._slant + self._dragged(gaps)
        return x

    def _dragged(self, gaps: np.ndarray) -> np.ndarray:
        return self._bound - self._stiffness @ gaps[self._m :]

    def project(self, u: np.ndarray) -> np.ndarray:
        """The displacement that supports and rows allow, with other values at their nodes alone."""
        u = self.free * u
        return u - self.moved(self.rows @ u)

    def unbalanced(self, forces: np.ndarray) -> np.ndarray:
        """Nodal forces projected onto the displacements that supports and held rows allow, flat.

        Its work is zero for all displacements by which ``project`` corrects others.
        """
        return self._balancing(forces)[1]

    def _balancing(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the held rows that balance nodal forces at their nodes, and the residual."""
        residual = self.free * forces
        between = self._between.pushing(residual)
        pushed = self._between.pushed @ (self._mine * between)
        residual = residual - self._gathered(pushed)
        at_vertices = self._at_vertices.pushing(residual)
        residual = residual - self._at_vertices.pushed @ at_vertices
        return between + at_vertices, residual

    def pins(self, N: int) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of closed rows, and projections onto the free directions there, (k, N, N).

        Rows over several nodes pin their own one.
        """
        rows = self.rows
        count = self.rows.shape[0]
        nodes, which = np.unique(self._nodes, return_inverse=True)
        columns = N * self._nodes[:, None] + np.arange(N)
        normals = np.asarray(rows[np.arange(count)[:, None], columns].todense())
        gram = np.zeros((len(nodes), N, N))
        np.add.at(gram, which, normals[:, :, None] * normals[:, None, :])
        sizes, vectors = np.linalg.eigh(gram)
        left = (sizes <= PARALLEL * sizes[:, -1:]).astype(float)
        return nodes, np.einsum("kan,kn,kbn->kab", vectors, left, vectors)


class EliminatedRows:
    """Some of the held rows, and displacements of their nodes in terms of which they are solved.

    With the rows R, what they push S and displacements E, the matrices R E and E' S are regular.
    E are the rows themselves, or their parts at a node of each of them, ``nodes``.
    """

    def __init__(
        self,
        rows: csr_matrix,
        pushed: csr_matrix,
        chosen: np.ndarray,
        nodes: np.ndarray | None = None,
        N: int = 1,
    ) -> None:
        count = rows.shape[0]
        self._chosen = chosen
        kept = csr_matrix(
            (np.ones(len(chosen)), (chosen, chosen)), shape=(count, count)
        )
        R = rows[chosen]
        own = R
        if nodes is not None:
            own = part_at(R, nodes[chosen], N)
        self._rows = R
        self._moves = own.T.tocsr()
        self._tests = own
        self.pushed = (kept @ pushed).T.tocsr()
        self._count = count
        self._solve_rows = solver(R @ self._moves)
        self._solve_forces = solver(own @ pushed[chosen].T)

    def moved(self, amounts: np.ndarray) -> np.ndarray:
        """A displacement along E that moves these rows by their part of the amounts."""
        return self._moves @ self._solve_rows(amounts[self._chosen])

    def pushing(self, forces: np.ndarray) -> np.ndarray:
        """Forces of all held rows, zero but for these, in balance with nodal forces along E."""
        result = np.zeros(self._count)
        result[self._chosen] = self._solve_forces(self._tests @ forces)
        return result


def part_at(rows: csr_matrix, nodes: np.ndarray, N: int) -> csr_matrix:
    """Rows on displacements flattened node by node, cut to one node for each."""
    entries = rows.tocoo()
    here = entries.col // N == nodes[entries.row]
    where = entries.row[here], entries.col[here]
    return csr_matrix((entries.data[here], where), shape=rows.shape)


def solver(matrix: csr_matrix) -> Linear:
    """The solution of small sparse systems; FactorisationError for a singular matrix."""
    if not matrix.shape[0]:
        return np.copy
    try:
        return splu(matrix.tocsc()).solve
    except RuntimeError as error:
        raise FactorisationError("contact rows of one node are dependent") from error
