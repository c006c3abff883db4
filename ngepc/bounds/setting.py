"""What the bounds of all states on one mesh have in common."""

from __future__ import annotations

import numpy as np

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import TO_PLANE, Conjugate
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.element import STRESS_MAP, midpoint_rows
from ngepc.bounds.equilibration import Patches, end_moments
from ngepc.bounds.triangles import Triangles
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State

START_MAP = midpoint_rows(STRESS_MAP)
"""Stresses at the midpoints from edge moments and body force, shape (27, 14)."""

FROM_PLANE = np.linalg.inv(TO_PLANE)

LEVEL = 1e-9
"""Square of the free part of a normal that moves nothing."""

CLEAR = 1e-12
"""Part of the largest displacement that counts as no penetration."""

NORMAL_PASSES = 50
"""Most passes over the facets that meet at a vertex until all of them are clear."""


class Setting:
    """Geometry, data and spaces of a discrete problem.

    Parameters
    ----------
    discrete
        The discrete problem.

    Raises
    ------
    ValueError
        For a problem that no bound covers.
    """

    def __init__(self, discrete: DiscreteProblem) -> None:
        check_covered(discrete.problem)
        self.discrete, self.problem = discrete, discrete.problem
        self.triangles = Triangles(self.problem.mesh)
        self.boundary = Boundary(self.problem, self.triangles)
        self.patches = Patches(self.boundary)
        self.space = AirySpace(self.boundary)
        self.conjugate = Conjugate(discrete.law)
        self.body_force = np.zeros((len(self.triangles.nodes), 2))
        if self.problem.f is not None:
            self.body_force = discrete.points.at(self.problem.f)
        self.row_of = self._rows_of_contact_ends()

    def _rows_of_contact_ends(self) -> np.ndarray:
        """The contact row of each end of the contact edges, -1 where a support holds it."""
        t, rows, edges = self.triangles, self.discrete.rows, self.boundary.contact
        of_vertex: dict[int, list[int]] = {}
        for row, vertex in enumerate(rows.vertices.tolist()):
            of_vertex.setdefault(vertex, []).append(row)
        found = np.full((len(edges), 2), -1)
        for i, edge in enumerate(edges.tolist()):
            for end in (0, 1):
                here = of_vertex.get(int(t.edges[edge, end]), [])
                if here:
                    found[i, end] = max(here, key=lambda r: rows.normals[r] @ t.normal[edge])
        return found

    def normal_displacement(self, u: np.ndarray) -> np.ndarray:
        """u . n at the ends of the contact edges, shape (contact edges, 2)."""
        t, on = self.triangles, self.boundary.contact
        return np.einsum("eac,ec->ea", u[t.edges[on]], t.normal[on])

    def feasible(self, u: np.ndarray) -> np.ndarray:
        """Nodal displacements near ``u`` that meet supports and clear the obstacle everywhere.

        Raises
        ------
        RuntimeError
            Where supports keep a vertex from clearing it.
        """
        t, on, free = self.triangles, self.boundary.contact, self.discrete.supports.free
        u = np.where(free, u, self.discrete.supports.values)
        rounding = CLEAR * np.abs(u).max(initial=0.0)
        for _ in range(NORMAL_PASSES):
            if (self.normal_displacement(u) - self.boundary.gap).max(initial=0.0) <= rounding:
                return u
            for end in (0, 1):
                excess = (self.normal_displacement(u) - self.boundary.gap)[:, end]
                vertices, n = t.edges[on][:, end], t.normal[on]
                n = np.where(free[vertices], n, 0.0)
                square = np.einsum("ec,ec->e", n, n)
                deep = (excess > 0) & (square > LEVEL)
                n[deep] *= (excess[deep] / square[deep])[:, None]
                u[vertices[deep]] -= n[deep]
        raise RuntimeError("the displacement could not be moved clear of the obstacle")

    def pressure(self, multipliers: np.ndarray) -> np.ndarray:
        """P >= 0 at the ends of the contact edges from forces of the rows (stress).

        Where a support holds an end it is that of the other end.
        """
        rows = self.discrete.rows
        values = np.append(np.maximum(multipliers, 0.0) / rows.weights, 0.0)
        P = values[self.row_of]
        return np.where(self.row_of < 0, P[:, ::-1], P)

    def loads(self, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Edge moments of the given tractions (ne, 2, 2), and nodal forces of P (nodes, 2)."""
        t, b, on = self.triangles, self.boundary, self.boundary.contact
        moments = np.zeros_like(b.traction)
        moments[t.outer] = end_moments(b.traction[t.outer], t.length[t.outer])
        of_pressure = end_moments(P, t.length[on])[:, :, None] * t.normal[on][:, None]
        moments[on] -= of_pressure
        forces, vertices = np.zeros((len(t.points), 2)), t.edges[on].ravel()
        for c in (0, 1):
            values = of_pressure[:, :, c].ravel()
            forces[:, c] = np.bincount(vertices, values, minlength=len(forces))
        return moments, forces

    def contact_gaps(self, u: np.ndarray, P: np.ndarray) -> np.ndarray:
        """The integral of P (psi - u . n) over each contact edge."""
        b = self.boundary
        room = end_moments(b.gap - self.normal_displacement(u), self.triangles.length[b.contact])
        return (P * (room + b.excess)).sum(axis=1)

    def strain(self, state: State) -> np.ndarray:
        """tr eps and the in-plane coordinates of dev eps, shape (nt, 3)."""
        e = state.deviator
        return np.stack([state.volume, e[:, 0], e[:, -1]], axis=1)

    def balanced(self, state: State, tangent: Factors, contact_forces: np.ndarray) -> np.ndarray:
        """In-plane stresses (nt, 3) in equilibrium with loads and contact forces (nodes, 2).

        What is missing in the nodal forces is made up for by the tangent.
        """
        law, points = self.discrete.law, self.discrete.points
        moduli = law.moduli(state.at, state.yielding)
        mean, deviator = law.bulk * state.volume, law.stress(state.at)
        for _ in range(2):
            missing = self.discrete.load - contact_forces - points.forces(mean, deviator)
            volume, e = points.strain(tangent.solve(missing))
            mean, deviator = mean + moduli.bulk * volume, deviator + moduli(e)
        return in_plane(mean, deviator)

    def admissible(self, stress: np.ndarray, moments: np.ndarray) -> np.ndarray:
        """The stress of Johnson and Mercier at the midpoints, shape (nt, 9, 3).

        Parameters
        ----------
        stress
            In equilibrium against hat functions, in-plane coordinates, shape (nt, 3).
        moments
            Of the given tractions, shape (ne, 2, 2).
        """
        t, f = self.triangles, self.body_force
        mu = self.patches.moments(tensors(stress), f, moments)
        around = t.per_triangle(mu).reshape(-1, 6, 2)
        data = np.concatenate([around, (f * t.det[:, None])[:, None]], axis=1)
        data = np.matmul(data, t.inverse.transpose(0, 2, 1)).reshape(-1, 14)
        return self.space.in_plane(data @ START_MAP.T)


def in_plane(mean: np.ndarray, deviator: np.ndarray) -> np.ndarray:
    """(a, b_0, b_1) of stresses with these mean parts and deviatoric coordinates, (nt, 3)."""
    first = mean if deviator.shape[1] == 2 else mean + deviator[:, 1] / np.sqrt(6.0)
    return np.stack([first, deviator[:, 0], deviator[:, -1]], axis=1)


def tensors(z: np.ndarray) -> np.ndarray:
    """The 2 x 2 matrices of in-plane coordinates (..., 3)."""
    v = z @ FROM_PLANE.T
    return np.stack([v[..., [0, 2]], v[..., [2, 1]]], axis=-2)
