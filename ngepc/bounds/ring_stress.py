"""Stresses of a body of revolution with continuous tractions, and the equations of the best one.

The stresses of ``ring_element`` on triangles have polynomials of degree k as tractions on edges.
That these have no jumps, and given values on the boundary, are conditions with multipliers.  A
quadratic functional is minimised by one linear system for the multipliers.

At a vertex conditions may depend on each other.  Therefore a small part of the diagonal is added to
the matrix of the system, and the solution is iterated.  Tractions given on both sides of a corner
need at least three triangles there, and a load that ends on an edge needs two or three: triangles
around boundary vertices with few triangles are cut into three.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from ngepc.bounds.ring_element import RingElement
from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.linalg.bernstein import from_lattice, lattice_points
from ngepc.linalg.direct import WITHOUT_PIVOTS

FEW = 2
"""Triangles at a boundary vertex with at most so many triangles are cut."""
VANISHING = 1e-18
"""Relative size of diagonal entries that count as zero: on the axis s_rz vanishes."""
SHIFT = 1e-12
"""Part of the diagonal that is added."""
PASSES = 20
ROUNDING = 1e-14
"""The iteration ends at this relative residual, or where it stops falling."""


class CutTriangles:
    """The triangles that stresses live on.

    ``cells`` are the triangles, ``parents`` (cells,) the triangles of the mesh in which they lie,
    ``places`` (cells, 3, 3) the barycentric coordinates of their corners there.
    """

    def __init__(self, whole: Simplices) -> None:
        count = len(whole.points)
        around = np.bincount(whole.nodes.ravel(), minlength=count)
        outer = np.zeros(count, dtype=bool)
        outer[whole.facets[whole.outer]] = True
        few = (outer & (around <= FEW))[whole.nodes].any(axis=1)
        cut = np.flatnonzero(few)
        kept = np.flatnonzero(~few)
        centres = whole.points[whole.nodes[cut]].mean(axis=1)
        number = count + np.arange(len(cut))
        ends = whole.nodes[cut][:, np.array(FACETS[2])]
        middle = np.broadcast_to(number[:, None, None], (len(cut), 3, 1))
        children = np.concatenate([ends, middle], axis=2).reshape(-1, 3)
        points = np.concatenate([whole.points, centres])
        self.cells = Simplices(points, np.concatenate([whole.nodes[kept], children]))
        self.parents = np.concatenate([kept, np.repeat(cut, 3)])
        corner = np.eye(3)[np.array(FACETS[2])]
        centre = np.full((3, 1, 3), 1 / 3)
        parts = np.concatenate([corner, centre], axis=1)
        self.places = np.concatenate(
            [
                np.broadcast_to(np.eye(3), (len(kept), 3, 3)),
                np.tile(parts, (len(cut), 1, 1)),
            ]
        )

    def sums(self, values: np.ndarray, count: int) -> np.ndarray:
        """Sums over the parts of each of ``count`` triangles of the mesh."""
        return np.bincount(self.parents, values, minlength=count)


class RingStresses:
    """The tractions of stresses on triangles.

    ``edge_rows`` (cells, 3 n, free) and ``edge_load`` (cells, 3 n) are the Bernstein coefficients
    of the tractions on the three edges, n = 2 (k + 1) for each edge, those of the first component
    first.  The components are those in the ``frame`` (facets, 2, 2) of the facet.
    """

    def __init__(
        self, cells: Simplices, element: RingElement, frame: np.ndarray
    ) -> None:
        self.cells = cells
        self.element = element
        k = element.degree
        count = len(cells.nodes)
        facet = cells.facet_of.ravel()
        x = np.matmul(lattice_points(1, k), cells.points[cells.facets[facet]])
        of_edges = element.of(np.repeat(np.arange(count), 3))
        rows, load = of_edges.traction_rows(x, cells.normal[facet], frame[facet])
        to_coefficients = from_lattice(1, k)
        rows = np.matmul(to_coefficients, rows)
        self.edge_rows = rows.reshape(count, -1, element.free)
        self.edge_load = np.matmul(load, to_coefficients.T).reshape(count, -1)

    def tractions(self, y: np.ndarray) -> np.ndarray:
        """The coefficients on the edges of the stress y (cells, free), (cells, 3 n)."""
        return self.edge_load + np.matmul(self.edge_rows, y[..., None])[..., 0]


class Conditions:
    """The conditions on coefficients of tractions that are ``active`` (facets, n)."""

    def __init__(self, stresses: RingStresses, active: np.ndarray) -> None:
        cells = stresses.cells
        self._stresses = stresses
        self.active = active
        n = active.shape[1]
        self.count = int(active.sum())
        number = np.full(active.shape, -1)
        number[active] = np.arange(self.count)
        self._numbers = number[cells.facet_of].reshape(-1, 3 * n)
        self._there = self._numbers >= 0
        self._sign = np.repeat(cells.sign, n, axis=1)

    @property
    def rows(self) -> np.ndarray:
        """The rows of the coefficients on the edges, (cells, 3 n, free)."""
        return self._stresses.edge_rows

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """Jumps (count,) of coefficients (cells, 3 n)."""
        signed = (self._sign * values)[self._there]
        return np.bincount(self._numbers[self._there], signed, minlength=self.count)

    def spread(self, multipliers: np.ndarray) -> np.ndarray:
        """Multipliers (count,) at the coefficients (cells, 3 n), with the signs of jumps."""
        return self._sign * np.append(multipliers, 0.0)[self._numbers]

    def assembled(self, blocks: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """The sum of blocks (cells, 3 n, 3 n), with a unit diagonal, and the scale for that."""
        signed = blocks * self._sign[:, :, None] * self._sign[:, None]
        rows = np.broadcast_to(self._numbers[:, :, None], blocks.shape)
        columns = np.broadcast_to(self._numbers[:, None], blocks.shape)
        chosen = self._there[:, :, None] & self._there[:, None]
        places = rows[chosen], columns[chosen]
        S = csc_matrix((signed[chosen], places), shape=(self.count, self.count))

        diagonal = S.diagonal()
        there = diagonal > VANISHING * diagonal.max(initial=0.0)
        positive = np.where(there, diagonal, 1.0)
        scale = np.where(there, 1 / np.sqrt(positive), 0.0)
        unit = diags(scale) @ S @ diags(scale)
        return unit.tocsc(), scale

    def missing(self, y: np.ndarray, given: np.ndarray) -> np.ndarray:
        """What the stress y lacks of the jumps ``given`` (facets, n), (count,)."""
        return given[self.active] - self.gathered(self._stresses.tractions(y))

    def system(self, A: np.ndarray) -> LinearSystem:
        """The equations for minimisers of the sum of y . A y/2 + b . y over the cells."""
        return LinearSystem(self, A)


class LinearSystem:
    """The equations of the stress y for which the sum of y . A y/2 + b . y is smallest.

    With the multipliers mu, A y + b + B' mu = 0 and B y = wanted.  So the smallest value has the
    derivative -mu by the wanted jumps.
    """

    def __init__(self, conditions: Conditions, A: np.ndarray) -> None:
        self._conditions = conditions
        B = conditions.rows
        self._inverse = np.linalg.inv(A)
        self._BA = np.matmul(B, self._inverse)
        blocks = np.matmul(self._BA, B.transpose(0, 2, 1))
        self._matrix, self._scale = conditions.assembled(blocks)
        shift = SHIFT * diags(np.ones(conditions.count))
        self._factors = splu((self._matrix + shift).tocsc(), **WITHOUT_PIVOTS)

    def multipliers(self, b: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """mu (count,)."""
        moved = self._conditions.gathered(np.matmul(self._BA, b[..., None])[..., 0])
        return -self.solved(wanted + moved)

    def solved(self, right: np.ndarray) -> np.ndarray:
        """The x with B A^-1 B' x = right, (count, ...); the matrix may be singular."""
        scale = self._scale.reshape(-1, *[1] * (right.ndim - 1))
        right = scale * right
        result = np.zeros(right.shape)
        size = np.abs(right).max(initial=0.0)
        before = np.inf
        for _ in range(PASSES):
            rest = right - self._matrix @ result
            left = np.abs(rest).max(initial=0.0)
            if left <= ROUNDING * size or left > before / 2:
                break
            before = left
            result = result + self._factors.solve(rest)
        return scale * result

    def minimiser(self, b: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """y (cells, free) for mu."""
        conditions = self._conditions
        spread = conditions.spread(multipliers)
        pulled = b + np.matmul(spread[:, None], conditions.rows)[:, 0]
        return -np.matmul(self._inverse, pulled[..., None])[..., 0]
