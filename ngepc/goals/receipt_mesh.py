"""The cells of a receipt: the parts of the cells of a mesh, bisected where bounds need it.

Stresses are polynomials on the parts of cells; parts in which the yielding zone ends are bisected,
so that the checker need not cut them.  A cell knows of which part it is a piece, and where.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ngepc.bounds.polynomials import quadratics
from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.goals.check_receipt import BETWEEN, PAIRS


class Pieces:
    """Pieces of the parts of the cells of ``mesh``, for displacements of an order.

    ``vertices`` (pieces, N + 1) are places in ``points``; ``part`` (pieces,) are numbers of parts,
    part k of cell c being (N + 1) c + k, with the vertices of facet k and the centre of c; and
    ``shares`` (pieces, N + 1, N + 1) the barycentric coordinates of the vertices in the part.
    """

    def __init__(self, mesh: Simplices, order: int) -> None:
        v = mesh.N + 1
        self.mesh, self.N, self.order = mesh, mesh.N, order
        self.points = np.concatenate(
            [mesh.points, mesh.points[mesh.nodes].mean(axis=1)]
        )
        centre = len(mesh.points) + np.arange(len(mesh.nodes))
        centre = np.broadcast_to(centre[:, None, None], (len(centre), v, 1))
        vertices = np.concatenate([mesh.nodes[:, FACETS[mesh.N]], centre], axis=2)
        self.vertices = vertices.reshape(-1, v)
        self.part = np.arange(len(self.vertices))
        self.shares = np.tile(np.eye(v), (len(self.vertices), 1, 1))

    def bisect(self, marked: np.ndarray) -> None:
        """Bisect the longest edges of the marked pieces, and all pieces around these edges."""
        ends, length = self._edges()
        longest = length.argmax(axis=1)[marked]
        wanted = np.unique(self._keys(ends[marked, longest]))
        while len(wanted):
            ends, length = self._edges()
            keys = self._keys(ends)
            left = np.isin(keys, wanted)
            first = np.where(left, length, 0.0).argmax(axis=1)
            first = np.where(left.any(axis=1), keys[np.arange(len(keys)), first], -1)
            around, count = np.unique(keys[left], return_counts=True)
            chosen, times = np.unique(first[first >= 0], return_counts=True)
            chosen = chosen[times == count[np.searchsorted(around, chosen)]]
            self._halve(keys, first, chosen, ends)
            wanted = np.setdiff1d(wanted, chosen)

    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (pieces, edges, 2), ascending, and lengths of edges; ties end by their numbers."""
        pairs = np.array(list(combinations(range(self.N + 1), 2)))
        ends = np.sort(self.vertices[:, pairs], axis=2)
        away = self.points[ends[..., 1]] - self.points[ends[..., 0]]
        length = np.linalg.norm(away, axis=2)
        tie = self._keys(ends) / float(len(self.points)) ** 2
        return ends, length * (1 + 1e-9 * tie)

    def _keys(self, ends: np.ndarray) -> np.ndarray:
        """A number for each edge."""
        return ends[..., 0] * (1 << 31) + ends[..., 1]

    def _halve(
        self, keys: np.ndarray, first: np.ndarray, chosen: np.ndarray, ends: np.ndarray
    ) -> None:
        """Bisect the edges ``chosen``, one of each piece at most."""
        cut = np.flatnonzero(np.isin(first, chosen))
        edge = (keys[cut] == first[cut, None]).argmax(axis=1)
        both = ends[cut, edge]
        middle = len(self.points) + np.searchsorted(chosen, first[cut])
        added = np.stack([chosen >> 31, chosen & ((1 << 31) - 1)], axis=1)
        self.points = np.concatenate([self.points, self.points[added].mean(axis=1)])
        place = [(self.vertices[cut] == both[:, [e]]).argmax(axis=1) for e in (0, 1)]
        rows = np.arange(len(cut))
        shares = (self.shares[cut, place[0]] + self.shares[cut, place[1]]) / 2
        new = []
        for end in place:
            vertices = self.vertices[cut]
            at = self.shares[cut]
            vertices[rows, end] = middle
            at[rows, end] = shares
            new.append((vertices, at, self.part[cut]))
        kept = np.ones(len(self.part), dtype=bool)
        kept[cut] = False
        old = self.vertices[kept], self.shares[kept], self.part[kept]
        self.vertices, self.shares, self.part = map(
            np.concatenate, zip(old, *new, strict=True)
        )


