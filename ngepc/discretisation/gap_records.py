"""Records of the nodes of contact facets: normal, weight, gap, shared between processes.

A gap may jump inside a facet; the polynomial that interpolates it at the nodes is then useless.
Where the polynomial differs from the gap between the nodes, its coefficient is at least the
smallest value of the gap at the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from ngsolve import (
    BND,
    CF,
    ET,
    H1,
    ElementId,
    FESpace,
    IntegrationRule,
    specialcf,
    x,
    y,
    z,
)
from ngsolve.fem import FiniteElement
from scipy.sparse import csr_matrix, vstack

from ngepc.discretisation.facets import (
    EDGES,
    MIDDLE,
    FacetNodes,
    facet_lattice,
    facet_nodes,
)
from ngepc.discretisation.narrow import clear_of
from ngepc.discretisation.quadrature import rules_of
from ngepc.discretisation.sampling import Scan, rounding_of_gaps
from ngepc.model.elements import regions_of
from ngepc.model.problem import Problem
from ngepc.model.processes import Team

SHAPES = tuple(EDGES)
"""The shapes of facets."""


JUMP = 0.4
"""A gap jumps if it differs from its polynomial by more than this fraction of the difference
between the coefficient and the value at a node."""


ZERO_GAP = 1e-9  # smaller differences, as a fraction of the largest gap, are no jump


class NodeGaps(NamedTuple):
    """Gaps of nodes of facets: arrays of the same shape, see ``_record_type``."""

    gap: np.ndarray
    coefficient: np.ndarray
    least: np.ndarray
    lowered: np.ndarray


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
            ("coefficient", float),  # of the gap on the facet alone
            ("least", float),  # of the coefficient of the gap
            ("lowered", float),  # by which it is lowered, ``narrow``
            ("normal", float, N),
        ]
    )


def facet_records(problem: Problem, scalar: FESpace) -> tuple[np.ndarray, csr_matrix]:
    """All nodes of all contact facets, and the values there of functions, (records, nodes).

    ``scalar`` is the space of one component of the displacement.
    """
    found = [np.zeros(0, dtype=_record_type(problem.N))]
    means = [csr_matrix((0, scalar.ndof))]
    facets = 0
    for number, name in enumerate(problem.contact_names):
        degree = 2 if problem.order == 1 else 6
        scan = scanned_gap(problem, name)
        for shape, dofs, _, area, at in mapped_facets(problem, scalar, name, degree):
            facet = facet_nodes(shape, problem.order)
            element = _element(problem, scalar, name, shape)
            nodes = dofs[:, facet.numbers(element)]
            rule = rules_of(problem.N - 1, degree)[shape]
            records = _records_of(problem, name, scan, facet, nodes)
            records["boundary"] = number
            records["facet"] = facets + np.arange(len(dofs))[:, None]
            around = np.reshape(problem.kinematics.weight(at), area.shape)
            records["weight"] = (area * around) @ facet.basis(_places(rule, facet))
            found.append(records.ravel())
            means.append(_values_at_nodes(facet, element, dofs, scalar.ndof))
            facets += len(dofs)
    return np.concatenate(found), vstack(means, format="csr")


def _records_of(
    problem: Problem, name: str, scan: Scan, facet: FacetNodes, nodes: np.ndarray
) -> np.ndarray:
    """The records of the nodes (facets, k) of the facets of a shape, same shape."""
    mesh = problem.mesh
    at = mesh.MapToAllElements({facet.shape: facet.rule}, mesh.Boundaries(name))
    records = np.zeros(nodes.shape, dtype=_record_type(problem.N))
    records["node"] = nodes
    records["rank"] = problem.processes.rank
    records["shape"] = SHAPES.index(facet.shape)
    records["local"] = np.arange(nodes.shape[1])
    records["corners"] = nodes[:, facet.corners]
    gaps = _gap_at_nodes(problem, name, scan, facet)
    for part, values in gaps._asdict().items():
        records[part] = values
    normal = np.asarray(problem.normal(at))
    records["normal"] = normal.reshape(*nodes.shape, problem.N)
    return records


def _gap_at_nodes(
    problem: Problem, name: str, scan: Scan, facet: FacetNodes
) -> NodeGaps:
    """The gaps of the nodes of the facets of a shape, arrays of shape (facets, k)."""
    mesh = problem.mesh
    region = mesh.Boundaries(name)
    at = mesh.MapToAllElements({facet.shape: facet.rule}, region)
    gap = np.ravel(problem.gaps[name](at)).reshape(-1, len(facet.places))
    least = np.full(gap.shape, -np.inf)
    if facet.degree == 2 and np.ptp(gap) != 0:  # a constant has no jumps
        least = _least(problem, name, facet, gap)
    coefficient = gap @ facet.coefficients.T
    if not len(scan.hidden):
        return NodeGaps(gap, coefficient, least, np.zeros(gap.shape))
    alike = [one.nr for one in region.Elements() if one.type == facet.shape]
    cleared = clear_of(scan, facet, np.array(alike), gap, least)
    return NodeGaps(gap, coefficient, *cleared)


def scanned_gap(problem: Problem, name: str) -> Scan:
    """The gap of a boundary on the lattice."""
    mesh = problem.mesh
    region = regions_of(mesh, mesh.dim - 1)
    there = np.array(mesh.Boundaries(name).Mask(), dtype=bool)[region]
    return Scan(mesh, problem.gaps[name], BND, there, rounding_of_gaps(mesh))


def nearer_between_nodes(problem: Problem) -> str:
    """A sentence about rows that are lowered by ``narrow.clear_of``; empty without."""
    if not problem.contact_names:
        return ""
    most = problem.processes.maximum(gap_records(problem).lowered)
    if most == 0.0:
        return ""
    return (
        f"An obstacle stands nearer between nodes by up to {most:.3g}: whole facets keep clear of "
        "it, and forces are too large where it touches; refine the contact boundary there."
    )


def gap_records(problem: Problem) -> NodeGaps:
    """The gaps of all nodes of facets of this process, one after the other."""
    found = [[np.zeros(0)] * len(NodeGaps._fields)]
    for name in problem.contact_names:
        scan = scanned_gap(problem, name)
        facets = problem.mesh.Boundaries(name).Elements()
        present = {facet.type for facet in facets}
        for shape in rules_of(problem.N - 1, 1):
            if shape in present:
                facet = facet_nodes(shape, problem.order)
                of_shape = _gap_at_nodes(problem, name, scan, facet)
                found.append([part.ravel() for part in of_shape])
    return NodeGaps(*map(np.concatenate, zip(*found, strict=True)))


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
    or length that belongs to them (facets, points), and the mapped points.
    """
    mesh = problem.mesh
    N = problem.N
    region = problem.mesh.Boundaries(name)
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
    rule, owners = facet.check_points
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


