"""The stress element of Johnson and Mercier on the reference simplex, and Airy functions.

The centre cuts a cell into N + 1 parts; part k has the vertices of facet k and the centre.
Stresses are symmetric and affine on each part, with continuous normal components.  They are fixed
by the moments int sigma n phi of the facets with the hat functions phi of their vertices, and by
constant and rotating body forces.  On a cell with Jacobian J the stress is J s J'/det J, the
moments are J times the reference moments, a constant body force f has coefficients det J J^-1 f.

In the plane the self-equilibrated stresses are the second derivatives of the Airy functions of
Hsieh, Clough and Tocher: polynomials on the three parts with continuous gradients.  Degree three
has twelve unknowns: values and gradients at the vertices and, on each edge, the normal derivative
at the midpoint less the mean of those at the ends (bend).  Degree four, with quadratic stresses,
has two more on each edge: the value at the midpoint less that of the cubic interpolant of the ends
(even), and the odd part of the normal derivative (odd); and three functions that vanish on the
boundary of the cell with their gradients.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from ngepc.bounds.oscillation import rotating_loads
from ngepc.bounds.polynomials import portions
from ngepc.bounds.simplices import FACETS, Simplices, by_cells
from ngepc.model.kinematics import SOLID, TWO_DIMENSIONAL

PAIRS = FACETS[2]


class Element:
    """Tables of the element in N dimensions, with the N + 1 vertices of one part after the other.

    ``stresses`` (vertices, c, k) are the components of basis stresses: first ``free`` orthonormal
    ones without divergence, then those of unit body forces.  ``moments`` (moments, k) are their
    moments by facet, vertex and direction.  ``of_data`` (vertices c, .) maps moments in equilibrium
    and body forces to stresses.  ``components`` (c, N, N) are the matrices of the components;
    ``coordinates`` (c, N, N) are the matrices whose products with a stress are its coordinates for
    ``Conjugate``.
    """

    def __init__(self, N: int) -> None:
        pairs = {
            2: ((0, 0), (1, 1), (0, 1)),
            3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)),
        }
        unit = np.eye(N)
        basis = {2: TWO_DIMENSIONAL, 3: SOLID}[N].basis
        outer = [np.outer(unit[i], unit[j]) for i, j in pairs[N]]
        self.N = N
        self.components = np.array([np.sign(E + E.T) for E in outer])
        self.basis = basis
        self.coordinates = np.concatenate([unit[None] / N, basis])
        # coordinates of J E J' for components E, from the products of two entries of J
        images = np.einsum("dil,cjk->cdijlk", self.coordinates, self.components)
        self._images = images.reshape(len(pairs[N]) ** 2, -1)
        self.corners = np.vstack([np.zeros(N), unit, np.full(N, 1 / (N + 1))])
        self.parts = [(*facet, N + 1) for facet in FACETS[N]]
        places = np.insert(self.corners[np.array(self.parts)], 0, 1.0, axis=2)
        # of the hat functions of each part, as columns
        self._slopes = np.linalg.inv(places)[:, 1:]
        equations = np.vstack([self._jumps(), self._divergences()])
        _, size, vectors = np.linalg.svd(equations)
        rank = int((size > 1e-10 * size[0]).sum())
        turning = rotating_loads(N).transpose(1, 2, 0).reshape(N * (N + 1), -1)
        loads = -np.hstack([np.tile(unit, (N + 1, 1)), turning])
        given = np.vstack(
            [np.zeros((len(equations) - len(loads), loads.shape[1])), loads]
        )
        forced = np.linalg.lstsq(equations, given, rcond=None)[0]
        both = np.hstack([vectors[rank:].T, forced])
        self.free = len(vectors) - rank
        self.moments = self._facet_moments() @ both
        self.stresses = both.reshape((N + 1) ** 2, len(pairs[N]), -1)
        closed = both[:, : self.free] @ np.linalg.pinv(self.moments[:, : self.free])
        self.of_data = np.hstack(
            [closed, forced - closed @ self.moments[:, self.free :]]
        )

    def _tractions(self, part: int, vertex: int, n: np.ndarray) -> np.ndarray:
        """Rows of sigma n at a vertex of a part, shape (N, unknowns)."""
        N = self.N
        rows = np.zeros((N, N + 1, N + 1, len(self.components)))
        rows[:, part, self.parts[part].index(vertex)] = (self.components @ n).T
        return rows.reshape(N, -1)

    def _jumps(self) -> np.ndarray:
        """The jumps of sigma n at the vertices of the inner facets."""
        rows = []
        for k, j in combinations(range(self.N + 1), 2):
            n = self._slopes[k][:, self.parts[k].index(j)]  # part j lacks the vertex j
            facet = [v for v in self.parts[k] if v != j]
            rows += [self._tractions(k, v, n) - self._tractions(j, v, n) for v in facet]
        return np.concatenate(rows)

    def _divergences(self) -> np.ndarray:
        """The divergence on each part, shape (N (N + 1), unknowns)."""
        N = self.N
        rows = np.zeros((N + 1, N, N + 1, N + 1, len(self.components)))
        for k, slopes in enumerate(self._slopes):
            rows[k, :, k] = np.einsum("cij,ja->iac", self.components, slopes)
        return rows.reshape(N * (N + 1), -1)

    def _facet_moments(self) -> np.ndarray:
        """Moments of sigma n, outward, with the hat functions of the facets' vertices."""
        N = self.N
        rows = []
        for k, facet in enumerate(FACETS[N]):
            n = -self._slopes[k][:, -1] / (math.factorial(N + 1) * (N + 1))
            tractions = [self._tractions(k, v, n) for v in facet]
            rows += [sum(tractions) + own for own in tractions]
        return np.concatenate(rows)

    def piola(self, cells: Simplices) -> np.ndarray:
        """Coordinates from components of reference stresses, to the right of them, (nt, c, c)."""
        c = len(self.components)
        result = by_cells(len(cells.det), c, c)
        for part in portions(len(result)):
            J = cells.jacobian[part].reshape(-1, self.N**2).T
            products = (J[:, None] * J).reshape(self.N**4, -1)
            found = self._images @ products / cells.det[part]
            result[part] = np.moveaxis(found.reshape(c, c, -1), 2, 0)
        return result

    def tensors(self, z: np.ndarray) -> np.ndarray:
        """The matrices (..., N, N) of stress coordinates (..., c)."""
        return z[..., :1, None] * np.eye(self.N) + np.tensordot(
            z[..., 1:], self.basis, 1
        )


