"""Where the facets of two surfaces face each other: points of integration on their overlaps.

A facet of the first surface is intersected with those of the second as seen along the normals
of the first: segments by projection along its interpolated normals, triangles in its plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from ngsolve import BND, ET, H1, ElementId, IntegrationRule
from scipy.spatial import cKDTree

from ngepc.model.problem import Problem

RULES = {2: IntegrationRule(ET.SEGM, 5), 3: IntegrationRule(ET.TRIG, 4)}
"""Space dimension -> rule on each piece: exact for products of quadratic functions in the plane."""

THIN = 1e-12  # overlaps below this part of a facet are none
PARALLEL = 1e-10  # sine of the angle below which two sides do not cross


@dataclass(frozen=True, eq=False)
class Surface:
    """The facets of some boundaries, straight, with N vertices each."""

    numbers: np.ndarray  # of the boundary elements, shape (facets,)
    vertices: np.ndarray  # numbers, shape (facets, N)
    corners: np.ndarray  # coordinates, shape (facets, N, N)
    normals: np.ndarray  # unit outer ones of the facets, shape (facets, N)
    nodal: np.ndarray  # unit normals at the corners, averaged over the facets, (facets, N, N)

    @classmethod
    def of(cls, problem: Problem, names: tuple[str, ...]) -> Surface:
        """The surface of these boundaries; a ValueError if a facet is no segment or triangle."""
        mesh, N = problem.mesh, problem.N
        region = mesh.Boundaries("|".join(names))
        facets = list(region.Elements())
        if any(len(facet.vertices) != N for facet in facets):
            raise ValueError(f"contact between {names} and another body needs triangular facets")
        vertices = np.array([[v.nr for v in facet.vertices] for facet in facets])
        corners = np.asarray(mesh.ngmesh.Coordinates())[vertices, :N]
        middle = IntegrationRule(points=[(1 / N,) * (N - 1)], weights=[1.0])
        shape = {2: ET.SEGM, 3: ET.TRIG}[N]
        outward = np.asarray(problem.normal(mesh.MapToAllElements({shape: middle}, region)))
        normals = _areas(corners)
        normals *= np.sign((normals * outward.reshape(-1, N)).sum(axis=1))[:, None]
        sums = np.zeros((mesh.nv, N))
        for k in range(N):
            np.add.at(sums, vertices[:, k], normals)
        numbers = np.array([facet.nr for facet in facets])
        return cls(numbers, vertices, corners, _unit(normals), _unit(sums)[vertices])

    @property
    def centres(self) -> np.ndarray:
        """Midpoints of the facets, shape (facets, N)."""
        return self.corners.mean(axis=1)

    @property
    def radii(self) -> np.ndarray:
        """Largest distance of a corner from the midpoint, shape (facets,)."""
        return np.linalg.norm(self.corners - self.centres[:, None], axis=2).max(axis=1)

    def shapes(self, space: H1, facets: np.ndarray, lam: np.ndarray) -> tuple[np.ndarray, ...]:
        """Nodes and shape functions at barycentric coordinates lam (n, N), both (n, k)."""
        nodes = np.array([space.GetDofNrs(ElementId(BND, int(i))) for i in self.numbers])
        N, k = lam.shape[1], nodes.shape[1]
        if k == N:
            return nodes[facets], lam
        element = space.GetFE(ElementId(BND, int(self.numbers[0])))
        pairs = np.array([*combinations_with_replacement(range(N), 2)])
        known = np.eye(N)[pairs].mean(axis=1)
        values = [np.array(element.CalcShape(*point[:-1])) for point in known]
        shapes = np.linalg.solve(known[:, pairs].prod(axis=2), values)
        return nodes[facets], lam[:, pairs].prod(axis=2) @ shapes


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
    i, j = _candidates(one, two)
    N = one.corners.shape[-1]
    first, lam, other, share = (_segments if N == 2 else _triangles)(one, two, i, j)
    i, j = i[first], j[first]
    normals = _unit(_between(one.nodal[i], lam))
    gaps = ((_between(two.corners[j], other) - _between(one.corners[i], lam)) * normals).sum(axis=1)
    near = gaps > -(one.radii[i] + two.radii[j])
    parts = i, j, lam, other, share, normals, gaps
    return Overlap(*(part[near] for part in parts))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """The vectors divided by their lengths."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _between(corners: np.ndarray, lam: np.ndarray) -> np.ndarray:
    """Points (n, N) at barycentric coordinates (n, N) between corners (n, N, N)."""
    return np.einsum("pk,pkc->pc", lam, corners)


def _areas(corners: np.ndarray) -> np.ndarray:
    """Normals of the facets, as long as these are large."""
    sides = corners[:, 1:] - corners[:, :1]
    if corners.shape[-1] == 2:
        return np.stack([sides[:, 0, 1], -sides[:, 0, 0]], axis=1)
    return 0.5 * np.cross(sides[:, 0], sides[:, 1])


