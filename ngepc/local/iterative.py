"""The tangent by conjugate gradients with multigrid: memory and time grow like the body.

In three dimensions factors grow like nodes^(4/3) in memory and nodes^2 in time.  Here nothing is
factorised.  Rows of contact that are closed, and supports, are kept by a projection, so that the
iterations see an elasticity matrix and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from typing import Annotated, Protocol

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, diags

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.discretisation.balance import Frame
from ngepc.discretisation.contact_step import FEW
from ngepc.discretisation.stiffness import Blocks
from ngepc.linalg.descent import Linear, conjugate_gradients
from ngepc.linalg.direct import FactorisationError
from ngepc.local.closed import Closed
from ngepc.local.system import State

ACCURACY = 1e-12
"""Relative residual of ``solve``, for callers that take it for exact."""

RESTART = 60
"""Directions that minimal residuals keep."""


class Engine(Protocol):
    """What multiplies by the matrix of the tangent and preconditions it."""

    def take(self, values: np.ndarray) -> None:
        """Take the values of a new matrix in the order of the pattern."""
        ...

    def build(self, values: np.ndarray) -> None:
        """Make the preconditioner from these values."""
        ...

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The matrix times a vector, into a new one."""
        ...

    def precondition(self, r: np.ndarray) -> np.ndarray:
        """The preconditioner, symmetric and positive definite, times a vector."""
        ...


@dataclass(frozen=True, kw_only=True)
class Iterative(Declared):
    """What ``PETSc()`` and ``PyAMG()`` share, their arguments and the tangent."""

    forcing: Annotated[float, Check(require_number, least=1e-12)] = 3e-3
    max_iterations: Count = 500

    def tangent(self, frame: Frame, blocks: Blocks) -> IterativeTangent:
        """The tangent of a discrete problem, whose entries ``blocks`` knows."""
        return IterativeTangent(frame, blocks, self)

    def engine(self, pattern: FullPattern, frame: Frame) -> Engine:
        """What multiplies and preconditions."""
        raise NotImplementedError


class FullPattern:
    """The matrix of both triangles, from blocks on and below the diagonal.

    ``starts`` and ``columns`` are CSR without the values, ``blocks`` which nodes are coupled.
    """

    def __init__(self, lower: Blocks) -> None:
        i, j, nodes, N = lower.rows, lower.columns, len(lower.free), lower.N
        above, entries = np.flatnonzero(i != j), np.arange(N * N, dtype=np.int32).reshape(N, N)
        rows, columns = np.append(i, j[above]), np.append(j, i[above])
        order = np.argsort(rows.astype(np.int64) * nodes + columns)
        starts = np.searchsorted(rows[order], np.arange(nodes + 1)).astype(np.int32)
        source = np.append(np.arange(len(i)), above)[order].astype(np.int32)
        source = N * N * source[:, None, None] + entries
        turned = order >= len(i)
        source[turned] = source[turned].swapaxes(1, 2)
        columns = columns[order].astype(np.int32)
        self.blocks = csr_matrix(
            (np.ones(len(columns), dtype=np.int32), columns, starts), shape=(nodes, nodes)
        )
        whole = bsr_matrix((source, columns, starts), shape=(N * nodes, N * nodes)).tocsr()
        self.starts, self.columns, self._source = whole.indptr, whole.indices, whole.data

    def graph(self, held: np.ndarray) -> csr_matrix:
        """Which nodes are coupled, those of a mask left out."""
        kept = diags(~held, dtype=np.int32)
        graph = (kept @ self.blocks @ kept).tocsr()
        graph.eliminate_zeros()
        graph.sort_indices()
        return graph

    def values(self, lower: np.ndarray) -> np.ndarray:
        """The values of the CSR matrix from the blocks, (blocks, N, N)."""
        return lower.ravel()[self._source]


