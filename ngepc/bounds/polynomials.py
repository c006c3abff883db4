"""Polynomials on triangles and tetrahedra: splitting and integration.

The coefficients of an affine function are its values at the vertices; those of a quadratic function
on a triangle are its Bernstein coefficients, vertices first.  Values lie in the convex hull of the
coefficients.  The keys of tables are numbers of coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from ngsolve import ET, IntegrationRule

from ngepc.bounds.simplices import EDGES, FACETS

NODES = {9: 3, 16: 4, 18: 6}  # nodes of each part by those of a cell


def quadratics(shares: np.ndarray, others: np.ndarray | None = None) -> np.ndarray:
    """Bernstein's polynomials of degree two at barycentric points (q, 3 or 4), (q, 6 or 10).

    With ``others``: their polar forms, which are symmetric and affine in either point.
    """
    others = shares if others is None else others
    mixed = [
        shares[:, i] * others[:, j] + shares[:, j] * others[:, i]
        for i, j in EDGES[shares.shape[1]]
    ]
    return np.concatenate([shares * others, np.stack(mixed, axis=1)], axis=1)


def _split(pairs: Sequence[tuple[str, ...]]) -> np.ndarray:
    """Barycentric coordinates of the parts whose corners are the means of two vertices each."""
    count = int(max("".join(sum(pairs, ())))) + 1
    unit = np.eye(count)
    return np.array(
        [[(unit[int(a)] + unit[int(b)]) / 2 for a, b in part] for part in pairs]
    )


SPLIT = {
    3: _split(
        [("00", "01", "02"), ("11", "12", "01"), ("22", "02", "12"), ("12", "02", "01")]
    ),
    4: _split(
        [
            *(
                ("00", "01", "02", "03"),
                ("01", "11", "12", "13"),
                ("02", "12", "22", "23"),
            ),
            *(
                ("03", "13", "23", "33"),
                ("01", "02", "03", "13"),
                ("01", "02", "12", "13"),
            ),
            *(("02", "03", "13", "23"), ("02", "12", "13", "23")),
        ]
    ),
}
"""Coefficients on the parts of equal volume of a triangle and a tetrahedron."""

_PAIRS = np.array([(0, 0), (1, 1), (2, 2), *FACETS[2]]).T
SPLIT[6] = np.array([quadratics(*part[_PAIRS]) for part in SPLIT[3]])

_INNER = (5 - math.sqrt(5)) / 20


def triangle_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points (q, 3) of a rule and their weights, which add up to one."""
    rule = IntegrationRule(ET.TRIG, degree)
    return np.array([(x, y, 1 - x - y) for x, y, *_ in rule.points]), 2 * np.array(
        rule.weights
    )


def tetrahedron_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for a tetrahedron, (q, 4)."""
    rule = IntegrationRule(ET.TET, degree)
    places = np.array([point[:3] for point in rule.points])
    last = 1 - places.sum(axis=1, keepdims=True)
    return np.concatenate([places, last], axis=1), 6 * np.array(rule.weights)


# points of a rule of degree four that fix quadratic functions, barycentric
SIX, _SIX_WEIGHTS = triangle_rule(4)
# values at the points of rules of degree two, and of degree four for quadratic functions
RULE = {
    3: (1 - np.eye(3)) / 2,
    4: _INNER + (1 - 4 * _INNER) * np.eye(4),
    6: quadratics(SIX),
}
# weights of the points, which add up to one
WEIGHTS = {3: np.full(3, 1 / 3), 4: np.full(4, 1 / 4), 6: _SIX_WEIGHTS}
MIDDLES = np.concatenate([np.eye(3), RULE[3]])


def _on_parts(shares: np.ndarray) -> np.ndarray:
    """Barycentric coordinates in a cell of points of its parts, those of one part (q, k)."""
    k = shares.shape[1]
    centre = np.full(k, 1 / k)
    corners = [np.vstack([np.eye(k)[list(f)], centre]) for f in FACETS[k - 1]]
    return np.concatenate([shares @ part for part in corners])


AT_POINTS = {3: _on_parts(SIX), 4: _on_parts(RULE[4])}
TO_NODES = {3: _on_parts(MIDDLES), 4: _on_parts(np.eye(4))}
"""Values at points and nodes of the parts of a cell with so many vertices, from those there."""

# cells or parts for which arrays are made at once: they stay in the processor's cache
PORTION = 1000
NARROW = 0.3  # Taylor polynomials of |s| need |s|^2 above this fraction of its mean
# parts are split where |s|^2 varies by more than this share, so many times at most
VARIES = 0.1
FROM_BELOW = {3: 3, 4: 2}
AT_NODES = quadratics(MIDDLES)
"""Values at vertices and edge midpoints from coefficients."""

WORTH = {3: 0.004, 4: 0.02, 6: 0.007}
"""Parts are split until the possible gain of the plastic term is this fraction of the bound.

