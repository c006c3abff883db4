"""Contact as rows on the nodal displacements: N u <= gaps, with forces lambda >= 0.

A row belongs to a node of the contact boundary and to one of the faces that meet there: facets
whose normals differ little are one face, so that a curved face has one row at a node, with the
averaged normal, and a node on the edge between two faces has two, each with its own gap.

For displacements of order one a row is n . u at the vertex.  For order two it is the coefficient of
n . u in Bernstein polynomials on the facet, and the gap of the row that of the polynomial through
the values of the gap at the nodes.  A parabola that vanishes at the ends and the middle of an edge
is zero, and it is nowhere above its coefficients: where the gap is quadratic on straight facets
rows without penetration mean u . n <= gap at every point.  The areas of the rows, the integrals of
the polynomials, are positive, which those of nodal values on quadratic triangles are not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from ngsolve import FESpace
from scipy.sparse import csr_matrix, diags, vstack

from ngepc.discretisation.gap_records import (
    JUMP,
    NodeGaps,
    facet_records,
    row_coefficients,
    shared_records,
)
from ngepc.discretisation.supports import Supports
from ngepc.model.problem import Problem
from ngepc.model.support import connected

SAME_FACE = 0.7
"""Cosine above which facets of one boundary at a vertex belong to one face."""

SAME_FACE_ACROSS = 0.985  # the same for facets of two boundaries

HELD = 1e-8  # a row with a smaller free part is held by the support: no contact can happen there


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The contact condition N u <= gaps; u flattened node by node, N components each."""

    normal: csr_matrix  # N, shape (m, nodes N)
    tangential: csr_matrix
    """Tangential displacements of the rows, shape (m (N - 1), nodes N)."""
    gaps: np.ndarray  # distance to the obstacle (length), shape (m,)
    weights: np.ndarray  # area of each row (length for N = 2), shape (m,)
    nodes: np.ndarray  # node of each row in a scalar space, vertices first, (m,)
    corners: np.ndarray  # four vertices that the node is the mean of, repeated, (m, 4)
    normals: np.ndarray  # unit outer ones, shape (m, N)
    tied: np.ndarray
    """Rows of glue and rollers: N u = gaps, forces of either sign, (m,)."""

    def __len__(self) -> int:
        return len(self.gaps)

    @cached_property
    def tangents(self) -> np.ndarray:
        """Orthonormal ones, shape (m, N - 1, N)."""
        return tangent_frames(self.normals)

    def at_vertices(self, values: np.ndarray, count: int) -> np.ndarray:
        """Values of the rows, shape (m, ...), distributed in equal parts to their vertices."""
        result = np.zeros((count, *values.shape[1:]))
        for corner in self.corners.T:
            np.add.at(result, corner, values / 4)
        return result

    def between(self, values: np.ndarray) -> np.ndarray:
        """Values at vertices (vertices, ...) at the nodes of the rows, shape (m, ...)."""
        return values[self.corners].mean(axis=1)

    def chosen(self, rows: np.ndarray) -> ContactRows:
        """Some of the rows, by their numbers."""
        if np.array_equal(rows, np.arange(len(self))):
            return self
        d = self.normals.shape[1] - 1
        tangents = (d * rows[:, None] + np.arange(d)).ravel()
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        chosen = {
            name: a[tangents if name == "tangential" else rows]
            for name, a in parts.items()
        }
        return ContactRows(**chosen)

    def movable(self, free: np.ndarray) -> np.ndarray:
        """Numbers of the rows that supports do not hold, given the free components (nodes, N)."""
        squares = self.normal.power(2) @ free.ravel().astype(float)
        return np.flatnonzero(squares > HELD**2)


@dataclass(frozen=True, eq=False)
class RowGaps:
    """The gaps of contact rows, from the gap at the nodes of the facets."""

    sums: csr_matrix  # sums of records for each row, shape (all rows, records)
    weights: np.ndarray  # areas of the records
    coefficients: csr_matrix | None  # of order two, from means at the nodes of the rows
    boundaries: np.ndarray  # numbers of the boundaries of the records

    def shares(self, count: int) -> csr_matrix:
        """The part of the area of each row that each boundary has, (all rows, ``count``)."""
        which = np.arange(len(self.weights)), self.boundaries
        areas = csr_matrix((self.weights, which), shape=(len(self.weights), count))
        return diags(1 / (self.sums @ self.weights)) @ self.sums @ areas

    def __call__(self, known: NodeGaps) -> np.ndarray:
        """From those of the records, also for rows that supports hold, shape (all rows,).

        Coefficients of order two are those of the values at the nodes of the rows, except where the
        gap jumps at a node: there they are those of the facets.
        """
        sums = self.sums
        gaps = self._mean(known.gap)
        if self.coefficients is not None:
            own = self._mean(known.coefficient)
            size = JUMP * (np.abs(own) + np.abs(gaps))
            gaps = self.coefficients @ gaps
            gaps = np.where(np.abs(gaps - own) > size, own, gaps)
            lowest = np.maximum.reduceat(known.least[sums.indices], sums.indptr[:-1])
            gaps = np.maximum(gaps, lowest)
        falls = known.lowered[sums.indices]
        return gaps - np.maximum.reduceat(falls, sums.indptr[:-1])

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """The means of values of the records, (all rows,)."""
        sums = self.sums
        return sums @ (self.weights * values) / (sums @ self.weights)