def _candidates(one: Surface, two: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets that are close and face each other."""
    tree = cKDTree(two.centres)
    nearest, _ = tree.query(one.centres)
    found = tree.query_ball_point(one.centres, nearest + one.radii + 2 * two.radii.max())
    i = np.repeat(np.arange(len(found)), [len(part) for part in found])
    j = np.concatenate([np.asarray(part, dtype=int) for part in found])
    facing = np.einsum("pc,pc->p", one.normals[i], two.normals[j]) < 0
    return i[facing], j[facing]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cross product of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _segments(one: Surface, two: Surface, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pair of each point, both coordinates, and the length that belongs to it."""
    a, b = one.corners[i, 0], one.corners[i, 1]
    n_a, n_b = one.nodal[i, 0], one.nodal[i, 1]
    ends = [_seen_from(a, b, n_a, n_b, two.corners[j, k]) for k in range(2)]
    low, high = np.maximum(np.minimum(*ends), 0.0), np.minimum(np.maximum(*ends), 1.0)
    kept = np.flatnonzero(high - low > THIN)
    rule = RULES[2]
    x, w = np.array([p[0] for p in rule.points]), np.array(rule.weights)
    t = (low[kept, None] + (high - low)[kept, None] * x).ravel()
    pair = np.repeat(kept, len(x))
    here = a[pair] + t[:, None] * (b - a)[pair]
    normal = n_a[pair] + t[:, None] * (n_b - n_a)[pair]
    start, side = two.corners[j[pair], 0], two.corners[j[pair], 1] - two.corners[j[pair], 0]
    s = _cross(here - start, normal) / _cross(side, normal)
    length = np.linalg.norm((b - a)[pair], axis=1) * (high - low)[pair]
    weights = length * np.tile(w, len(kept))
    return pair, np.stack([1 - t, t], axis=1), np.stack([1 - s, s], axis=1), weights


def _seen_from(
    a: np.ndarray, b: np.ndarray, n_a: np.ndarray, n_b: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """t with (a + t (b - a) - y) parallel to n_a + t (n_b - n_a), by Newton's method."""
    side, turn = b - a, n_b - n_a
    t = np.einsum("pc,pc->p", y - a, side) / np.einsum("pc,pc->p", side, side)
    for _ in range(8):
        offset, normal = a + t[:, None] * side - y, n_a + t[:, None] * turn
        t = t - _cross(offset, normal) / (_cross(side, normal) + _cross(offset, turn))
    return t


def _triangles(one: Surface, two: Surface, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, ...]:
    """Pair of each point, both coordinates, and the area that belongs to it."""
    origin = one.corners[i, 0]
    e_1 = one.corners[i, 1] - origin
    e_1 /= np.linalg.norm(e_1, axis=1)[:, None]
    frame = np.stack([e_1, np.cross(one.normals[i], e_1)], axis=1)
    A, B = (
        np.einsum("pac,pkc->pka", frame, x - origin[:, None])
        for x in (one.corners[i], two.corners[j])
    )
    size = one.radii[i] ** 2
    apart = (B.min(axis=1) >= A.max(axis=1)) | (B.max(axis=1) <= A.min(axis=1))
    flat = np.abs(_cross(B[:, 1] - B[:, 0], B[:, 2] - B[:, 0])) <= THIN * size
    kept = np.flatnonzero(~apart.any(axis=1) & ~flat)
    polygon, valid = _intersection(A[kept], B[kept])
    middle = np.einsum("pkc,pk->pc", polygon, valid) / np.maximum(valid.sum(axis=1), 1)[:, None]
    spokes = polygon - middle[:, None]
    angle = np.where(valid, np.arctan2(spokes[..., 1], spokes[..., 0]), np.inf)
    order = np.argsort(angle, axis=1)
    first = order[:, :1]
    order = np.where(np.take_along_axis(valid, order, axis=1), order, first)
    spokes = np.take_along_axis(spokes, order[..., None], axis=1)
    following = np.roll(spokes, -1, axis=1)
    area = 0.5 * np.abs(_cross(spokes, following)) * (valid.sum(axis=1) > 2)[:, None]
    pair, fan = np.nonzero(area > THIN * size[kept, None])
    rule = RULES[3]
    x, w = np.array([p[:2] for p in rule.points]), 2 * np.array(rule.weights)
    points = middle[pair, None] + x[:, :1] * spokes[pair, fan, None]
    points = (points + x[:, 1:] * following[pair, fan, None]).reshape(-1, 2)
    weights = (area[pair, fan, None] * w).ravel()
    pair = np.repeat(kept[pair], len(w))
    return pair, _barycentric(A[pair], points), _barycentric(B[pair], points), weights


def _intersection(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the intersections of pairs of triangles, (pairs, 15, 2), and which are some."""
    inside = [(_barycentric(T[:, None], x) >= -THIN).all(axis=-1) for T, x in ((A, B), (B, A))]
    a, b = (np.roll(T, -1, axis=1) - T for T in (A, B))
    across = _cross(a[:, :, None], b[:, None])
    offset = B[:, None] - A[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = _cross(offset, b[:, None]) / across, _cross(offset, a[:, :, None]) / across
    lengths = [np.linalg.norm(side, axis=2) for side in (a, b)]
    oblique = np.abs(across) > PARALLEL * lengths[0][:, :, None] * lengths[1][:, None]
    crosses = oblique & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    points = A[:, :, None] + np.where(crosses, s, 0.0)[..., None] * a[:, :, None]
    polygon = np.concatenate([B, A, points.reshape(len(A), 9, 2)], axis=1)
    return polygon, np.concatenate([*inside, crosses.reshape(len(A), 9)], axis=1)


def _barycentric(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (..., 3) of points (..., 2) in triangles (..., 3, 2)."""
    u, v, x = T[..., 1, :] - T[..., 0, :], T[..., 2, :] - T[..., 0, :], points - T[..., 0, :]
    area = _cross(u, v)
    second, third = _cross(x, v) / area, _cross(u, x) / area
    return np.stack([1 - second - third, second, third], axis=-1)
