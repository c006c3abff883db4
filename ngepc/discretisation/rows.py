"""Contact as rows on the nodal displacements: N u <= gaps, with forces lambda >= 0.

A row belongs to a vertex of the contact boundary and to one of the faces that meet there: facets
whose normals differ little are one face, so that a curved face has one row at a vertex, with the
averaged normal, and a vertex on the edge between two faces has two, each with its own gap.

For displacements of order one a row is n . u at the vertex.  For order two it is the mean
int phi n . u / int phi with the hat function phi of the vertex: the weights int phi are positive in
every dimension, which those of the nodal values of quadratic triangles are not.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from ngsolve import BND, H1, ElementId, FESpace, IntegrationRule, specialcf
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.linalg import norm

from ngepc.discretisation.loads import Supports
from ngepc.discretisation.quadrature import rules_of
from ngepc.model.places import values_at
from ngepc.model.problem import Problem

SAME_FACE = 0.7  # cosine above which facets of one boundary at a vertex belong to one face
SAME_FACE_ACROSS = 0.985  # the same for facets of two boundaries
HELD = 1e-8  # a row with a smaller free part is held by the support: no contact can happen there


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The contact condition N u <= gaps; u flattened node by node, N components each."""

    normal: csr_matrix  # N, shape (m, nodes N)
    tangential: csr_matrix  # tangential displacements of the rows, shape (m (N - 1), nodes N)
    gaps: np.ndarray  # distance to the obstacle (length), shape (m,)
    weights: np.ndarray  # area of each row (length for N = 2), shape (m,)
    vertices: np.ndarray  # vertex of each row, shape (m,)
    normals: np.ndarray  # unit outer ones, shape (m, N)
    tied: np.ndarray  # rows of glue and rollers: N u = gaps, forces of either sign, (m,)

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
        chosen = {name: a[tangents if name == "tangential" else rows] for name, a in parts.items()}
        return ContactRows(**chosen)

    def movable(self, free: np.ndarray) -> ContactRows:
        """The rows that supports do not hold, given the free components (nodes, N)."""
        part = self.normal @ diags(free.ravel().astype(float))
        return self.chosen(np.flatnonzero(norm(part, axis=1) > HELD))

    def slip(self, u: np.ndarray) -> np.ndarray:
        """Tangential displacements of the rows, shape (m, N - 1)."""
        return (self.tangential @ u.ravel()).reshape(self.tangents.shape[:2])

    def friction_forces(self, multipliers: np.ndarray) -> np.ndarray:
        """T' lambda_t for tangential multipliers (m, N - 1), shape (nodes, N)."""
        return (self.tangential.T @ multipliers.ravel()).reshape(-1, self.normals.shape[1])


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
    M, N = means.tocoo(), directions.shape[1]
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
    arrays = {f.name: [getattr(part, f.name) for part in parts] for f in fields(ContactRows)}
    sparse = {n: vstack(arrays.pop(n), format="csr") for n in ("normal", "tangential")}
    return ContactRows(**sparse, **{n: np.concatenate(each) for n, each in arrays.items()})


def meeting_faces(
    nodes: Iterable[int], names: Iterable[str], normals: np.ndarray
) -> tuple[np.ndarray, csr_matrix]:
    """The faces that meet at nodes: facets of a node whose normals differ little are one.

    From node, boundary and normal, as long as it is large, of each corner of a facet: nodes of the
    faces and the matrix that sums corners, shape (faces, corners).
    """
    at: dict[int, list[tuple[str, np.ndarray]]] = {}
    places = []
    for node, name, normal in zip(nodes, names, normals, strict=True):
        here = at.setdefault(node, [])
        for k, (first, total) in enumerate(here):
            least = SAME_FACE if name == first else SAME_FACE_ACROSS
            if total @ normal > least * np.linalg.norm(total) * np.linalg.norm(normal):
                here[k] = first, total + normal
                break
        else:
            k = len(here)
            here.append((name, normal))
        places.append((node, k))
    found, row = np.unique(np.reshape(places, (-1, 2)).astype(int), axis=0, return_inverse=True)
    where, shape = (row.ravel(), np.arange(len(places))), (len(found), len(places))
    return found[:, 0], csr_matrix((np.ones(len(places)), where), shape=shape)


