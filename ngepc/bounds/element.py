"""The stress element of Johnson and Mercier on the reference triangle, and its Airy functions.

A triangle is cut into three by its centre; sub-triangle k has the nodes (i, j, centre) with
(i, j) = PAIRS[k].  Stresses (xx, yy, xy) are affine on each of them, symmetric, with continuous
normal components.  They are fixed by the moments int sigma n phi of the edges with the hat
functions phi of their ends, and by a constant body force.  The ones without body force and without
edge resultants that do not close are the second derivatives of the Airy functions of Hsieh, Clough
and Tocher: twelve unknowns, the values and gradients at the vertices and, on each edge, by how much
the normal derivative in the middle differs from the mean of those at the ends.

On a triangle with Jacobian J the stress is J s J'/det J.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.oscillation import rotating_loads
from ngepc.bounds.triangles import PAIRS

CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
"""Vertices of the reference triangle."""

_OUT = [CORNERS[j] - CORNERS[i] for i, j in PAIRS]
LENGTHS = np.array([np.hypot(*t) for t in _OUT])
NORMALS = np.array([(t[1], -t[0]) for t in _OUT]) / LENGTHS[:, None]
"""Lengths and outer normals of the reference edges."""


def _traction(triangle: int, node: int, n: np.ndarray) -> np.ndarray:
    """Rows (2, 27) of sigma n at a node of a sub-triangle."""
    rows = np.zeros((2, 3, 3, 3))
    rows[0, triangle, node, 0], rows[0, triangle, node, 2] = n
    rows[1, triangle, node, 1], rows[1, triangle, node, 2] = n[::-1]
    return rows.reshape(2, 27)


def _edge_equations(k: int) -> tuple[np.ndarray, np.ndarray]:
    """The traction at the ends of edge k from its moments: t_i = (4 m_i - 2 m_j) / L."""
    given = np.zeros((2, 2, 15))
    for end in (0, 1):
        for c in (0, 1):
            given[end, c, 4 * k + 2 * end + c] = 4 / LENGTHS[k]
            given[end, c, 4 * k + 2 * (1 - end) + c] = -2 / LENGTHS[k]
    rows = [_traction(k, end, NORMALS[k]) for end in (0, 1)]
    return np.concatenate(rows), given.reshape(4, 15)


def _divergence_equations(k: int) -> tuple[np.ndarray, np.ndarray]:
    """The divergence on sub-triangle k is minus the body force."""
    i, j = PAIRS[k]
    places = np.array([CORNERS[i], CORNERS[j], CORNERS.mean(axis=0)])
    slopes = np.linalg.inv(np.column_stack([np.ones(3), places]))[1:]
    rows = np.zeros((2, 3, 3, 3))
    for c in (0, 1):
        rows[c, k, :, c], rows[c, k, :, 2] = slopes[c], slopes[1 - c]
    given = np.zeros((2, 15))
    given[0, 12] = given[1, 13] = -1.0
    given[:, 14] = -rotating_loads(2)[0, k]
    return rows.reshape(2, 27), given


def _continuity_equations(v: int) -> tuple[np.ndarray, np.ndarray]:
    """The traction is continuous across the inner edge from vertex v to the centre."""
    a, b = (k for k in range(3) if k != v)
    t = CORNERS.mean(axis=0) - CORNERS[v]
    n = np.array([t[1], -t[0]])
    ends = ((PAIRS[a].index(v), PAIRS[b].index(v)), (2, 2))
    rows = [_traction(a, at_a, n) - _traction(b, at_b, n) for at_a, at_b in ends]
    return np.concatenate(rows), np.zeros((4, 15))


def _stress_map() -> np.ndarray:
    parts = (_edge_equations, _divergence_equations, _continuity_equations)
    equations = [part(k) for part in parts for k in range(3)]
    rows, given = (np.concatenate(side) for side in zip(*equations, strict=True))
    assert np.linalg.matrix_rank(rows) == 27
    return np.linalg.pinv(rows) @ given


def _airy_moments() -> np.ndarray:
    """Edge moments (12) from the twelve unknowns of an Airy function.

    With psi = (Phi_y, -Phi_x) the traction is its derivative along the edge, so that the moments
    are mean(psi) - psi_i and psi_j - mean(psi).
    """
    moments = np.zeros((3, 2, 2, 12))
    for k, (i, j) in enumerate(PAIRS):
        n, t = NORMALS[k], np.array([-NORMALS[k][1], NORMALS[k][0]])
        psi = np.zeros((2, 2, 12))
        for end, v in enumerate((i, j)):
            psi[end, 0, 3 * v + 2], psi[end, 1, 3 * v + 1] = 1.0, -1.0
        mean = np.zeros((2, 12))
        mean[:, 3 * j] += n / LENGTHS[k]
        mean[:, 3 * i] -= n / LENGTHS[k]
        slope = np.zeros(12)  # mean of the normal derivative
        for v in (i, j):
            slope[3 * v + 1 : 3 * v + 3] += n / 2
        slope[9 + k] = 2 / 3
        mean -= np.outer(t, slope)
        moments[k, 0], moments[k, 1] = mean - psi[0], psi[1] - mean
    return moments.reshape(12, 12)


STRESS_MAP = _stress_map()
"""Stresses (sub-triangle, node, component) from 12 edge moments and 3 body forces, (27, 15)."""

AIRY_MAP = STRESS_MAP[:, :12] @ _airy_moments()
"""Stresses times det J from the twelve unknowns of an Airy function, shape (27, 12)."""


def rows_at(shares: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """From rows (27, k) of nodal values, those at points of each part, barycentric (q, 3)."""
    return np.matmul(shares, rows.reshape(3, 3, -1)).reshape(9 * len(shares), -1)
