"""Meshes of which each process has a part: made on one process, refined on all at once.

A part is a mesh of its own for NGSolve, which knows nothing of the other ones.  Uniform refinement
halves all edges, also those between two parts, so that parts stay conforming without any search,
and no process ever has the fine mesh.
"""

from __future__ import annotations

import sys
from functools import cached_property, partial
from itertools import combinations, pairwise
from types import TracebackType
from typing import Any

import numpy as np
from ngsolve import Mesh

from ngepc.checks.kinds import require_mesh
from ngepc.checks.sentences import counted
from ngepc.geometries.outlines import netgen_mesh
from ngepc.model.elements import (
    cells_of,
    edge_ends,
    element_facets,
    element_nodes,
    facet_keys,
    vertex_coordinates,
)
from ngepc.model.processes import Team
from ngepc.model.support import check_conforming, connected

try:
    from mpi4py import MPI
except ImportError:  # said when distribute() is called
    MPI = None

INSTALL = (
    "distribute() needs mpi4py: 'apt install python3-mpi4py' on Debian and Ubuntu, "
    "'conda install -c conda-forge mpi4py openmpi' anywhere"
)

INTERRUPTED = 130
"""The exit status after Ctrl-C."""

Regions = list[tuple[int, str, np.ndarray]]


def end_all_processes(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    """Print an exception that nothing caught, and end the other processes with this one.

    They would wait for it: at the end of Python petsc4py finalises PETSc together with all
    processes, before mpi4py, which knows that one has failed, comes to end them.
    """
    sys.__excepthook__(kind, error, traceback)
    _end_all(INTERRUPTED if issubclass(kind, KeyboardInterrupt) else 1)


def end_all_on_exit(status: int) -> None:
    """End the other processes if this one calls ``sys.exit`` with a status or a message.

    ``python -m mpi4py`` calls it while an exception goes through; all but SystemExit are left to
    ``end_all_processes``.
    """
    error = sys.exc_info()[1]
    if not isinstance(error, SystemExit):
        return
    if not isinstance(error.code, int):
        sys.stderr.write(f"{error.code}\n")
    _end_all(status)


def _end_all(status: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    MPI.COMM_WORLD.Abort(status)


if MPI is not None and MPI.COMM_WORLD.size > 1:
    sys.excepthook = end_all_processes
    MPI._set_abort_status = end_all_on_exit


def _halved(corners: np.ndarray, edges: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Simplices cut at the middles of their edges: the middle of edge k is vertex count + k.

    Inside a tetrahedron an octahedron is left, cut along its shortest diagonal (Bey, 1995).
    """
    k = corners.shape[1]
    at = _corners_and_middles(corners, edges, len(points) - len(edges))
    children = [np.stack([at[i, j] for j in range(k)], axis=1) for i in range(k)]
    if k == 3:
        children.append(np.stack([at[0, 1], at[1, 2], at[0, 2]], axis=1))
    if k == 4:
        children += _octahedron(at, points)
    return np.concatenate(children)


def _corners_and_middles(
    corners: np.ndarray, edges: np.ndarray, count: int
) -> dict[tuple[int, int], np.ndarray]:
    """(i, j) -> the vertex between the corners i and j of each simplex; corner i for i = j.

    ``edges`` are codes of the vertices of an edge, low * count + high, in order.
    """
    k = corners.shape[1]
    at = {(i, i): corners[:, i] for i in range(k)}
    for a, b in combinations(range(k), 2):
        low, high = np.sort(corners[:, [a, b]], axis=1).T
        middle = count + np.searchsorted(edges, low * count + high)
        at[a, b] = middle
        at[b, a] = middle
    return at


OPPOSITE = (((2, 3), (0, 1)), ((2, 0), (1, 3)), ((1, 2), (0, 3)))
"""Opposite edges of a tetrahedron, whose middles a diagonal of the octahedron joins."""


def _octahedron(
    at: dict[tuple[int, int], np.ndarray], points: np.ndarray
) -> list[np.ndarray]:
    """The four tetrahedra around the shortest diagonal of the octahedron of middles."""
    cuts = []
    lengths = []
    for (a, b), (c, d) in OPPOSITE:
        first = at[a, b]
        last = at[c, d]
        ring = [at[c, a], at[d, a], at[d, b], at[c, b]]
        sides = pairwise([*ring, ring[0]])
        cuts.append([np.stack([first, last, *side], axis=1) for side in sides])
        lengths.append(np.linalg.norm(points[first] - points[last], axis=1))
    shortest = np.argmin(np.round(lengths, 12), axis=0)[:, None]
    return [np.choose(shortest, cut) for cut in zip(*cuts, strict=True)]


class MeshPart(Mesh):
    """The part of a mesh that this process has, of simplices.

    ``regions`` are those of the body and of its boundaries, also without anything here: dimension,
    name and vertices of their simplices, shape (k, dimension + 1).  ``interfaces`` are the names of
    boundaries inside the body, and ``processes`` know who has the common vertices as well.
    """

    coarse: MeshPart | None = None  # the part before refinement
    parents: np.ndarray | None = None
    """Vertices between which those beyond lie, shape (k, 2)."""

    def __init__(
        self,
        points: np.ndarray,
        regions: Regions,
        interfaces: frozenset[str],
        processes: Team,
    ) -> None:
        super().__init__(netgen_mesh(points.shape[1], points, regions))
        self.regions = regions
        self.interfaces = interfaces
        self.processes = processes

    def GetBoundaries(self) -> tuple[str, ...]:
        """The names of all boundaries of the body; NGSolve forgets those that have no element."""
        return tuple(name for d, name, _ in self.regions if d < self.dim)

    def of_nodes(self, order: int) -> Team:
        """The processes by the nodes of displacements of order one or two."""
        return self.processes if order == 1 else self._of_edges_too

    @cached_property
    def _of_edges_too(self) -> Team:
        """The processes by vertices, then edges, in the order of NGSolve's spaces."""
        ends = edge_ends(self)
        copies = self._common(ends)
        return Team(self.processes.comm, copies, self.nv + len(ends))

    def refined(self) -> MeshPart:
        """The part of the mesh with all edges halved; the processes refine at the same time."""
        corners = np.concatenate(
            [cells for d, _, cells in self.regions if d == self.dim]
        )
        ends = [corners[:, pair] for pair in combinations(range(self.dim + 1), 2)]
        ends = np.sort(np.concatenate(ends), axis=1)
        edges = np.unique(ends[:, 0] * self.nv + ends[:, 1])
        parents = np.column_stack(np.divmod(edges, self.nv))
        points = vertex_coordinates(self)
        points = np.concatenate([points, points[parents].mean(axis=1)])
        regions = [
            (d, name, _halved(cells, edges, points)) for d, name, cells in self.regions
        ]
        processes = Team(self.processes.comm, self._common(parents), len(points))
        fine = MeshPart(points, regions, self.interfaces, processes)
        fine.coarse = self
        fine.parents = parents
        return fine

    def _common(self, parents: np.ndarray) -> dict[int, np.ndarray]:
        """Number of another process -> the vertices that it has as well, then the edges.

        Edges are numbered behind the vertices; ``parents`` (edges, 2) are their ends.  An edge
        whose ends are on two processes need not be: they tell each other which ones are.
        """
        processes = self.processes
        copies = {}
        pairs = np.sort(processes.numbers[parents], axis=1)
        keys = pairs[:, 0] * processes.node_count + pairs[:, 1]
        near = {
            r: np.isin(parents, nodes).all(axis=1)
            for r, nodes in processes.copies.items()
        }
        others = processes.traded({rank: keys[edges] for rank, edges in near.items()})
        for rank, edges in near.items():
            _, which, _ = np.intersect1d(keys[edges], others[rank], return_indices=True)
            added = self.nv + np.flatnonzero(edges)[which]
            copies[rank] = np.concatenate([processes.copies[rank], added])
        return copies


def distribute(mesh: Mesh | None, comm: Any = None) -> MeshPart:
    """Give each process a part of a mesh: a collective call.

    Parameters
    ----------
    mesh
        The whole mesh on process 0, straight triangles or tetrahedra; the others may give None.
    comm
        The processes: a communicator of mpi4py, or an object with the methods that ``Team`` calls.
        None for all processes that mpiexec has started.

    Returns
    -------
    MeshPart
        To be used like any mesh, ``Problem(mesh=...)``, and refined.

    Raises
    ------
    ImportError
        If mpi4py is missing and no communicator is given.
    TypeError, ValueError
        If it is no such mesh, or has fewer elements than there are processes.
    """
    if comm is None:
        if MPI is None:
            raise ImportError(INSTALL)
        comm = MPI.COMM_WORLD
    work = partial(_pieces, mesh, comm.size) if comm.rank == 0 else list
    points, regions, interfaces, copies = comm.scatter(Team(comm).together(work))
    return MeshPart(points, regions, interfaces, Team(comm, copies, len(points)))


def _require_simplices(mesh: Mesh, count: int) -> None:
    """Accept a mesh that can be distributed."""
    require_mesh("mesh", mesh)
    if mesh.comm.size > 1 or mesh.GetCurveOrder() > 1 or mesh.deformation is not None:
        raise ValueError(
            "mesh is distributed, curved or deformed: a mesh on one process with straight "
            "elements is needed"
        )
    if (element_nodes(mesh)[:, mesh.dim + 1 :] >= 0).any():
        raise ValueError(
            "mesh has elements of other shapes: triangles or tetrahedra are needed"
        )
    if mesh.ne < count:
        raise ValueError(
            f"mesh has {counted(mesh.ne, 'element')}: at least {count}, one for each "
            "process, are needed"
        )


def _pieces(mesh: Mesh, count: int) -> list[tuple]:
    """Points, regions and interfaces for ``count`` processes, and the copies of ``Team``."""
    _require_simplices(mesh, count)
    N = mesh.dim
    points = vertex_coordinates(mesh)
    keys, owners = element_facets(mesh)
    if connected(mesh.ne, *check_conforming(keys, owners)).any():
        raise ValueError("mesh has several parts: a connected mesh is needed")
    elements, material = cells_of(mesh, N)
    elements = elements[:, : N + 1]
    facets, boundary = cells_of(mesh, N - 1)
    facets = np.sort(facets[:, :N], axis=1)
    part = partition(points[elements].mean(axis=1), count)
    wanted = facet_keys(facets, mesh)
    owner = part[owners[np.searchsorted(keys, wanted)]]
    inner = boundary[np.isin(wanted, keys[1:][np.diff(keys) == 0])]
    boundaries = mesh.GetBoundaries()
    interfaces = frozenset(boundaries[k] for k in np.unique(inner))
    regions = [
        (N, name, elements, part, material == k)
        for k, name in enumerate(mesh.GetMaterials())
    ]
    regions += [
        (N - 1, name, facets, owner, boundary == k) for k, name in enumerate(boundaries)
    ]
    vertices = [np.unique(elements[part == rank]) for rank in range(count)]
    pieces = []
    for rank, mine in enumerate(vertices):
        own_regions = [
            (dimension, name, np.searchsorted(mine, cells[there & (home == rank)]))
            for dimension, name, cells, home, there in regions
        ]
        copies = _copies(vertices, rank)
        pieces.append((points[mine], own_regions, interfaces, copies))
    return pieces


def _copies(vertices: list[np.ndarray], rank: int) -> dict[int, np.ndarray]:
    """Other process -> the vertices of a process that it has, too, by their numbers here."""
    mine = vertices[rank]
    copies = {}
    for other, theirs in enumerate(vertices):
        common = np.intersect1d(mine, theirs)
        if other != rank and len(common):
            copies[other] = np.searchsorted(mine, common)
    return copies


def partition(points: np.ndarray, count: int) -> np.ndarray:
    """Parts 0 ... count - 1 of about as many points each, cut across their longest extent."""
    part = np.zeros(len(points), dtype=int)
    if count > 1:
        left = count // 2
        order = np.argsort(points[:, np.ptp(points, axis=0).argmax()], kind="stable")
        first, rest = np.split(order, [len(points) * left // count])
        part[first] = partition(points[first], left)
        part[rest] = left + partition(points[rest], count - left)
    return part