def row_coefficients(
    records: np.ndarray, sums: csr_matrix, first: np.ndarray
) -> csr_matrix:
    """Bernstein coefficients of the rows from values at their nodes, shape (rows, rows)."""
    row_of = np.empty(len(records), dtype=int)
    row_of[sums.indices] = np.repeat(np.arange(len(first)), np.diff(sums.indptr))
    most = 16  # larger than the number of nodes of a facet
    facet = records["rank"] * (records["facet"].max(initial=0) + 1) + records["facet"]
    key = most * facet + records["local"]
    order = np.argsort(key)
    rows = []
    columns = []
    values = []
    for number in np.unique(records["shape"]).tolist():
        table = facet_nodes(SHAPES[number], 2).coefficients
        for local, entries in enumerate(table):
            chosen = (records["shape"] == number) & (records["local"] == local)
            mine = np.flatnonzero(chosen[first])
            for other in np.flatnonzero(entries):
                wanted = most * facet[first[mine]] + other
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
    found = (float(depth.max(initial=0.0)) for depth, _ in overlaps(problem, u))
    return max(found, default=0.0)


def overlaps(
    problem: Problem, u: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """u . n - gap (length) at many points of the facets of rigid obstacles, and the points.

    Of shapes (points,) and (points, N), from nodal displacements (nodes, N).
    """
    mesh = problem.mesh
    scalar = H1(mesh, order=problem.order)
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
            along = np.einsum("eqc,eqc->eq", moved, normal).ravel()
            places = np.asarray(CF((x, y, z)[: problem.N])(at))
            yield along - np.ravel(problem.gaps[name](at)), places


def shared_records(
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
