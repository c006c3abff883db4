"""What the bounds of all states on one mesh have in common, in N dimensions and of either order.

Displacements of order two are affine on each cell in their strains, which three points fix, and
have an unknown on each edge: NGSolve's function of an edge is BUBBLE times the product of the hat
functions of its ends.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import R6, Conjugate
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.equilibration import Patches, moments_of
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.bounds.parts import AT_POINTS, TO_NODES, exceeding
from ngepc.bounds.simplices import Simplices
from ngepc.discretisation.conditions import initial_displacements
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.processes import require_whole

LEVEL = 1e-9
"""Square of the free part of a normal that moves nothing."""

CLEAR = 1e-12
"""Part of the largest displacement that counts as no penetration."""

BALANCED = 1e-12
"""Part of the largest nodal force that may be missing after PASSES corrections at most."""

PASSES = 2

NORMAL_PASSES = 50
"""Most passes over the facets that meet at a vertex until all of them are clear."""

BUBBLE = -0.5

AT_CORNERS = 2 * np.eye(3)[[1, 2, 0]] - 1 / 3
"""Values of affine functions at the vertices from those at the three points."""

STUCK = "the displacement could not be moved clear of the obstacle"


class Setting(ABC):
    """Geometry, data and spaces of a discrete problem.

    ``conjugate`` and ``at_nodes`` are phi* at the points and at the nodes of the parts of each
    cell, ``weights`` those of the points at which stresses are integrated, ``row_of`` the contact
    row of each vertex of the contact facets, -1 where a support holds it.  ValueError for a problem
    that no bound covers.
    """

    weights = np.ones(1)

    def __init__(self, discrete: DiscreteProblem) -> None:
        require_whole("guaranteed bounds", discrete.problem.mesh)
        check_covered(discrete.problem)
        self.discrete, self.problem = discrete, discrete.problem
        c = self.cells = Simplices(self.problem.mesh)
        self.boundary = Boundary(self.problem, c)
        self.each = len(discrete.points) // len(c.nodes)
        self.conjugate = self.at_nodes = Conjugate(discrete.law, self.each)
        self.carried, self.patches = CarriedLoads(self.boundary), Patches(self.boundary)
        self.start = initial_displacements(self.problem, discrete.supports)
        self.row_of = self._rows_of_contact_ends()
        if self.problem.order == 2:
            self._take_edges()

    def _take_edges(self) -> None:
        """The unknowns of the contact edges, and histories that are affine on triangles."""
        c, nodes = self.cells, self.discrete.points.blocks[0].nodes
        self._turned = nodes[:, 1] != c.nodes[:, 1]
        bubble = np.empty(len(c.facets), dtype=int)
        for k, ends in enumerate(((2, 0), (1, 2), (0, 1))):
            bubble[c.facets_between(nodes[:, ends])] = nodes[:, 3 + k]
        self._bubble = bubble[self.boundary.contact]
        history = self.discrete.law.back, self.discrete.law.initial
        if any(np.ptp(v.reshape(len(c.nodes), 3, -1), axis=1).any() for v in history):
            corners = [self.at_corners(values) for values in history]
            self.conjugate, self.at_nodes = (
                self.conjugate.with_history(*(np.matmul(shares, values) for values in corners))
                for shares in (AT_POINTS, TO_NODES)
            )

    def at_corners(self, values: np.ndarray) -> np.ndarray:
        """What is given at the points (., c) at the vertices of the triangles, (nt, 3, c)."""
        values = values.reshape(len(self.cells.nodes), self.each, -1)
        if self.each == 1:
            return np.repeat(values, 3, axis=1)
        result = np.matmul(AT_CORNERS, values)
        result[self._turned, 1:] = result[self._turned, :0:-1]
        return result

    def on_parts(self, values: np.ndarray) -> np.ndarray:
        """The same at points of the parts (nt, 18, c), or constants once for each cell."""
        return values[:, None] if self.each == 1 else np.matmul(AT_POINTS, self.at_corners(values))

    @abstractmethod
    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, again at points, and its P.

        It is sought near a state, by a tangent of a state near it (or without factors), from the
        contact pressure P (contact facets, N). The first are coordinates at the vertices of the
        N + 1 parts of each cell, (nt, (N + 1)^2, c), the second those at the points of ``strain``.
        """

    def _rows_of_contact_ends(self) -> np.ndarray:
        """``row_of``; of several rows the one whose normal is nearest to that of the facet."""
        c, rows, on = self.cells, self.discrete.rows, self.boundary.contact
        order = np.argsort(rows.vertices, kind="stable")
        vertices, normals = c.facets[on], c.normal[on][:, None]
        first, last = (
            np.searchsorted(rows.vertices[order], vertices, s) for s in ("left", "right")
        )
        found, best = np.full(vertices.shape, -1), np.full(vertices.shape, -2.0)
        for k in range(int((last - first).max(initial=0))):
            row = order[np.minimum(first + k, len(order) - 1)]
            cosine = (rows.normals[row] * normals).sum(axis=2)
            better = (first + k < last) & (cosine > best)
            found, best = np.where(better, row, found), np.where(better, cosine, best)
        return found

    def normal_displacement(self, u: np.ndarray) -> np.ndarray:
        """u . n at the vertices of the contact facets, shape (contact facets, N)."""
        c, on = self.cells, self.boundary.contact
        return np.einsum("eac,ec->ea", u[c.facets[on]], c.normal[on])

    def bent(self, u: np.ndarray) -> np.ndarray:
        """The unknowns of the contact edges, zero for order one, (contact facets, N)."""
        return (
            u[self._bubble]
            if self.problem.order == 2
            else 0 * self.cells.normal[self.boundary.contact]
        )

    def feasible(self, u: np.ndarray) -> np.ndarray:
        """Nodal displacements near ``u`` that meet supports and clear the obstacle everywhere.

        A parabola below zero at its ends does not rise above between them.  RuntimeError where
        supports keep a vertex or an edge from clearing it.
        """
        c, on, free = self.cells, self.boundary.contact, self.discrete.supports.free
        u = np.where(free, u, self.discrete.supports.values)
        rounding = CLEAR * np.abs(u).max(initial=0.0)
        for _ in range(NORMAL_PASSES):
            if (self.normal_displacement(u) - self.boundary.gap).max(initial=0.0) <= rounding:
                break
            for end in range(c.N):
                excess = (self.normal_displacement(u) - self.boundary.gap)[:, end]
                self._lower(u, c.facets[on][:, end], excess)
        else:
            raise RuntimeError(STUCK)
        if self.problem.order == 2:
            room = np.sqrt(np.maximum(self.boundary.gap - self.normal_displacement(u), 0.0))
            rise = BUBBLE * np.einsum("ec,ec->e", self.bent(u), c.normal[on])
            if self._lower(u, self._bubble, rise - room.sum(axis=1) ** 2, BUBBLE):
                raise RuntimeError(STUCK)
        return u

    def _lower(
        self, u: np.ndarray, nodes: np.ndarray, excess: np.ndarray, value: float = 1.0
    ) -> bool:
        """Lower u . n by a positive excess of each contact facet; whether supports forbid it.

        The unknowns of the nodes (contact facets,) count ``value`` times.
        """
        n = np.where(
            self.discrete.supports.free[nodes], self.cells.normal[self.boundary.contact], 0.0
        )
        square = np.einsum("ec,ec->e", n, n)
        deep, stuck = (excess > 0) & (square > LEVEL), (excess > 0) & (square <= LEVEL)
        u[nodes[deep]] -= n[deep] * (excess[deep] / square[deep] / value)[:, None]
        return stuck.any()

    def pressure(self, multipliers: np.ndarray) -> np.ndarray:
        """P >= 0 at the vertices of the contact facets from forces of the rows (stress).

        Where a support holds a vertex it is the mean of the others.
        """
        rows = self.discrete.rows
        values = np.append(np.maximum(multipliers, 0.0) / rows.weights, 0.0)
        P, there = values[self.row_of], self.row_of >= 0
        mean = P.sum(axis=1) / np.maximum(there.sum(axis=1), 1)
        return np.where(there, P, mean[:, None])

    def across(self, vectors: np.ndarray) -> np.ndarray:
        """The tangential parts of vectors on the contact facets, both (contact facets, N, N)."""
        n = self.cells.normal[self.boundary.contact]
        return vectors - np.einsum("eac,ec->ea", vectors, n)[:, :, None] * n[:, None]

    def check_touching(self, state: State) -> None:
        """Refuse friction where the gap is open: no minimum problem is left."""
        touches = np.append(state.multipliers > 0, True)[self.row_of]
        if (self.boundary.friction[~touches] > 0).any():
            raise ValueError(
                f"friction={self.problem.friction!r}: it acts where the gap is closed, and the gap "
                "opens; bounds need F = 0 there"
            )

    def friction(self, state: State) -> np.ndarray:
        """Tangential tractions |T| <= F on the obstacle (stress), (contact facets, N, N)."""
        rows, bound = self.discrete.rows, self.boundary.friction
        forces = np.einsum("md,mdc->mc", state.tangential_forces, rows.tangents)
        stress = np.append(forces / rows.weights[:, None], np.zeros((1, self.problem.N)), axis=0)
        T = self.across(stress[self.row_of])
        size = np.linalg.norm(T, axis=2)
        return (np.minimum(size, bound) / np.where(size > 0, size, 1.0))[:, :, None] * T

    def slip(self, u: np.ndarray) -> np.ndarray:
        """What the vertices of the contact facets have slipped (length), (contact facets, N, N)."""
        return self.across((u - self.start)[self.cells.facets[self.boundary.contact]])

    def friction_works(self, state: State) -> np.ndarray:
        """No less than int F |slip| over each contact facet: |slip| is convex there.

        Of parabolas the sizes of Bernstein's coefficients are taken.
        """
        F, measure, ends = (
            self.boundary.friction,
            self.cells.measure[self.boundary.contact],
            self.slip(state.u),
        )
        if self.problem.order == 1:
            return (moments_of(F, measure) * np.linalg.norm(ends, axis=2)).sum(axis=1)
        middle = (
            ends.mean(axis=1)
            + BUBBLE / 2 * self.across(self.bent(state.u - self.start)[:, None])[:, 0]
        )
        total = F.sum(axis=1, keepdims=True)
        works = ((F / 6 + total / 12) * np.linalg.norm(ends, axis=2)).sum(axis=1)
        return measure * (works + total[:, 0] / 6 * np.linalg.norm(middle, axis=1))

    def energy(self, state: State) -> float:
        """No less than J(u), with this friction."""
        friction = float(self.friction_works(state).sum())
        return state.energy - state.friction_work + friction + float(self._missed(state).sum())

    def loads(self, state: State, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet moments of given tractions (nf, N, N), and nodal forces of contact (nodes, N)."""
        c, b, on = self.cells, self.boundary, self.boundary.contact
        moments = np.zeros_like(b.traction)
        moments[c.outer] = moments_of(b.traction[c.outer], c.measure[c.outer])
        pushed = P[:, :, None] * c.normal[on][:, None] + self.friction(state)
        of_contact, forces = moments_of(pushed, c.measure[on]), np.zeros_like(state.u)
        moments[on] -= of_contact
        forces[: len(c.points)] = c.at_nodes(of_contact, c.facets[on])
        if self.problem.order == 2:
            forces[self._bubble] = self._bent_moment(pushed)
        return moments, forces

    def _bent_moment(self, traction: np.ndarray) -> np.ndarray:
        """The integral of tractions (n, N, N) times the functions of the contact edges, (n, N)."""
        measure = self.cells.measure[self.boundary.contact]
        return BUBBLE / 12 * measure[:, None] * traction.sum(axis=1)

    def contact_gaps(self, state: State, P: np.ndarray) -> np.ndarray:
        """The integral of P (psi - u . n) + F |slip| - T . slip over each contact facet."""
        b, on = self.boundary, self.boundary.contact
        measure, n, T = self.cells.measure[on], self.cells.normal[on], self.friction(state)
        room = moments_of(b.gap - self.normal_displacement(state.u), measure)
        dragged = (moments_of(T, measure) * self.slip(state.u)).sum(axis=(1, 2))
        gaps = (P * (room + b.excess)).sum(axis=1) - dragged + self.friction_works(state)
        pushed, slid = P[:, :, None] * n[:, None], self.bent(state.u - self.start)
        gaps -= (self._bent_moment(pushed) * self.bent(state.u)).sum(axis=1)
        return gaps - (self._bent_moment(T) * slid).sum(axis=1)

    def gaps(self, state: State, z: np.ndarray) -> np.ndarray:
        """int [phi(eps) - sigma : eps] over each cell for stresses at the points of ``strain``."""
        work = np.einsum("tqc,tqc->tq", z, self.strain(state)) @ self.weights
        return self.phi(state) - self.cells.volume * work

    def phi(self, state: State) -> np.ndarray:
        """No less than int phi(eps(u)) over each cell."""
        points = self.discrete.points
        density = points.weights * self.discrete.law.energy_density(state.volume, state.at)
        return density.reshape(-1, self.each).sum(axis=1) + self._missed(state)

    def _missed(self, state: State) -> np.ndarray:
        """By how much the sum over the points may be below the integral, for each cell."""
        law, area = self.conjugate, self.cells.volume
        if self.each == 1:
            return np.zeros(len(area))
        over = np.maximum(state.at.size - self.discrete.law.beta, 0.0).reshape(-1, 3)
        summed = area * np.einsum("tq,tq->t", over, over) / 3
        least = exceeding(self.at_corners(state.at.trial), law.beta, area)
        return (summed - least) / (2 * (law.two_mu + law.hardening))

    def point_strain(self, state: State) -> np.ndarray:
        """The strain coordinates whose product with a stress is sigma : eps, shape (points, c)."""
        return stress_coordinates(self.problem.N, state.volume, state.deviator, 0.0)

    def strain(self, state: State) -> np.ndarray:
        """Those at points of the parts, or once for each cell where they are constant."""
        return self.on_parts(self.point_strain(state))

    def carried_forces(self) -> np.ndarray:
        """Nodal forces of the loads that the stress carries, shape (nodes, N)."""
        if self.problem.order == 2:
            return self.discrete.load
        c, outer = self.cells, self.cells.outer
        given = moments_of(self.boundary.traction[outer], c.measure[outer])
        return c.at_nodes(self.carried.nodal, c.nodes) + c.at_nodes(given, c.facets[outer])

    def balanced(self, state: State, tangent: Factors, load: np.ndarray) -> np.ndarray:
        """Stresses (points, c) in equilibrium with nodal forces (nodes, N).

        What is missing in the nodal forces is made up for by a tangent.
        """
        law, points = self.discrete.law, self.discrete.points
        mean, deviator = law.bulk * state.volume, law.stress(state.at)
        forces = state.internal_forces
        for _ in range(PASSES):
            missing = np.where(self.discrete.free, load - forces, 0)
            if np.abs(missing).max() <= BALANCED * np.abs(forces).max():
                break
            factorise(state, tangent)
            change = tangent.solve(missing)
            volume, e = points.strain(change)
            mean, deviator = mean + tangent.moduli.bulk * volume, deviator + tangent.moduli(e)
            forces = forces + tangent.multiply(change)
        return stress_coordinates(self.problem.N, mean, deviator)


def factorise(state: State, tangent: Factors) -> None:
    """Take the tangent at the state unless there are factors of another one."""
    if tangent.moduli is None:
        tangent.update(state.moduli)


def stress_coordinates(
    N: int, mean: np.ndarray, deviator: np.ndarray, plane: float = 1.0
) -> np.ndarray:
    """Coordinates (nt, c) of ``Conjugate`` from the mean part and deviatoric coordinates.

    In plane strain the in-plane trace takes ``plane`` times what sigma_zz differs from the mean.
    """
    if N == 3 or deviator.shape[1] == 2:
        return np.concatenate([mean[:, None], deviator], axis=1)
    first = mean + plane * deviator[:, 1] / R6
    return np.stack([first, deviator[:, 0], deviator[:, 2]], axis=1)
