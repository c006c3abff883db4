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

A gap may jump inside a facet; the polynomial through its nodes then says nothing.  Where it misses
the gap between the nodes, the coefficient is at least the smallest value of the gap at the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from ngsolve import BND, ET, H1, ElementId, FESpace, IntegrationRule, specialcf
from ngsolve.fem import FiniteElement
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import norm

from ngepc.discretisation.facets import (
    EDGES,
    MIDDLE,
    FacetNodes,
    facet_lattice,
    facet_nodes,
)
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.quadrature import rules_of
from ngepc.model.problem import Problem
from ngepc.model.processes import Team

SAME_FACE = (
    0.7  # cosine above which facets of one boundary at a vertex belong to one face
)
SAME_FACE_ACROSS = 0.985  # the same for facets of two boundaries
SHAPES = tuple(EDGES)
"""The shapes of facets."""

JUMP = 0.4
"""A gap jumps if it differs from its polynomial by more than this fraction of the difference
between the coefficient and the value at a node."""
ZERO_GAP = 1e-9  # smaller differences, as a fraction of the largest gap, are no jump
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
    nodes: np.ndarray  # node of each row in a scalar space, vertices first, (m,)
    corners: np.ndarray  # four vertices that the node is the mean of, repeated, (m, 4)
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
        part = self.normal @ diags(free.ravel().astype(float))
        return np.flatnonzero(norm(part, axis=1) > HELD)


@dataclass(frozen=True, eq=False)
class RowGaps:
    """The gaps of contact rows, from the gap at the nodes of the facets."""

    sums: csr_matrix  # adds up what the nodes of facets have, shape (all rows, records)
    weights: np.ndarray  # areas of the records
    coefficients: csr_matrix | None  # of order two, from means at the nodes of the rows
    chosen: np.ndarray  # rows that supports do not hold

    def __call__(self, gap: np.ndarray, least: np.ndarray) -> np.ndarray:
        """From the gap and the least coefficient of each record, shape (m,)."""
        sums = self.sums
        gaps = sums @ (self.weights * gap) / (sums @ self.weights)
        if self.coefficients is not None:
            lowest = np.maximum.reduceat(least[sums.indices], sums.indptr[:-1])
            gaps = np.maximum(self.coefficients @ gaps, lowest)
        return gaps[self.chosen]


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
    return rows_and_gaps(problem, supports)[0]


def rows_and_gaps(
    problem: Problem, supports: Supports
) -> tuple[ContactRows, RowGaps | None]:
    """The same with what gives the rows other gaps, None without a contact boundary."""
    own, means = _records(problem)
    records, means = _shared(own, means, problem.nodal_processes)
    weights = records["weight"]
    directions = weights[:, None] * records["normal"]
    nodes, sums = meeting_faces(records["node"], records["boundary"], directions)
    if not len(nodes):
        return _no_rows(problem), None
    first = sums.indices[sums.indptr[:-1]]  # one of the corners of each row
    normals = sums @ directions
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    area = sums @ weights

    coefficients = None
    means = means[first]
    along = means_along(means, normals)
    if problem.order == 2:
        coefficients = _coefficients(records, sums, first)
        means = coefficients @ means
        along = coefficients @ along
    at = {"nodes": nodes, "corners": records["corners"][first]}
    without_gaps = {"gaps": np.zeros(len(nodes)), "weights": area}
    rows = rows_along(normals, means, along, **at, **without_gaps)
    chosen = rows.movable(supports.free)
    gaps = RowGaps(sums, weights, coefficients, chosen)
    known = gaps(records["gap"], records["least"])
    return replace(rows.chosen(chosen), gaps=known), gaps


def _no_rows(problem: Problem) -> ContactRows:
    """The rows of a problem without a contact boundary."""
    N = problem.N
    count = H1(problem.mesh, order=problem.order).ndof
    none = np.zeros(0)
    return rows_along(
        np.zeros((0, N)),
        csr_matrix((0, count)),
        nodes=none.astype(int),
        corners=np.zeros((0, 4), dtype=int),
        gaps=none,
        weights=none,
    )


def _record_type(N: int) -> np.dtype:
    """The record type of a node of a facet."""
    whole = np.int64
    return np.dtype(
        [
            ("boundary", whole),  # number of its name
            ("node", whole),
            ("facet", whole),  # of a process
            ("rank", whole),  # of the process
            ("shape", whole),  # number in SHAPES
            ("local", whole),  # number of the node in the facet
            ("corners", whole, 4),  # vertices that the node is the mean of
            ("weight", float),  # integral of the polynomial of the node
            ("gap", float),
            ("least", float),  # of the coefficient of the gap
            ("normal", float, N),
        ]
    )


