"""Contact facets in error bounds: clearing of the obstacle, works of pressure and friction."""

from __future__ import annotations

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.coverage import BUBBLE
from ngepc.bounds.row_stresses import RowStresses, across
from ngepc.bounds.simplices import EDGES, Simplices
from ngepc.discretisation.conditions import initial_displacements
from ngepc.local.system import DiscreteProblem, State

LEVEL = 1e-9  # a normal whose free part has a smaller square counts as held
CLEAR = 1e-12  # tolerance of penetration, relative to the largest displacement
CLEARED = 0.5
"""Middle coefficient of cleared parabolas over the one with which they touch inside an edge.

Goals need a large lambda where a gap closes at a point between the nodes.
"""
NORMAL_PASSES = 50
"""Most passes over the facets that meet at a vertex until all of them are clear."""

EDGES_OF_NGSOLVE = {
    2: ((2, 0), (1, 2), (0, 1)),
    3: ((3, 0), (3, 1), (3, 2), (0, 1), (0, 2), (1, 2)),
}
"""The ends of the edges of a triangle and of a tetrahedron, in NGSolve's order."""


def nodes_of_facets(
    discrete: DiscreteProblem, cells: Simplices, vertices: np.ndarray
) -> np.ndarray:
    """The vertices (facets, N) of facets, followed by the nodes of their edges for order two."""
    if discrete.problem.order == 1:
        return vertices
    nodes = discrete.points.blocks[0].nodes
    count = len(cells.points)
    there = np.zeros(count, dtype=bool)
    there[vertices] = True
    nodes = nodes[there[nodes[:, : cells.N + 1]].sum(axis=1) > 1]
    ends = np.array(EDGES_OF_NGSOLVE[cells.N])
    keys = np.sort(nodes[:, ends], axis=2) @ [count, 1]
    known, first = np.unique(keys, return_index=True)
    of_facets = np.sort(vertices[:, np.array(EDGES[cells.N])], axis=2)
    found = np.searchsorted(known, of_facets @ [count, 1])
    edges = nodes[:, cells.N + 1 :].ravel()[first[found]]
    return np.column_stack([vertices, edges])


