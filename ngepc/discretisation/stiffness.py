"""The stiffness matrix of the displacements as N x N blocks, one for each pair of nodes.

They stand on one pattern and are filled in place.  A direct solver that orders and eliminates nodes
instead of single components takes a third of the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from ngsolve import (
    CF,
    H1,
    BaseMatrix,
    BilinearForm,
    BitArray,
    InnerProduct,
    Mesh,
    Trace,
    dx,
)
from ngsolve.comp import ProxyFunction, SumOfIntegrals
from ngsolve.la import SparseMatrixd
from scipy.sparse import bsr_matrix, csr_matrix, tril

from ngepc.discretisation.element_strains import Elements
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.slanted import SlantedNodes
from ngepc.linalg.cores import in_order
from ngepc.linalg.direct import both_triangles, lower_triangle
from ngepc.linalg.morton import along_curve
from ngepc.model.elements import vertex_coordinates


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
        i = self.free[self.rows[some]]
        j = self.free[self.columns[some]]
        values[some] = np.where(i[:, :, None] & j[:, None], values[some], 0.0)
        nodes, components = np.nonzero(~self.free)
        values[
            np.flatnonzero(self.rows == self.columns)[nodes], components, components
        ] = 1.0
        return values


class Stiffness(Blocks):
    """The blocks of tangents that elements add up to (``summed``), and matrices for them.

    ``data`` determine a tangent: moduli at the points, or displacements.
    """

    def __init__(self, mesh: Mesh, order: int, free: np.ndarray) -> None:
        self.mesh = mesh
        self.free = free
        self.N = free.shape[1]
        self.order = order
        self._space = H1(mesh, order=order, dim=self.N)
        # in the plane blocks are small: the matrix itself shows the pattern
        plane = mesh.dim == 2
        pattern = pattern_matrix(self._space if plane else H1(mesh, order=order))
        self._pattern = pattern if plane else None
        rows, columns, _ = lower_triangle(pattern)
        self.rows = rows.astype(np.int32)
        self.columns = columns.astype(np.int32)
        self._added = np.zeros(0, dtype=int), 0.0
        self._slanted: SlantedBlocks | None = None

    def with_added(self, added: csr_matrix) -> Stiffness:
        """The same plus a symmetric matrix, u flattened node by node.

        It couples nodes of one element only, and replaces what was added before.
        """
        other = copy(self)
        blocks = added.tobsr((self.N, self.N))
        i = np.repeat(np.arange(len(self.free)), np.diff(blocks.indptr))
        lower = i >= blocks.indices
        other._added = self.places(i[lower], blocks.indices[lower]), blocks.data[lower]
        return other

    def with_slanted(self, slanted: SlantedNodes | None) -> Stiffness:
        """The same with nodes that are held along directions that are no axes."""
        other = copy(self)
        if slanted is not None:
            other._slanted = SlantedBlocks(self, slanted)
        return other

    def places(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Where the blocks of pairs of nodes i >= j are."""
        keys, wanted = (
            r.astype(np.int64) * len(self.free) + c
            for r, c in ((self.rows, self.columns), (i, j))
        )
        return np.searchsorted(keys, wanted)

    def summed(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """The blocks without added and held entries, shape (blocks, N, N), in ``out`` if given."""
        raise NotImplementedError

    def values(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """The blocks, shape (blocks, N, N), in ``out`` if given."""
        return self.completed(self.summed(data, out))

    def completed(self, values: np.ndarray) -> np.ndarray:
        """Sums with added and held entries, in place."""
        places, blocks = self._added
        values[places] += blocks
        values = self.held(values)
        if self._slanted is not None:
            self._slanted.hold(values)
        return values

    def matrix(self, elements: np.ndarray | None = None) -> BaseMatrix:
        """A new matrix of NGSolve, of which the lower half is stored.

        With booleans ``elements`` it has the blocks that these elements touch.
        """
        if self._pattern is None or elements is not None:
            return pattern_matrix(self._space, elements)
        return self._pattern.CreateMatrix()

    def numbers(self, matrix: BaseMatrix) -> np.ndarray:
        """The numbers of the blocks of such a matrix, in ascending order."""
        rows, columns, _ = lower_triangle(matrix)
        return self.places(rows, columns)

    def entries(self, matrix: BaseMatrix) -> np.ndarray:
        """View of the blocks of such a matrix, shape (blocks, N, N)."""
        return matrix.AsVector().FV().NumPy().reshape(-1, self.N, self.N)

    def whole(self, matrix: BaseMatrix) -> SparseMatrixd:
        """Both triangles of such a matrix, number by number, for solvers that need them."""
        return both_triangles(self._lower(self.entries(matrix)))

    def symmetric(
        self, values: np.ndarray, chosen: slice | np.ndarray = slice(None)
    ) -> csr_matrix:
        """The matrix of all or some blocks, number by number, with both triangles."""
        lower = tril(self._lower(values, chosen)).tocsr()
        return (lower + tril(lower, -1).T).tocsr()

    def _lower(
        self, values: np.ndarray, chosen: slice | np.ndarray = slice(None)
    ) -> bsr_matrix:
        """The blocks on and below the diagonal, or some of them, as a matrix."""
        starts = np.searchsorted(self.rows[chosen], np.arange(len(self.free) + 1))
        shape = (self.free.size, self.free.size)
        return bsr_matrix((values, self.columns[chosen], starts), shape=shape)


class SlantedBlocks:
    """Blocks of slanted nodes: P K P' + k (1 - P) with the projectors P onto what is free.

    The stiffness k of what is held is that of the node, so that rounding errors of P matter little.
    """

    def __init__(self, blocks: Blocks, slanted: SlantedNodes) -> None:
        projectors = np.tile(np.eye(blocks.N), (len(blocks.free), 1, 1))
        projectors[slanted.nodes] = slanted.projectors
        is_slanted = np.zeros(len(blocks.free), dtype=bool)
        is_slanted[slanted.nodes] = True
        rows = blocks.rows
        columns = blocks.columns
        self._places = np.flatnonzero(is_slanted[rows] | is_slanted[columns])
        self._left = projectors[rows[self._places]]
        self._right = projectors[columns[self._places]]
        self._own = np.flatnonzero((rows == columns) & is_slanted[rows])
        self._held = np.eye(blocks.N) - projectors[rows[self._own]]

    def hold(self, values: np.ndarray) -> None:
        """Hold the nodes in ``values`` (blocks, N, N), in place."""
        stiffness = np.einsum("kii->k", values[self._own]) / values.shape[1]
        turned = np.matmul(self._left, values[self._places])
        values[self._places] = np.matmul(turned, self._right)
        values[self._own] += stiffness[:, None, None] * self._held


class ElementPart(NamedTuple):
    """Some ``count`` elements of one shape, whose matrices are in memory at the same time."""

    block: Elements
    chosen: slice | np.ndarray
    count: int

    @property
    def elements(self) -> Elements:
        """The elements, views of the block or copies."""
        return self.block.of(self.chosen)


def parts_for_matrices(points: Points) -> Iterator[ElementPart]:
    """Parts of the elements, in space such that the elements of a part are near each other.

    Then few blocks belong to several parts.  Refined meshes have the children of an element far
    from each other.
    """
    for block in points.blocks:
        chunks = block.matrix_chunks
        order = None
        if points.mesh.dim == 3 and len(chunks) > 1:
            corners = vertex_coordinates(points.mesh)[block.nodes[:, :4]]
            order = along_curve(corners.mean(axis=1))
        for chunk in chunks:
            chosen = chunk if order is None else np.sort(order[chunk])
            yield ElementPart(block, chosen, len(block.nodes[chunk]))


class Gather(NamedTuple):
    """Which blocks some elements touch, and how they are summed from pairs of nodes.

    Rows of the ``matrix`` are those of the blocks ``touched``, its columns the rows with N numbers
    that matrices (elements, k N, k N) consist of.
    """

    touched: np.ndarray
    matrix: csr_matrix

    def summed(self, matrices: Iterator[np.ndarray], N: int) -> np.ndarray:
        """The sums over the elements of ``Elements.stiffness``, shape (blocks, N, N)."""

        def sums(K: np.ndarray) -> np.ndarray:
            """The sums of blocks of such matrices, flat."""
            return (self.matrix @ K.reshape(-1, N)).reshape(-1, N * N)

        blocks, turned = map(sums, matrices)
        blocks += turned @ transpose_and_trace(N)
        return blocks.reshape(-1, N, N)


def transpose_and_trace(N: int) -> np.ndarray:
    """The map of a matrix G to G' + tr G I, both flat, from the right, shape (N^2, N^2)."""
    unit = np.eye(N)
    transpose = np.einsum("ad,bc->cdab", unit, unit)
    trace = np.einsum("cd,ab->cdab", unit, unit)
    return (transpose + trace).reshape(N * N, -1)


class ElementStiffness(Stiffness):
    """B' C B, summed element by element, for moduli at the points."""

    def __init__(self, points: Points, free: np.ndarray) -> None:
        super().__init__(points.mesh, points.order, free)
        self._parts = list(parts_for_matrices(points))
        most = max(part.count * part.block.nodes.shape[1] ** 2 for part in self._parts)
        self._ones = np.ones(self.N * most)
        self._gathers = list(in_order(self._gather, self._parts))
        self._rows_first = list(self._first_touched())

    def _gather(self, part: ElementPart) -> Gather:
        """How the blocks of some elements are summed.

        The block of nodes i >= j takes the pair (a, b) of an element with its nodes in this order.
        """
        nodes = part.block.nodes[part.chosen]
        count, k = nodes.shape
        N = self.N
        a, b = np.tril_indices(k)
        i = nodes[:, a]
        j = nodes[:, b]
        first_row = np.where(i >= j, N * k * a + b, N * k * b + a)
        first_row = first_row + N * k**2 * np.arange(count)[:, None]
        places = self.places(np.maximum(i, j), np.minimum(i, j)).ravel()
        order = np.argsort(places, kind="stable")
        places = places[order]
        first = np.flatnonzero(np.diff(places, prepend=-1))
        starts = np.append(first, len(order)).astype(np.int32)
        matrix = self._by_rows(starts, first_row.ravel()[order], nodes.shape)
        return Gather(places[first], matrix)

    def _first_touched(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Rows of blocks of each part that no earlier part has touched, and the others.

        The first ones are written without being read.
        """
        seen = np.zeros(len(self.rows), dtype=bool)
        for gather in self._gathers:
            there = seen[gather.touched]
            yield np.flatnonzero(~there), np.flatnonzero(there)
            seen[gather.touched] = True

    def _by_rows(
        self, starts: np.ndarray, first: np.ndarray, shape: tuple[int, int]
    ) -> csr_matrix:
        """``Gather.matrix`` of (elements, k); ``first``: the columns of first rows of blocks."""
        N = self.N
        count, k = shape
        sizes = np.diff(starts)
        numbers = np.arange(len(first)) - np.repeat(starts[:-1], sizes)
        # the N rows of a block stand behind each other, with equally many entries
        places = np.repeat(N * starts[:-1], sizes) + numbers
        columns = np.empty(N * len(first), dtype=np.int32)
        for c in range(N):
            columns[places + c * np.repeat(sizes, sizes)] = first + c * k
        ends = np.append(0, np.cumsum(np.repeat(sizes, N))).astype(np.int32)
        shape = (N * len(sizes), N * count * k**2)
        return csr_matrix((self._ones[: len(columns)], columns, ends), shape=shape)

    def summed(self, data: Moduli, out: np.ndarray | None = None) -> np.ndarray:
        """See ``Stiffness``."""
        if out is None:
            out = np.empty((len(self.rows), self.N, self.N))
        items = as_items(out)

        def enter(number: int) -> tuple[np.ndarray, np.ndarray]:
            """Write what is fresh of the blocks of a part; where the others are, and these."""
            gather = self._gathers[number]
            fresh, others = self._rows_first[number]
            blocks = gather.summed(self._parts[number].elements.stiffness(data), self.N)
            items[gather.touched[fresh]] = as_items(blocks)[fresh]
            return gather.touched[others], blocks[others]

        for seen, blocks in in_order(enter, range(len(self._parts))):
            out[seen] += blocks
        return out


def as_items(blocks: np.ndarray) -> np.ndarray:
    """A view of blocks (k, N, N) as k items without numbers inside: NumPy moves them faster.

    It does not keep Python's lock for them either.
    """
    size = blocks[0].nbytes if len(blocks) else 1
    return blocks.reshape(-1).view(np.dtype((np.void, size)))


class SymbolicStiffness(Stiffness):
    """A tangent assembled by a symbolic form of NGSolve: slower, but the formula is visible.

    ``form`` maps a trial and a test function to the form, ``enter`` sets its coefficients for given
    data.
    """

    def __init__(
        self,
        mesh: Mesh,
        order: int,
        free: np.ndarray,
        form: Callable[[ProxyFunction, ProxyFunction], SumOfIntegrals],
        enter: Callable[[Any], object],
    ) -> None:
        super().__init__(mesh, order, free)
        self._form = BilinearForm(self._space, symmetric=True, symmetric_storage=True)
        self._form += form(*self._space.TnT())
        self._enter = enter

    def summed(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """See ``Stiffness``."""
        self._enter(data)
        blocks = self.entries(self._form.Assemble().mat)
        if out is None:
            return blocks
        out[:] = blocks
        return out


def by_moduli(points: Points, free: np.ndarray) -> SymbolicStiffness:
    """The same as ``ElementStiffness``."""
    functions = points.functions
    kinematics = points.kinematics
    s = 1 + kinematics.d
    count = len(points)
    shapes = [(count,)] * 3 + [(count, kinematics.d), (count, s * s)]
    known = [functions.function(np.zeros(shape)) for shape in shapes]

    def form(u: ProxyFunction, v: ProxyFunction) -> SumOfIntegrals:
        """The stiffness form with the moduli of the points."""
        bulk, across, extra, direction, coupling = known
        strain_u = kinematics.strain(u)
        strain_v = kinematics.strain(v)
        volume_u = Trace(strain_u)
        volume_v = Trace(strain_v)
        e = kinematics.coordinates(strain_u)
        d = kinematics.coordinates(strain_v)

        along = InnerProduct(direction, e) * InnerProduct(direction, d)
        power = bulk * volume_u * volume_v + across * InnerProduct(e, d)
        power = power + extra * along
        if kinematics.thin:
            matrix = CF(tuple(coupling[i] for i in range(s * s)), dims=(s, s))
            stresses = matrix * CF((volume_u, e))
            power = power + InnerProduct(stresses, CF((volume_v, d)))
        return (kinematics.weight * power).Compile() * dx(intrules=points.rules)

    def enter(moduli: Moduli) -> None:
        """Store moduli in the functions of the form."""
        data = (moduli.bulk, moduli.across, moduli.extra, moduli.direction)
        if moduli.coupling is not None:
            data = (*data, moduli.coupling.reshape(count, -1))
        for function, values in zip(known, data, strict=False):
            function.vec.data = functions.function(values).vec

    return SymbolicStiffness(points.mesh, points.order, free, form, enter)


def pattern_matrix(space: H1, elements: np.ndarray | None = None) -> BaseMatrix:
    """A symmetric matrix with the pattern of the space, its lower triangle stored.

    Booleans ``elements`` choose those whose pattern it is.
    """
    u, v = space.TnT()
    form = BilinearForm(space, symmetric=True, symmetric_storage=True)
    chosen = None if elements is None else BitArray(elements.tolist())
    form += CF(0) * u * v * dx(definedonelements=chosen)
    return form.Assemble().mat