Each level may leave half of it, as many parts gain nothing.
"""

SPLIT_LEVELS = {3: 3, 4: 2, 6: 2}  # how often a part is split at most


def portions(count: int, size: int = PORTION) -> list[slice]:
    """Slices of ``size`` entries that together cover ``count`` entries."""
    return [slice(first, first + size) for first in range(0, count, size)]


def worth_keeping(gain: np.ndarray, allowed: float) -> np.ndarray:
    """The parts with the smallest possible gains, which add up to half of what is allowed.

    They are not cut; the other half is left for the next level.
    """
    left = max(allowed, 0.0) / 2
    kept = gain <= left / max(len(gain), 1)  # together these are allowed
    left -= np.maximum(gain[kept], 0.0).sum()
    others = np.flatnonzero(~kept)
    order = others[np.argsort(gain[others])]
    kept[order[np.cumsum(gain[order]) <= left]] = True
    return kept


def coefficients(nodal: np.ndarray) -> np.ndarray:
    """Coefficients of functions from their values at the nodes (..., k, c)."""
    return nodal if nodal.shape[-2] < 6 else np.matmul(np.linalg.inv(AT_NODES), nodal)


def beyond(s: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """s minus its projection onto the ball of radius beta, for s (parts, points, d)."""
    size = np.sqrt(np.einsum("tqd,tqd->tq", s, s))
    share = 1 - np.minimum(beta[:, None] / np.maximum(size, np.finfo(float).tiny), 1.0)
    return share[..., None] * s


_EIGHT = triangle_rule(8)
_SIXTEEN = triangle_rule(16)
TRIANGLES = (3, 6)
"""Numbers of coefficients of functions on triangles."""

POWERS = {
    (2, 3): triangle_rule(4),
    (4, 3): _EIGHT,
    (2, 6): (quadratics(_EIGHT[0]), _EIGHT[1]),
    (4, 6): (quadratics(_SIXTEEN[0]), _SIXTEEN[1]),
}
"""Rules for second or fourth powers of |s|^2, by this power and the number of coefficients.