ELEMENTS = {N: Element(N) for N in (2, 3)}

CORNERS = ELEMENTS[2].corners[:3]
LEGS = np.array([CORNERS[j] - CORNERS[i] for i, j in PAIRS])
# outer normals of the reference edges
NORMALS = np.array([(t[1], -t[0]) / np.hypot(*t) for t in LEGS])
ORDERS = ((0, 0), (1, 0), (0, 1))  # of derivatives: the value and the gradient


def airy_stresses(degree: int, shares: np.ndarray) -> np.ndarray:
    """Stresses times det J of the Airy functions of a degree, shape (3 q, 3, functions).

    They are evaluated at barycentric points (q, 3) of each part.
    """
    powers = np.array(
        [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    )
    smooth = []
    centre = CORNERS.mean(axis=0)  # jumps at points of the three inner edges
    for v in range(3):
        a, b = (k for k in range(3) if k != v)
        for t in np.linspace(0, 1, 5):
            place = (1 - t) * CORNERS[v] + t * centre
            for order in ORDERS:
                jump = _derivative(powers, a, place, order) - _derivative(
                    powers, b, place, order
                )
                smooth.append(jump)
    numbers = _airy_numbers(powers)[: 12 if degree == 3 else 18]
    known = np.array(smooth + numbers)
    inside = np.linalg.svd(known)[2][np.linalg.matrix_rank(known) :].T
    coefficients = np.hstack([np.linalg.pinv(known)[:, -len(numbers) :], inside])
    rows = []
    for k, part in enumerate(ELEMENTS[2].parts):
        for place in shares @ ELEMENTS[2].corners[list(part)]:
            second = [
                _derivative(powers, k, place, order)
                for order in ((0, 2), (2, 0), (1, 1))
            ]
            xx, yy, xy = np.array(second) @ coefficients
            rows.append((xx, yy, -xy))
    return np.array(rows)


def _derivative(
    powers: np.ndarray, part: int, at: np.ndarray, order: tuple[int, int]
) -> np.ndarray:
    """Derivatives of the monomials of a part at a point, among those of all three."""
    result = np.zeros((3, len(powers)))
    left = np.maximum(powers - order, 0)
    factors = [list(map(math.perm, each, order)) for each in powers.tolist()]
    result[part] = np.prod(factors * at**left, axis=1)
    return result.ravel()


def _airy_numbers(powers: np.ndarray) -> list[np.ndarray]:
    """Values and gradients at the vertices, then three numbers of each edge, kind by kind."""
    rows = [
        _derivative(powers, (vertex + 1) % 3, CORNERS[vertex], order)
        for vertex in range(3)
        for order in ORDERS
    ]
    edges = []
    for k, (start, _) in enumerate(PAIRS):
        along = [CORNERS[start] + t * LEGS[k] for t in (0, 0.25, 0.5, 0.75, 1)]
        value, by_x, by_y = (
            np.array([_derivative(powers, k, place, order) for place in along])
            for order in ORDERS
        )
        slope = LEGS[k][0] * by_x + LEGS[k][1] * by_y
        across = NORMALS[k][0] * by_x + NORMALS[k][1] * by_y
        bend = across[2] - (across[0] + across[4]) / 2
        even = value[2] - (value[0] + value[4]) / 2 - (slope[0] - slope[4]) / 8
        odd = (across[1] - across[3] - (across[0] - across[4]) / 2) / 6
        edges.append((bend, even, odd))
    return rows + [edge[kind] for kind in range(3) for edge in edges]