def _records(problem: Problem) -> tuple[np.ndarray, csr_matrix]:
    """All nodes of all contact facets, and the values there of functions, (records, nodes)."""
    scalar = H1(problem.mesh, order=problem.order)
    found = [np.zeros(0, dtype=_record_type(problem.N))]
    means = [csr_matrix((0, scalar.ndof))]
    facets = 0
    for number, name in enumerate(problem.contact_names):
        degree = 2 if problem.order == 1 else 6
        for shape, dofs, _, area, _ in mapped_facets(problem, scalar, name, degree):
            facet = facet_nodes(shape, problem.order)
            element = _element(problem, scalar, name, shape)
            nodes = dofs[:, facet.numbers(element)]
            rule = rules_of(problem.N - 1, degree)[shape]
            records = _records_of(problem, name, facet, nodes)
            records["boundary"] = number
            records["facet"] = facets + np.arange(len(dofs))[:, None]
            records["weight"] = area @ facet.basis(_places(rule, facet))
            found.append(records.ravel())
            means.append(_values_at_nodes(facet, element, dofs, scalar.ndof))
            facets += len(dofs)
    return np.concatenate(found), vstack(means, format="csr")


def _records_of(
    problem: Problem, name: str, facet: FacetNodes, nodes: np.ndarray
) -> np.ndarray:
    """The records of the nodes (facets, k) of the facets of a shape, same shape."""
    mesh = problem.mesh
    at = mesh.MapToAllElements({facet.shape: facet.rule}, mesh.Boundaries(name))
    gap, least = _gap_at_nodes(problem, name, facet)
    records = np.zeros(nodes.shape, dtype=_record_type(problem.N))
    records["node"] = nodes
    records["rank"] = problem.processes.rank
    records["shape"] = SHAPES.index(facet.shape)
    records["local"] = np.arange(nodes.shape[1])
    records["corners"] = nodes[:, facet.corners]
    records["gap"] = gap
    records["least"] = least
    normal = np.asarray(problem.normal(at))
    records["normal"] = normal.reshape(*nodes.shape, problem.N)
    return records


def _gap_at_nodes(
    problem: Problem, name: str, facet: FacetNodes
) -> tuple[np.ndarray, np.ndarray]:
    """The gap at the nodes of the facets of a shape, and its least coefficients, (facets, k)."""
    mesh = problem.mesh
    at = mesh.MapToAllElements({facet.shape: facet.rule}, mesh.Boundaries(name))
    gap = np.ravel(problem.gaps[name](at)).reshape(-1, len(facet.places))
    if facet.degree == 1:
        return gap, np.full(gap.shape, -np.inf)
    return gap, _least(problem, name, facet, gap)


