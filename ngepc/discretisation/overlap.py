"""The overlap of two surfaces that face each other: facets clipped by facets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import scipy
from ngsolve import BND, ET, H1, ElementId, IntegrationRule
from scipy.sparse import csr_matrix

from ngepc.discretisation.rows import meeting_faces
from ngepc.model.problem import Problem

RULES = {2: IntegrationRule(ET.SEGM, 5), 3: IntegrationRule(ET.TRIG, 4)}
"""Space dimension -> rule on each piece: exact for products of quadratic functions in the plane."""


CHUNK = 2000  # facets of the first surface whose pairs are held in memory at once


THIN = 1e-12  # smaller overlaps, as a part of a facet, are neglected


OUTSIDE = 1e-6
"""Barycentric coordinates below minus this are not on a facet: where a surface curves away from the
other one, lines along its normals pass by."""


class Surface:
    """The facets of some boundaries, straight, with N vertices each."""

    vertices: np.ndarray  # numbers, shape (facets, N)
    corners: np.ndarray  # coordinates, shape (facets, N, N)
    normals: np.ndarray  # unit outer ones of the facets, shape (facets, N)
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
        self.normals = unit_vectors(turned)

    @cached_property
    def nodal(self) -> np.ndarray:
        """Unit normals at the corners, averaged over the facets of a face, (facets, N, N)."""
        face, sums = self.faces(self.vertices)
        turned = self.areas[:, None] * self.normals
        at_corners = np.repeat(turned, self.corners.shape[-1], axis=0)
        return unit_vectors(sums @ at_corners)[face]

    def faces(self, nodes: np.ndarray) -> tuple[np.ndarray, csr_matrix]:
        """Numbers of the faces at nodes of the facets, like ``nodes``, (facets, k), in its order.

        And the matrix that sums over the facets of a face, shape (faces, facets k).  Facets whose
        normals differ much belong to two faces, as on obstacles (``meeting_faces``).
        """
        facets, k = nodes.shape
        normals = np.repeat(self.normals, k, axis=0)
        _, sums = meeting_faces(nodes.ravel(), np.zeros(nodes.size), normals)
        return sums.tocsc().indices.reshape(facets, k), sums

    def nodes(self, space: H1) -> np.ndarray:
        """The nodes of a space on the facets in the order of ``pairs_of``, shape (facets, k)."""
        nodes = self._unknowns(space)
        N = self.corners.shape[-1]
        if nodes.shape[1] == N:
            return nodes
        places = np.eye(N)[pairs_of(N, 2)].mean(axis=1)
        values = np.abs(self._shapes_at(space, places))
        at_corner = values[:, :N].max(axis=1) > 1 - 1e-9
        corner = values[:, :N].argmax(axis=1)
        edge = N + values[:, N:].argmax(axis=1)
        return nodes[:, np.where(at_corner, corner, edge)]

    def _unknowns(self, space: H1) -> np.ndarray:
        """The unknowns of a space on the facets in NGSolve's order, shape (facets, k)."""
        return np.array([space.GetDofNrs(number) for number in self._numbers])

    def _shapes_at(self, space: H1, places: np.ndarray) -> np.ndarray:
        """The shape functions on a facet at barycentric coordinates (n, N), shape (n, k)."""
        element = space.GetFE(self._numbers[0])
        return np.array([element.CalcShape(*place[:-1]) for place in places])

    def means(self, space: H1, facets: np.ndarray, lam: np.ndarray) -> csr_matrix:
        """A function of a space at barycentric coordinates lam (n, N), shape (n, nodes)."""
        nodes = self._unknowns(space)[facets]
        points, k = nodes.shape
        shapes = lam if k == lam.shape[1] else self._quadratic_shapes(space, lam)
        rows = np.repeat(np.arange(points), k)
        entries = shapes.ravel(), (rows, nodes.ravel())
        return csr_matrix(entries, shape=(points, space.ndof))

    def _quadratic_shapes(self, space: H1, lam: np.ndarray) -> np.ndarray:
        """The shape functions of order two at barycentric coordinates (n, N), shape (n, k).

        They are combinations of products of two coordinates, found from as many values.
        """
        N = lam.shape[1]
        pairs = np.array([*combinations_with_replacement(range(N), 2)])
        known = np.eye(N)[pairs].mean(axis=1)
        at_known = known[:, pairs].prod(axis=2)
        factors = np.linalg.solve(at_known, self._shapes_at(space, known))
        return lam[:, pairs].prod(axis=2) @ factors


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

    shares, of_rule = _barycentric_rule(N)
    count = len(of_rule)
    lam = (shares @ pieces[pair, piece]).reshape(len(pair) * count, N)
    areas = size[pair, piece] * one.areas[i[pair]]
    weights = areas[:, None] * of_rule / of_rule.sum()
    i = np.repeat(i[pair], count)
    j = np.repeat(j[pair], count)

    here = _interpolated(one.corners[i], lam)
    normals = unit_vectors(_interpolated(one.nodal[i], lam))
    other = _hit(two.corners[j], here, normals if N == 2 else one.normals[i])
    there = _interpolated(two.corners[j], other)
    gaps = ((there - here) * normals).sum(axis=1)
    near = gaps > -(one.radii[i] + two.radii[j])
    near &= other.min(axis=1) > -OUTSIDE
    parts = i, j, lam, other, weights.ravel(), normals, gaps
    return tuple(part[near] for part in parts)


def _barycentric_rule(N: int) -> tuple[np.ndarray, np.ndarray]:
    """The barycentric points (q, N) and the weights of the rule on a facet."""
    x = np.array([point[: N - 1] for point in RULES[N].points])
    shares = np.column_stack([1 - x.sum(axis=1), x])
    return shares, np.array(RULES[N].weights)


def _candidates(one: Surface, two: Surface) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of facets that are close and face each other, for some facets after the other.

    Facets of the second surface of one size have a tree, so that a large one among small ones is no
    neighbour of all.  In space a facet looks along its own normal: facets whose circles do not
    overlap along it are left out.
    """
    nearest, _ = scipy.spatial.cKDTree(two.centres).query(one.centres)
    reach = nearest + one.radii
    sizes = np.floor(np.log2(two.radii / two.radii.min()))
    alike = [np.flatnonzero(sizes == size) for size in np.unique(sizes)]
    trees = [(some, scipy.spatial.cKDTree(two.centres[some])) for some in alike]
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
    tree: scipy.spatial.cKDTree,
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


def unit_vectors(vectors: np.ndarray) -> np.ndarray:
    """The vectors divided by their lengths."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _interpolated(corners: np.ndarray, lam: np.ndarray) -> np.ndarray:
    """Points (n, N) at barycentric coordinates (n, N) between corners (n, N, N)."""
    return np.einsum("pk,pkc->pc", lam, corners)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
