"""Tangents solved by conjugate gradients with multigrid: memory and time grow like the nodes.

In three dimensions factors grow like nodes^(4/3) in memory and nodes^2 in time.  Here nothing is
factorised.  Rows of contact that are closed, and supports, are kept by a projection, so that the
iterations work with an elasticity matrix alone.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Annotated, Any, Protocol

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.sentences import counted
from ngepc.discretisation.body import DiscreteBody, Iterate
from ngepc.discretisation.contact_step import FEW
from ngepc.discretisation.stiffness import Blocks, Stiffness
from ngepc.linalg.cores import in_order
from ngepc.linalg.cycle import Product
from ngepc.linalg.descent import Linear, conjugate_gradients, minimal_residuals
from ngepc.linalg.direct import FactorisationError
from ngepc.local.closed import Closed
from ngepc.model.elements import vertex_coordinates
from ngepc.model.support import rigid_motions

ACCURACY = 1e-8
"""Relative residual of ``solve``, for callers that need accurate solutions."""

FORCING = 3e-3
"""Relative residual of the first Newton steps, where the options give none."""

CHUNK = 250_000
"""Entries of a matrix that are filled at once: NumPy and SciPy make copies of them."""


class Preconditioner(Protocol):
    """Symmetric positive definite maps of vectors for tangents with closed rows pinned.

    Each process has the matrices of its own elements.  All matrices are the same object, the one
    of the ``Storage``, with new values in each call.
    """

    def coarsen(self, matrix: Any) -> None:
        """Make coarse spaces for the first tangent, in which nothing is pinned."""

    def update(self, pinned: Any) -> Linear:
        """The map for a pinned tangent."""


class Storage(Protocol):
    """A tangent in memory: its values change in place."""

    matrix: Any
    """What preconditioners are made from."""

    def fill(self, data: Any) -> None:
        """Assemble the tangent for data of ``Stiffness``."""

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The tangent times displacements, flat."""

    def pin(self, nodes: np.ndarray, projections: np.ndarray) -> csr_matrix:
        """Pin directions of some nodes; returns what that leaves out.

        ``projections`` (k, N, N) keep the free directions.  The others are projected out of the
        blocks and get a diagonal of similar size.
        """


@dataclass(frozen=True, kw_only=True)
class Iterative(Declared):
    """Base class of ``PETSc()`` and ``PyAMG()``: arguments and tangent."""

    forcing: Annotated[float | None, Check(require_number, least=1e-12)] = None
    max_iterations: Count = 500

    def tangent(self, body: DiscreteBody, stiffness: Stiffness) -> IterativeTangent:
        """The tangent of a discrete problem, assembled by ``stiffness``."""
        return IterativeTangent(body, stiffness, self)

    def forcing_of(self, order: int) -> float:
        """``forcing``, or the usual one for displacements of an order."""
        return FORCING if self.forcing is None else self.forcing

    def storage(self, stiffness: Stiffness) -> Storage:
        """What stores the tangents: by default matrices of both triangles."""
        return FullStorage(stiffness)

    def preconditioner(self, storage: Any, body: DiscreteBody) -> Preconditioner:
        """A function that makes preconditioners for the matrices of a storage."""
        raise NotImplementedError


