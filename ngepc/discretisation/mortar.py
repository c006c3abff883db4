"""Contact of two bodies as rows: means of the gap with biorthogonal functions on the first body.

With the hat functions phi_i of the first surface and the functions psi_i biorthogonal to them on
each facet, int psi_i phi_j = delta_ij int phi_i over what faces the second surface,

    N_i u = int psi_i n . (u_1 - u_2) / int psi_i,   gap_i likewise.

Constant pressures pass between meshes that do not match without any error.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1
from scipy.sparse import csr_matrix

from ngepc.checks.arguments import boundary_names
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.rows import HELD, ContactRows, interleaved, joined, tangent_frames
from ngepc.discretisation.segments import Overlap, Surface, overlap
from ngepc.model.contact import Contact
from ngepc.model.problem import Problem

SLIVER = 1e-8
"""Smallest condition of a facet's mass matrix, relative, that leaves biorthogonal functions."""

COVERED = 1e-6
"""Rows with a smaller part of the largest weight are left out."""


def mortar_rows(problem: Problem, supports: Supports, pair: Contact) -> ContactRows:
    """The contact conditions between two boundaries.

    Parameters
    ----------
    problem, supports
        The problem and what holds its bodies.
    pair
        The two boundaries; the rows stand at the vertices of the first.

    Raises
    ------
    ValueError
        If the two nowhere face each other.
    """
    one, two = (
        Surface.of(problem, boundary_names("contact", names, problem.mesh))
        for names in (pair.first, pair.second)
    )
    at = overlap(one, two)
    if not len(at.weights):
        raise ValueError(f"contact={pair!r}: the two boundaries nowhere face each other")
    means = _Means(problem, one, two, at)
    return means.glued(supports.free) if pair.tied else means.rows(supports.free)


class _Means:
    """Means over the points with the biorthogonal function of each vertex."""

    def __init__(self, problem: Problem, one: Surface, two: Surface, at: Overlap) -> None:
        weights, self.at = at.weights, at
        if problem.kinematics.hoop:
            weights = (
                2 * np.pi * weights * np.einsum("pk,pk->p", at.lam, one.corners[at.first, :, 0])
            )
        share = weights[:, None] * biorthogonal(one, at)
        vertices, row = np.unique(one.vertices[at.first], return_inverse=True)
        row = row.reshape(share.shape)
        area = np.bincount(row.ravel(), share.ravel())
        kept = area > COVERED * area.max()
        number = np.where(kept, np.cumsum(kept) - 1, kept.sum())[row]  # the last row is dropped
        self.vertices, self.area, self._row = vertices[kept], area[kept], number
        self._share = share / np.where(kept, area, 1.0)[row]
        space = H1(problem.mesh, order=problem.order)
        nodes, values = one.shapes(space, at.first, at.lam)
        others, opposite = two.shapes(space, at.second, at.other)
        self._nodes, self._values = np.hstack([nodes, others]), np.hstack([values, -opposite])
        self._columns = space.ndof * problem.N

    def of(self, values: np.ndarray) -> np.ndarray:
        """The means of values at the points (points,)."""
        m = len(self.area)
        return np.bincount(self._row.ravel(), (self._share * values[:, None]).ravel(), m + 1)[:m]

    def jump(self, directions: np.ndarray) -> csr_matrix:
        """The means of d . (u_1 - u_2) for directions d at the points, (points, 1 or N, N)."""
        m, N = len(self.area), directions.shape[-1]
        values = self._share[:, :, None, None] * self._values[:, None, :, None]
        values = values * directions[:, :, None]
        columns = N * self._nodes[:, None, :, None] + np.arange(N)
        parts = np.broadcast_arrays(values, self._row[:, :, None, None], columns)
        data, i, j = (part.ravel() for part in parts)
        return csr_matrix((data, (i, j)), shape=(m + 1, self._columns))[:m]

    def rows(self, free: np.ndarray) -> ContactRows:
        """Rows of contact: one normal and N - 1 tangents for each vertex."""
        normals = np.stack([self.of(n) for n in self.at.normals.T], axis=1)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        rows = self._as_rows(
            self.jump(self.at.normals[:, None]), self.of(self.at.gaps), normals, free
        )
        part = rows.normal.multiply(free.ravel()[None, :]).tocsr()
        return rows.chosen(np.flatnonzero(np.sqrt(part.multiply(part).sum(axis=1)).A1 > HELD))

    def glued(self, free: np.ndarray) -> ContactRows:
        """Rows of glue: one for each component of each vertex that is free to move there."""
        N, parts = free.shape[1], []
        for axis in np.eye(N):
            normals = np.tile(axis, (len(self.area), 1))
            jump, gaps = self.jump(axis[None, None]), np.zeros(len(self.area))
            rows = self._as_rows(jump, gaps, normals, free, tied=True)
            parts.append(rows.chosen(_movable(normals, free[self.vertices])))
        return joined(parts)

    def _as_rows(
        self,
        normal: csr_matrix,
        gaps: np.ndarray,
        normals: np.ndarray,
        free: np.ndarray,
        tied: bool = False,
    ) -> ContactRows:
        """The rows with tangents in which held components of their vertices do not count."""
        tangents, dropped = tangent_frames(normals), np.zeros((1, normals.shape[1]))
        slips = np.where(free[self.vertices], tangents.swapaxes(0, 1), 0.0)
        each = [self.jump(np.vstack([d, dropped])[self._row]) for d in slips]
        return ContactRows(
            normal=normal,
            tangential=interleaved(each, self._columns),
            gaps=gaps,
            weights=self.area,
            vertices=self.vertices,
            normals=normals,
            tangents=tangents,
            tied=np.full(len(gaps), tied),
        )


def _movable(directions: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Numbers of the directions (m, N) that supports leave a part of, given what is free."""
    return np.flatnonzero(np.linalg.norm(np.where(free, directions, 0.0), axis=1) > HELD)


def biorthogonal(surface: Surface, at: Overlap) -> np.ndarray:
    """The values psi of the biorthogonal functions at the points, shape (points, N).

    On facets of which hardly anything faces the other surface the hats take their place.
    """
    count, N = len(surface.numbers), at.lam.shape[1]
    mass = np.zeros((count, N, N))
    np.add.at(mass, at.first, at.weights[:, None, None] * at.lam[:, :, None] * at.lam[:, None, :])
    size = np.linalg.eigvalsh(mass)
    good = size[:, 0] > SLIVER * size[:, -1]
    A = np.broadcast_to(np.eye(N), mass.shape).copy()
    A[good] = mass[good].sum(axis=2)[:, :, None] * np.linalg.inv(mass[good])
    return np.einsum("pij,pj->pi", A[at.first], at.lam)
