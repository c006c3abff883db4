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
from ngepc.bounds.edge_rows import EdgeRows, RowSum
from ngepc.bounds.simplices import Simplices, marked
from ngepc.bounds.vertex_matrix import VertexGraph, VertexMatrix
from ngepc.linalg.descent import conjugate_gradients_by_pairs

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


class TwoLevels:
    """K x = r for the free unknowns of Airy functions, with a direct solver for vertices.

    ``cells`` are the triangles of the mesh; None if the space is that of some of them.  Inside,
    vectors have the order of ``VertexMatrix``, and the unknowns of edges are scaled such that their
    diagonal is one; held ones are zero.
    """

    def __init__(self, space: AirySpace, cells: Simplices | None = None) -> None:
        self.space = space
        self._cells = cells
        self._count = space.vertices
        edges = space.unknowns[9:] - self._count
        self._graph = VertexGraph(space.unknowns[:9:3] // 3, edges[:3])
        self._rows = EdgeRows(self._graph, edges)
        self._free = space.free[: self._count].reshape(-1, 3).T

    def another(self) -> TwoLevels:
        """The same unknowns for another matrix."""
        return copy(self)

    def update(self, blocks: Iterable[Blocks]) -> None:
        """Set the stiffness of the triangles to ``blocks`` of ``AirySpace.stiffness``.

        The solver for them is ``focused``.
        """
        self._vertices = VertexMatrix(self._graph)
        beside = RowSum(self._rows.vertices)
        among = RowSum(self._rows.others)
        for cells, corners, cross, rest in blocks:
            self._vertices.add(cells, corners)
            each = cross.reshape(3, 3, *cross.shape[1:])
            beside.add(cells, each.transpose(2, 0, 1, 3))
            among.add(cells, rest[:, :, None])
        self._take_edges(beside.matrix(self._count), among.matrix(self._rows.count))
        self._damped_blocks = DAMPED * self._vertices.inverse_blocks(self._free)
        self._whole: TwoLevels | None = None

    def _take_edges(self, beside: csr_matrix, among: csr_matrix) -> None:
        """The rows of edges scaled, and a bound of the eigenvalues of their own matrix."""
        diagonal = among.diagonal()
        free = self.space.free[self._count :]
        self._scale = free / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        for matrix in (beside, among):
            matrix.data *= np.repeat(self._scale, np.diff(matrix.indptr))
        among.data *= self._scale[among.indices]
        self._on_edges = beside
        self._on_vertices = beside.T
        self._edge_matrix = among
        # abs(among) would add up equal columns in place, which all matrices of the mesh share
        self._largest = np.add.reduceat(np.abs(among.data), among.indptr[:-1]).max()

    def inside(self, r: np.ndarray) -> np.ndarray:
        """A right side in the order and the scale of the inside."""
        vertex, edge = np.split(r, [self._count])
        return np.append(vertex.reshape(-1, 3).T, self._scale * edge)

    def outside(self, x: np.ndarray) -> np.ndarray:
        """The unknowns of a solution in this order and scale."""
        vertex, edge = np.split(x, [self._count])
        return np.append(vertex.reshape(3, -1).T, self._scale * edge)

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
        chosen = np.zeros(self._graph.count, dtype=bool)
        chosen[direct] = True
        result._inverse = self._vertices.inverse(self._free & chosen)
        result._inverse_blocks = np.where(chosen, 0.0, self._damped_blocks)
        result._take_modes()
        return result

    def _take_modes(self) -> None:
        """The resultants between supports on coarse meshes; free unknowns move with them."""
        few = self._cells is not None and len(self.space.det) <= MODES_UP_TO
        self._modes = self._images = np.zeros((0, len(self.space.free)))
        if not few:
            return
        modes = [self.inside(mode) for mode in self.space.modes()]
        modes = [mode - self.relaxed(self.product(mode))[0] for mode in modes]
        if modes:
            self._modes = np.array(modes)
            self._images = np.array([self.product(mode) for mode in modes])
            self._gram = self._modes @ self._images.T

    def product(self, x: np.ndarray) -> np.ndarray:
        """K x, with the rows of vertices that are held."""
        vertex, edge = np.split(x, [self._count])
        of_vertices = self._vertices.product(vertex) + self._on_vertices @ edge
        of_edges = self._edge_matrix @ edge + self._on_edges @ vertex
        return np.append(of_vertices, of_edges)

    def answered(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The preconditioner: an approximate solution z of K z = r, and K z."""
        z, of_z = self.relaxed(r)
        if len(self._modes):
            shares = np.linalg.solve(self._gram, self._modes @ r)
            z += shares @ self._modes
            of_z += shares @ self._images
        return z, of_z

    def relaxed(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Block Gauss-Seidel for the free unknowns: edges, vertices, edges again; K z with it."""
        of_vertices, of_edges = np.split(r, [self._count])
        z = np.empty_like(r)
        of_z = np.empty_like(r)
        vertex, edge = np.split(z, [self._count])
        first = self._of_edges(of_edges)
        vertex[:] = self._of_vertices(of_vertices - self._on_vertices @ first)
        beside = self._on_edges @ vertex
        np.subtract(first, self._of_edges(beside), out=edge)
        of_z[: self._count] = self._vertices.product(vertex)
        of_z[: self._count] += self._on_vertices @ edge
        np.add(self._edge_matrix @ edge, beside, out=of_z[self._count :])
        return z, of_z

    def _of_vertices(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution of the vertices' block."""
        x = np.einsum("ijn,jn->in", self._inverse_blocks, r.reshape(3, -1)).ravel()
        self._inverse.solve(r, x)
        return x

    def _of_edges(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution of the edges' block by Chebyshev's iteration."""
        middle = self._largest * (1 + LEAST) / 2
        half = self._largest * (1 - LEAST) / 2
        step = r / middle
        x = step.copy()
        rho = half / middle
        for _ in range(EDGE_STEPS - 1):
            left = self._edge_matrix @ x
            np.subtract(r, left, out=left)
            before = rho
            rho = 1 / (2 * middle / half - before)
            step *= rho * before
            left *= 2 * rho / half
            step += left
            x += step
        return x

    def solve(self, right: np.ndarray, bound: float, gain: float, most: int) -> tuple:
        """An approximate solution of K x = right, and the resulting error bound.

        Each step of conjugate gradients lowers ``bound``.  They end after ``most`` steps, or at a
        step that lowers it by less than the fraction ``gain``.
        """
        x = np.zeros_like(right)
        steps = conjugate_gradients_by_pairs(self.answered, self.inside(right))
        for step in islice(steps, most):
            x, gained = step
            bound -= gained
            if gained <= gain * bound:
                break
        return self.outside(x), bound
