"""Contact of two bodies as rows: means of the gap with biorthogonal functions on the first body.

With the Bernstein polynomials B_i of the first surface, hat functions for order one, and the
functions psi_i biorthogonal to them on each facet, int psi_i B_j = delta_ij int B_i over the part
that faces the second surface (on a body of revolution over its ring, with the radius),

    N_i u = int psi_i n . (u_1 - u_2) / int psi_i,   gap_i likewise.

That is the coefficient of B_i in the projection of n . (u_1 - u_2) onto polynomials.  Constant
pressures pass between meshes that do not match without any error.  A facet of the second surface is
projected onto one of the first surface along its normals, which in the plane are interpolated
between its nodes; the projection is cut off where a barycentric coordinate becomes negative.  Where
faces of the first surface meet at an angle, each has a row of its own, as on obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from ngsolve import H1
from scipy.sparse import csr_matrix, diags

from ngepc.checks.arguments import boundary_names
from ngepc.checks.sentences import in_words
from ngepc.discretisation.overlap import (
    Overlap,
    Surface,
    overlap,
    pairs_of,
    unit_vectors,
)
from ngepc.discretisation.rows import ContactRows, means_along, rows_along
from ngepc.discretisation.supports import Supports
from ngepc.model.places import Contact
from ngepc.model.problem import Problem

SLIVER = {1: 1e-8, 2: 1e-6}
"""Order -> smallest relative eigenvalue of a facet's mass matrix for biorthogonal functions."""

HALF = 0.5
"""Part of the mean of the second body that is free where that body moves."""

COVERED = 1e-6  # rows with a smaller part of the area of their facets are left out


def mortar_rows(problem: Problem, supports: Supports, pair: Contact) -> ContactRows:
    """The rows at the first of two boundaries; a ValueError if they do not overlap.

    Rows of contact are all of them, also those that supports hold.
    """
    one, two = surfaces_of(problem, pair)
    at = overlap(one, two)
    if not len(at.weights):
        raise ValueError(
            f"contact={in_words(pair)}: the two boundaries nowhere face each other"
        )
    space = H1(problem.mesh, order=problem.order)
    nodes = one.nodes(space)
    # glue holds all components: faces that meet have one row for each of them
    rows = nodes if pair.tied else one.faces(nodes)[0]
    means = _mortar_means(problem, nodes, rows, one, at)
    opposite = two.means(space, at.second, at.other)
    jumps = one.means(space, at.first, at.lam) - opposite
    free = supports.free[means.nodes]
    free = free | ((means.averages @ opposite) @ supports.free.astype(float) > HALF)
    if pair.tied:
        return _tied_rows(means, jumps, free)
    normals = unit_vectors(means.averages @ at.normals)
    return rows_along(
        normals,
        means.averages @ jumps,
        means.averages @ means_along(jumps, at.normals),
        gaps=means.averages @ at.gaps,
        nodes=means.nodes,
        corners=means.corners,
        weights=means.area,
        free=free,
    )


def surfaces_of(problem: Problem, pair: Contact) -> tuple[Surface, Surface]:
    """The two surfaces of a contact pair."""
    first, second = (
        Surface(problem, boundary_names("contact", names, problem.mesh))
        for names in (pair.first, pair.second)
    )
    return first, second


@dataclass(frozen=True, eq=False)
class MortarMeans:
    """Weighted means over the points of an overlap, one for each row of the first surface."""

    averages: csr_matrix  # shape (rows, points), every row sums to one
    nodes: np.ndarray  # node of each row
    corners: np.ndarray  # four corners of which a node is the mean, shape (rows, 4)
    area: np.ndarray  # length or area of each row


