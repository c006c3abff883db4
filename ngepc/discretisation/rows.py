"""Contact as rows on the nodal displacements: N u <= gaps, with forces lambda >= 0.

A row belongs to a vertex of the contact boundary and to one of the faces that meet there: facets
whose normals differ little are one face, so that a curved face has one row at a vertex, with the
averaged normal, and a vertex on the edge between two faces has two, each with its own gap.

For displacements of order one a row is n . u at the vertex.  For order two it is the mean
int phi n . u / int phi with the hat function phi of the vertex: the weights int phi are positive in
every dimension, which those of the nodal values of quadratic triangles are not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from ngsolve import BND, ET, H1, ElementId, FESpace, specialcf
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import norm

from ngepc.checks.arguments import corner_rules, sample
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.quadrature import rules_of
from ngepc.model.problem import Problem
from ngepc.model.processes import Team

SAME_FACE = (
    0.7  # cosine above which facets of one boundary at a vertex belong to one face
)
SAME_FACE_ACROSS = 0.985  # the same for facets of two boundaries
HELD = 1e-8  # a row with a smaller free part is held by the support: no contact can happen there


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The contact condition N u <= gaps; u flattened node by node, N components each."""

    normal: csr_matrix  # N, shape (m, nodes N)
    tangential: (
        csr_matrix  # tangential displacements of the rows, shape (m (N - 1), nodes N)
    )
    gaps: np.ndarray  # distance to the obstacle (length), shape (m,)
    weights: np.ndarray  # area of each row (length for N = 2), shape (m,)
    vertices: np.ndarray  # vertex of each row, shape (m,)
    normals: np.ndarray  # unit outer ones, shape (m, N)
    tied: (
        np.ndarray
    )  # rows of glue and rollers: N u = gaps, forces of either sign, (m,)

    def __len__(self) -> int:
        return len(self.gaps)

    @cached_property
    def tangents(self) -> np.ndarray:
        """Orthonormal ones, shape (m, N - 1, N)."""
        return tangent_frames(self.normals)

    def chosen(self, rows: np.ndarray) -> ContactRows:
        """Some of the rows, by their numbers."""
        d = self.normals.shape[1] - 1
        tangents = (d * rows[:, None] + np.arange(d)).ravel()
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        chosen = {
            name: a[tangents if name == "tangential" else rows]
            for name, a in parts.items()
        }
        return ContactRows(**chosen)

    def movable(self, free: np.ndarray) -> ContactRows:
        """The rows that supports do not hold, given the free components (nodes, N)."""
        part = self.normal @ diags(free.ravel().astype(float))
        return self.chosen(np.flatnonzero(norm(part, axis=1) > HELD))


def rows_along(
    normals: np.ndarray,
    means: csr_matrix,
    normal: csr_matrix | None = None,
    *,
    vertices: np.ndarray,
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
        vertices=vertices,
        normals=normals,
        tied=np.full(m, tied),
    )


def means_along(means: csr_matrix, directions: np.ndarray) -> csr_matrix:
    """Means (m, nodes) of scalars as those of d . u for directions d (m, N), shape (m, nodes N)."""
    M = means.tocoo()
    N = directions.shape[1]
    columns = N * M.col[:, None].astype(np.int64) + np.arange(N)
    values = M.data[:, None] * directions[M.row]
    where = np.repeat(M.row, N), columns.ravel()
    return csr_matrix((values.ravel(), where), shape=(M.shape[0], N * M.shape[1]))


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
    ones = np.ones(count)
    corners = np.arange(count)
    size = np.linalg.norm(normals, axis=1)
    at = csr_matrix((ones, (corners, nodes)), shape=(count, nodes.max(initial=0) + 1))
    i, j = (at @ at.T).nonzero()
    least = np.where(names[i] == names[j], SAME_FACE, SAME_FACE_ACROSS)
    alike = np.einsum("pc,pc->p", normals[i], normals[j]) > least * size[i] * size[j]
    graph = csr_matrix((ones[i[alike]], (i[alike], j[alike])), shape=(count, count))
    face = connected_components(graph)[1]
    found, row = np.unique(np.column_stack([nodes, face]), axis=0, return_inverse=True)
    sums = csr_matrix((ones, (row.ravel(), corners)), shape=(len(found), count))
    return found[:, 0], sums