def gap_records(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """The gap at the nodes of all contact facets, and its least coefficients, for ``RowGaps``."""
    gaps = []
    least = []
    for name in problem.contact_names:
        facets = problem.mesh.Boundaries(name).Elements()
        present = {facet.type for facet in facets}
        for shape in rules_of(problem.N - 1, 1):
            if shape in present:
                facet = facet_nodes(shape, problem.order)
                found = _gap_at_nodes(problem, name, facet)
                gaps.append(found[0].ravel())
                least.append(found[1].ravel())
    return np.concatenate(gaps), np.concatenate(least)


def _element(problem: Problem, space: FESpace, name: str, shape: ET) -> FiniteElement:
    """The functions of a space on the facets of a shape."""
    facets = problem.mesh.Boundaries(name).Elements()
    one = next(facet.nr for facet in facets if facet.type == shape)
    return space.GetFE(ElementId(BND, one))


def _places(rule: IntegrationRule, facet: FacetNodes) -> np.ndarray:
    """The points of a rule in the reference facet, shape (points, dimension)."""
    dimension = facet.places.shape[1]
    return np.array([point[:dimension] for point in rule.points])


def _values_at_nodes(
    facet: FacetNodes, element: FiniteElement, dofs: np.ndarray, count: int
) -> csr_matrix:
    """The values at the nodes of facets with unknowns (facets, k), shape (facets k, count)."""
    places = facet.places.tolist()
    shapes = np.array([np.array(element.CalcShape(*place)) for place in places])
    shapes[np.abs(shapes) < 1e-12] = 0.0
    values = np.broadcast_to(shapes, (len(dofs), *shapes.shape))
    columns = np.broadcast_to(dofs[:, None], values.shape)
    size = len(dofs) * len(places)
    where = np.arange(size).repeat(dofs.shape[1]), columns.ravel()
    result = csr_matrix((values.ravel(), where), shape=(size, count))
    result.eliminate_zeros()
    return result


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


def _least(
    problem: Problem, name: str, facet: FacetNodes, gap: np.ndarray
) -> np.ndarray:
    """Least coefficients of a gap that jumps, -inf elsewhere, from its values (facets, k)."""
    mesh = problem.mesh
    rule, owners = facet.check_points()
    at = mesh.MapToAllElements({facet.shape: rule}, mesh.Boundaries(name))
    between = np.ravel(problem.gaps[name](at)).reshape(len(gap), -1)
    coefficients = gap @ facet.coefficients.T
    off = np.abs(between - coefficients @ facet.basis(_places(rule, facet)).T)
    bend = np.abs(coefficients - gap)
    jumps = off > JUMP * bend[:, owners] + ZERO_GAP * np.abs(gap).max(initial=0.0)

    result = np.full(gap.shape, -np.inf)
    for node, row in enumerate(facet.coefficients):
        low = gap[:, row != 0].min(axis=1)
        jumping = jumps[:, owners == node].any(axis=1)
        result[:, node] = np.where(jumping, low, -np.inf)
    return result


def _coefficients(
    records: np.ndarray, sums: csr_matrix, first: np.ndarray
) -> csr_matrix:
    """Bernstein coefficients of the rows from values at their nodes, shape (rows, rows)."""
    row_of = np.empty(len(records), dtype=int)
    row_of[sums.indices] = np.repeat(np.arange(len(first)), np.diff(sums.indptr))
    most = 16  # larger than the number of nodes of a facet
    facet = np.unique(records[["rank", "facet"]], return_inverse=True)[1]
    key = most * facet.astype(np.int64) + records["local"]
    order = np.argsort(key)
    rows = []
    columns = []
    values = []
    for number, shape in enumerate(SHAPES):
        table = facet_nodes(shape, 2).coefficients
        for local, entries in enumerate(table):
            chosen = (records["shape"] == number) & (records["local"] == local)
            mine = np.flatnonzero(chosen[first])
            for other in np.flatnonzero(entries):
                wanted = most * facet[first[mine]].astype(np.int64) + other
                there = order[np.searchsorted(key, wanted, sorter=order)]
                rows.append(mine)
                columns.append(row_of[there])
                values.append(np.full(len(mine), entries[other]))
    where = np.concatenate(rows), np.concatenate(columns)
    size = len(first), len(first)
    return csr_matrix((np.concatenate(values), where), shape=size)


def deepest_overlap(problem: Problem, u: np.ndarray) -> float:
    """The largest u . n - gap at many points of the contact boundary (length), zero if none.

    From nodal displacements (nodes, N).
    """
    mesh = problem.mesh
    scalar = H1(mesh, order=problem.order)
    result = 0.0
    for name in problem.contact_names:
        region = mesh.Boundaries(name)
        for shape in {facet.type for facet in region.Elements()}:
            rule = facet_lattice(shape)
            element = _element(problem, scalar, name, shape)
            functions = np.array([np.array(element.CalcShape(*p)) for p in rule.points])
            alike = (f for f in region.Elements() if f.type == shape)
            dofs = [scalar.GetDofNrs(ElementId(BND, facet.nr)) for facet in alike]
            moved = np.einsum("qk,ekc->eqc", functions, u[np.array(dofs)])

            at = mesh.MapToAllElements({shape: rule}, region)
            normal = np.asarray(problem.normal(at)).reshape(moved.shape)
            gap = np.ravel(problem.gaps[name](at)).reshape(moved.shape[:2])
            depth = np.einsum("eqc,eqc->eq", moved, normal) - gap
            result = max(result, float(depth.max(initial=0.0)))
    return result


def _shared(
    records: np.ndarray, means: csr_matrix, processes: Team
) -> tuple[np.ndarray, csr_matrix]:
    """The records with those of other processes at common nodes, in the same order on all."""
    if processes.size == 1:
        return records, means
    own = processes.rank
    number = processes.numbers
    records = _renumbered(records, lambda nodes: number[nodes])
    sent = {}
    for rank, nodes in processes.copies.items():
        sent[rank] = records[np.isin(records["node"], number[nodes])]
    found = processes.traded(sent) | {own: records}
    order = np.argsort(number)
    every = np.concatenate([found[rank] for rank in sorted(found)])
    every = _renumbered(
        every, lambda nodes: order[np.searchsorted(number, nodes, sorter=order)]
    )
    parts = []
    for rank in sorted(found):
        if rank == own:
            parts.append(means)
            continue
        there = every[every["rank"] == rank]
        parts.append(_at_common_nodes(there, means.shape[1]))
    return every, vstack(parts, format="csr")


def _renumbered(
    records: np.ndarray, number: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """The records with other numbers of nodes."""
    result = records.copy()
    for name in ("node", "corners"):
        result[name] = number(records[name])
    return result


def _at_common_nodes(records: np.ndarray, count: int) -> csr_matrix:
    """Values at nodes on the boundary of a facet, corners and middles of edges, (n, count)."""
    corners = records["corners"]
    middle = corners[:, 0] != corners[:, 3]
    columns = np.column_stack([corners, records["node"]])
    values = np.column_stack(
        [np.full(corners.shape, 0.25), np.where(middle, MIDDLE, 0)]
    )
    where = np.arange(len(records)).repeat(5), columns.ravel()
    return csr_matrix((values.ravel(), where), shape=(len(records), count))