class ContactFacets:
    """The contact facets of a discrete problem.

    ``nodes`` (facets, .) are the vertices of the facets, followed by the edges for order two.
    ``normal``, ``measure`` and ``owner`` belong to the facets, ``from_rows`` are their stresses by
    forces of the contact rows.

    The last facets are ``paired`` with facets of another body: ``opposite`` (pairs, .) are the
    nodes that ``nodes`` face, and ``slots`` (pairs, N) the places of those vertices among the
    moments of all facets.
    """

    def __init__(self, discrete: DiscreteProblem, boundary: Boundary) -> None:
        self.discrete = discrete
        self.boundary = boundary
        self.problem = discrete.problem
        c = boundary.cells
        on = boundary.contact
        self.N = boundary.cells.N
        self.normal = c.normal[on]
        self.measure = c.measure[on]
        self.owner = c.owners[on, 0]
        self.nodes = nodes_of_facets(discrete, c, c.facets[on])
        self.opposite = nodes_of_facets(discrete, c, boundary.opposite)
        self.paired = slice(len(on) - len(self.opposite), None)
        facing = c.facets_between(boundary.opposite)
        order = boundary.opposite[:, :, None] > boundary.opposite[:, None]
        self.slots = self.N * facing[:, None] + order.sum(axis=2)
        self._hats = (1 + np.eye(self.N)) / (self.N * (self.N + 1))
        if self.problem.order == 2:
            bubbles = {2: np.full((2, 1), 1 / 12), 3: 1 / 30 - np.eye(3) / 60}[self.N]
            self._hats = np.column_stack([self._hats, BUBBLE * bubbles])
        self._start = initial_displacements(self.problem, discrete.supports)
        self.from_rows = RowStresses(
            discrete, self.nodes, self.normal, self.measure, self._hats
        )

    def moments(self, values: np.ndarray) -> np.ndarray:
        """Moments of affine functions, given at vertices (facets, N, .), at ``nodes``."""
        return self.measure[:, None, None] * np.matmul(self._hats.T, values)

    def along(self, u: np.ndarray) -> np.ndarray:
        """u . n at ``nodes``, in pairs less that of the other body, (facets, nodes)."""
        jump = u[self.nodes]
        jump[self.paired] -= u[self.opposite]
        return np.einsum("eac,ec->ea", jump, self.normal)

    def slack(self, u: np.ndarray) -> np.ndarray:
        """The slack psi - u . n at ``nodes``, shape (facets, nodes)."""
        slack = -self.along(u)
        gap = self.boundary.gap
        slack[:, : gap.shape[1]] += gap
        return slack

    def affine_slack(self, u: np.ndarray) -> np.ndarray:
        """The affine functions nearest to psi - u . n on the facets, at vertices, (facets, N)."""
        N = self.N
        moments = self.slack(u) @ self._hats.T
        moments += self.boundary.excess / self.measure[:, None]
        return N * (N + 1) * (moments - moments.sum(axis=1, keepdims=True) / (N + 1))

    def edge_coefficients(self, values: np.ndarray) -> np.ndarray:
        """Bernstein coefficients of the edges, (facets, edges, ...), from values at ``nodes``.

        The values, numbers or vectors, are those of displacements of order two.
        """
        ends = np.array(EDGES[self.N])
        return values[:, ends].mean(axis=2) + BUBBLE / 2 * values[:, self.N :]

    def least_coefficients(self, slack: np.ndarray, edge: int) -> np.ndarray:
        """The least Bernstein coefficients of an edge with which nothing penetrates, (facets,).

        A parabola with end values a, b >= 0 is nonnegative if its middle coefficient is at least
        -(a b)^(1/2); a quadratic function on a triangle, if all coefficients are >= 0.
        """
        if self.N == 3:
            return np.zeros(len(slack))
        ends = np.array(EDGES[2][edge])
        return -np.sqrt(np.maximum(slack[:, ends].prod(axis=1), 0.0))

    def lift(self, slack: np.ndarray) -> float:
        """Raise a slack at ``nodes`` until it is nonnegative; the largest change (length)."""
        N = self.N
        most = -float(slack[:, :N].min(initial=0.0))
        slack[:, :N] = np.maximum(slack[:, :N], 0.0)
        for k in range(slack.shape[1] - N):
            missing = self.least_coefficients(slack, k)
            missing = np.maximum(missing - self.edge_coefficients(slack)[:, k], 0.0)
            slack[:, N + k] += 2 * missing / BUBBLE
            most = max(most, float(missing.max(initial=0.0)))
        return most

    def cleared(self, u: np.ndarray) -> np.ndarray:
        """Nodal displacements near ``u`` that satisfy supports and do not penetrate the obstacle.

        RuntimeError where supports prevent that at a vertex or an edge.
        """
        u = self.discrete.supports.admissible(u)
        rounding = CLEAR * np.abs(u).max(initial=0.0)
        for _ in range(NORMAL_PASSES):
            stuck = self.slack(u)[:, : self.N].min(initial=0.0) < -rounding
            if not stuck:
                break
            for end in range(self.N):
                self.shift(u, end, np.minimum(self.slack(u)[:, end], 0.0), 1.0)
        if self.problem.order == 2 and not stuck:
            stuck = self._edges_cleared(u)
        if stuck:
            raise RuntimeError(
                "the displacement could not be moved clear of the obstacle"
            )
        return u

    def _edges_cleared(self, u: np.ndarray) -> bool:
        """Lower u at the edges where it penetrates the obstacle; True if supports prevent that."""
        rounding = CLEAR * np.abs(u).max(initial=0.0)
        for _ in range(NORMAL_PASSES):
            most = 0.0
            for k in range(len(EDGES[self.N])):
                slack = self.slack(u)
                lowest = self.least_coefficients(slack, k)
                middle = self.edge_coefficients(slack)[:, k]
                deep = middle < lowest - rounding / 2
                excess = np.where(deep, 2 * (CLEARED * lowest - middle), 0.0)
                if self.shift(u, self.N + k, -excess, BUBBLE):
                    return True
                most = max(most, excess.max(initial=0.0))
            if most <= rounding:
                return False
        return True

    def shift(
        self, u: np.ndarray, column: int, amount: np.ndarray, value: float
    ) -> bool:
        """Increase u . n by an amount (facets,); True if supports prevent that somewhere.

        A unit change of the unknowns of a column of ``nodes`` changes u . n by ``value``.  At a
        node of several facets the largest amount is taken, so that the gap of each facet is kept.
        Of two bodies both move, if supports allow that.
        """
        supports = self.discrete.supports
        nodes = self.nodes[:, column]
        n = supports.kept_at(nodes, self.normal)
        square = np.einsum("ec,ec->e", n, n)
        other = np.zeros_like(n)
        facing = self.opposite[:, column]
        other[self.paired] = supports.kept_at(facing, self.normal[self.paired])
        square += np.einsum("ec,ec->e", other, other)
        changed = np.flatnonzero((amount != 0) & (square > LEVEL))
        forbidden = np.count_nonzero(amount) > len(changed)
        changed = changed[np.argsort(np.abs(amount[changed]), kind="stable")]
        length = (amount[changed] / square[changed] / value)[:, None]
        moved = u[nodes[changed]] + length * n[changed]
        u[nodes[changed]] = moved  # the last of equal nodes is kept
        first = len(self.nodes) - len(facing)
        length = length[changed >= first]
        changed = changed[changed >= first]
        moved = u[facing[changed - first]] - length * other[changed]
        u[facing[changed - first]] = moved
        return forbidden

    def friction(self, state: State) -> np.ndarray:
        """Tangential tractions |T| <= F on the obstacle (stress), (facets, N, N)."""
        rows = self.discrete.rows
        bound = self.boundary.friction
        forces = np.einsum("md,mdc->mc", state.tangential_forces, rows.tangents)
        return self.from_rows.drag(forces, bound)

    def slip(self, u: np.ndarray) -> np.ndarray:
        """The slip of the nodes (length), (facets, nodes, N)."""
        return self.tangential(u - self._start)

    def tangential(self, u: np.ndarray) -> np.ndarray:
        """The tangential displacements at ``nodes``, (facets, nodes, N)."""
        return across(self.normal, u[self.nodes])

    def works(self, tractions: np.ndarray, u: np.ndarray) -> np.ndarray:
        """int t . u over each facet for t at vertices (facets, N, N), u at ``nodes``."""
        return (self.moments(tractions) * u).sum(axis=(1, 2))

    def friction_works(self, u: np.ndarray) -> np.ndarray:
        """No less than int F |slip| over each facet, for nodal displacements."""
        if not self.boundary.friction.any():
            return np.zeros(len(self.owner))
        return self.friction_works_of(self.slip(u))

    def friction_works_of(self, slip: np.ndarray) -> np.ndarray:
        """The same for slips at ``nodes``: their size is convex on a facet.

        For parabolas the norms of the Bernstein coefficients are used.
        """
        F = self.boundary.friction
        size = np.linalg.norm(slip[:, : self.N], axis=2)
        if self.problem.order == 1:
            return (self.moments(F[:, :, None])[:, :, 0] * size).sum(axis=1)
        middle = np.linalg.norm(self.edge_coefficients(slip), axis=2)
        total = F.sum(axis=1)
        sizes = size.sum(axis=1)
        if self.N == 2:
            between = total * (sizes / 12 + middle[:, 0] / 6)
            own = (F * size).sum(axis=1) / 6
            return self.measure * (own + between)

        # means of hat functions times Bernstein's: 1/10 and 1/30, 1/15 and 1/30
        between = total * (sizes + 2 * middle.sum(axis=1)) / 30
        own = (F * (2 * size - middle)).sum(axis=1) / 30
        return self.measure * (own + between)

    def pushed(self, state: State, P: np.ndarray) -> np.ndarray:
        """Forces of the body on the obstacle at ``nodes``, shape (facets, nodes, N)."""
        return self.moments(P[:, :, None] * self.normal[:, None] + self.friction(state))

    def subtract(
        self, pushed: np.ndarray, moments: np.ndarray, forces: np.ndarray
    ) -> None:
        """Subtract ``pushed`` from facet moments (nf, N, N) and nodal forces (nodes, N).

        The other bodies of pairs are pushed the other way.
        """
        N = self.N
        np.subtract.at(moments, self.boundary.contact, pushed[:, :N])
        np.subtract.at(forces, self.nodes, pushed)
        back = pushed[self.paired]
        np.add.at(moments.reshape(-1, N), self.slots, back[:, :N])
        np.add.at(forces, self.opposite, back)

    def opening(self, u: np.ndarray, P: np.ndarray) -> np.ndarray:
        """The integral of P (psi - u . n) over each facet for vertex values P (facets, N)."""
        pressed = self.moments(P[:, :, None])[:, :, 0] * self.slack(u)
        return pressed.sum(axis=1) + (P * self.boundary.excess).sum(axis=1)

    def gaps(self, state: State, P: np.ndarray, T: np.ndarray) -> np.ndarray:
        """The integral of P (psi - u . n) + F |slip| - T . slip over each facet.

        ``T`` (facets, N, N) are tangential tractions at vertices.
        """
        dragged = self.works(T, self.slip(state.u))
        return self.opening(state.u, P) - dragged + self.friction_works(state.u)