def _mortar_means(
    problem: Problem, nodes: np.ndarray, rows: np.ndarray, one: Surface, at: Overlap
) -> MortarMeans:
    """The means with biorthogonal functions; rows that are hardly covered are left out.

    ``nodes`` and numbers of ``rows`` are those of the facets of the first surface, (facets, k).
    """
    points, N = at.lam.shape
    radius = (at.lam * one.corners[at.first, :, 0]).sum(axis=1)
    weights = at.weights * problem.kinematics.weight_at(radius)
    found, first, row = np.unique(
        rows[at.first], return_index=True, return_inverse=True
    )
    at = replace(at, weights=weights)
    share = weights[:, None] * biorthogonal(one, at, problem.order)
    per_facet = share.shape[1]
    where = row.ravel(), np.repeat(np.arange(points), per_facet)
    sums = csr_matrix((share.ravel(), where), shape=(len(found), points))
    area = np.asarray(sums.sum(axis=1)).ravel()
    around = one.areas * problem.kinematics.weight_at(one.centres[:, 0])
    whole = np.bincount(rows.ravel(), np.repeat(around, per_facet))
    kept = area > COVERED * whole[found]

    facet = at.first[first[kept] // per_facet]
    local = four_corners(N, problem.order)[first[kept] % per_facet]
    return MortarMeans(
        averages=diags(1 / area[kept]) @ sums[kept],
        nodes=nodes[facet, first[kept] % per_facet],
        corners=np.take_along_axis(one.vertices[facet], local, axis=1),
        area=area[kept],
    )


def _tied_rows(means: MortarMeans, jumps: csr_matrix, free: np.ndarray) -> ContactRows:
    """Rows along all axes without a gap, for components that are not clamped."""
    count = len(means.area)
    N = free.shape[1]
    every = np.tile(np.arange(count), N)
    rows = rows_along(
        np.repeat(np.eye(N), count, axis=0),
        (means.averages @ jumps)[every],
        gaps=np.zeros(len(every)),
        tied=True,
        nodes=means.nodes[every],
        corners=means.corners[every],
        weights=means.area[every],
        free=free[every],
    )
    return rows.chosen(np.flatnonzero(free.T.ravel()))


def four_corners(N: int, order: int) -> np.ndarray:
    """Four corners that the node of each polynomial is the mean of, repeated, shape (k, 4)."""
    return np.repeat(pairs_of(N, order), 2, axis=1)


def bernstein(lam: np.ndarray, order: int) -> np.ndarray:
    """The Bernstein polynomials at barycentric coordinates (points, N), shape (points, k)."""
    if order == 1:
        return lam
    a, b = pairs_of(lam.shape[1], order).T
    return np.where(a == b, 1.0, 2.0) * lam[:, a] * lam[:, b]


def biorthogonal(one: Surface, at: Overlap, order: int) -> np.ndarray:
    """The functions biorthogonal to Bernstein polynomials on each facet at points, (points, k).

    These polynomials themselves where little of a facet is covered.
    """
    B = bernstein(at.lam, order)
    k = B.shape[1]
    mass = np.zeros((len(one.corners), k, k))
    products = at.weights[:, None, None] * B[:, :, None] * B[:, None, :]
    np.add.at(mass, at.first, products)
    eigenvalues = np.linalg.eigvalsh(mass)
    covered = eigenvalues[:, 0] > SLIVER[order] * eigenvalues[:, -1]

    A = np.broadcast_to(np.eye(k), mass.shape).copy()
    lumped = mass[covered].sum(axis=2)
    A[covered] = lumped[:, :, None] * np.linalg.inv(mass[covered])
    return np.einsum("pij,pj->pi", A[at.first], B)


def deepest_pair_overlap(problem: Problem, pair: Contact, u: np.ndarray) -> float:
    """The largest n . (u_1 - u_2) - gap at the points of a pair for nodal values u (nodes, N)."""
    one, two = surfaces_of(problem, pair)
    at = overlap(one, two)
    space = H1(problem.mesh, order=problem.order)
    moved = one.means(space, at.first, at.lam) @ u
    moved -= two.means(space, at.second, at.other) @ u
    depth = np.einsum("pc,pc->p", moved, at.normals) - at.gaps
    return float(depth.max(initial=0.0))
