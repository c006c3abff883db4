"""Contact of two bodies as rows: means of the gap with biorthogonal functions on the first body.

With the Bernstein polynomials B_i of the first surface, hat functions for order one, and the
functions psi_i biorthogonal to them on each facet, int psi_i B_j = delta_ij int B_i over the part
that faces the second surface,

    N_i u = int psi_i n . (u_1 - u_2) / int psi_i,   gap_i likewise.

That is the coefficient of B_i in the projection of n . (u_1 - u_2) onto polynomials.  Constant
pressures pass between meshes that do not match without any error.  A facet of the second surface is
projected onto one of the first surface along its normals, which in the plane are interpolated
between its nodes; the projection is cut off where a barycentric coordinate becomes negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from ngsolve import BND, ET, H1, ElementId, IntegrationRule
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from ngepc.checks.arguments import boundary_names
from ngepc.discretisation.loads import Supports
from ngepc.discretisation.rows import ContactRows, means_along, rows_along
from ngepc.model.places import Contact
from ngepc.model.problem import Problem

RULES = {2: IntegrationRule(ET.SEGM, 5), 3: IntegrationRule(ET.TRIG, 4)}
"""Space dimension -> rule on each piece: exact for products of quadratic functions in the plane."""

CHUNK = 2000  # facets of the first surface whose pairs are held in memory at once
THIN = 1e-12  # smaller overlaps, as a part of a facet, are neglected
SLIVER = {1: 1e-8, 2: 1e-6}
"""Order -> smallest relative eigenvalue of a facet's mass matrix for biorthogonal functions."""

COVERED = 1e-6  # rows with a smaller fraction of the largest weight are left out


def mortar_rows(problem: Problem, supports: Supports, pair: Contact) -> ContactRows:
    """The contact rows at the first of two boundaries; a ValueError if they do not overlap."""
    one, two = surfaces_of(problem, pair)
    at = overlap(one, two)
    if not len(at.weights):
        raise ValueError(
            f"contact={pair!r}: the two boundaries nowhere face each other"
        )
    space = H1(problem.mesh, order=problem.order)
    means = _mortar_means(problem, space, one, at)
    jumps = one.means(space, at.first, at.lam) - two.means(space, at.second, at.other)
    free = supports.free[means.nodes]
    if pair.tied:
        return _tied_rows(means, jumps, free)
    normals = _unit(means.averages @ at.normals)
    rows = rows_along(
        normals,
        means.averages @ jumps,
        means.averages @ means_along(jumps, at.normals),
        gaps=means.averages @ at.gaps,
        nodes=means.nodes,
        corners=means.corners,
        weights=means.area,
        free=free,
    )
    return rows.chosen(rows.movable(supports.free))


def surfaces_of(problem: Problem, pair: Contact) -> tuple[Surface, Surface]:
    """The two surfaces of a contact pair."""
    first, second = (
        Surface(problem, boundary_names("contact", names, problem.mesh))
        for names in (pair.first, pair.second)
    )
    return first, second


@dataclass(frozen=True, eq=False)
class MortarMeans:
    """Weighted means over the points of an overlap, one for each node of the first surface."""

    averages: csr_matrix  # shape (rows, points), every row sums to one
    nodes: np.ndarray  # node of each row
    corners: np.ndarray  # four corners of which a node is the mean, shape (rows, 4)
    area: np.ndarray  # length or area of each row


