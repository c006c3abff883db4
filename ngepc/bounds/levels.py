"""Conjugate gradients for Airy functions, with a preconditioner in three parts.

Unknowns of vertices: a direct solver where most of the bound is, elsewhere the blocks of the
vertices; unknowns of edges: a Chebyshev polynomial.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from itertools import islice

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.bounds.airy import AirySpace, Blocks
from ngepc.bounds.simplices import Simplices, marked, stable_order
from ngepc.bounds.vertex_matrix import VertexGraph, VertexMatrix
from ngepc.linalg.descent import Linear, conjugate_gradients

EDGE_STEPS = 3  # steps of Chebyshev's iteration for the unknowns of edges
LEAST = 0.2  # lower end of its interval of eigenvalues, relative to the upper end
SHARE = 0.97
"""The direct solver takes the fewest triangles that have this share of the bound."""
RINGS = 9
"""... and so many rings of triangles around them."""
DAMPED = 0.5
"""Factor of the inverse blocks of the other vertices.

No triangle adds more than twice what the direct solver and the blocks over this factor have there:
with n vertices outside |sum of n terms|^2 is at most n times the sum of their squares.
"""
MODES_UP_TO = 1000
"""Largest number of triangles for which resultants between supports are unknowns.

On finer meshes they are taken from the discrete solution: they converge twice as fast as its
stress.
"""


class ElementRows:
    """The rows of element matrices in sparse matrices, for unknowns with ``numbers`` (m, nt).

    What several elements enter in one place stands there several times: sorting it would take
    longer than all products.
    """

    def __init__(self, numbers: np.ndarray) -> None:
        self._order = stable_order(numbers.ravel())
        self.rows = np.empty(numbers.shape, dtype=int)
        self.rows.flat[self._order] = np.arange(numbers.size)
        self.starts = np.append(0, np.cumsum(np.bincount(numbers.ravel())))

    def columns(self, columns: np.ndarray) -> np.ndarray:
        """The columns of all rows, (m nt, k), from those of the elements (k, nt)."""
        return columns.T.astype(np.int32)[self._order % columns.shape[1]]


class ElementSum:
    """A sparse matrix of ``width`` columns from element matrices with ``rows`` and ``columns``."""

    def __init__(self, rows: ElementRows, columns: np.ndarray, width: int) -> None:
        self._rows = rows
        self._columns = columns
        self._width = width
        self._entries = np.empty(columns.shape)

    def enter(self, cells: slice, values: np.ndarray) -> None:
        """Enter the matrices (m, k, n) of some elements."""
        self._entries[self._rows.rows[:, cells]] = values.transpose(0, 2, 1)

    def matrix(self) -> csr_matrix:
        """The sum of the matrices that were entered."""
        starts = self._columns.shape[1] * self._rows.starts
        parts = self._entries.ravel(), self._columns.ravel(), starts
        return csr_matrix(parts, shape=(len(starts) - 1, self._width))


class TwoLevels:
    """K x = r for the free unknowns of Airy functions, with a direct solver for vertices.

    ``cells`` are the triangles of the mesh; None if the space is that of some of them.
    """

    def __init__(self, space: AirySpace, cells: Simplices | None = None) -> None:
        self.space = space
        self._cells = cells
        self._count = space.vertices
        edges = space.unknowns[9:] - self._count
        self._edges = edges
        self._graph = VertexGraph(space.unknowns[:9:3] // 3, edges[:3])
        self._rows = ElementRows(edges)
        self._corners = self._rows.columns(space.unknowns[:9])
        self._free = space.free[: self._count].reshape(-1, 3)

    def another(self) -> TwoLevels:
        """The same unknowns for another matrix."""
        return copy(self)

    def update(self, blocks: Iterable[Blocks], forces: Linear) -> None:
        """Set the stiffness of the triangles.

        ``blocks`` are those of ``AirySpace.stiffness``, ``forces`` is the product with all
        unknowns, held ones too.  The solver for them is ``focused``.
        """
        self._forces = forces
        self._vertices = VertexMatrix(self._graph)
        beside = ElementSum(self._rows, self._corners, self._count)
        m, count = self._edges.shape
        among = np.empty((m, m, count))
        for cells, corners, cross, rest in blocks:
            self._vertices.add(cells, corners)
            beside.enter(cells, cross.swapaxes(0, 1))
            among[..., cells] = rest
        self._on_edges = beside.matrix()
        self._on_vertices = self._on_edges.T
        self._take_edges(among)
        self._whole: TwoLevels | None = None

    def focused(
        self,
        per_cell: np.ndarray | None = None,
        share: float = SHARE,
        rings: int = RINGS,
    ) -> TwoLevels:
        """The solver with factors for the vertices where this share of the bound is.

        ``per_cell`` is the bound on each triangle; ``rings`` of triangles around are added.  All
        vertices are taken without it, and if these would be most of the triangles.
        """
        if per_cell is not None:
            near = self._cells.around(marked(per_cell, share), rings)
            if 2 * len(near) <= len(per_cell):
                return self._with_factors(self._cells.nodes[near])
        if self._whole is None:
            self._whole = self._with_factors(slice(None))
        return self._whole

    def _with_factors(self, direct: np.ndarray | slice) -> TwoLevels:
        """The solver with factors for these vertices, and the inverse blocks of all others."""
        result = copy(self)
        chosen = np.zeros(len(self._free), dtype=bool)
        chosen[direct] = True
        unknowns = (self._free & chosen[:, None]).ravel()
        result._inverse = self._vertices.inverse(unknowns)
        others = np.flatnonzero(~chosen & self._free.any(axis=1))
        result._others = others
        inverse_blocks = self._vertices.inverse_blocks(others, self._free[others])
        result._inverse_blocks = DAMPED * inverse_blocks
        result._take_modes()
        return result

    def _take_modes(self) -> None:
        """The resultants between supports on coarse meshes; free unknowns move with them."""
        few = self._cells is not None and len(self.space.det) <= MODES_UP_TO
        modes = self.space.modes() if few else []
        self._modes = np.array(
            [mode - self._relaxed(self._forces(mode)) for mode in modes]
        )
        self._gram = np.array(
            [self._modes @ self._forces(mode) for mode in self._modes]
        )

    def _of_vertices(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution of the vertices' block."""
        x = self._inverse.solve(r)
        alone = r.reshape(-1, 3)[self._others]
        alone = np.einsum("nij,nj->ni", self._inverse_blocks, alone)
        x.reshape(-1, 3)[self._others] = alone
        return x

    def product(self, x: np.ndarray) -> np.ndarray:
        """K x; without modes x is zero at held unknowns, and so is the result."""
        if len(self._modes):
            return self._forces(x)
        vertex = x[: self._count]
        edge = x[self._count :]
        of_edges = self._unscale * (self._edge_matrix @ (self._unscale * edge))
        of_vertices = self._vertices.product(vertex) + self._on_vertices @ edge
        product = np.append(of_vertices, of_edges + self._on_edges @ vertex)
        return product * self.space.free

    def precondition(self, r: np.ndarray) -> np.ndarray:
        """The preconditioner: an approximate solution of K x = r."""
        x = self._relaxed(r)
        if len(self._modes):
            x += np.linalg.solve(self._gram, self._modes @ r) @ self._modes
        return x

    def _take_edges(self, K: np.ndarray) -> None:
        """The matrix of the edges, its diagonal scaled to one, and a bound of its eigenvalues."""
        free = self.space.free[self._count :]
        edges = self._edges
        own = np.einsum("kkt->kt", K).ravel()
        diagonal = np.bincount(edges.ravel(), own, len(free))
        self._unscale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        self._scale = free / self._unscale
        scale = self._scale[edges]
        K *= scale
        K *= scale[:, None]
        among = ElementSum(self._rows, self._rows.columns(edges), len(free))
        among.enter(slice(None), K)
        self._edge_matrix = among.matrix()
        self._edge_matrix.sum_duplicates()
        self._largest = abs(self._edge_matrix).sum(axis=1).max()

    def _of_edges(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution of the edges' block by Chebyshev's iteration."""
        middle = self._largest * (1 + LEAST) / 2
        half = self._largest * (1 - LEAST) / 2
        r = self._scale * r
        x = step = r / middle
        rho = half / middle
        for _ in range(EDGE_STEPS - 1):
            left = r - self._edge_matrix @ x
            before = rho
            rho = 1 / (2 * middle / half - before)
            step = rho * before * step + 2 * rho / half * left
            x = x + step
        return self._scale * x

    def _relaxed(self, r: np.ndarray) -> np.ndarray:
        """Block Gauss-Seidel for the free unknowns: edges, vertices, edges again."""
        count = self._count
        edge = self._of_edges(r[count:])
        vertex = self._of_vertices(r[:count] - self._on_vertices @ edge)
        edge -= self._of_edges(self._on_edges @ vertex)
        return np.concatenate([vertex, edge])

    def solve(self, right: np.ndarray, bound: float, gain: float, most: int) -> tuple:
        """An approximate solution of K x = right, and the resulting error bound.

        Each step of conjugate gradients lowers ``bound``.  They end after ``most`` steps, or at a
        step that lowers it by less than the fraction ``gain``.
        """
        x = np.zeros_like(right)
        steps = conjugate_gradients(self.product, self.precondition, right)
        for step in islice(steps, most):
            x, _, gained = step
            bound -= gained
            if gained <= gain * bound:
                break
        return x, bound
