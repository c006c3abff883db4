"""The stiffness matrix of the displacements as N x N blocks, one for each pair of nodes.

They stand on one pattern and are filled in place.  A direct solver that orders and eliminates nodes
instead of single components takes a third of the time.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import CF, H1, BaseMatrix, BilinearForm, InnerProduct, Trace, VectorH1, dx
from ngsolve.la import SparseMatrixd
from scipy.sparse import bsr_matrix, csr_matrix

from ngepc.discretisation.points import Elements, Moduli, PointFunctions, Points
from ngepc.linalg.direct import both_triangles, lower_triangle


class Blocks:
    """Tangents by N x N blocks on and below the diagonal: ``values``, shape (blocks, N, N)."""

    rows: np.ndarray  # nodes of the blocks, row by row, rows >= columns
    columns: np.ndarray
    free: np.ndarray  # boolean, shape (nodes, N): components that no support holds
    N: int

    def held(self, values: np.ndarray) -> np.ndarray:
        """Make rows and columns of held components those of the identity."""
        held = ~self.free.all(axis=1)
        some = np.flatnonzero(held[self.rows] | held[self.columns])
        i, j = self.free[self.rows[some]], self.free[self.columns[some]]
        values[some] = np.where(i[:, :, None] & j[:, None], values[some], 0.0)
        nodes, components = np.nonzero(~self.free)
        values[np.flatnonzero(self.rows == self.columns)[nodes], components, components] = 1.0
        return values


class StiffnessBlocks(Blocks):
    """The blocks of B' C B and of a symmetric matrix between nodes of one element, ``added``."""

    def __init__(self, points: Points, free: np.ndarray, added: csr_matrix | None = None) -> None:
        self.points, self.free, self.N = points, free, points.kinematics.N
        rows, columns, _ = lower_triangle(pattern_matrix(points.scalar))
        self.rows, self.columns = rows.astype(np.int32), columns.astype(np.int32)
        keys, self._added = rows * len(free) + columns, None
        self._places = [[self._places_of(p, keys) for p in block.parts] for block in points.blocks]
        if added is not None:
            blocks = added.tobsr((self.N, self.N))
            i = np.repeat(np.arange(len(free)), np.diff(blocks.indptr))
            lower = i >= blocks.indices
            wanted = i[lower] * np.int64(len(free)) + blocks.indices[lower]
            self._added = np.searchsorted(keys, wanted), blocks.data[lower]

    def _places_of(self, part: Elements, keys: np.ndarray) -> tuple[np.ndarray, ...]:
        """Blocks that some elements touch, which of these each pair is, and where to transpose."""
        a, b = np.tril_indices(part.nodes.shape[1])
        i, j = part.nodes[:, a], part.nodes[:, b]
        wanted = np.maximum(i, j) * np.int64(len(self.free)) + np.minimum(i, j)
        touched, which = np.unique(wanted, return_inverse=True)
        touched = np.searchsorted(keys, touched)
        return touched.astype(np.int32), which.astype(np.int32).ravel(), i < j

    def values(self, moduli: Moduli) -> np.ndarray:
        """The blocks for these moduli at the points, shape (blocks, N, N)."""
        values = self.summed(moduli)
        if self._added is not None:
            places, blocks = self._added
            values[places] += blocks
        return self.held(values)

    def summed(self, moduli: Moduli) -> np.ndarray:
        """The blocks without what is added and held."""
        values = np.zeros((len(self.rows), self.N**2))
        for block, places in zip(self.points.blocks, self._places, strict=True):
            k = block.nodes.shape[1]
            a, b = np.tril_indices(k)
            for part, (touched, which, turned) in zip(block.parts, places, strict=True):
                K = part.stiffness(moduli)
                K = K.reshape(-1, k, self.N, k, self.N)[:, a, :, b, :].swapaxes(0, 1)
                K[turned] = K[turned].swapaxes(1, 2)
                found = [np.bincount(which, c, len(touched)) for c in K.reshape(-1, self.N**2).T]
                values[touched] += np.column_stack(found)
        return values.reshape(-1, self.N, self.N)


