"""Contact as rows on the nodal displacements: N u <= gaps, with forces lambda >= 0.

A row belongs to a vertex of the contact boundary and to one of the faces that meet there: facets
whose normals differ little are one face, so that a curved face has one row at a vertex, with the
averaged normal, and a vertex on the edge between two faces has two, each with its own gap.

For displacements of order one a row is n . u at the vertex.  For order two it is the mean
int phi n . u / int phi with the hat function phi of the vertex: the weights int phi are positive in
every dimension, which those of the nodal values of quadratic triangles are not.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from ngsolve import BND, ET, H1, ElementId, IntegrationRule, specialcf
from scipy.sparse import csr_matrix, vstack

from ngepc.discretisation.loads import Supports
from ngepc.model.problem import Problem

SAME_FACE = 0.7
"""Cosine above which facets of one boundary at a vertex belong to one face."""

SAME_FACE_ACROSS = 0.985
"""The same for facets of two boundaries."""

HELD = 1e-8
"""A row with a smaller free part is held by the support: no contact can happen there."""

_HATS = {
    ET.SEGM: lambda x: (x[0], 1 - x[0]),
    ET.TRIG: lambda x: (x[0], x[1], 1 - x[0] - x[1]),
    ET.QUAD: lambda x: (
        (1 - x[0]) * (1 - x[1]),
        x[0] * (1 - x[1]),
        x[0] * x[1],
        (1 - x[0]) * x[1],
    ),
}


_ARRAYS = ("gaps", "weights", "vertices", "normals", "tangents", "tied")


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The contact condition N u <= gaps; u flattened node by node, N components each.

    Parameters
    ----------
    normal
        N, sparse, shape (m, nodes N).
    tangential
        Tangential displacements of the rows, sparse, shape (m (N - 1), nodes N).
    gaps
        Distance to the obstacle (length), shape (m,).
    weights
        Area that belongs to each row (length for N = 2, area for N = 3), shape (m,).
    vertices
        Vertex of each row, shape (m,).
    normals
        Unit outer normals, shape (m, N).
    tangents
        Orthonormal tangents, shape (m, N - 1, N).
    tied
        Boolean, shape (m,): rows of glued bodies, N u = gaps with forces of either sign.
    """

    normal: csr_matrix
    tangential: csr_matrix
    gaps: np.ndarray
    weights: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    tangents: np.ndarray
    tied: np.ndarray

    def __len__(self) -> int:
        return len(self.gaps)

    def chosen(self, rows: np.ndarray) -> ContactRows:
        """Some of the rows, by their numbers."""
        d = self.tangents.shape[1]
        tangents = (d * rows[:, None] + np.arange(d)).ravel()
        return ContactRows(
            normal=self.normal[rows],
            tangential=self.tangential[tangents],
            **{name: getattr(self, name)[rows] for name in _ARRAYS},
        )

    def forces(self, multipliers: np.ndarray) -> np.ndarray:
        """N' lambda, the nodal forces that the body exerts on the obstacle, (nodes, N)."""
        return (self.normal.T @ multipliers).reshape(-1, self.normals.shape[1])

    def slip(self, u: np.ndarray) -> np.ndarray:
        """Tangential displacements of the rows, shape (m, N - 1)."""
        return (self.tangential @ u.ravel()).reshape(len(self), -1)

    def friction_forces(self, multipliers: np.ndarray) -> np.ndarray:
        """T' lambda_t for tangential multipliers (m, N - 1), shape (nodes, N)."""
        return (self.tangential.T @ multipliers.ravel()).reshape(-1, self.normals.shape[1])


def joined(parts: list[ContactRows]) -> ContactRows:
    """The rows of several parts, one after the other."""
    return ContactRows(
        normal=vstack([part.normal for part in parts], format="csr"),
        tangential=vstack([part.tangential for part in parts], format="csr"),
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS},
    )


@dataclass
class _Face:
    """What the facets of one face at a vertex add up to."""

    name: str
    normal: np.ndarray
    weight: float = 0.0
    gap: float = 0.0
    means: dict[int, np.ndarray] = field(default_factory=dict)

    def takes(self, name: str, normal: np.ndarray) -> bool:
        least = SAME_FACE if name == self.name else SAME_FACE_ACROSS
        return self.normal @ normal > least * np.linalg.norm(self.normal) * np.linalg.norm(normal)


@dataclass(frozen=True)
class _Corner:
    """One corner of one contact facet: integrals with the hat function of the vertex."""

    name: str
    vertex: int
    normal: np.ndarray
    weight: float
    gap: float
    gap_there: float
    nodes: np.ndarray
    means: np.ndarray


def contact_rows(problem: Problem, supports: Supports) -> ContactRows:
    """The discrete contact condition of a problem; no rows without a contact boundary."""
    faces: dict[int, list[_Face]] = {}
    for corner in _shared(_corners(problem), problem):
        here = faces.setdefault(corner.vertex, [])
        face = next((f for f in here if f.takes(corner.name, corner.normal)), None)
        if face is None:
            face = _Face(corner.name, np.zeros(problem.N))
            here.append(face)
        face.normal = face.normal + corner.normal
        face.weight += corner.weight
        face.gap += corner.gap if problem.order == 2 else corner.gap_there * corner.weight
        for node, mean in zip(corner.nodes.tolist(), corner.means, strict=True):
            face.means[node] = face.means.get(node, 0.0) + mean
    found = [(vertex, face) for vertex, here in sorted(faces.items()) for face in here]
    return _assembled(problem, supports, found)