class FileCells:
    """The cells of a file, with ascending vertices, and what they are of the mesh.

    ``cells`` (cells, k) are the vertices, and for order two the nodes on the edges between the
    ``PAIRS`` of vertices; ``points`` are their positions.  ``other`` (N + 1, cells) are the places
    (side, cell) beyond sides, and ``out`` those of the boundary.
    """

    def __init__(self, pieces: Pieces) -> None:
        self.mesh, self.N, self.order = pieces.mesh, pieces.N, pieces.order
        v = self.N + 1
        turn = pieces.vertices.argsort(axis=1)
        self.cells = np.take_along_axis(pieces.vertices, turn, axis=1)
        self.part = pieces.part
        self._shares = np.take_along_axis(pieces.shares, turn[:, :, None], axis=1)
        self.points = pieces.points
        sides = Simplices(self.points, self.cells)
        order = sides.nodes.argsort(axis=1)
        number = np.take_along_axis(sides.facet_of, order, axis=1)
        if self.order == 2:
            self._add_edges()
        self._join(number.T.ravel())
        side, self._owner = np.divmod(self.out, len(self.cells))
        self._kept = np.array([np.delete(np.arange(v), i) for i in range(v)])[side]
        self._side = side

    def _add_edges(self) -> None:
        """Nodes in the middle of all edges, with numbers after those of the vertices."""
        v = self.N + 1
        edges = self.cells[:, PAIRS[v][:, v:].T]
        count = len(self.points)
        keys, number = np.unique(edges @ [count, 1], return_inverse=True)
        self.cells = np.hstack([self.cells, count + number.reshape(edges.shape[:2])])
        middles = self.points[np.transpose(np.divmod(keys, count))].mean(axis=1)
        self.points = np.concatenate([self.points, middles])

    def _join(self, number: np.ndarray) -> None:
        """The places beyond sides, and those of the boundary, by the numbers of sides."""
        order = number.argsort(kind="stable")
        second = np.flatnonzero(np.diff(number[order]) == 0) + 1
        other = np.arange(len(number))
        other[order[second]] = order[second - 1]
        other[order[second - 1]] = order[second]
        self.other = other.reshape(self.N + 1, -1)
        self.out = np.flatnonzero(other == np.arange(len(other)))

    def of_cells(self, values: np.ndarray) -> np.ndarray:
        """Values on the cells of the mesh."""
        return values[self.part // (self.N + 1)]

    def of_facets(self, values: np.ndarray) -> np.ndarray:
        """Values on the facets of the mesh for the sides of the boundary."""
        return values[self.mesh.facet_of.ravel()[self.part[self._owner]]]

    def on_facets(self, values: np.ndarray) -> np.ndarray:
        """Coefficients (sides, t, .) of affine functions from vertex values (facets, N, .)."""
        shares = self._shares[self._owner[:, None], self._kept, : self.N]
        place = self.mesh.place.reshape(-1, self.N)[self.part[self._owner]]
        local = self.of_facets(values)[np.arange(len(place))[:, None], place]
        at = np.einsum("bvi,bi...->bv...", shares, local)
        return at if self.order == 1 else as_quadratic(at)

    def ends(self) -> np.ndarray:
        """The nodes of the sides of the boundary, (sides, t)."""
        every = np.arange(self.cells.shape[1])
        around = BETWEEN[self.order, self.N + 1]
        kept = np.array([np.setdiff1d(every, row) for row in around])
        return self.cells[self._owner[:, None], kept[self._side]]

    def stress(self, c: np.ndarray) -> np.ndarray:
        """Coefficients (cells, k, .) of polynomials with coefficients on parts (parts, k, .)."""
        found = polar(self._shares, c[self.part])
        affine = found.shape[1] == self.N + 1
        return as_quadratic(found) if self.order == 2 and affine else found

    def displacement(self, local: np.ndarray) -> np.ndarray:
        """Coefficients at the nodes of a displacement with those of the cells of the mesh."""
        v = self.N + 1
        centre = np.full((1, v), 1 / v)
        corners = [np.vstack([np.eye(v)[list(f)], centre]) for f in FACETS[self.N]]
        corners = np.array(corners)[self.part % v]
        values = polar(self._shares @ corners, self.of_cells(local))
        u = np.zeros_like(self.points)
        u[self.cells] = values
        return u


def as_quadratic(affine: np.ndarray) -> np.ndarray:
    """Coefficients (n, k, .) of affine functions (n, v, .) as quadratic ones."""
    i, j = PAIRS[affine.shape[1]]
    return (affine[:, i] + affine[:, j]) / 2


def polar(shares: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Coefficients (pieces, k, .) on pieces with these vertices of polynomials on simplices."""
    v = shares.shape[1]
    if c.shape[1] == v:
        return shares @ c
    ends = shares[:, PAIRS[v]]
    first, second = ends.swapaxes(0, 1).reshape(2, -1, v)
    return quadratics(first, second).reshape(len(shares), -1, c.shape[1]) @ c
