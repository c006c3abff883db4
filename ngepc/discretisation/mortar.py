"""Contact of two bodies as rows: means of the gap with biorthogonal functions on the first body.

With the hat functions phi_i of the first surface and the functions psi_i biorthogonal to them on
each facet, int psi_i phi_j = delta_ij int phi_i over what faces the second surface,

    N_i u = int psi_i n . (u_1 - u_2) / int psi_i,   gap_i likewise.

Constant pressures pass between meshes that do not match without any error.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1
from scipy.sparse import csr_matrix, diags

from ngepc.checks.arguments import boundary_names
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.rows import ContactRows, joined, means_along, rows_along
from ngepc.discretisation.segments import Overlap, Surface, overlap
from ngepc.model.contact import Contact
from ngepc.model.problem import Problem

SLIVER = 1e-8
"""Smallest condition of a facet's mass matrix, relative, that leaves biorthogonal functions."""

COVERED = 1e-6  # rows with a smaller part of the largest weight are left out


def mortar_rows(problem: Problem, supports: Supports, pair: Contact) -> ContactRows:
    """The contact conditions at the vertices of the first of two boundaries.

    A ValueError if they nowhere face each other.
    """
    one, two = (
        Surface.of(problem, boundary_names("contact", names, problem.mesh))
        for names in (pair.first, pair.second)
    )
    at = overlap(one, two)
    if not len(at.weights):
        raise ValueError(f"contact={pair!r}: the two boundaries nowhere face each other")
    averages, vertices, area = _averages(problem, one, at)
    jumps, free = _jumps(problem, one, two, at), supports.free[vertices]
    given = {"vertices": vertices, "weights": area, "free": free}
    if pair.tied:
        parts, no = [], np.zeros(len(area))
        for k, axis in enumerate(np.eye(problem.N)):
            normals = np.tile(axis, (len(area), 1))
            rows = rows_along(normals, averages @ jumps, gaps=no, tied=True, **given)
            parts.append(rows.chosen(np.flatnonzero(free[:, k])))
        return joined(parts)
    normals = averages @ at.normals
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    along = averages @ means_along(jumps, at.normals)
    rows = rows_along(normals, averages @ jumps, along, gaps=averages @ at.gaps, **given)
    return rows.movable(supports.free)


def _averages(
    problem: Problem, one: Surface, at: Overlap
) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
    """Means over the points with the function psi of each vertex, the vertices, and int psi."""
    weights, (points, N) = at.weights, at.lam.shape
    if problem.kinematics.hoop:
        weights = 2 * np.pi * weights * (at.lam * one.corners[at.first, :, 0]).sum(axis=1)
    share = weights[:, None] * biorthogonal(one, at)
    vertices, row = np.unique(one.vertices[at.first], return_inverse=True)
    where = row.ravel(), np.repeat(np.arange(points), N)
    sums = csr_matrix((share.ravel(), where), shape=(len(vertices), points))
    area = np.asarray(sums.sum(axis=1)).ravel()
    kept = area > COVERED * area.max()
    return diags(1 / area[kept]) @ sums[kept], vertices[kept], area[kept]


def _jumps(problem: Problem, one: Surface, two: Surface, at: Overlap) -> csr_matrix:
    """u_1 - u_2 at the points for one component, shape (points, nodes)."""
    space, points, sides = H1(problem.mesh, order=problem.order), len(at.weights), []
    for surface, facets, lam in ((one, at.first, at.lam), (two, at.second, at.other)):
        nodes, shapes = surface.shapes(space, facets, lam)
        where = np.repeat(np.arange(points), nodes.shape[1]), nodes.ravel()
        sides.append(csr_matrix((shapes.ravel(), where), shape=(points, space.ndof)))
    return sides[0] - sides[1]


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
