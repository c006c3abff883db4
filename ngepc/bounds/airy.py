"""Self-equilibrated stresses of a triangulation: Airy functions of degree three or four.

The unknowns are the value and the gradient of the function at each vertex and, on each edge, the
normal derivative at the midpoint less the mean of those at the ends.  Degree four has two more
unknowns on each edge and three on each triangle, see ``element``.

The stresses must not change given tractions: on a connected part of the traction boundary the
function is affine.  On one part it is set to zero with its gradient; on the others the three
coefficients of the affine function are unknowns, called ``modes``: the resultants of the tractions
between the parts.  On rollers, where the traction is free along one direction d, the derivative
along d is constant: the part of the normal derivative that the vertices do not determine is
minus (d . t)/(d . n) times that of the tangential one.  At vertices of rollers along no axis the
gradient has the coordinates of ``RollerFrames``.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.element import LEGS, NORMALS, PAIRS, airy_stresses
from ngepc.bounds.frames import RollerFrames
from ngepc.bounds.polynomials import AT_NODES, RULE, SIX, WEIGHTS, portions
from ngepc.bounds.simplices import Simplices, by_cells
from ngepc.bounds.vertex_matrix import BLOCKS

# entries of a symmetric matrix that are kept
FIRST, SECOND = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]).T
AT_ONCE = 1000
"""Triangles whose stiffness is computed at once."""
LEVEL = 1e-9
"""Smaller components of a unit normal and smaller eigenvalues count as zero."""


Blocks = tuple[slice, np.ndarray, np.ndarray, np.ndarray]
"""Triangles, and blocks of their stiffness matrices, see ``AirySpace.stiffness``."""


def kept_entries(n: int) -> np.ndarray:
    """The entries of a symmetric matrix n x n, row by row, from which ``AirySpace`` takes blocks.

    First those of the pairs ``BLOCKS`` of vertices, (3, 3, 6), then those of the vertices with the
    n - 9 other unknowns, then those of the others.
    """
    number = np.arange(n * n).reshape(n, n)
    a, b = BLOCKS
    pairs = number[:9, :9].reshape(3, 3, 3, 3)[a, :, b].transpose(1, 2, 0)
    return np.concatenate(
        [pairs.ravel(), number[:9, 9:].ravel(), number[9:, 9:].ravel()]
    )


class Rule:
    """The points of a triangle at which stresses are stored, and the Airy stresses there.

    Affine stresses are stored at the edge midpoints of the three parts, quadratic ones at six
    points of each part.  ``shares`` (q, 3) are their barycentric coordinates; ``weights`` (3 q,)
    add up to one; ``nodal`` (q, q) gives values at the nodes of a part, ``rows`` (9 q, n) stresses
    times det J from the n unknowns of a triangle, ``forces`` is the same with the weights,
    ``stiffness`` (3 q, 6, .) entries of the stiffness of a triangle, see ``kept_entries``, from six
    compliances at each point.
    """

    def __init__(self, degree: int) -> None:
        k = {3: 3, 4: 6}[degree]  # points of a part
        self.shares = {3: RULE[3], 6: SIX}[k]
        self.weights = np.tile(WEIGHTS[k] / 3, 3)
        to_coefficients = np.linalg.inv(RULE[k])
        self.nodal = {3: np.eye(3), 6: AT_NODES}[k] @ to_coefficients

        rows = airy_stresses(3, self.shares)
        if degree == 4:
            more = airy_stresses(4, self.shares)[:, :, 12:]
            rows = np.concatenate([rows, more], axis=2)

        products = np.einsum("q,qim,qjn->qijmn", self.weights, rows, rows)
        off_diagonal = 1 - np.eye(3)
        products += off_diagonal[:, :, None, None] * products.swapaxes(1, 2)
        entries = products[:, FIRST, SECOND].reshape(len(rows), 6, -1)
        self.stiffness = entries[..., kept_entries(rows.shape[2])]

        self.rows = rows.reshape(3 * len(rows), -1)
        self.forces = np.repeat(self.weights, 3)[:, None] * self.rows


RULES = {degree: Rule(degree) for degree in (3, 4)}

EDGE_ROWS = np.zeros((3, 9))
"""The tangential derivative in the middle of an edge less the mean, times its length."""
for _k, (_i, _j) in enumerate(PAIRS):
    EDGE_ROWS[_k, [3 * _j, 3 * _i]] = 1.5, -1.5
    for _v in (_i, _j):
        EDGE_ROWS[_k, 3 * _v + 1 : 3 * _v + 3] = -0.75 * LEGS[_k]


def of_bends() -> np.ndarray:
    """The table (54, 27) of the blocks of R' M + M' R for R = ``EDGE_ROWS`` and M' (9, 3)."""
    unit = np.eye(27).reshape(9, 3, 27)
    product = np.einsum("ka,bkm->abm", EDGE_ROWS, unit)
    both = (product + product.swapaxes(0, 1)).reshape(3, 3, 3, 3, 27)
    a, b = BLOCKS
    return both[a, :, b].transpose(1, 2, 0, 3).reshape(54, 27)


