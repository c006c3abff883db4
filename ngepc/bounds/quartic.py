"""Airy functions of degree four: their stresses are quadratic on the three parts of a triangle.

To the unknowns of the cubic element come three of each edge's two, and three inside: by how much
the function in the middle of the edge differs from the cubic one of the ends (even), how strongly
the normal derivative bends there (odd), and functions that vanish with their gradients outside.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.airy import AirySpace, Rule
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.element import AIRY_MAP, CORNERS, NORMALS, rows_at
from ngepc.bounds.parts import AT_NODES, RULE, SIX, WEIGHTS
from ngepc.bounds.triangles import PAIRS

POWERS = np.array([(a, b) for a in range(5) for b in range(5 - a)])
CENTRE = CORNERS.mean(axis=0)


def _derivative(at: np.ndarray, order: tuple[int, int]) -> np.ndarray:
    """Derivatives of the 15 monomials at a point."""
    result = np.ones(len(POWERS))
    for x, k, power in zip(at, order, POWERS.T, strict=True):
        for i in range(k):
            result *= power - i
        result *= x ** np.maximum(power - k, 0)
    return result


def _on_part(k: int, row: np.ndarray) -> np.ndarray:
    """A row on the monomials of part k among those of all three."""
    result = np.zeros((3, len(POWERS)))
    result[k] = row
    return result.ravel()


def _smooth_rows() -> list[np.ndarray]:
    """What vanishes for C1 functions: jumps at points of the three inner edges."""
    rows = []
    for v in range(3):
        a, b = (k for k in range(3) if k != v)
        for t in np.linspace(0, 1, 5):
            for order in ((0, 0), (1, 0), (0, 1)):
                row = _derivative((1 - t) * CORNERS[v] + t * CENTRE, order)
                rows.append(_on_part(a, row) - _on_part(b, row))
    return rows


def _outer_rows() -> list[np.ndarray]:
    """Values and gradients at the vertices, then the three numbers of each edge, kind by kind."""
    orders, numbers = ((0, 0), (1, 0), (0, 1)), []
    rows = [_on_part((v + 1) % 3, _derivative(CORNERS[v], o)) for v in range(3) for o in orders]
    for k, (i, j) in enumerate(PAIRS):
        along = CORNERS[j] - CORNERS[i]
        places = [CORNERS[i] + t * along for t in (0, 0.25, 0.5, 0.75, 1)]
        value, x, y = (np.array([_on_part(k, _derivative(p, o)) for p in places]) for o in orders)
        slope, across = (d[0] * x + d[1] * y for d in (along, NORMALS[k]))
        bend = across[2] - (across[0] + across[4]) / 2
        even = value[2] - (value[0] + value[4]) / 2 - (slope[0] - slope[4]) / 8
        odd = (across[1] - across[3] - (across[0] - across[4]) / 2) / 6
        numbers.append((bend, even, odd))
    return rows + [edge[kind] for kind in range(3) for edge in numbers]


def _further_rows() -> np.ndarray:
    """Stresses times det J at the points of the nine functions that are not cubic, (54, 9)."""
    known = np.array(_smooth_rows() + _outer_rows())
    inside = np.linalg.svd(known)[2][-3:].T
    edges = np.linalg.pinv(known)[:, -6:]
    coefficients = np.concatenate([edges, inside], axis=1).reshape(3, len(POWERS), 9)
    stresses = []
    for k, (i, j) in enumerate(PAIRS):
        for place in SIX @ np.array([CORNERS[i], CORNERS[j], CENTRE]):
            orders = ((0, 2), (2, 0), (1, 1))
            xx, yy, xy = (_derivative(place, order) @ coefficients[k] for order in orders)
            stresses += [xx, yy, -xy]
    return np.array(stresses)


QUARTIC = Rule(
    SIX,
    np.tile(WEIGHTS[6] / 3, 3),
    np.concatenate([rows_at(SIX, AIRY_MAP), _further_rows()], axis=1),
    AT_NODES @ np.linalg.inv(RULE[6]),
)
"""Quadratic stresses, known at the six points of each part; its nodes are vertices, midpoints."""


class QuarticSpace(AirySpace):
    """``AirySpace`` of degree four.

    Unknowns are those of the vertices, bend, even and odd of the edges, three of each triangle.
    """

    rule = QUARTIC
    of_triangles = (*AirySpace.of_triangles, "_odd")

    def __init__(self, boundary: Boundary) -> None:
        super().__init__(boundary)
        t, (nt, ne) = boundary.triangles, (len(self.det), len(boundary.triangles.facets))
        self._odd = self._across * np.where(t.forward, 1.0, -1.0)
        first = self.vertices + ne
        edges = [first + t.facet_of, first + ne + t.facet_of]
        inside = first + 2 * ne + np.arange(3 * nt).reshape(-1, 3)
        self.unknowns = np.concatenate([self.unknowns, *edges, inside], axis=1)
        bend = self.held.free[self.vertices :]
        more = [self.held.even, bend, np.ones(3 * nt, dtype=bool)]
        self.held.free = np.concatenate([self.held.free, *more])

    def reference(self, local: np.ndarray) -> np.ndarray:
        """Unknowns of the reference triangle, shape (nt, 21)."""
        result = super().reference(local)
        result[:, 15:18] *= self._odd
        result[:, 15:18] += self._along * local[:, 12:15]
        return result

    def _transposed(self, reference: np.ndarray) -> np.ndarray:
        result = super()._transposed(reference)
        result[:, 12:15] += self._along * reference[:, 15:18]
        result[:, 15:18] *= self._odd
        return result

    def _in_unknowns(self, K: np.ndarray) -> None:
        super()._in_unknowns(K)
        along, odd = self._along.T, self._odd.T
        K[12:15] += along[:, None] * K[15:18]
        K[:, 12:15] += along * K[:, 15:18]
        K[15:18] *= odd[:, None]
        K[:, 15:18] *= odd
