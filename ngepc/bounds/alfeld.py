"""The stress element of Johnson and Mercier on the reference tetrahedron.

The centre cuts a tetrahedron into four; part k has the vertices of the tetrahedron, k replaced by
the centre.  Stresses are symmetric and affine on each part, with continuous normal components: 42
unknowns.  Those without divergence, 30, are fixed by the moments int sigma n phi of the four faces
with the hat functions phi of their vertices, 36 with six equations of equilibrium.  Six more have
the divergences of constant and of rotating body forces.

On a tetrahedron with Jacobian J the stress is J s J'/det J, the moments are J times the reference
moments, and a constant body force f has the coefficients det J J^-1 f.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ngepc.bounds.oscillation import rotating_loads
from ngepc.bounds.parts import RULE
from ngepc.bounds.simplices import FACETS
from ngepc.model.kinematics import SOLID

_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

_UNIT = np.eye(3)
COMPONENTS = np.array(
    [np.sign(np.outer(_UNIT[i], _UNIT[j]) + np.outer(_UNIT[j], _UNIT[i])) for i, j in _PAIRS]
)
"""The symmetric matrices of the six components of a reference stress."""

COORDINATES = np.concatenate([np.eye(3)[None] / 3, SOLID.basis])
"""The matrices whose products with a stress are its coordinates for ``Conjugate``."""

_CORNERS = np.vstack([np.zeros(3), np.eye(3), np.full(3, 0.25)])
_PARTS = [[4 if v == k else v for v in range(4)] for k in range(4)]


def _area_normal(vertices: tuple[int, ...]) -> np.ndarray:
    a, b, c = _CORNERS[list(vertices)]
    return np.cross(b - a, c - a) / 2


def _tractions(part: int, vertex: int, n: np.ndarray) -> np.ndarray:
    """Rows (3, 96) of sigma n at a vertex of a part."""
    rows = np.zeros((3, 4, 4, 6))
    rows[:, part, _PARTS[part].index(vertex)] = (COMPONENTS @ n).T
    return rows.reshape(3, 96)


def _jumps() -> np.ndarray:
    """The jumps of sigma n at the vertices of the six inner faces, shape (54, 96)."""
    rows = []
    for k, j in combinations(range(4), 2):
        face = (*(v for v in range(4) if v not in (k, j)), 4)
        n = _area_normal(face)
        rows += [_tractions(k, v, n) - _tractions(j, v, n) for v in face]
    return np.concatenate(rows)


def _divergences() -> np.ndarray:
    """The divergence on each part, shape (12, 96)."""
    rows = np.zeros((4, 3, 4, 4, 6))
    for k, part in enumerate(_PARTS):
        slopes = np.linalg.inv(np.column_stack([np.ones(4), _CORNERS[part]]))[1:]
        rows[k, :, k] = np.einsum("cij,ja->iac", COMPONENTS, slopes)
    return rows.reshape(12, 96)


def _face_moments() -> np.ndarray:
    """Moments of sigma n, outward, with the hat functions of the faces' vertices, (36, 96)."""
    rows = np.zeros((4, 3, 3, 96))
    for k, face in enumerate(FACETS[3]):
        n = _area_normal(face)
        n = n * np.sign(n @ (_CORNERS[face[0]] - _CORNERS[k]))
        for i in range(3):
            for j, v in enumerate(face):
                rows[k, i] += (1 + (i == j)) / 12 * _tractions(k, v, n)
    return rows.reshape(36, 96)


def _basis() -> np.ndarray:
    """Orthonormal stresses without divergence, and those of unit body forces, shape (96, 36)."""
    equations = np.vstack([_jumps(), _divergences()])
    _, size, vectors = np.linalg.svd(equations)
    rank = int((size > 1e-10 * size[0]).sum())
    turning = rotating_loads(3).transpose(1, 2, 0).reshape(12, 3)
    given = np.vstack([np.zeros((54, 6)), np.hstack([np.tile(-np.eye(3), (4, 1)), -turning])])
    return np.hstack([vectors[rank:].T, np.linalg.lstsq(equations, given, rcond=None)[0]])


_STRESSES = _basis()
FREE = _STRESSES.shape[1] - 6
"""Unknowns without divergence: 30."""

AT_VERTICES = _STRESSES.reshape(16, 6, -1)
"""Components at the vertices of the parts, one part after the other, (16, 6, 36)."""

AT_POINTS = np.einsum("qa,kacj->kqcj", RULE[4], AT_VERTICES.reshape(4, 4, 6, -1)).reshape(16, 6, -1)
"""Components at the points of a rule of degree two on the parts, with equal weights."""

MOMENTS = _face_moments() @ _STRESSES
"""Moments (face, vertex, direction) of the basis, shape (36, 36)."""

FROM_MOMENTS = np.linalg.pinv(MOMENTS[:, :FREE])
"""Coefficients without divergence from moments in equilibrium, shape (30, 36)."""

MEANS = np.einsum("qci,qdj->cdij", AT_POINTS, AT_POINTS) / 16
"""Means of the products of components of the basis, shape (6, 6, 36, 36)."""
