"""Conjugate gradients for Airy functions, with a preconditioner in three parts.

Unknowns of vertices: a direct solver where most of the bound is, elsewhere the blocks of the
vertices; unknowns of edges: a Chebyshev polynomial.
"""

from __future__ import annotations

from copy import copy
from itertools import islice

import numpy as np
from ngsolve import H1, BitArray
from scipy.sparse import csr_matrix

from ngepc.bounds.airy import LOWER, AirySpace, joined_blocks
from ngepc.bounds.simplices import Simplices, marked
from ngepc.discretisation.stiffness import Blocks, pattern_matrix
from ngepc.linalg.descent import Linear, conjugate_gradients
from ngepc.linalg.direct import lower_triangle
from ngepc.model.elements import inverses

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
    """Sparse matrices from the rows of element matrices, for unknowns with ``numbers`` (m, nt).

    What several elements enter in one place stands there several times: sorting it would take
    longer than all products.
    """

    def __init__(self, numbers: np.ndarray, count: int) -> None:
        self._count = count
        self._order = np.argsort(numbers.ravel(), kind="stable")
        times = np.bincount(numbers.ravel(), minlength=count)
        self._starts = np.append(0, np.cumsum(times))

    def matrix(self, values: np.ndarray, columns: np.ndarray, width: int) -> csr_matrix:
        """The sum of matrices (m, k, nt) whose columns have the numbers ``columns`` (k, nt)."""
        _, k, count = values.shape
        entries = values.transpose(0, 2, 1).reshape(-1, k)[self._order]
        places = columns.T.astype(np.int32)[self._order % count]
        data = (entries.ravel(), places.ravel(), k * self._starts)
        return csr_matrix(data, shape=(self._count, width))


