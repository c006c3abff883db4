"""What the bounds of all states on one mesh have in common, in two and three dimensions."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import R6, Conjugate
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.equilibration import moments_of
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.bounds.simplices import Simplices
from ngepc.bounds.triangles import Triangles
from ngepc.discretisation.conditions import initial_displacements
from ngepc.discretisation.points import Moduli
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


class Setting(ABC):
    """Geometry, data and spaces of a discrete problem in N dimensions.

    ``conjugate`` and ``at_nodes`` are phi* at the points and at the nodes of the parts of each
    cell. ValueError for a problem that no bound covers.
    """

    def __init__(self, discrete: DiscreteProblem) -> None:
        require_whole("guaranteed bounds", discrete.problem.mesh)
        check_covered(discrete.problem)
        self.discrete, self.problem = discrete, discrete.problem
        self.cells = (Triangles if self.problem.N == 2 else Simplices)(self.problem.mesh)
        self.boundary = Boundary(self.problem, self.cells)
        each = len(discrete.points) // len(self.cells.nodes)
        self.conjugate = self.at_nodes = Conjugate(discrete.law, each)
        self.carried = CarriedLoads(self.boundary)
        self.start = initial_displacements(self.problem, discrete.supports)
        self.row_of = self._rows_of_contact_ends()

    @abstractmethod
    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, again at points, and its P.

        It is sought near a state, by a tangent of a state near it (or without factors), from the
        contact pressure P (contact facets, N). The first are coordinates at the vertices of the
        N + 1 parts of each cell, (nt, (N + 1)^2, c), the second those whose product with
        ``strain`` has the integral as its mean.
        """

    def _rows_of_contact_ends(self) -> np.ndarray:
        """The contact row of each vertex of the contact facets, -1 where a support holds it.

        Of several rows it is the one whose normal is nearest to that of the facet.
        """
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

    def feasible(self, u: np.ndarray) -> np.ndarray:
        """Nodal displacements near ``u`` that meet supports and clear the obstacle everywhere.

        RuntimeError where supports keep a vertex from clearing it.
        """
        c, on, free = self.cells, self.boundary.contact, self.discrete.supports.free
        u = np.where(free, u, self.discrete.supports.values)
        rounding = CLEAR * np.abs(u).max(initial=0.0)
        for _ in range(NORMAL_PASSES):
            if (self.normal_displacement(u) - self.boundary.gap).max(initial=0.0) <= rounding:
                return u
            for end in range(c.N):
                excess = (self.normal_displacement(u) - self.boundary.gap)[:, end]
                vertices, n = c.facets[on][:, end], c.normal[on]
                n = np.where(free[vertices], n, 0.0)
                square = np.einsum("ec,ec->e", n, n)
                deep = (excess > 0) & (square > LEVEL)
                n[deep] *= (excess[deep] / square[deep])[:, None]
                u[vertices[deep]] -= n[deep]
        raise RuntimeError("the displacement could not be moved clear of the obstacle")

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
        """No less than int F |slip| over each contact facet: |slip| is convex there."""
        F = moments_of(self.boundary.friction, self.cells.measure[self.boundary.contact])
        return (F * np.linalg.norm(self.slip(state.u), axis=2)).sum(axis=1)

    def energy(self, state: State) -> float:
        """J(u) with this friction."""
        return state.energy - state.friction_work + float(self.friction_works(state).sum())

    def loads(self, state: State, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet moments of given tractions (nf, N, N), and nodal forces of contact (nodes, N)."""
        c, b, on = self.cells, self.boundary, self.boundary.contact
        moments = np.zeros_like(b.traction)
        moments[c.outer] = moments_of(b.traction[c.outer], c.measure[c.outer])
        of_contact = moments_of(self.pushed(state, P), c.measure[on])
        moments[on] -= of_contact
        return moments, c.at_nodes(of_contact, c.facets[on])

    def pushed(self, state: State, P: np.ndarray) -> np.ndarray:
        """The tractions of the body on the obstacle (stress), (contact facets, N, N)."""
        n = self.cells.normal[self.boundary.contact]
        return P[:, :, None] * n[:, None] + self.friction(state)

    def contact_gaps(self, state: State, P: np.ndarray) -> np.ndarray:
        """The integral of P (psi - u . n) + F |slip| - T . slip over each contact facet."""
        b, measure = self.boundary, self.cells.measure[self.boundary.contact]
        room = moments_of(b.gap - self.normal_displacement(state.u), measure)
        dragged = moments_of(self.friction(state), measure) * self.slip(state.u)
        gaps = (P * (room + b.excess)).sum(axis=1) - dragged.sum(axis=(1, 2))
        return gaps + self.friction_works(state)

    def gaps(self, state: State, z: np.ndarray) -> np.ndarray:
        """int [phi(eps) - sigma : eps] over each cell for stresses at points (nt, ., c)."""
        strain = self.strain(state)
        if strain.shape[1] == 1:
            z = z.mean(axis=1, keepdims=True)
        work = np.einsum("tqc,tqc->t", z, strain) / strain.shape[1]
        return self.phi(state) - self.cells.volume * work

    def phi(self, state: State) -> np.ndarray:
        """int phi(eps(u)) over each cell."""
        points = self.discrete.points
        density = points.weights * self.discrete.law.energy_density(state.volume, state.at)
        return density.reshape(len(self.cells.nodes), -1).sum(axis=1)

    def point_strain(self, state: State) -> np.ndarray:
        """The strain coordinates whose product with a stress is sigma : eps, shape (points, c)."""
        return stress_coordinates(self.problem.N, state.volume, state.deviator, 0.0)

    def strain(self, state: State) -> np.ndarray:
        """Those at points of each cell: one, where they are constant, shape (nt, 1, c)."""
        return self.point_strain(state)[:, None]

    def factorised(self, state: State, tangent: Factors) -> Moduli:
        """The moduli of a tangent, that at the state unless it has factors of another one."""
        if tangent.moduli is None:
            tangent.update(self.discrete.law.moduli(state.at, state.yielding))
        return tangent.moduli

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
            moduli, change = self.factorised(state, tangent), tangent.solve(missing)
            volume, e = points.strain(change)
            mean, deviator = mean + moduli.bulk * volume, deviator + moduli(e)
            forces = forces + tangent.multiply(change)
        return stress_coordinates(self.problem.N, mean, deviator)


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
