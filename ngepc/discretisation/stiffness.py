"""The stiffness matrix of the displacements as N x N blocks, one for each pair of nodes.

They stand on one pattern and are filled in place.  A direct solver that orders and eliminates nodes
instead of single components takes a third of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from ngsolve import CF, H1, BaseMatrix, BilinearForm, InnerProduct, Mesh, Trace, dx
from ngsolve.comp import ProxyFunction, SumOfIntegrals
from ngsolve.la import SparseMatrixd
from scipy.sparse import bsr_matrix, csr_matrix, tril

from ngepc.discretisation.points import Elements, Moduli, Points
from ngepc.linalg.cores import in_order
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
        return self.held(values)

    def matrix(self) -> BaseMatrix:
        """A new matrix of NGSolve, of which the lower half is stored."""
        if self._pattern is None:
            return pattern_matrix(self._space)
        return self._pattern.CreateMatrix()

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


class Gather(NamedTuple):
    """Which blocks some elements touch, and how they are summed from pairs of nodes.

    ``fresh`` are positions that no earlier element has touched, which are written without being
    read, ``seen`` the others; rows of the ``matrix`` are the blocks in this order.  Its columns are
    the numbers of matrices (elements, N k, N k) from the one on that belongs to two components.
    """

    fresh: np.ndarray
    seen: np.ndarray
    matrix: csr_matrix

    def summed(self, single: np.ndarray, products: np.ndarray, N: int) -> np.ndarray:
        """The sums over the elements of ``Elements.stiffness``, shape (blocks, N, N)."""
        k = single.shape[1] // N
        width = self.matrix.shape[1]

        def component(K: np.ndarray, a: int, b: int) -> np.ndarray:
            """The sums of the numbers that belong to components a of rows and b of columns."""
            first = k * (a * N * k + b)
            return self.matrix @ K.reshape(-1)[first : first + width]

        blocks = np.empty((self.matrix.shape[0], N, N))
        along = 0.0
        for a, b in np.ndindex(N, N):
            product = component(products, b, a)
            if a == b:
                along += product
            blocks[:, a, b] = component(single, a, b) + product
        for a in range(N):
            blocks[:, a, a] += along
        return blocks


class ElementStiffness(Stiffness):
    """B' C B, summed element by element, for moduli at the points."""

    def __init__(self, points: Points, free: np.ndarray) -> None:
        super().__init__(points.mesh, points.order, free)
        self._points = points
        blocks = [list(block.parts) for block in points.blocks]
        most = max(part.nodes.size * part.nodes.shape[1] for b in blocks for part in b)
        self._ones = np.ones(most)
        seen = np.zeros(len(self.rows), dtype=bool)
        self._gathers = [
            [self._gather(part, seen) for part in block] for block in blocks
        ]

    def _gather(self, part: Elements, seen: np.ndarray) -> Gather:
        """How the blocks of some elements are summed.

        The block of nodes i >= j takes the pair (a, b) of an element with its nodes in this order.
        Blocks that earlier elements have touched are ``seen``.
        """
        count, k = part.nodes.shape
        a, b = np.tril_indices(k)
        i = part.nodes[:, a]
        j = part.nodes[:, b]
        width = self.N * k
        pair = np.where(i >= j, width * a + b, width * b + a)
        pair = pair + width**2 * np.arange(count)[:, None]
        places = self.places(np.maximum(i, j), np.minimum(i, j)).ravel()
        order = np.lexsort((places, seen[places]))
        places = places[order]
        first = np.flatnonzero(np.diff(places, prepend=-1))
        touched = places[first]
        fresh = len(touched) - int(np.count_nonzero(seen[touched]))
        seen[touched] = True
        starts = np.append(first, len(order)).astype(np.int32)
        columns = pair.ravel()[order].astype(np.int32)
        shape = (len(touched), int(pair.max()) + 1)
        matrix = csr_matrix((self._ones[: len(order)], columns, starts), shape=shape)
        positions = touched.astype(np.int32)
        return Gather(positions[:fresh], positions[fresh:], matrix)

    def summed(self, data: Moduli, out: np.ndarray | None = None) -> np.ndarray:
        """See ``Stiffness``."""
        if out is None:
            out = np.empty((len(self.rows), self.N, self.N))

        def enter(given: tuple[Elements, Gather]) -> tuple[np.ndarray, np.ndarray]:
            """Write what is fresh of the blocks of some elements; the others and where they are."""
            part, gather = given
            blocks = gather.summed(*part.stiffness(data), self.N)
            count = len(gather.fresh)
            out[gather.fresh] = blocks[:count]
            return gather.seen, blocks[count:]

        for block, gathers in zip(self._points.blocks, self._gathers, strict=True):
            parts = list(zip(block.parts, gathers, strict=True))
            for seen, blocks in in_order(enter, parts):
                out[seen] += blocks
        return out


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
        e, d = (kinematics.coordinates(kinematics.strain(w)) for w in (u, v))
        volumes = [Trace(kinematics.strain(w)) for w in (u, v)]
        along = InnerProduct(direction, e) * InnerProduct(direction, d)
        power = bulk * volumes[0] * volumes[1] + across * InnerProduct(e, d)
        power = power + extra * along
        if kinematics.thin:
            matrix = CF(tuple(coupling[i] for i in range(s * s)), dims=(s, s))
            strains = [CF((t, c)) for t, c in zip(volumes, (e, d), strict=True)]
            power = power + InnerProduct(matrix * strains[0], strains[1])
        return (kinematics.weight * power).Compile() * dx(intrules=points.rules)

    def enter(moduli: Moduli) -> None:
        """Store moduli in the functions of the form."""
        data = (moduli.bulk, moduli.across, moduli.extra, moduli.direction)
        if moduli.coupling is not None:
            data = (*data, moduli.coupling.reshape(count, -1))
        for function, values in zip(known, data, strict=False):
            function.vec.data = functions.function(values).vec

    return SymbolicStiffness(points.mesh, points.order, free, form, enter)


def pattern_matrix(space: H1) -> BaseMatrix:
    """A symmetric matrix with the pattern of the space, its lower triangle stored."""
    u, v = space.TnT()
    form = BilinearForm(space, symmetric=True, symmetric_storage=True)
    form += CF(0) * u * v * dx
    return form.Assemble().mat