def _assembled(problem: Problem, supports: Supports, found: list[tuple[int, _Face]]) -> ContactRows:
    N, free = problem.N, supports.free
    normals = np.array([f.normal / np.linalg.norm(f.normal) for _, f in found]).reshape(-1, N)
    tangents = tangent_frames(normals)
    normal = _sparse(found, normals, problem.order, free.size)
    part = normal.multiply(free.ravel()[None, :]).tocsr()
    keep = np.flatnonzero(np.sqrt(part.multiply(part).sum(axis=1)).A1 > HELD)
    found, normals, tangents = [found[i] for i in keep], normals[keep], tangents[keep]
    stacked = [_sparse(found, tangents[:, k], problem.order, free.size) for k in range(N - 1)]
    tangential = interleaved(stacked, free.size)
    return ContactRows(
        normal=normal[keep],
        tangential=tangential,
        gaps=np.array([f.gap / f.weight for _, f in found]),
        weights=np.array([f.weight for _, f in found]),
        vertices=np.array([vertex for vertex, _ in found], dtype=int),
        normals=normals,
        tangents=tangents,
        tied=np.zeros(len(found), dtype=bool),
    )


def tangent_frames(normals: np.ndarray) -> np.ndarray:
    """Orthonormal tangents (m, N - 1, N): (-n_y, n_x) for N = 2."""
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None, :]
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = np.cross(normals, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def _sparse(found: list, directions: np.ndarray, order: int, size: int) -> csr_matrix:
    """Rows d . u at the vertex, or int phi d . u / int phi, for one direction d of each row."""
    N = directions.shape[1]
    rows, columns, values = [], [], []
    for i, (vertex, face) in enumerate(found):
        means = {vertex: face.weight} if order == 1 else face.means
        for node, mean in means.items():
            rows += [i] * N
            columns += range(N * node, N * node + N)
            values += (mean / face.weight * directions[i]).tolist()
    return csr_matrix((values, (rows, columns)), shape=(len(found), size))


def interleaved(matrices: list[csr_matrix], size: int) -> csr_matrix:
    """Row i of each matrix, then row i + 1 of each."""
    m, k = matrices[0].shape[0], len(matrices)
    parts = [M.tocoo() for M in matrices]
    rows = np.concatenate([k * part.row + number for number, part in enumerate(parts)])
    columns = np.concatenate([part.col for part in parts])
    return csr_matrix(
        (np.concatenate([part.data for part in parts]), (rows, columns)), shape=(m * k, size)
    )


def _shared(corners: Iterable[_Corner], problem: Problem) -> Iterable[_Corner]:
    """The corners with those that other processes have at common vertices, in one order on all."""
    processes = problem.processes
    if processes.size == 1:
        return corners
    corners, sent = list(corners), {}
    for rank, nodes in processes.copies.items():
        place = {node: k for k, node in enumerate(nodes.tolist())}
        here = [c for c in corners if c.vertex in place]
        sent[rank] = [replace(c, vertex=place[c.vertex]) for c in here]
    found = {processes.rank: corners}
    for rank, theirs in processes.traded(sent).items():
        nodes = processes.copies[rank]
        found[rank] = [replace(c, vertex=int(nodes[c.vertex])) for c in theirs]
    return chain.from_iterable(found[rank] for rank in sorted(found))


def _corners(problem: Problem) -> Iterator[_Corner]:
    """The corners of all contact facets."""
    mesh, scalar = problem.mesh, H1(problem.mesh, order=problem.order)
    for name in problem.contact_names:
        region, psi = mesh.Boundaries(name), problem.gaps[name]
        facets = list(region.Elements())
        if not facets:
            continue
        inside, corners = (
            mesh.MapToAllElements({shape: rules[shape] for shape in _HATS}, region)
            for rules in (_rules(problem.order), _CORNERS)
        )
        normals = np.asarray(problem.normal(inside)).reshape(len(inside), -1)
        gaps, gaps_there = (np.ravel(psi(points)) for points in (inside, corners))
        area = surface_measure(problem, inside)
        first = first_corner = 0
        for facet in facets:
            number = ElementId(BND, facet.nr)
            element, nodes = scalar.GetFE(number), np.array(scalar.GetDofNrs(number))
            rule = _rules(problem.order)[element.type]
            here = slice(first, first + len(rule))
            first = here.stop
            weights = area[here] * np.array(rule.weights)
            shapes = np.array([np.array(element.CalcShape(*point)) for point in rule.points])
            hats = np.array([_HATS[element.type](point) for point in rule.points]).T * weights
            for k, (vertex, hat) in enumerate(zip(facet.vertices, hats, strict=True)):
                yield _Corner(
                    name,
                    vertex.nr,
                    hat @ normals[here],
                    float(hat.sum()),
                    float(hat @ gaps[here]),
                    float(gaps_there[first_corner + k]),
                    nodes,
                    hat @ shapes,
                )
            first_corner += len(facet.vertices)


def surface_measure(problem: Problem, points: np.ndarray) -> np.ndarray:
    """Surface per reference facet at mapped points, times 2 pi r where the body is a ring."""
    N = problem.N
    J = specialcf.JacobianMatrix(N, N - 1)(points).reshape(-1, N, N - 1)
    area = np.sqrt(np.linalg.det(J.transpose(0, 2, 1) @ J))
    return area * np.ravel(problem.kinematics.weight(points))


def _rules(order: int) -> dict[ET, IntegrationRule]:
    """Points on facets, for order two accurate enough for gaps that vary."""
    return {shape: IntegrationRule(shape, 2 if order == 1 else 6) for shape in _HATS}


_CORNERS = {
    shape: IntegrationRule(points=points, weights=[0.0] * len(points))
    for shape, points in {
        ET.SEGM: [(1.0,), (0.0,)],
        ET.TRIG: [(1.0, 0.0), (0.0, 1.0), (0.0, 0.0)],
        ET.QUAD: [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)],
    }.items()
}