These are values at the points from the coefficients, and weights.
"""

_DEGREE_SIX = {3: triangle_rule(6), 4: tetrahedron_rule(6)}


def excess_integrals(
    s: np.ndarray, beta: np.ndarray, volume: np.ndarray, power: int = 4
) -> np.ndarray:
    """Upper bound of int (|s| - beta)^2 on triangles, up to a power of variations, 4 or 2.

    With r = |s|^2/c - 1 >= m > -1, m <= 0, Taylor's remainder gives

        |s| >= c^(1/2) (1 + r/2 - r^2/8 + r^3/16 - 5/128 (1 + m)^(-7/2) r^4),
        |s| >= c^(1/2) (1 + r/2 - 1/8 (1 + m)^(-3/2) r^2).

    The first is a polynomial of degree 16 for quadratic s, 8 for affine s, the second of half that
    degree.  The coefficients of s bound |s| from below; where that bound is too small, the result
    is infinite.

    ``s`` (n, 3 or 6, d) are coefficients; ``beta`` and ``volume`` have the shape (n,).
    """
    k = s.shape[1]
    points, weights = POWERS[power, k]
    result = np.empty(len(s))
    for part in portions(len(s)):
        own = s[part].transpose(1, 2, 0)
        values = (points @ own.reshape(k, -1)).reshape(len(points), *own.shape[1:])
        square = np.einsum("qdn,qdn->qn", values, values)
        b = beta[part]
        c = np.maximum(weights @ square, np.finfo(float).tiny)
        mean = own.sum(axis=0) / k
        away = own - mean
        farthest = np.einsum("kdn,kdn->kn", away, away).max(axis=0)
        least = np.sqrt(np.einsum("dn,dn->n", mean, mean)) - np.sqrt(farthest)
        least = np.maximum(least, 0.0) ** 2 / c
        size = np.sqrt(c) * root_from_below(square / c - 1, least, power)
        found = weights @ (square - 2 * b * size + b**2)
        result[part] = np.where(least >= NARROW, found, np.inf)
    return result * volume


def root_from_below(r: np.ndarray, least: np.ndarray, power: int) -> np.ndarray:
    """A polynomial of r below (1 + r)^(1/2), of degree 2 or 4, for 1 + r >= ``least``."""
    least = np.maximum(least, NARROW)
    if power == 2:
        return 1 + r * (1 / 2 - least**-1.5 / 8 * r)
    last = 5 / 128 * least**-3.5
    return 1 + r * (1 / 2 - r * (1 / 8 - r * (1 / 16 - last * r)))


def square_integrals(values: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """int |v|^2 for v with coefficients (..., k, c) on simplices of these volumes (...)."""
    k = values.shape[-2]
    if k == 6:
        values = np.matmul(RULE[k], values)
        return volume * (np.einsum("...qc,...qc->...q", values, values) @ WEIGHTS[k])
    total = np.einsum("...nc->...c", values)
    squares = np.einsum("...nc,...nc->...", values, values)
    return (
        volume / (k * (k + 1)) * (squares + np.einsum("...c,...c->...", total, total))
    )


def exceeding(s: np.ndarray, beta: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Lower bound of int ([|s| - beta]_+)^2, up to fourth powers of the variation of s.

    Where |s| > beta everywhere that is |s|^2 - 2 beta |s| + beta^2, and with r = |s|^2/c - 1

        |s| <= c^(1/2) (1 + r/2 - r^2/8 + r^3/16),

    a polynomial of degree six.  Elsewhere |s| >= d : s for a unit vector d, and the square is at
    least 2 theta (d : s - beta) - theta^2 for affine theta >= 0.

    ``s`` (n, k, d) are the values of affine functions at the vertices of triangles or tetrahedra;
    ``beta`` and ``area``, their sizes, have shape (n,).
    """
    result = np.zeros(len(s))
    cell = np.arange(len(s))
    k = s.shape[1]
    parts = len(SPLIT[k])
    for level in range(FROM_BELOW[k] + 1):
        out = (np.einsum("tvd,tvd->tv", s, s) > beta[:, None] ** 2).any(axis=1)
        s = s[out]
        beta = beta[out]
        area = area[out]
        cell = cell[out]
        means = np.empty(len(s))
        narrow = np.empty(len(s), dtype=bool)
        for some in portions(len(s)):
            means[some], narrow[some] = _exceeding(s[some], beta[some])
        done = narrow if level < FROM_BELOW[k] else np.ones(len(s), dtype=bool)
        result += np.bincount(cell[done], (area * means)[done], minlength=len(result))
        s = np.matmul(SPLIT[k].reshape(-1, k), s[~done]).reshape(-1, k, s.shape[2])
        beta, area, cell = (
            np.repeat(v[~done], parts) for v in (beta, area / parts, cell)
        )
    return result


def _exceeding(s: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bound over the area without splitting, and where that is accurate."""
    k = s.shape[1]
    own = s.transpose(1, 2, 0).copy()  # sums over vertices are sums of long vectors
    mean = own.sum(axis=0) / k
    length = np.sqrt(np.einsum("dn,dn->n", mean, mean))
    direction = mean / np.where(length > 0, length, 1.0)
    along = np.einsum("vdn,dn->vn", own, direction) - beta
    theta = np.maximum(along, 0.0)
    twice = 2 * along - theta
    sums = theta.sum(axis=0) * twice.sum(axis=0)
    found = (sums + np.einsum("vn,vn->n", theta, twice)) / (k * (k + 1))
    outside = np.flatnonzero(along.min(axis=0) >= 0)
    whole, variation = _exceeding_outside(own[..., outside], beta[outside])
    found[outside] = np.maximum(found[outside], whole)
    narrow = np.zeros(len(s), dtype=bool)
    narrow[outside] = variation <= VARIES
    return np.maximum(found, 0.0), narrow


def _exceeding_outside(
    own: np.ndarray, beta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The bound by the polynomial for values (k, d, n) at vertices, and the largest |r|, (n,)."""
    k, d, count = own.shape
    places, weights = _DEGREE_SIX[k]
    values = (places @ own.reshape(k, -1)).reshape(len(places), d, count)
    square = np.einsum("qdn,qdn->qn", values, values)
    middle = weights @ square
    size = root_above(square, middle)
    means = weights @ (square - 2 * beta * size + beta**2)
    variation = np.abs(square / middle - 1)
    return means, variation.max(axis=0, initial=0.0)


def root_above(square: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """No less than the root of ``square``: its Taylor polynomial of degree three at ``middle``.

    The next term is negative.
    """
    r = square / middle - 1
    return np.sqrt(middle) * (1 + r * (1 / 2 - r * (1 / 8 - r / 16)))