def contact_rows(problem: Problem, supports: Supports) -> ContactRows:
    """The discrete contact condition of a problem; no rows without a contact boundary."""
    corners, means = _corners(problem)
    corners = _shared(corners, problem.processes)
    names = corners[:, 0]
    at = corners[:, 1].astype(int)
    integrals = corners[:, 2:]
    vertices, sums = meeting_faces(at, names, integrals[:, 2:])
    m = len(vertices)
    integrals = sums @ integrals
    weights = integrals[:, 0]
    gaps = integrals[:, 1]
    normals = integrals[:, 2:]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    if problem.order == 1:
        where = (np.arange(m), vertices)
        shape = (m, means.shape[1])
        means = csr_matrix((np.ones(m), where), shape=shape)
    else:
        means = diags(1 / weights) @ sums @ means
    rows = rows_along(
        normals, means, vertices=vertices, gaps=gaps / weights, weights=weights
    )
    return rows.movable(supports.free)


def _corners(problem: Problem) -> tuple[np.ndarray, csr_matrix]:
    """The corners of all contact facets, and integrals of functions there, (corners, nodes).

    A corner has the number of its boundary, its vertex and integrals with its hat: of 1, of the gap
    and of the normal, shape (corners, 4 + N).  For order one the gap is that of the vertex.
    """
    mesh = problem.mesh
    N = problem.N
    order = problem.order
    scalar = H1(mesh, order=order)
    found = [np.zeros((0, 4 + N))]
    means = [csr_matrix((0, scalar.ndof))]
    for number, name in enumerate(problem.contact_names):
        psi = problem.gaps[name]
        facets = mapped_facets(problem, scalar, name, 2 if order == 1 else 6)
        for shape, nodes, shapes, area, points in facets:
            given = np.column_stack(
                [np.ones(len(points)), psi(points), problem.normal(points)]
            )
            vertices = nodes[:, nodes[0] < mesh.nv]
            hats = (area[:, :, None] * shapes[:, : vertices.shape[1]]).swapaxes(1, 2)
            integrals = hats @ given.reshape(*area.shape, 2 + N)
            if order == 1:
                at_corners = sample(
                    psi, mesh, [name], {shape: corner_rules(N - 1)[shape]}
                )
                integrals[:, :, 1] = integrals[:, :, 0] * at_corners.reshape(
                    vertices.shape
                )
            boundary = np.full(vertices.size, number)
            integrals = integrals.reshape(-1, 2 + N)
            found.append(np.column_stack([boundary, vertices.ravel(), integrals]))
            columns = nodes.repeat(vertices.shape[1], axis=0).ravel()
            where = np.arange(vertices.size).repeat(nodes.shape[1]), columns
            shape = vertices.size, scalar.ndof
            means.append(csr_matrix(((hats @ shapes).ravel(), where), shape=shape))
    return np.vstack(found), vstack(means, format="csr")


def mapped_facets(
    problem: Problem, space: FESpace, name: str, order: int
) -> Iterator[tuple[ET, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """The facets of a boundary shape by shape, with the points of a rule.

    Shape, nodes in a scalar space (facets, k), its functions at the points (points, k), the surface
    that belongs to them (facets, points), 2 pi r times as much on a ring, and the mapped points.
    """
    mesh, N, region = problem.mesh, problem.N, problem.mesh.Boundaries(name)
    for shape, rule in rules_of(N - 1, order).items():
        facets = [
            ElementId(BND, facet.nr)
            for facet in region.Elements()
            if facet.type == shape
        ]
        if not facets:
            continue
        points = mesh.MapToAllElements({shape: rule}, region)
        element = space.GetFE(facets[0])
        nodes = np.array([space.GetDofNrs(facet) for facet in facets])
        shapes = np.array(
            [np.array(element.CalcShape(*point)) for point in rule.points]
        )
        J = specialcf.JacobianMatrix(N, N - 1)(points).reshape(-1, N, N - 1)
        area = np.sqrt(np.linalg.det(J.swapaxes(1, 2) @ J))
        area *= np.ravel(problem.kinematics.weight(points))
        yield (
            shape,
            nodes,
            shapes,
            area.reshape(len(facets), -1) * np.array(rule.weights),
            points,
        )


def _shared(corners: np.ndarray, processes: Team) -> np.ndarray:
    """The corners with those that other processes have at common vertices, in one order on all."""
    if processes.size == 1:
        return corners
    number = processes.numbers
    sent = {}
    corners[:, 1] = number[corners[:, 1].astype(int)]
    for rank, nodes in processes.copies.items():
        sent[rank] = corners[np.isin(corners[:, 1], number[nodes])]
    found = processes.traded(sent) | {processes.rank: corners}
    every = np.vstack([found[rank] for rank in sorted(found)])
    order = np.argsort(number)
    every[:, 1] = order[np.searchsorted(number, every[:, 1], sorter=order)]
    return every
