"""Processes that share a body: what one has, and what all do together.

Each process has some of the elements and the nodes on them; nodes between two parts are on both.
Nodal arrays, displacements and forces alike, have the same values on all processes that have a
node, so that whatever is local to a node or an element is computed as on one process.  What is left
are sums: over the elements of a node (``summed``), over the body (``total``, ``dot``).  These are
collective calls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from ngsolve import Mesh

from ngepc._deprecated import renamed

T = TypeVar("T")


class Team:
    """The processes that have a part of the body each, as one of them; no ``comm``: one has it all.

    This one has so many ``nodes``; the ``copies`` say which of them another process has as well, in
    an order both agree upon.
    """

    own: slice | np.ndarray = slice(
        None
    )  # what selects the nodes that this one answers for
    numbers: np.ndarray  # of each node among all: those of a process follow each other
    count: int  # nodes of all processes
    most = renamed("most", "maximum")

    def __init__(
        self,
        comm: Any = None,
        copies: dict[int, np.ndarray] | None = None,
        nodes: int = 0,
    ) -> None:
        self.comm = comm
        self.copies = copies or {}
        self.size, self.rank = (1, 0) if comm is None else (comm.size, comm.rank)
        if comm is None:
            return
        mine = np.ones(nodes, dtype=bool)
        for rank, shared in self.copies.items():
            mine[shared] &= rank > self.rank
        self._mine = mine
        self.own = np.flatnonzero(mine)
        self._inner = np.unique(
            np.concatenate([np.zeros(0, dtype=int), *self.copies.values()])
        )
        counts = np.array(self.all(len(self.own)))
        self.count, first = int(counts.sum()), int(counts[: self.rank].sum())
        numbers = np.zeros(nodes, dtype=np.int64)
        numbers[self.own] = first + np.arange(len(self.own))
        self.numbers = self.spread(numbers)

    def owned(self, nodes: np.ndarray) -> slice | np.ndarray:
        """What selects those of some nodes that this process answers for."""
        return self.own if self.comm is None else self._mine[nodes]

    def all(self, value: T) -> list[T]:
        """The values that the processes give, in their order."""
        return [value] if self.comm is None else self.comm.allgather(value)

    def total(self, value: T) -> T:
        """The sum of what the processes give, numbers or arrays."""
        return value if self.comm is None else self.comm.allreduce(value)

    def any(self, flags: np.ndarray) -> bool:
        """Whether one of the flags of all processes is set."""
        return any(self.all(bool(flags.any())))

    def maximum(self, values: np.ndarray) -> float:
        """The largest of the values >= 0 of all processes, 0 for none."""
        return max(self.all(float(values.max(initial=0.0))))

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """The inner product of two nodal arrays, flat ones too."""
        if self.comm is not None:
            a, b = (array.reshape(len(self._mine), -1)[self.own] for array in (a, b))
        return self.total(float(np.vdot(a, b)))

    def norm(self, a: np.ndarray) -> float:
        """The Euclidean norm of a nodal array."""
        return float(np.sqrt(self.dot(a, a)))

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Nodal values to which the processes contribute, added up, in the same order on all."""
        if self.comm is None:
            return values
        given = self._exchanged(values) | {self.rank: values[self._inner]}
        nodes = self.copies | {self.rank: self._inner}
        result = values.copy()
        result[self._inner] = 0
        for rank in sorted(given):
            result[nodes[rank]] += given[rank]
        return result

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Nodal values as the process has them that answers for the node: the first that has it."""
        if self.comm is None:
            return values
        received = self._exchanged(values)
        result = values.copy()
        for rank in sorted((r for r in received if r < self.rank), reverse=True):
            result[self.copies[rank]] = received[rank]
        return result

    def _exchanged(self, values: np.ndarray) -> dict[int, np.ndarray]:
        """What the neighbours have at the common nodes."""
        sent = {
            rank: np.ascontiguousarray(values[nodes])
            for rank, nodes in self.copies.items()
        }
        received = {rank: np.empty_like(array) for rank, array in sent.items()}
        requests = [self.comm.Irecv(array, rank) for rank, array in received.items()]
        requests += [self.comm.Isend(array, rank) for rank, array in sent.items()]
        for request in requests:
            request.Wait()
        return received

    def traded(self, parts: dict[int, T]) -> dict[int, T]:
        """What the neighbours give for what they are given."""
        received = self.comm.alltoall([parts.get(rank) for rank in range(self.size)])
        return {rank: received[rank] for rank in self.copies}

    def together(self, work: Callable[[], T]) -> T:
        """Do a work that may fail: what one process raises, all raise."""
        value = None
        error = None
        try:
            value = work()
        except (
            Exception
        ) as raised:  # whatever it is, the others must not wait for this process
            error = raised
        errors = [raised for raised in self.all(error) if raised is not None]
        if errors:
            raise errors[0]
        return value


ALONE = Team()


def processes_of(mesh: Mesh) -> Team:
    """The processes that share a mesh: those of a ``MeshPart``, otherwise this one alone."""
    return getattr(mesh, "processes", ALONE)


def nodal_processes_of(mesh: Mesh, order: int) -> Team:
    """The same processes, which agree on the nodes of displacements of an order.

    These are the vertices, for order two the edges after them.
    """
    return mesh.of_nodes(order) if processes_of(mesh).size > 1 else ALONE


def nodes_of(mesh: Mesh) -> int:
    """Vertices of a mesh, each counted once where processes share it."""
    return getattr(processes_of(mesh), "count", mesh.nv)


def require_whole(what: str, mesh: Mesh) -> None:
    """Accept a mesh of one process; ``what`` says what is not done where several share it."""
    size = max(processes_of(mesh).size, mesh.comm.size)
    if size > 1:
        raise ValueError(
            f"{what}: not on a mesh that {size} processes share; one is needed"
        )
