"""Processes that share a body, and the sums over them.

Each process has some of the elements and the nodes on them; nodes between two parts are on both.
Nodal arrays, displacements and forces alike, have the same values on all processes that have a
node, so that quantities of a node or an element are computed as on one process.  What remains are
sums: over the elements of a node (``summed``), over the body (``total``, ``dot``).  These are
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
    """The processes that share a body, seen from one of them; without ``comm`` there is only one.

    This process has ``nodes`` nodes.  ``copies`` maps the number of another process to the nodes
    that both have, in the same order on both.
    """

    own: slice | np.ndarray = slice(None)  # index of the nodes that this process owns
    numbers: np.ndarray  # global number of each node, consecutive on each process
    node_count: int  # nodes of all processes, each counted once
    count = renamed("count", "node_count")
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
        self.node_count = int(counts.sum())
        first = int(counts[: self.rank].sum())
        numbers = np.zeros(nodes, dtype=np.int64)
        numbers[self.own] = first + np.arange(len(self.own))
        self.numbers = self.spread(numbers)

    def owned(self, nodes: np.ndarray) -> slice | np.ndarray:
        """An index of those of some nodes that this process owns."""
        return self.own if self.comm is None else self._mine[nodes]

    def all(self, value: T) -> list[T]:
        """The values of all processes, in their order."""
        return [value] if self.comm is None else self.comm.allgather(value)

    def total(self, value: T) -> T:
        """The sum over the processes of numbers or arrays."""
        return value if self.comm is None else self.comm.allreduce(value)

    def any(self, flags: np.ndarray) -> bool:
        """Whether one of the flags of all processes is set."""
        return any(self.all(bool(flags.any())))

    def show(self, monitor: Callable[[T], None], seen: T) -> None:
        """Show something to the monitor of each process.

        StopIteration or SystemExit, as ``sys.exit`` raises it, of one process is raised on all:
        the others would wait for it.
        """
        ending: BaseException | None = None
        try:
            monitor(seen)
        except (StopIteration, SystemExit) as error:
            ending = error
        endings = [found for found in self.all(ending) if found is not None]
        if endings:
            leaving = [found for found in endings if isinstance(found, SystemExit)]
            raise (leaving or endings)[0]

    def check_stop(self, error: BaseException) -> None:
        """Raise an interrupt again where others would wait: it ends all processes."""
        if self.size > 1 and isinstance(error, KeyboardInterrupt):
            raise error

    def maximum(self, values: np.ndarray) -> float:
        """The largest of the values >= 0 of all processes, 0 for none."""
        return max(self.all(float(values.max(initial=0.0))))

    def extent(self, points: np.ndarray) -> np.ndarray:
        """The extent of the points (k, N) of all processes along each axis, shape (N,)."""
        low = np.min(self.all(points.min(axis=0)), axis=0)
        high = np.max(self.all(points.max(axis=0)), axis=0)
        return high - low

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """The inner product of two nodal arrays, flat ones too."""
        if self.comm is not None:
            a, b = (array.reshape(len(self._mine), -1)[self.own] for array in (a, b))
        return self.total(float(np.vdot(a, b)))

    def norm(self, a: np.ndarray) -> float:
        """The Euclidean norm of a nodal array."""
        return float(np.sqrt(self.dot(a, a)))

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Nodal contributions of the processes, added in the same order on all of them."""
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
        """Nodal values of the owner of each node, the first process that has it."""
        if self.comm is None:
            return values
        received = self._exchanged(values)
        result = values.copy()
        for rank in sorted((r for r in received if r < self.rank), reverse=True):
            result[self.copies[rank]] = received[rank]
        return result

    def _exchanged(self, values: np.ndarray) -> dict[int, np.ndarray]:
        """The values of the neighbours at common nodes."""
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
        """Send ``parts`` to the neighbours; returns what they send."""
        received = self.comm.alltoall([parts.get(rank) for rank in range(self.size)])
        return {rank: received[rank] for rank in self.copies}

    def together(self, work: Callable[[], T]) -> T:
        """Call ``work``; an exception on one process is raised on all."""
        value = None
        error = None
        try:
            value = work()
        except Exception as raised:
            # of any kind, as the others must not wait for this process
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
    return getattr(processes_of(mesh), "node_count", mesh.nv)


def require_whole(what: str, mesh: Mesh) -> None:
    """Refuse a mesh shared by several processes; ``what`` names the operation in the message."""
    size = max(processes_of(mesh).size, mesh.comm.size)
    if size > 1:
        raise ValueError(
            f"{what}: not on a mesh that {size} processes share; one is needed"
        )