def contact_rows(problem: Problem, supports: Supports) -> ContactRows:
    """The discrete contact condition of a problem; no rows without a contact boundary."""
    N, nodes = problem.N, supports.space.ndof // problem.N
    corners, means = _corners(problem)
    corners = _shared(corners, problem)
    integrals = np.reshape([given for *_, given in corners], (-1, 2 + N))
    at, names = ([corner[k] for corner in corners] for k in (1, 0))
    vertices, sums = meeting_faces(at, names, integrals[:, 2:])
    m, integrals = len(vertices), sums @ integrals
    weights, gaps, normals = integrals[:, 0], integrals[:, 1], integrals[:, 2:]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    if means is None:
        means = csr_matrix((np.ones(m), (np.arange(m), vertices)), shape=(m, nodes))
    else:
        means = diags(1 / weights) @ sums @ means
    rows = rows_along(normals, means, vertices=vertices, gaps=gaps / weights, weights=weights)
    return rows.movable(supports.free)


Corner = tuple[str, int, np.ndarray]
"""A corner of a contact facet: boundary, vertex, integrals with its hat of 1, gap and normal."""


def _corners(problem: Problem) -> tuple[list[Corner], csr_matrix | None]:
    """The corners of all contact facets; for order two means of functions too, (corners, nodes)."""
    mesh, order = problem.mesh, problem.order
    linear, scalar = H1(mesh, order=1), H1(mesh, order=order)
    rules, found, entries = rules_of(problem.N - 1, 2 if order == 1 else 6), [], []
    for name in problem.contact_names:
        region, psi = mesh.Boundaries(name), problem.gaps[name]
        points = mesh.MapToAllElements(rules, region)
        if not len(points):
            continue
        normals, gaps = np.asarray(problem.normal(points)), np.ravel(psi(points))
        given = np.column_stack([np.ones(len(points)), gaps, normals.reshape(len(points), -1)])
        given *= surface_measure(problem, points)[:, None]
        first, gaps = 0, iter(values_at(psi, mesh, name)[1][:, 0])
        for facet in region.Elements():
            number = ElementId(BND, facet.nr)
            rule = rules[linear.GetFE(number).type]
            here, first = given[first : first + len(rule)], first + len(rule)
            hats = _shapes(linear, number, rule).T * np.array(rule.weights)
            means, nodes = (
                (hats * here[:, 0]) @ _shapes(scalar, number, rule),
                scalar.GetDofNrs(number),
            )
            for vertex, integrals, row in zip(facet.vertices, hats @ here, means, strict=True):
                if order == 1:
                    integrals[1] = integrals[0] * next(gaps)
                else:
                    entries += [(len(found), *e) for e in zip(nodes, row, strict=True)]
                found.append((name, vertex.nr, integrals))
    if not entries:
        return found, None
    row, column, values = np.transpose(entries)
    return found, csr_matrix((values, (row, column)), shape=(len(found), scalar.ndof))


def _shared(corners: list[Corner], problem: Problem) -> list[Corner]:
    """The corners with those that other processes have at common vertices, in one order on all."""
    processes, sent = problem.processes, {}
    if processes.size == 1:
        return corners
    for rank, nodes in processes.copies.items():
        place = {node: k for k, node in enumerate(nodes.tolist())}
        sent[rank] = [(name, place[v], given) for name, v, given in corners if v in place]
    found = {processes.rank: corners}
    for rank, theirs in processes.traded(sent).items():
        nodes = processes.copies[rank].tolist()
        found[rank] = [(name, nodes[v], given) for name, v, given in theirs]
    return [corner for rank in sorted(found) for corner in found[rank]]


def _shapes(space: FESpace, number: ElementId, rule: IntegrationRule) -> np.ndarray:
    """The shape functions of a facet at the points of a rule, shape (points, k)."""
    element = space.GetFE(number)
    return np.array([np.array(element.CalcShape(*point)) for point in rule.points])


def surface_measure(problem: Problem, points: np.ndarray) -> np.ndarray:
    """Surface per reference facet at mapped points, times 2 pi r where the body is a ring."""
    N = problem.N
    J = specialcf.JacobianMatrix(N, N - 1)(points).reshape(-1, N, N - 1)
    area = np.sqrt(np.linalg.det(J.transpose(0, 2, 1) @ J))
    return area * np.ravel(problem.kinematics.weight(points))