def _mortar_means(
    problem: Problem, space: H1, one: Surface, at: Overlap
) -> MortarMeans:
    """The means with biorthogonal functions; nodes that are hardly covered are left out."""
    points, N = at.lam.shape
    weights = at.weights
    if problem.kinematics.hoop:
        radius = (at.lam * one.corners[at.first, :, 0]).sum(axis=1)
        weights = 2 * np.pi * weights * radius
    nodes, first, row = np.unique(
        one.nodes(space)[at.first], return_index=True, return_inverse=True
    )
    share = weights[:, None] * biorthogonal(one, at, problem.order)
    per_facet = share.shape[1]
    where = row.ravel(), np.repeat(np.arange(points), per_facet)
    sums = csr_matrix((share.ravel(), where), shape=(len(nodes), points))
    area = np.asarray(sums.sum(axis=1)).ravel()
    kept = area > COVERED * area.max()

    facet = at.first[first[kept] // per_facet]
    local = four_corners(N, problem.order)[first[kept] % per_facet]
    return MortarMeans(
        averages=diags(1 / area[kept]) @ sums[kept],
        nodes=nodes[kept],
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


class Surface:
    """The facets of some boundaries, straight, with N vertices each."""

    vertices: np.ndarray  # numbers, shape (facets, N)
    corners: np.ndarray  # coordinates, shape (facets, N, N)
    normals: np.ndarray  # unit outer ones of the facets, shape (facets, N)
    nodal: (
        np.ndarray
    )  # unit normals at the corners, averaged over the facets, (facets, N, N)
    areas: np.ndarray  # or lengths, shape (facets,), as are the next ones
    radii: np.ndarray  # largest distance of a corner from the centre

    def __init__(self, problem: Problem, names: tuple[str, ...]) -> None:
        mesh = problem.mesh
        N = problem.N
        region = mesh.Boundaries("|".join(names))
        facets = list(region.Elements())
        if any(len(facet.vertices) != N for facet in facets):
            raise ValueError(
                f"contact between {names} and another body needs triangular facets"
            )
        self._numbers = [ElementId(BND, facet.nr) for facet in facets]
        self.vertices = np.array([[v.nr for v in facet.vertices] for facet in facets])
        self.corners = np.asarray(mesh.ngmesh.Coordinates())[self.vertices, :N]
        self.centres = self.corners.mean(axis=1)
        self.radii = np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(
            axis=1
        )
        middle = IntegrationRule(points=[(1 / N,) * (N - 1)], weights=[1.0])
        shape = {2: ET.SEGM, 3: ET.TRIG}[N]
        outward = np.asarray(
            problem.normal(mesh.MapToAllElements({shape: middle}, region))
        )
        sides = self.corners[:, 1:] - self.corners[:, :1]
        turned = (
            sides[:, 0, ::-1] * [1, -1]
            if N == 2
            else 0.5 * np.cross(*sides.swapaxes(0, 1))
        )
        turned *= np.sign((turned * outward.reshape(-1, N)).sum(axis=1))[:, None]
        self.areas = np.linalg.norm(turned, axis=1)
        self.normals = _unit(turned)
        sums = np.zeros((mesh.nv, N))
        for column in self.vertices.T:
            np.add.at(sums, column, turned)
        self.nodal = _unit(sums)[self.vertices]

    def nodes(self, space: H1) -> np.ndarray:
        """The nodes of a space on the facets in the order of ``pairs_of``, shape (facets, k)."""
        nodes = np.array([space.GetDofNrs(number) for number in self._numbers])
        N = self.corners.shape[-1]
        if nodes.shape[1] == N:
            return nodes
        element = space.GetFE(self._numbers[0])
        places = np.eye(N)[pairs_of(N, 2)].mean(axis=1)
        values = np.abs([np.array(element.CalcShape(*p[:-1])) for p in places])
        corner = values[:, :N].max(axis=1) > 1 - 1e-9
        edge = N + values[:, N:].argmax(axis=1)
        return nodes[:, np.where(corner, values[:, :N].argmax(axis=1), edge)]

    def means(self, space: H1, facets: np.ndarray, lam: np.ndarray) -> csr_matrix:
        """A function of a space at barycentric coordinates lam (n, N), shape (n, nodes)."""
        nodes = np.array([space.GetDofNrs(number) for number in self._numbers])[facets]
        if nodes.shape[1] > lam.shape[1]:
            element = space.GetFE(self._numbers[0])
            N = lam.shape[1]
            pairs = np.array([*combinations_with_replacement(range(N), 2)])
            known = np.eye(N)[pairs].mean(axis=1)
            values = [np.array(element.CalcShape(*point[:-1])) for point in known]
            shapes = np.linalg.solve(known[:, pairs].prod(axis=2), values)
            lam = lam[:, pairs].prod(axis=2) @ shapes
        where = np.repeat(np.arange(len(lam)), nodes.shape[1]), nodes.ravel()
        return csr_matrix((lam.ravel(), where), shape=(len(lam), space.ndof))


@dataclass(frozen=True, eq=False)
class Overlap:
    """Points on the overlaps of the facets of two surfaces."""

    first: np.ndarray  # facets, shape (points,)
    second: np.ndarray
    lam: np.ndarray  # barycentric coordinates in both, shape (points, N)
    other: np.ndarray
    weights: np.ndarray  # length or area that belongs to each point, shape (points,)
    normals: np.ndarray  # unit ones of the first surface, shape (points, N)
    gaps: np.ndarray  # distance along the normal (length), shape (points,)


def overlap(one: Surface, two: Surface) -> Overlap:
    """The points on the overlaps of two surfaces that face each other."""
    N = one.corners.shape[-1]
    none = np.zeros((0, N))
    number = np.zeros(0, dtype=int)
    nothing = (number, number, none, none, np.zeros(0), none, np.zeros(0))
    pairs = (_overlaps(one, two, *found) for found in _candidates(one, two))
    parts = zip(nothing, *pairs, strict=True)
    return Overlap(*(np.concatenate(part) for part in parts))


def _overlaps(one: Surface, two: Surface, i: np.ndarray, j: np.ndarray) -> tuple:
    """The fields of ``Overlap`` for some pairs of facets, at least one."""
    N = one.corners.shape[-1]
    seen = _seen(one, i, two.corners[j])
    pieces = np.clip(seen, 0, 1)[:, None] if N == 2 else _fans(_clipped(seen))
    size = np.abs(np.linalg.det(pieces))
    pair, piece = np.nonzero(size > THIN)
    x = np.array([point[: N - 1] for point in RULES[N].points])
    w = np.array(RULES[N].weights)
    x = np.column_stack([1 - x.sum(axis=1), x])
    lam = (x @ pieces[pair, piece]).reshape(len(pair) * len(w), N)
    weights = (size[pair, piece] * one.areas[i[pair]])[:, None] * w / w.sum()
    i = np.repeat(i[pair], len(w))
    j = np.repeat(j[pair], len(w))
    here = _between(one.corners[i], lam)
    normals = _unit(_between(one.nodal[i], lam))
    other = _hit(two.corners[j], here, normals if N == 2 else one.normals[i])
    gaps = ((_between(two.corners[j], other) - here) * normals).sum(axis=1)
    near = gaps > -(one.radii[i] + two.radii[j])
    parts = i, j, lam, other, weights.ravel(), normals, gaps
    return tuple(part[near] for part in parts)


def _candidates(one: Surface, two: Surface) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of facets that are close and face each other, for some facets after the other.

    Facets of the second surface of one size have a tree, so that a large one among small ones is no
    neighbour of all.  In space a facet looks along its own normal: facets whose circles do not
    overlap along it are left out.
    """
    nearest, _ = cKDTree(two.centres).query(one.centres)
    reach = nearest + one.radii
    sizes = np.floor(np.log2(two.radii / two.radii.min()))
    alike = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    trees = [(some, cKDTree(two.centres[some])) for some in alike]
    for first in range(0, len(one.centres), CHUNK):
        chunk = np.arange(first, min(first + CHUNK, len(one.centres)))
        found = [_close(one, two, chunk, reach, some, tree) for some, tree in trees]
        i, j = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.lexsort((j, i))
        if len(order):
            yield i[order], j[order]


def _close(
    one: Surface,
    two: Surface,
    chunk: np.ndarray,
    reach: np.ndarray,
    some: np.ndarray,
    tree: cKDTree,
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of some facets of the first surface and those of one size of the second one."""
    far = reach[chunk] + 2 * two.radii[some].max()
    found = tree.query_ball_point(one.centres[chunk], far)
    counts = [len(part) for part in found]
    i = np.repeat(chunk, counts)
    j = some[np.concatenate([np.asarray(part, dtype=int) for part in found])]
    normals = one.normals[i]
    kept = np.einsum("pc,pc->p", normals, two.normals[j]) < 0
    if one.corners.shape[-1] == 3:
        apart = two.centres[j] - one.centres[i]
        apart -= np.einsum("pc,pc->p", apart, normals)[:, None] * normals
        sideways = np.linalg.norm(apart, axis=1)
        kept &= sideways <= (1 + THIN) * (one.radii[i] + two.radii[j])
    return i[kept], j[kept]


def _seen(one: Surface, i: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric coordinates in facets of points y along the normals, both (pairs, N, N)."""
    if y.shape[-1] == 3:
        corners, normals = (
            np.repeat(a[i], 3, axis=0) for a in (one.corners, one.normals)
        )
        return _hit(corners, y.reshape(-1, 3), normals).reshape(y.shape)
    a = one.corners[i, :1]
    n_a = one.nodal[i, :1]
    side = np.diff(one.corners[i], axis=1)
    turn = np.diff(one.nodal[i], axis=1)
    t = ((y - a) * side).sum(axis=2) / (side**2).sum(axis=2)
    for _ in range(8):  # Newton's method: a + t side - y is parallel to n_a + t turn
        offset = a + t[..., None] * side - y
        normal = n_a + t[..., None] * turn
        t = t - _cross(offset, normal) / (_cross(side, normal) + _cross(offset, turn))
    return np.stack([1 - t, t], axis=2)


def _hit(corners: np.ndarray, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n, N) where lines from points meet facets (n, N, N)."""
    sides = corners[:, 1:] - corners[:, :1]
    axes = np.concatenate([sides, direction[:, None]], axis=1)
    found = np.linalg.solve(axes.swapaxes(1, 2), (start - corners[:, 0])[..., None])[
        :, :-1, 0
    ]
    return np.column_stack([1 - found.sum(axis=1), found])


def _clipped(polygon: np.ndarray) -> np.ndarray:
    """Convex polygons (pairs, k, N) where no coordinate is negative; corners may be repeated."""
    for side in range(polygon.shape[-1]):
        following = np.roll(polygon, -1, axis=1)
        pairs, k, _ = polygon.shape
        a = polygon[..., side]
        b = following[..., side]
        crosses = (a >= 0) != (b >= 0)
        t = np.where(crosses, a / np.where(crosses, a - b, 1.0), 0.0)
        cut = polygon + t[..., None] * (following - polygon)
        both = np.stack([polygon, cut], axis=2).reshape(pairs, 2 * k, -1)
        valid = np.stack([a >= 0, crosses], axis=2).reshape(pairs, 2 * k)
        order = np.argsort(~valid, axis=1, kind="stable")[:, : k + 1]
        order = np.where(np.take_along_axis(valid, order, axis=1), order, order[:, :1])
        polygon = np.take_along_axis(both, order[..., None], axis=1)
        polygon *= valid.any(axis=1)[:, None, None]
    return polygon


def _fans(polygon: np.ndarray) -> np.ndarray:
    """Triangles from the first corner of polygons (pairs, k, 3), shape (pairs, k - 2, 3, 3)."""
    first = np.broadcast_to(polygon[:, :1], polygon[:, 2:].shape)
    return np.stack([first, polygon[:, 1:-1], polygon[:, 2:]], axis=2)


def pairs_of(N: int, order: int) -> np.ndarray:
    """Pairs of corners whose hat functions multiply to a Bernstein polynomial, shape (k, 2)."""
    if order == 1:
        return np.repeat(np.arange(N)[:, None], 2, axis=1)
    return np.array([*combinations_with_replacement(range(N), 2)])


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
    size = np.linalg.eigvalsh(mass)
    good = size[:, 0] > SLIVER[order] * size[:, -1]
    A = np.broadcast_to(np.eye(k), mass.shape).copy()
    A[good] = mass[good].sum(axis=2)[:, :, None] * np.linalg.inv(mass[good])
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


def _unit(vectors: np.ndarray) -> np.ndarray:
    """The vectors divided by their lengths."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _between(corners: np.ndarray, lam: np.ndarray) -> np.ndarray:
    """Points (n, N) at barycentric coordinates (n, N) between corners (n, N, N)."""
    return np.einsum("pk,pkc->pc", lam, corners)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