class TwoLevels(Blocks):
    """K x = r for Airy functions, with a direct solver for vertices.

    The matrix of the vertices consists of blocks (3, 3) on and below the diagonal.
    """

    N = 3

    def __init__(self, space: AirySpace, cells: Simplices) -> None:
        self._cells = cells
        nv = np.int64(len(cells.points))
        self.matrix = pattern_matrix(H1(cells.mesh, order=1, dim=3))
        self.rows, self.columns, _ = lower_triangle(self.matrix)
        keys = self.rows * nv + self.columns
        ends = cells.facets.astype(np.int64)
        edge = np.searchsorted(keys, ends[:, 1] * nv + ends[:, 0])[cells.facet_of]
        corner = np.searchsorted(keys, np.arange(nv) * (nv + 1))[cells.nodes]
        a, b = LOWER
        self._turned = (cells.nodes[:, a] < cells.nodes[:, b]).T
        pairs = zip(a, b, strict=True)
        places = [corner[:, i] if i == j else edge[:, 3 - i - j] for i, j in pairs]
        self._places = np.stack(places)
        self._right, self._left = (self.matrix.CreateColVector() for _ in range(2))
        self._entries: np.ndarray | slice = slice(None)  # of the matrix
        self._vertices: np.ndarray | slice = slice(None)  # of the mesh
        self._take(space)

    def _take(self, space: AirySpace) -> None:
        """Solve for the free unknowns of a space."""
        self.space = space
        self._count = space.vertices
        self._corners = space.unknowns[:9]
        self._edges = space.unknowns[9:] - space.vertices
        self._rows = ElementRows(self._edges, len(space.free) - space.vertices)
        free = space.free[: self._count].reshape(-1, 3)
        self._there = free.any(axis=1)
        # the solver leaves out what is held as a whole
        self.free = free | ~self._there[:, None]

    def another(self) -> TwoLevels:
        """The same unknowns with a matrix of its own."""
        result = copy(self)
        result.matrix = self.matrix.CreateMatrix()
        return result

    def on(self, space: AirySpace, chosen: np.ndarray) -> TwoLevels:
        """The same for the space ``AirySpace.alone`` of some triangles, a matrix of its own.

        Its unknowns alone have places in arrays; only the matrix for the direct solver keeps the
        numbers of the mesh.
        """
        result = self.another()
        result.matrix.AsVector()[:] = 0.0
        result._turned = self._turned[:, chosen]
        result._entries, places = np.unique(
            self._places[:, chosen], return_inverse=True
        )
        result._places = places.reshape(self._places[:, chosen].shape)
        result._vertices = space.numbers[: space.vertices : 3] // 3
        own = np.zeros(len(self._there), dtype=int)
        own[result._vertices] = np.arange(len(result._vertices))
        result.rows = own[self.rows[result._entries]]
        result.columns = own[self.columns[result._entries]]
        result._take(space)
        return result

    def update(self, blocks: tuple[np.ndarray, ...], forces: Linear) -> None:
        """Set the stiffness of the triangles.

        ``blocks`` are those of ``AirySpace.stiffness``, ``forces`` is the product with all
        unknowns, held ones too.  The solver for them is ``focused``.
        """
        corners, cross, rest = blocks
        self._forces = forces
        self._on_edges = self._rows.matrix(
            cross.swapaxes(0, 1), self._corners, self._count
        )
        self._on_vertices = self._on_edges.T
        if not self._is_whole:
            self._joined = joined_blocks(*blocks)
        self._take_edges(rest)
        where = self._places.ravel()
        sums = np.empty((len(self.rows), 3, 3))
        for i, j in np.ndindex(3, 3):
            values = np.where(self._turned, corners[j, i], corners[i, j])
            sums[:, i, j] = np.bincount(where, values.ravel(), len(sums))
        self._values[self._entries] = self.held(sums)
        diagonal = sums[self.rows == self.columns]
        self._inverse_blocks = DAMPED * inverses(diagonal)
        self._whole: TwoLevels | None = None

    @property
    def _values(self) -> np.ndarray:
        """View of the blocks of the matrix."""
        return self.matrix.AsVector().FV().NumPy().reshape(-1, 3, 3)

    def focused(
        self, per_cell: np.ndarray | None = None, share: float = SHARE
    ) -> TwoLevels:
        """The solver with factors for the vertices where this share of the bound is.

        ``per_cell`` is the bound on each triangle.  All vertices are taken without it, and if these
        would be most of the triangles.
        """
        if per_cell is not None:
            near = self._cells.around(marked(per_cell, share), RINGS)
            if 2 * len(near) <= len(per_cell):
                return self._with_factors(self._cells.nodes[near])
        if self._whole is None:
            self._whole = self._with_factors(slice(None))
        return self._whole

    def _with_factors(self, direct: np.ndarray | slice) -> TwoLevels:
        """The solver with factors for these vertices, and the inverse blocks of all others."""
        result = copy(self)
        chosen = np.zeros(len(self._there), dtype=bool)
        chosen[direct] = True
        inside = np.zeros(len(self._right), dtype=bool)
        inside[self._vertices] = chosen & self._there
        inside = BitArray(inside.tolist())
        result._inverse = self.matrix.Inverse(inside, inverse="sparsecholesky")
        result._others = np.flatnonzero(~chosen & self._there)
        result._inverse_blocks = self._inverse_blocks[result._others]
        result._take_modes()
        return result

    @property
    def _is_whole(self) -> bool:
        """Whether these are the unknowns of the whole mesh."""
        return len(self.space.det) == len(self._cells.nodes)

    def _take_modes(self) -> None:
        """The resultants between supports on coarse meshes; free unknowns move with them."""
        few = self._is_whole and len(self.space.det) <= MODES_UP_TO
        modes = self.space.modes() if few else []
        self._modes = np.array(
            [mode - self._relaxed(self._forces(mode)) for mode in modes]
        )
        self._gram = np.array(
            [self._modes @ self._forces(mode) for mode in self._modes]
        )

    def _of_vertices(self, r: np.ndarray) -> np.ndarray:
        """Approximate solution of the vertices' block."""
        r = np.where(self.space.free[: self._count], r, 0.0).reshape(-1, 3)
        self._right.FV().NumPy().reshape(-1, 3)[self._vertices] = r
        self._left.data = self._inverse * self._right
        x = self._left.FV().NumPy().reshape(-1, 3)[self._vertices].copy()
        alone = r[self._others]
        x[self._others] = np.einsum("nij,nj->ni", self._inverse_blocks, alone)
        return x.ravel()

    def product(self, x: np.ndarray) -> np.ndarray:
        """K x; without modes x is zero at held unknowns, and so is the result."""
        if len(self._modes):
            return self._forces(x)
        if not self._is_whole:
            forces = np.einsum("ijt,jt->it", self._joined, x[self.space.unknowns])
            return self.space.summed(forces) * self.space.free
        vertex = x[: self._count]
        edge = x[self._count :]
        self._right.FV().NumPy()[:] = vertex
        self._left.data = self.matrix * self._right
        of_edges = self._unscale * (self._edge_matrix @ (self._unscale * edge))
        of_vertices = self._left.FV().NumPy() + self._on_vertices @ edge
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
        scaled = K * scale
        scaled *= scale[:, None]
        self._edge_matrix = self._rows.matrix(scaled, edges, len(free))
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
