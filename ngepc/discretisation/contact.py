"""Contact node by node: n_i . u_i <= psi_i at the nodes of the closed contact boundary."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import H1, FESpace, InnerProduct, LinearForm, VectorH1, ds

from ngepc.model.problem import Problem
from ngepc.model.support import at_corners

_SAME_FACE = 0.7
"""Cosine above which normals of two boundaries that meet at a node belong to one smooth face."""
_HELD = 1e-8
"""A normal with a smaller free part is held by the support: no contact can happen there."""


@dataclass(frozen=True, eq=False)
class NodalContact:
    """The rows n_i . u_i <= psi_i of the discrete contact condition.

    A node on a kink between two contact boundaries has two rows; a node on one smooth boundary,
    curved or flat, has one with the normal averaged by the lumped boundary mass.

    Parameters
    ----------
    vertices
        Vertex number of each row, shape (m,).
    normals
        Unit outer normals, shape (m, N).
    free_normals
        The normals without the components that are prescribed, shape (m, N).
    gaps
        psi_i (length), shape (m,).
    masses
        Lumped boundary mass of each row (length for N = 2, area for N = 3), shape (m,).
    """

    vertices: np.ndarray
    normals: np.ndarray
    free_normals: np.ndarray
    gaps: np.ndarray
    masses: np.ndarray

    def __len__(self) -> int:
        return len(self.vertices)

    def normal_displacement(self, u: np.ndarray) -> np.ndarray:
        """n_i . u_i for nodal displacements ``u`` of shape (N, vertices)."""
        return np.einsum("mi,im->m", self.normals, u[:, self.vertices])

    def free_displacement(self, d: np.ndarray) -> np.ndarray:
        """n_i . d_i for a change ``d``, shape (N, vertices), that leaves the supports alone."""
        return np.einsum("mi,im->m", self.free_normals, d[:, self.vertices])

    def open_gap(self, u: np.ndarray) -> np.ndarray:
        """psi_i - n_i . u_i, negative where the obstacle is penetrated."""
        return self.gaps - self.normal_displacement(u)

    def violation(self, u: np.ndarray) -> float:
        """Deepest penetration, 0 for a feasible displacement."""
        return float(np.maximum(-self.open_gap(u), 0.0).max(initial=0.0))

    def snapped(self, u: np.ndarray, active: np.ndarray) -> np.ndarray:
        """``u`` with the ``active`` nodes exactly on the obstacle and none beyond it.

        Removes the rounding errors of a step; a node with two rows takes them in turn.
        """
        u = u.copy()
        squared = (self.free_normals**2).sum(1)
        for rows in self._independent_rows:
            gap = self.open_gap(u)
            move = np.where(active, gap, np.minimum(gap, 0.0))[rows]
            u[:, self.vertices[rows]] += (self.free_normals.T * (1 / squared))[:, rows] * move
        return u

    def unit_force(self, row: int, vertices: int) -> np.ndarray:
        """The normal of one row at its node, zero elsewhere, shape (N, ``vertices``)."""
        force = np.zeros((self.normals.shape[1], vertices))
        force[:, self.vertices[row]] = self.normals[row]
        return force

    def nodal_forces(self, multipliers: np.ndarray, vertices: int) -> np.ndarray:
        """Sum of multiplier times normal at the nodes, shape (N, ``vertices``)."""
        forces = np.zeros((self.normals.shape[1], vertices))
        np.add.at(forces.T, self.vertices, multipliers[:, None] * self.normals)
        return forces

    def multipliers(self, residual: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Nodal contact forces >= 0 that balance ``residual`` best at the ``touching`` rows."""
        r = residual[:, self.vertices].T
        squared = (self.free_normals**2).sum(1)
        forces = np.where(touching, -(self.free_normals * r).sum(1) / squared, 0.0)
        for rows in self._corner_rows:
            chosen = [row for row in rows if touching[row]]
            if len(chosen) > 1:
                A = self.free_normals[chosen].T
                forces[chosen] = np.linalg.lstsq(A, -r[chosen[0]], rcond=None)[0]
        return np.maximum(forces, 0.0)

    @cached_property
    def _corner_rows(self) -> list[list[int]]:
        order = np.argsort(self.vertices, kind="stable")
        split = np.flatnonzero(np.diff(self.vertices[order])) + 1
        return [rows.tolist() for rows in np.split(order, split) if len(rows) > 1]

    @cached_property
    def _independent_rows(self) -> list[np.ndarray]:
        """Groups of rows with at most one row of each vertex."""
        repeated = np.zeros(len(self), dtype=int)
        for rows in self._corner_rows:
            repeated[rows] = np.arange(len(rows))
        return [np.flatnonzero(repeated == k) for k in range(repeated.max(initial=0) + 1)]


def nodal_contact(problem: Problem, V: FESpace) -> NodalContact:
    """The discrete contact condition of ``problem`` for the displacement space ``V``."""
    N, nv = problem.N, problem.mesh.nv
    rows: dict[int, list[list]] = {}
    for name in problem.contact_names:
        for vertex, normal, gap, mass in _boundary_rows(problem, name):
            _merge(rows.setdefault(vertex, []), normal, gap, mass)
    free = np.array(list(V.FreeDofs()), dtype=bool).reshape(N, nv)
    found = [
        (vertex, normal / np.linalg.norm(normal), gap, mass)
        for vertex, entries in sorted(rows.items())
        for normal, gap, mass in entries
    ]
    vertices = np.array([f[0] for f in found], dtype=int)
    normals = np.array([f[1] for f in found]).reshape(-1, N)
    gaps, masses = np.array([f[2] for f in found]), np.array([f[3] for f in found])
    free_normals = normals * free[:, vertices].T
    keep = np.linalg.norm(free_normals, axis=1) > _HELD
    return NodalContact(vertices[keep], normals[keep], free_normals[keep], gaps[keep], masses[keep])


def _merge(entries: list[list], normal: np.ndarray, gap: float, mass: float) -> None:
    """Add a face to the rows of a node: averaged by mass with a row of nearly its direction."""
    for entry in entries:
        if entry[0] @ normal > _SAME_FACE * np.linalg.norm(entry[0]):
            total = entry[2] + mass
            entry[1] = (entry[1] * entry[2] + gap * mass) / total
            entry[0], entry[2] = entry[0] + mass * normal, total
            return
    entries.append([mass * normal, gap, mass])


def _boundary_rows(problem: Problem, name: str) -> list[tuple[int, np.ndarray, float, float]]:
    """(vertex, unit normal, gap, lumped mass) on one boundary, the normal averaged by mass."""
    mesh, N = problem.mesh, problem.N
    scalar, vector = H1(mesh, order=1), VectorH1(mesh, order=1)
    mass, average = LinearForm(scalar), LinearForm(vector)
    mass += scalar.TestFunction() * ds(name, bonus_intorder=1)
    average += InnerProduct(problem.normal, vector.TestFunction()) * ds(name, bonus_intorder=1)
    m = mass.Assemble().vec.FV().NumPy()
    n = average.Assemble().vec.FV().NumPy().reshape(N, -1)
    vertices, psi = at_corners(problem.gaps[name], mesh, [name])
    gaps = dict(zip(vertices.tolist(), psi[:, 0].tolist(), strict=True))
    return [(v, n[:, v] / np.linalg.norm(n[:, v]), gap, m[v]) for v, gap in sorted(gaps.items())]