class Stiffness:
    """``StiffnessBlocks`` as a matrix for NGSolve's direct solvers: its lower half."""

    def __init__(self, points: Points, free: np.ndarray, added: csr_matrix | None = None) -> None:
        self._blocks = StiffnessBlocks(points, free, added)
        self.matrix = pattern_matrix(H1(points.mesh, order=points.order, dim=points.kinematics.N))
        if self.entries.shape[0] != len(self._blocks.rows):
            raise RuntimeError("the block matrix has another pattern than the scalar one")

    def another(self, blocks: StiffnessBlocks | None = None) -> Stiffness:
        """One more matrix on the same pattern, assembled by other blocks if there are some."""
        other = copy(self)
        other.matrix, other._blocks = self.matrix.CreateMatrix(), blocks or self._blocks
        return other

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, shape (entries, N, N)."""
        N = self._blocks.N
        return self.matrix.AsVector().FV().NumPy().reshape(-1, N, N)

    def whole(self) -> SparseMatrixd:
        """A matrix with both triangles, number by number, for solvers that need it."""
        blocks, nodes = self._blocks, len(self._blocks.free)
        starts = np.searchsorted(blocks.rows, np.arange(nodes + 1))
        shape = (blocks.N * nodes,) * 2
        return both_triangles(bsr_matrix((self.entries, blocks.columns, starts), shape=shape))

    def diagonal_places(self, nodes: np.ndarray) -> np.ndarray:
        """Where in ``entries`` the diagonal blocks of these nodes are."""
        return np.flatnonzero(self._blocks.rows == self._blocks.columns)[nodes]

    def fill(self, moduli: Moduli) -> None:
        """Assemble the entries for these moduli at the points."""
        self.entries[:] = self._blocks.values(moduli)


class SymbolicBlocks(StiffnessBlocks):
    """The same matrix, assembled by a symbolic form of NGSolve: slower, the formula to be seen."""

    def __init__(self, points: Points, free: np.ndarray, added: csr_matrix | None = None) -> None:
        super().__init__(points, free, added)
        self._functions, kinematics = PointFunctions(points), points.kinematics
        shapes = [(len(points),)] * 3 + [(len(points), kinematics.d)]
        self._moduli = [self._functions.function(np.zeros(shape)) for shape in shapes]
        bulk, across, extra, direction = self._moduli
        u, v = VectorH1(points.mesh, order=points.order).TnT()
        e, d = (kinematics.coordinates(kinematics.strain(w)) for w in (u, v))
        volume = Trace(kinematics.strain(u)) * Trace(kinematics.strain(v))
        along = InnerProduct(direction, e) * InnerProduct(direction, d)
        power = bulk * volume + across * InnerProduct(e, d) + extra * along
        self._form = BilinearForm((kinematics.weight * power).Compile() * dx(intrules=points.rules))

    def summed(self, moduli: Moduli) -> np.ndarray:
        """The blocks without what is added and held."""
        for function, values in zip(self._moduli, vars(moduli).values(), strict=True):
            function.vec.data = self._functions.function(values).vec
        matrix = self._form.Assemble().mat
        return ComponentBlocks(matrix, self.free).values(matrix)


class ComponentBlocks(Blocks):
    """Those of matrices of NGSolve that go component by component, made for one of them."""

    def __init__(self, matrix: BaseMatrix, free: np.ndarray) -> None:
        self.free, (nodes, self.N) = free, free.shape
        pattern = csr_matrix(tuple(map(np.asarray, matrix.CSR())))[:nodes, :nodes].tocoo()
        self._lower = pattern.row >= pattern.col
        self.rows, self.columns = (a[self._lower] for a in (pattern.row, pattern.col))

    def values(self, matrix: BaseMatrix) -> np.ndarray:
        """The blocks of a matrix, shape (blocks, N, N)."""
        whole, nodes = csr_matrix(tuple(map(np.asarray, matrix.CSR()))), len(self.free)
        parts = [slice(first, first + nodes) for first in range(0, nodes * self.N, nodes)]
        entries = [whole[i, j].data[self._lower] for i in parts for j in parts]
        return self.held(np.stack(entries, axis=1).reshape(-1, self.N, self.N))


def pattern_matrix(space: H1) -> BaseMatrix:
    """A symmetric matrix with the pattern of the space, its lower triangle stored."""
    u, v = space.TnT()
    form = BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += CF(0) * u * v * dx
    return form.Assemble().mat