OF_BENDS = of_bends()


def turn(x: np.ndarray, y: np.ndarray, J: np.ndarray) -> None:
    """Replace vectors with the components x and y (..., nt) by J (2, 2, nt) times these."""
    first = J[0, 0] * x
    first += J[0, 1] * y
    y *= J[1, 1]
    y += J[1, 0] * x
    x[:] = first


def turned(values: np.ndarray, J: np.ndarray) -> np.ndarray:
    """Values and gradients at vertices, (9, ., nt) or (9, nt), the latter times J (2, 2, nt)."""
    result = values.copy()
    each = result.reshape(3, 3, *values.shape[1:])
    turn(each[:, 1], each[:, 2], J)
    return result


def bodies_of(cells: Simplices) -> list[np.ndarray]:
    """The vertices of each connected part of a triangulation."""
    count = len(cells.points)
    start, end = cells.facets.T
    sides = csr_matrix((np.ones(len(start)), (start, end)), shape=(count, count))
    number = connected_components(sides, directed=False)[1]
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


class AirySpace:
    """The Airy functions of a triangulation.

    ``unknowns`` (n, nt) are the numbers of the unknowns of each triangle: first ``vertices``
    unknowns of vertices, three each, then those of edges.  The unknowns that are ``free`` do not
    change given tractions.  ``area`` (nt,) are the areas of the triangles, ``numbers`` those of the
    unknowns in the space of the whole mesh.
    """

    of_triangles = ("det", "area", "unknowns", "_piola", "_J", "_along", "_across")
    of_triangles += ("_even", "_odd")

    def __init__(self, boundary: Boundary, degree: int, piola: np.ndarray) -> None:
        self._boundary = boundary
        self.rule = RULES[degree]
        self._piola = piola.transpose(1, 2, 0)
        c = self._cells = boundary.cells
        self.det = c.det
        self.area = c.volume
        self.vertices = 3 * len(c.points)
        nt = len(c.nodes)
        ne = len(c.facets)
        corners = (3 * c.nodes.T[:, None] + np.arange(3)[:, None]).reshape(9, -1)
        unknowns = [corners, self.vertices + c.facet_of.T]
        self._bodies = bodies_of(c)
        held, bend, even = self._held()
        free = [~held, bend]
        if degree == 4:
            unknowns += [unknowns[1] + ne, unknowns[1] + 2 * ne]
            unknowns += [self.vertices + 3 * ne + np.arange(3 * nt).reshape(3, -1)]
            free += [even, bend, np.ones(3 * nt, dtype=bool)]
        self.unknowns = np.concatenate(unknowns)
        self.free = np.concatenate(free)
        self.numbers = np.arange(len(self.free))
        self._times = np.bincount(self.unknowns.ravel(), minlength=len(self.free))
        self._of_slices: dict[tuple[int, int], AirySpace] = {}
        self._set_maps()

    def _held(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fixed unknowns of vertices; edges whose unknowns ``bend`` and ``even`` are free."""
        c = self._cells
        given = self._boundary.given
        first, second = given.T
        closed = c.outer & first & second
        closed[self._boundary.slanted] = False
        single = c.outer & (first ^ second)
        self._directions = np.where(single[:, None], ~given, 0.0)
        self._directions[self._boundary.slanted] = self._boundary.directions
        rolled = single.copy()
        rolled[self._boundary.slanted] = True
        across = np.abs(np.einsum("ei,ei->e", self._directions, c.normal)) > LEVEL
        # edges along which the function is affine:
        self._affine = closed | (rolled & ~across)
        self._rolled = rolled
        self._constant = [closed | (single & given[:, k]) for k in (0, 1)]
        vertex = np.zeros((len(c.points), 3), dtype=bool)
        vertex[c.facets[self._affine].ravel(), 0] = True
        for k, edges in enumerate(self._constant):  # of dPhi/dx_(1 - k)
            vertex[c.facets[edges].ravel(), 2 - k] = True
        self.frames = RollerFrames(self._boundary, vertex[:, 1:])
        vertex[self.frames.vertices, 1:] = self.frames.held
        for body in self._bodies:  # what no stress sees
            most = body[vertex[body].sum(axis=1).argmax()]
            vertex[most] |= self.frames.missing(vertex, body, most)
        return vertex.ravel(), ~(closed | across), ~self._affine

    def modes(self) -> np.ndarray:
        """Changes of the fixed unknowns that keep the tractions, shape (modes, unknowns)."""
        c = self._cells
        free = self.free[: self.vertices]
        held = np.flatnonzero(~free)
        length = c.measure.mean()
        pins = np.zeros((3 * len(self._bodies), self.vertices))
        for k, body in enumerate(self._bodies):  # what no stress sees
            pinned = self.frames.pinned(~free.reshape(-1, 3), body)
            pins[3 * k + np.arange(3), pinned] = 1.0
        rows = []
        for k, edges in enumerate(self._constant):
            row = np.zeros((edges.sum(), self.vertices))
            for end, sign in zip(c.facets[edges].T, (-1.0, 1.0), strict=True):
                row[np.arange(len(row)), 3 * end + 2 - k] = sign
            rows.append(row)
        start, end = c.facets[self._affine].T
        row = np.zeros((len(start), self.vertices))
        there = np.arange(len(start))
        row[there, 3 * end], row[there, 3 * start] = 1.0, -1.0
        for k in (0, 1):
            row[there, 3 * start + 1 + k] = (
                c.points[start, k] - c.points[end, k]
            ) / length
        rows += [row, self.frames.equations(self.vertices)]
        turned = self.frames.into(np.concatenate(rows))
        equations = np.concatenate([pins, turned])[:, held]
        squares = equations.T @ equations
        _, vectors = eigh(squares, subset_by_value=(-np.inf, LEVEL * squares.max()))
        result = np.zeros((vectors.shape[1], len(self.free)))
        result[:, held] = vectors.T / np.where(held % 3, length, 1.0)
        return result

    def of(self, chosen: np.ndarray | slice) -> AirySpace:
        """The space on some of the triangles, with the same unknowns; those of slices are kept."""
        if not isinstance(chosen, slice):
            return self._of(chosen)
        key = chosen.start, chosen.stop
        if key not in self._of_slices:
            self._of_slices[key] = self._of(chosen)
        return self._of_slices[key]

    def _of(self, chosen: np.ndarray | slice) -> AirySpace:
        """The same, made anew."""
        part = copy(self)
        part._of_slices = {}
        for name in self.of_triangles:
            values = getattr(self, name)
            if isinstance(chosen, slice):
                values = values[..., chosen]
            else:
                values = values.take(chosen, axis=-1)
            setattr(part, name, values)
        return part

    def alone(self, chosen: np.ndarray) -> AirySpace:
        """The space on some of the triangles; unknowns that others share are not free."""
        part = self._of(chosen)
        times = np.bincount(part.unknowns.ravel(), minlength=len(self.free))
        part.numbers = np.flatnonzero(times)
        part.unknowns = (np.cumsum(times > 0) - 1)[part.unknowns]
        part.free = (self.free & (times == self._times))[part.numbers]
        part.vertices = int(np.searchsorted(part.numbers, self.vertices))
        part.frames = self.frames.among(part.numbers[: part.vertices : 3] // 3)
        return part

    def gathered(self, local: np.ndarray) -> np.ndarray:
        """Sums over the triangles of values for their unknowns (n, nt)."""
        return self.frames.into(self.summed(local))

    def summed(self, local: np.ndarray) -> np.ndarray:
        """The same for values that belong to the unknowns themselves, in their frames."""
        return np.bincount(
            self.unknowns.ravel(), local.ravel(), minlength=len(self.free)
        )

    def _set_maps(self) -> None:
        """The parts of the map from the unknowns of a triangle to those of the reference.

        ``_J`` (2, 2, nt) maps the gradients at the vertices.  The unknowns of the edges are
        multiplied by ``_across`` (3, nt); the first kind has ``_along`` (3, nt) times the products
        of ``EDGE_ROWS`` with values and gradients of the reference in addition, the third kind the
        signs ``_odd`` and ``_even`` (3, nt) times the second kind.  On rollers these kinds are
        what the normal derivative has beyond that of a constant derivative along d.
        """
        c = self._cells
        J = c.jacobian.transpose(2, 1, 0).copy()
        directions, tangents = (
            (vectors @ J.reshape(2, -1)).reshape(3, 2, -1)
            for vectors in (NORMALS, LEGS)
        )
        normal = c.normal.T[:, c.facet_of.T]
        across = np.einsum("kjt,jkt->kt", directions, normal)
        size = np.einsum("kjt,kjt->kt", tangents, tangents)
        self._J = J
        self._across = across
        self._along = np.einsum("kjt,kjt->kt", directions, tangents) / size
        edge, cell = np.nonzero(self._rolled[c.facet_of.T])
        d = self._directions[c.facet_of[cell, edge]]
        over = np.einsum("rj,jr->r", d, normal[:, edge, cell])
        beside = np.einsum("rj,rj->r", d, tangents[edge, :, cell]) / size[edge, cell]
        slope = np.where(np.abs(over) > LEVEL, beside / np.where(over, over, 1.0), 0.0)
        self._along[edge, cell] -= across[edge, cell] * slope
        self._even = self._along
        self._odd = np.where(c.place[:, :, 0].T == 0, across, -across)

    def _on_reference(self, local: np.ndarray) -> np.ndarray:
        """Unknowns of the reference triangle from those of the mesh, both (n, nt)."""
        corners = turned(local[:9], self._J)
        result = np.concatenate([corners, local[9:]])
        result[9:12] *= self._across
        result[9:12] += self._along * (EDGE_ROWS @ corners)
        if len(local) > 12:
            result[15:18] = self._odd * local[15:18] + self._even * local[12:15]
        return result

    def _from_reference(self, forces: np.ndarray) -> np.ndarray:
        """The transpose of this map."""
        bent = forces[:9] + EDGE_ROWS.T @ (self._along * forces[9:12])
        others = self._combined(forces[9:])
        return np.concatenate([turned(bent, self._J.swapaxes(0, 1)), others])

    def _combined(self, rows: np.ndarray) -> np.ndarray:
        """The transpose of the map of the other unknowns alone, (n - 9, nt) or (n - 9, ., nt)."""

        def each(values: np.ndarray) -> np.ndarray:
            """Values (3, nt) for rows of this shape."""
            return values if rows.ndim == 2 else values[:, None]

        result = rows.copy()
        result[:3] *= each(self._across)
        if len(rows) > 3:
            result[3:6] += each(self._even) * rows[6:9]
            result[6:9] *= each(self._odd)
        return result

    def _blocks(self, K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The blocks of T' K T for ``kept_entries`` (., nt) of matrices K of the reference.

        T is the map to the reference triangle; the blocks are those of ``stiffness``.
        """
        n, nt = self.unknowns.shape
        corners, cross, rest = np.split(K, np.cumsum([54, 9 * (n - 9)]))
        corners = corners.reshape(3, 3, 6, nt)
        cross = cross.reshape(9, n - 9, nt)
        rest = rest.reshape(n - 9, n - 9, nt)
        bent = EDGE_ROWS.T @ (self._along[:, None] * rest[:3]).reshape(3, -1)
        bent = bent.reshape(cross.shape)
        half = (cross[:, :3] + bent[:, :3] / 2) * self._along
        corners += (OF_BENDS @ half.reshape(27, -1)).reshape(corners.shape)
        back = self._J.swapaxes(0, 1)
        turn(corners[1], corners[2], back)
        turn(corners[:, 1], corners[:, 2], back)
        cross += bent
        cross = self._combined(cross.swapaxes(0, 1)).swapaxes(0, 1)
        rest = self._combined(self._combined(rest).swapaxes(0, 1))
        return corners, turned(cross, back), rest

    def _compliances(self, H: np.ndarray) -> np.ndarray:
        """The six entries of H (nt, ., 3, 3) for reference stresses, (. 6, nt)."""
        M = self._piola * (np.sqrt(self.area) / self.det)
        half = np.einsum("ijt,tqjk->qikt", M, H)
        six = np.einsum("qskt,skt->qst", half[:, FIRST], M[SECOND])
        return six.reshape(-1, len(H))

    def stiffness(self, H: np.ndarray) -> Iterator[Blocks]:
        """Stiffness of the triangles from d2 phi*/dz2 at one point or all, (nt, ., 3, 3).

        For some triangles after the others: which these are, the blocks of the pairs ``BLOCKS`` of
        vertices, (3, 3, 6, n); those of the vertices with the k other unknowns, (9, k, n); those of
        the others.  All of them at once would be new memory on each mesh, which takes longer.
        """
        table = self.rule.stiffness
        table = table if H.shape[1] > 1 else table.sum(axis=0)
        table = table.reshape(-1, table.shape[-1]).T.copy()
        for cells in portions(len(H), AT_ONCE):
            part = self.of(cells)
            corners, cross, rest = part._blocks(table @ part._compliances(H[cells]))
            self.frames.turn(corners, cross, part.unknowns[:9:3] // 3, BLOCKS)
            yield cells, corners, cross, rest

    def stress(self, x: np.ndarray) -> np.ndarray:
        """In-plane stress coordinates at the points, (nt, points, 3), of all unknowns x."""
        result = by_cells(len(self.det), len(self.rule.weights), 3)
        for cells, stress in self._stresses(x):
            result[cells] = stress
        return result

    def add_stress(self, x: np.ndarray, z: np.ndarray) -> None:
        """Add this stress to stresses z in place, without new memory for all triangles."""
        for cells, stress in self._stresses(x):
            z[cells] += stress

    def _stresses(self, x: np.ndarray) -> Iterator[tuple[slice, np.ndarray]]:
        """The stress on some triangles after the others, and which these are."""
        x = self.frames.out_of(x)
        for cells in portions(len(self.det)):
            part = self.of(cells)
            own = x.take(part.unknowns) / part.det
            reference = self.rule.rows @ part._on_reference(own)
            reference = reference.reshape(len(self.rule.weights), 3, -1)
            stress = np.einsum("qbt,bct->qct", reference, part._piola)
            yield cells, np.moveaxis(stress, 2, 0)

    def to_nodes(self, z: np.ndarray) -> None:
        """Replace values (nt, points, c) at the points by those at the nodes of the parts."""
        k = len(self.rule.nodal)
        for cells in portions(len(z)):
            values = z[cells].transpose(1, 2, 0)
            found = np.matmul(self.rule.nodal, values.reshape(3, k, -1))
            z[cells] = np.moveaxis(found.reshape(values.shape), 2, 0)

    def forces(self, strain: np.ndarray) -> np.ndarray:
        """The transpose of ``stress`` with the weights of the points, by triangle, (n, nt)."""
        M = self._piola * (self.area / self.det)
        pulled = np.einsum("bct,tqc->qbt", M, strain).reshape(-1, len(self.det))
        return self._from_reference(self.rule.forces.T @ pulled)