def rows_along(
    normals: np.ndarray,
    means: csr_matrix,
    normal: csr_matrix | None = None,
    *,
    nodes: np.ndarray,
    corners: np.ndarray,
    gaps: np.ndarray,
    weights: np.ndarray,
    free: np.ndarray | None = None,
    tied: bool = False,
) -> ContactRows:
    """Rows n . (M u) for unit vectors n (m, N) and means M (m, nodes) of each component.

    ``normal`` are these where n varies; tangential rows have the components ``free`` (m, N).
    """
    tangents = tangent_frames(normals)
    slips = tangents if free is None else np.where(free[:, None], tangents, 0.0)
    m, d, N = tangents.shape
    return ContactRows(
        normal=means_along(means, normals) if normal is None else normal,
        tangential=means_along(means[np.repeat(np.arange(m), d)], slips.reshape(-1, N)),
        gaps=gaps,
        weights=weights,
        nodes=nodes,
        corners=corners,
        normals=normals,
        tied=np.full(m, tied),
    )


def means_along(means: csr_matrix, directions: np.ndarray) -> csr_matrix:
    """Means (m, nodes) of scalars as those of d . u for directions d (m, N), shape (m, nodes N)."""
    m, count = means.shape
    N = directions.shape[1]
    columns = N * means.indices[:, None].astype(np.int64) + np.arange(N)
    along = np.repeat(directions, np.diff(means.indptr), axis=0)
    values = means.data[:, None] * along
    entries = values.ravel(), columns.ravel(), N * means.indptr
    return csr_matrix(entries, shape=(m, N * count))


def tangent_frames(normals: np.ndarray) -> np.ndarray:
    """Orthonormal tangents (m, N - 1, N): (-n_y, n_x) for N = 2."""
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None, :]
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def joined(parts: list[ContactRows]) -> ContactRows:
    """The rows of several parts, one after the other."""
    parts = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        return parts[0]
    arrays = {
        f.name: [getattr(part, f.name) for part in parts] for f in fields(ContactRows)
    }
    sparse = {n: vstack(arrays.pop(n), format="csr") for n in ("normal", "tangential")}
    return ContactRows(
        **sparse, **{n: np.concatenate(each) for n, each in arrays.items()}
    )


def meeting_faces(
    nodes: np.ndarray, names: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, csr_matrix]:
    """The faces that meet at nodes: facets of a node that pairs of close normals connect are one.

    From node, boundary and normal, as long as it is large, of each corner of a facet: nodes of the
    faces and the matrix that sums corners, shape (faces, corners).
    """
    count = len(nodes)
    size = np.linalg.norm(normals, axis=1)
    i, j = pairs_of_equals(nodes)
    least_cosine = np.where(names[i] == names[j], SAME_FACE, SAME_FACE_ACROSS)
    products = np.einsum("pc,pc->p", normals[i], normals[j])
    alike = products > least_cosine * size[i] * size[j]
    face = connected(count, i[alike], j[alike])

    found, first, row = np.unique(
        nodes * count + face, return_index=True, return_inverse=True
    )
    ends = np.append(0, np.cumsum(np.bincount(row, minlength=len(found))))
    corners = np.argsort(row, kind="stable")
    sums = csr_matrix((np.ones(count), corners, ends), shape=(len(found), count))
    return nodes[first], sums


def pairs_of_equals(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The places i and j of all pairs of equal numbers, each with itself, too."""
    order = np.argsort(numbers, kind="stable")
    _, first, group, count = np.unique(
        numbers[order], return_index=True, return_inverse=True, return_counts=True
    )
    several = count[group]
    i = np.repeat(order, several)
    before = np.cumsum(several) - several
    j = (
        np.arange(len(i))
        - np.repeat(before, several)
        + np.repeat(first[group], several)
    )
    return i, order[j]


def contact_rows(problem: Problem, supports: Supports) -> ContactRows:
    """The discrete contact condition of a problem; no rows without a contact boundary."""
    rows = rows_and_gaps(problem, supports.scalar)[0]
    return rows.chosen(rows.movable(supports.free))


def rows_and_gaps(
    problem: Problem, scalar: FESpace
) -> tuple[ContactRows, RowGaps | None]:
    """All rows, also those that supports hold, and ``RowGaps``; None without contact boundary.

    ``scalar`` is the space of one component of the displacement.
    """
    if not problem.contact_names:
        return _no_rows(problem.N, scalar.ndof), None
    own, means = facet_records(problem, scalar)
    records, means = shared_records(own, means, problem.nodal_processes)
    weights = records["weight"]
    directions = weights[:, None] * records["normal"]
    nodes, sums = meeting_faces(records["node"], records["boundary"], directions)
    if not len(nodes):
        return _no_rows(problem.N, scalar.ndof), None
    first = sums.indices[sums.indptr[:-1]]  # one of the corners of each row
    normals = sums @ directions
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    area = sums @ weights

    coefficients = None
    means = means[first]
    along = means_along(means, normals)
    if problem.order == 2:
        coefficients = row_coefficients(records, sums, first)
        means = coefficients @ means
        along = coefficients @ along
    at = {"nodes": nodes, "corners": records["corners"][first]}
    gaps = RowGaps(sums, weights, coefficients, records["boundary"])
    known = gaps(NodeGaps(*(records[name] for name in NodeGaps._fields)))
    return rows_along(normals, means, along, **at, gaps=known, weights=area), gaps


def _no_rows(N: int, count: int) -> ContactRows:
    """The rows of a problem in N dimensions without contact boundary, for a number of nodes."""
    none = np.zeros(0)
    return rows_along(
        np.zeros((0, N)),
        csr_matrix((0, count)),
        nodes=none.astype(int),
        corners=np.zeros((0, 4), dtype=int),
        gaps=none,
        weights=none,
    )