class FullPattern:
    """The CSR matrix of both triangles, from blocks on and below the diagonal.

    ``blocks`` says which nodes are coupled, ``graph`` without those that are held altogether.
    """

    def __init__(self, lower: Blocks) -> None:
        nodes = len(lower.free)
        self._N = lower.N
        strict = lower.rows != lower.columns
        numbers = np.arange(1, len(strict) + 1, dtype=np.int32)
        below = placed(lower, slice(None), numbers)
        above = placed(lower, strict, -numbers).T.tocsr()
        whole = below + above
        self._source = whole.data  # number of a block from 1 on, negative if transposed
        ones = np.ones(len(whole.indices), dtype=np.int32)
        self.blocks = csr_matrix((ones, whole.indices, whole.indptr), (nodes, nodes))
        self._rows = rows_in_order(whole.indptr, CHUNK // self._N**2)
        self._columns: np.ndarray | None = None
        kept = diags(lower.free.any(axis=1), dtype=np.int32)
        self.graph = (kept @ self.blocks @ kept).tocsr()
        self.graph.eliminate_zeros()
        self.graph.sort_indices()

    def matrix(self, lower: np.ndarray, before: csr_matrix | None = None) -> csr_matrix:
        """The matrix from its blocks, (blocks, N, N), in the place of an earlier one."""
        N = self._N
        size = N * N * len(self._source)
        values = np.empty(size) if before is None else before.data
        first = self._columns is None
        if first:
            self._columns = np.empty(size, dtype=np.int32)

        def fill(rows: slice) -> None:
            """Enter the values of the blocks of some nodes."""
            part = self._part(lower, rows)
            start = N * N * self.blocks.indptr[rows.start]
            here = slice(start, start + part.nnz)
            values[here] = part.data
            if first:
                self._columns[here] = part.indices

        deque(in_order(fill, self._rows), maxlen=0)
        if before is not None:
            return before
        widths = np.repeat(N * np.diff(self.blocks.indptr), N)
        starts = np.append(0, np.cumsum(widths)).astype(np.int32)
        shape = (len(widths), len(widths))
        return csr_matrix((values, self._columns, starts), shape=shape)

    def _part(self, lower: np.ndarray, rows: slice) -> csr_matrix:
        """The rows of the matrix that belong to some nodes."""
        starts = self.blocks.indptr[rows.start : rows.stop + 1]
        here = slice(starts[0], starts[-1])
        source = self._source[here]
        values = lower[np.abs(source) - 1]
        above = source < 0
        values[above] = values[above].swapaxes(1, 2)
        shape = (self._N * (rows.stop - rows.start), self._N * self.blocks.shape[1])
        arrays = (values, self.blocks.indices[here], starts - starts[0])
        return bsr_matrix(arrays, shape=shape).tocsr()

    def rows_of(self, pairs: np.ndarray) -> np.ndarray:
        """The node of the row of each of these blocks, by their numbers in ``blocks``."""
        return np.searchsorted(self.blocks.indptr, pairs, side="right") - 1

    def places(self, pairs: np.ndarray) -> np.ndarray:
        """Where the entries of these blocks are in the values of a matrix, (k, N, N)."""
        N = self._N
        starts = self.blocks.indptr.astype(np.int64)
        rows = self.rows_of(pairs)
        first = starts[rows]
        width = N * (starts[rows + 1] - first)
        corner = N * N * first + N * (pairs - first)
        component = np.arange(N)
        down = width[:, None, None] * component[:, None]
        return corner[:, None, None] + down + component


def placed(lower: Blocks, kept: slice | np.ndarray, numbers: np.ndarray) -> csr_matrix:
    """A number for each of the kept pairs of nodes, where its block is."""
    nodes = len(lower.free)
    starts = np.searchsorted(lower.rows[kept], np.arange(nodes + 1))
    arrays = (numbers[kept], lower.columns[kept], starts.astype(np.int32))
    return csr_matrix(arrays, shape=(nodes, nodes))


def rows_in_order(starts: np.ndarray, size: int) -> list[slice]:
    """Rows of a CSR pattern in portions of about so many entries, at least one row each."""
    count = len(starts) - 1
    entries = np.arange(0, starts[-1], size)
    ends = np.unique(np.append(np.searchsorted(starts, entries), [0, count]))
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


class FullStorage:
    """A tangent as one CSR matrix of both triangles, see ``Storage``."""

    matrix: csr_matrix | None = None

    def __init__(self, stiffness: Stiffness) -> None:
        self._stiffness = stiffness
        self.pattern = FullPattern(stiffness)

    def fill(self, data: Any) -> None:
        """See ``Storage``."""
        before = self.matrix
        self.matrix = self.pattern.matrix(self._stiffness.values(data), before)
        if before is None:
            self._product = Product(self.matrix)

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """See ``Storage``."""
        return self._product @ x

    def pin(self, nodes: np.ndarray, projections: np.ndarray) -> csr_matrix:
        """See ``Storage``."""
        blocks = self.pattern.blocks
        number = place_among(nodes, blocks.shape[0])
        pinned = number >= 0
        in_rows = np.repeat(pinned, np.diff(blocks.indptr))
        pairs = np.flatnonzero(in_rows | pinned[blocks.indices])
        rows = self.pattern.rows_of(pairs)
        columns = blocks.indices[pairs]
        places = self.pattern.places(pairs)
        before = self.matrix.data[places]
        after = pinned_blocks(before, projections, number[rows], number[columns])
        self.matrix.data[places] = after
        starts = np.searchsorted(rows, np.arange(blocks.shape[0] + 1))
        arrays = before - after, columns, starts
        return bsr_matrix(arrays, shape=self.matrix.shape).tocsr()


def place_among(nodes: np.ndarray, count: int) -> np.ndarray:
    """The place of each of ``count`` nodes among some of them, -1 for the others."""
    number = np.full(count, -1)
    number[nodes] = np.arange(len(nodes))
    return number


def pinned_blocks(
    blocks: np.ndarray, projections: np.ndarray, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Blocks (k, N, N) without the pinned directions of their rows and columns.

    ``rows`` and ``columns`` are numbers among the ``projections``, -1 where nothing is pinned.  In
    a pinned direction the diagonal is a mean of the diagonal of the block.
    """
    N = blocks.shape[1]
    unit = np.eye(N)
    free = np.concatenate([projections, unit[None]])
    of_rows = free[rows]
    pinned = of_rows @ blocks @ free[columns]
    same = (rows == columns) & (rows >= 0)
    size = np.trace(blocks[same], axis1=1, axis2=2)[:, None, None] / N
    pinned[same] += size * (unit - of_rows[same])
    return pinned


class IterativeTangent:
    """A tangent that is never factorised, with a new hierarchy for each state.

    Solves with the present tangent and the iterations in them are ``back_substitutions`` and
    ``linear_iterations``, ``forcing`` is that of the ``solver`` or the usual one.
    """

    examined = FEW
    stiffened = None

    def __init__(
        self, body: DiscreteBody, stiffness: Stiffness, solver: Iterative
    ) -> None:
        self._body = body
        self._processes = body.contact.processes
        self.forcing = solver.forcing_of(body.problem.order)
        self._most = solver.max_iterations
        self._storage = solver.storage(stiffness)
        self._preconditioner = solver.preconditioner(self._storage, body)
        self._left_out: csr_matrix | None = None
        self._precondition: Linear | None = None
        self.back_substitutions = self.linear_iterations = 0

    @property
    def matrix(self) -> Any:
        """The present tangent, with pinned directions after the first solve."""
        return self._storage.matrix

    def linearise(self, here: Iterate) -> None:
        """Assemble the tangent at a state; the first solve makes a hierarchy."""
        self.update(here.moduli)

    def update(self, moduli: Any) -> None:
        """The same for moduli."""
        self._storage.fill(moduli)
        self._left_out = None
        self.back_substitutions = self.linear_iterations = 0

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The tangent times nodal displacements, flat."""
        image = self._storage.multiply(x)
        if self._left_out is not None:
            image += self._left_out @ x
        return self._processes.summed(image.reshape(self._body.free.shape)).ravel()

    def prepare(self, closed: Closed) -> None:
        """Make a hierarchy for the present tangent and closed rows if there is none yet.

        The matrix is stored once: what pinning changes is added to products.
        """
        if self._left_out is not None:
            return
        if self._precondition is None:
            self._preconditioner.coarsen(self.matrix)
        self._left_out = self._storage.pin(*closed.pins(self._body.free.shape[1]))
        self._precondition = self._preconditioner.update(self.matrix)

    def solve(self, forces: np.ndarray, accuracy: float = ACCURACY) -> np.ndarray:
        """Displacements, zero where held, that answer nodal forces; both (nodes, N).

        ``accuracy`` is a relative residual.
        """
        closed = Closed(self._body, np.zeros(len(self._body.contact.rows), dtype=bool))
        right = closed.unbalanced(forces.ravel())
        tolerance = accuracy * self._processes.norm(right)
        return self.minimise(closed, right, np.zeros_like(right), tolerance).reshape(
            forces.shape
        )

    def minimise(
        self, closed: Closed, right: np.ndarray, start: np.ndarray, tolerance: float
    ) -> np.ndarray:
        """The x that ``closed`` allows with K x = right but for its rows, from such a ``start``.

        ``tolerance`` bounds the norm of the forces that remain.  FactorisationError if that takes
        more than ``max_iterations`` or the preconditioner is not positive.
        """
        self.prepare(closed)
        self.back_substitutions += 1
        multiply = closed.stiffened(self.multiply)
        processes = self._processes

        def image(x: np.ndarray) -> np.ndarray:
            """The tangent times x, projected onto the displacements that the rows allow."""
            return closed.unbalanced(multiply(x))

        def precondition(r: np.ndarray) -> np.ndarray:
            """The preconditioner times r, projected."""
            return closed.project(self._precondition(r))

        moved = processes.dot(start, start) > 0
        left = closed.unbalanced(right - multiply(start) if moved else right)
        if processes.norm(left) <= tolerance:
            return start
        oblique = processes.any(np.array(closed.slanted))
        taken = 0
        method = minimal_residuals if oblique else conjugate_gradients
        steps = method(image, precondition, left, processes.dot)
        for taken, (x, r, _) in enumerate(islice(steps, self._most), start=1):
            if processes.norm(r) <= tolerance:
                self.linear_iterations += taken
                return start + x
        if taken < self._most:
            raise FactorisationError("the preconditioner is not positive definite")
        raise FactorisationError(
            f"the linear solver did not converge in {counted(taken, 'iteration')}, as on thin "
            "plates and with little compressibility: leave inverse out, then factors take over, "
            "or raise max_iterations"
        )


def low_energy_modes(body: DiscreteBody) -> np.ndarray:
    """Translations and rotations as nodal displacements, shape (unknowns, k).

    Functions of nodes that are not vertices are hierarchical: zero for linear fields.
    """
    x = vertex_coordinates(body.problem.mesh)
    processes = body.problem.processes
    own = x[processes.own]
    motions = rigid_motions(
        x - processes.total(own.sum(axis=0)) / processes.total(len(own))
    )
    modes = np.zeros((*body.free.shape, motions.shape[2]))
    modes[: len(x)] = motions
    return modes.reshape(body.free.size, -1)