class IterativeTangent:
    """A ``Tangent`` that is never factorised, with a new hierarchy for each state.

    Solves with the present tangent and the iterations in them are ``back_substitutions`` and
    ``linear_iterations``, ``forcing`` is that of the ``solver``.
    """

    examined, stiffened = FEW, None

    def __init__(self, frame: Frame, blocks: Blocks, solver: Iterative) -> None:
        self._frame, self._processes = frame, frame.contact.processes
        self.forcing, self._most = solver.forcing, solver.max_iterations
        self._blocks, self._pattern = blocks, FullPattern(blocks)
        self._engine = solver.engine(self._pattern, frame)
        self._lower: np.ndarray | None = None
        self.back_substitutions = self.linear_iterations = 0

    def update(self, state: object) -> None:
        """Assemble from what ``Blocks.values`` takes; the first solve makes a hierarchy."""
        self._lower = self._blocks.values(state)
        self._engine.take(self._pattern.values(self._lower))
        self.back_substitutions = self.linear_iterations = 0

    def linearise(self, here: State) -> None:
        """Take the tangent of the primal-dual method at a state."""
        self.update(here.moduli)

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The tangent times nodal displacements, flat."""
        return self._engine.multiply(x)

    def prepare(self, closed: Closed) -> None:
        """Make a hierarchy for the present tangent and closed rows if there is none for it."""
        if self._lower is None:
            return
        nodes, projections = closed.pins(self._blocks.N)
        lower, self._lower = self._lower, None
        if len(nodes):
            self._pin(lower, nodes, projections)
        self._engine.build(self._pattern.values(lower))

    def _pin(self, values: np.ndarray, nodes: np.ndarray, projections: np.ndarray) -> None:
        """Project out of the blocks what is pinned, and put the size of the diagonal there."""
        rows, columns, N = self._blocks.rows, self._blocks.columns, projections.shape[1]
        place = np.full(len(self._blocks.free), -1)
        place[nodes] = np.arange(len(nodes))
        padded = np.concatenate([projections, np.eye(N)[None]])  # number -1: not pinned
        hit = np.flatnonzero((place[rows] >= 0) | (place[columns] >= 0))
        before, same = values[hit], rows[hit] == columns[hit]
        after = padded[place[rows[hit]]] @ before @ padded[place[columns[hit]]]
        size = np.trace(before[same], axis1=1, axis2=2)[:, None, None] / N
        after[same] += size * (np.eye(N) - padded[place[rows[hit[same]]]])
        values[hit] = after

    def minimise(
        self, closed: Closed, right: np.ndarray, start: np.ndarray, tolerance: float
    ) -> np.ndarray:
        """The x that ``closed`` leaves free with K x = right there, flat, from such a ``start``.

        ``tolerance`` bounds the norm of the forces that remain.  FactorisationError if that takes
        more than ``most`` iterations or the preconditioner is not positive.
        """
        self.prepare(closed)
        oblique = self._processes.any(np.array(closed.slanted))
        work = self._engine.precondition, self._processes.dot, closed.project
        system = ProjectedSystem(closed.stiffened(self.multiply), *work)
        iterate = system.minimal_residuals if oblique else system.conjugate_gradients
        x, iterations = iterate(right, start, tolerance, self._most)
        self.back_substitutions += 1
        self.linear_iterations += iterations
        return x

    def solve(self, forces: np.ndarray, accuracy: float = ACCURACY) -> np.ndarray:
        """Displacements, zero where held, that answer nodal forces; both (nodes, N).

        ``accuracy`` is a relative residual.
        """
        closed = Closed(self._frame, np.zeros(len(self._frame.contact.rows), dtype=bool))
        right = closed.project(forces.ravel())
        size = self._processes.norm(right)
        return self.minimise(closed, right, np.zeros_like(right), accuracy * size).reshape(
            forces.shape
        )


@dataclass(frozen=True, eq=False)
class ProjectedSystem:
    """A linear system on what a projection leaves free.

    Both methods take the right side, where to start, the norm of the residual that may be left and
    the most iterations; they return the solution and its iterations, or raise FactorisationError.
    """

    multiply: Linear
    precondition: Linear
    dot: Callable[[np.ndarray, np.ndarray], float]
    project: Linear

    def conjugate_gradients(
        self, right: np.ndarray, start: np.ndarray, tolerance: float, most: int
    ) -> tuple[np.ndarray, int]:
        """For positive definite matrices and preconditioners (Gould, Hribar, Nocedal 2001)."""
        moved = self.dot(start, start) > 0
        missing, taken = self.project(right - self.multiply(start) if moved else right), 0
        if np.sqrt(self.dot(missing, missing)) <= tolerance:
            return start, 0
        free = self._left_free(self.multiply), self._left_free(self.precondition)
        for x, r, _ in islice(conjugate_gradients(*free, missing, self.dot), most):
            taken += 1
            if np.sqrt(self.dot(r, r)) <= tolerance:
                return start + x, taken
        if taken < most:
            raise FactorisationError("the multigrid preconditioner is not positive definite")
        raise FactorisationError(f"conjugate gradients did not converge in {most} iterations")

    def _left_free(self, linear: Linear) -> Linear:
        """The same, projected."""
        return lambda x: self.project(linear(x))

    def minimal_residuals(
        self, right: np.ndarray, start: np.ndarray, tolerance: float, most: int
    ) -> tuple[np.ndarray, int]:
        """Where the projection is oblique: restarted GMRES (Saad and Schultz 1986)."""
        x, iterations = start, 0
        while iterations < most:
            r = self.project(right - self.multiply(x))
            size = np.sqrt(self.dot(r, r))
            if size <= tolerance:
                return x, iterations
            basis, H, left = [r / size], np.zeros((RESTART + 1, RESTART)), size
            while left > 0.9 * tolerance and len(basis) <= min(RESTART, most - iterations):
                k, z = len(basis), self.project(self.precondition(basis[-1]))
                image = self.project(self.multiply(z))
                for j, known in enumerate(basis):
                    H[j, k - 1] = self.dot(known, image)
                    image = image - H[j, k - 1] * known
                H[k, k - 1] = np.sqrt(self.dot(image, image))
                goal = size * np.eye(k + 1)[0]
                y = np.linalg.lstsq(H[: k + 1, :k], goal, rcond=None)[0]
                left = np.linalg.norm(H[: k + 1, :k] @ y - goal)
                basis.append(image / (H[k, k - 1] or 1.0))
            iterations += len(y)
            x = x + self.project(self.precondition(np.tensordot(y, basis[:-1], 1)))
        raise FactorisationError(f"minimal residuals did not converge in {most} iterations")


def low_energy_modes(frame: Frame) -> np.ndarray:
    """Translations and rotations as nodal displacements, shape (unknowns, k).

    Nodes that are no vertices carry what is not linear: zero.
    """
    problem = frame.problem
    N, free = problem.N, frame.free
    x = np.asarray(problem.mesh.ngmesh.Coordinates())[: problem.mesh.nv, :N]
    own, processes = x[problem.processes.own], problem.processes
    x = x - processes.total(own.sum(axis=0)) / processes.total(len(own))
    pairs = [(0, 1)] if N == 2 else [(0, 1), (1, 2), (2, 0)]
    modes = np.zeros((*free.shape, N + len(pairs)))
    for c in range(N):
        modes[: len(x), c, c] = 1.0
    for k, (a, b) in enumerate(pairs, start=N):
        modes[: len(x), a, k], modes[: len(x), b, k] = -x[:, b], x[:, a]
    return modes.reshape(free.size, -1)
