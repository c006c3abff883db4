"""Meshes of which each process has a part: made on one process, refined on all at once.

A part is a mesh of its own for NGSolve, which knows nothing of the other ones.  Uniform refinement
halves all edges, also those between two parts, so that parts stay conforming without any search,
and no process ever has the fine mesh.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from ngsolve import BND, Mesh

from ngepc.checks.kinds import require_mesh
from ngepc.model.elements import combine, element_facets, element_nodes, vertex_coordinates
from ngepc.model.pieces import Piece
from ngepc.model.processes import Team
from ngepc.model.rigid import check_conforming, connected

try:
    from mpi4py import MPI
except ImportError:  # said when distribute() is called
    MPI = None

INSTALL = (
    "distribute() needs mpi4py: 'apt install python3-mpi4py' on Debian and Ubuntu, "
    "'conda install -c conda-forge mpi4py openmpi' anywhere"
)


class MeshPart(Mesh):
    """The part of a mesh that this process has.

    It is made of its simplices and of which ``processes`` have the others, and the common vertices.
    If refined, ``coarse`` is the part before, and ``parents`` (k, 2) are the two vertices between
    which those beyond lie.
    """

    def __init__(
        self,
        piece: Piece,
        processes: Team,
        coarse: MeshPart | None = None,
        parents: np.ndarray | None = None,
    ) -> None:
        super().__init__(piece.mesh())
        self.piece, self.processes = piece, processes
        self.coarse, self.parents = coarse, parents

    def GetBoundaries(self) -> tuple[str, ...]:
        """The names of all boundaries of the body; NGSolve forgets those that have no element."""
        return self.piece.boundaries

    @property
    def interfaces(self) -> frozenset[str]:
        """Names of boundaries inside the body."""
        return self.piece.interfaces

    def refined(self) -> MeshPart:
        """The part of the mesh with all edges halved; the processes refine at the same time."""
        piece, parents = self.piece.refined()
        processes = Team(self.processes.comm, self._common(parents), len(piece.points))
        return MeshPart(piece, processes, self, parents)

    def _common(self, parents: np.ndarray) -> dict[int, np.ndarray]:
        """The vertices of the refined mesh that each neighbour has as well.

        An edge whose ends are on both processes need not be: they tell each other which ones are.
        """
        processes, near = self.processes, {}
        pairs = np.sort(processes.numbers[parents], axis=1)
        keys = pairs[:, 0] * processes.count + pairs[:, 1]
        for rank, nodes in processes.copies.items():
            there = np.zeros(self.nv, dtype=bool)
            there[nodes] = True
            near[rank] = np.flatnonzero(there[parents].all(axis=1))
        others = processes.traded({rank: keys[edges] for rank, edges in near.items()})
        common = {}
        for rank, edges in near.items():
            _, which, _ = np.intersect1d(keys[edges], others[rank], return_indices=True)
            added = self.nv + edges[which]
            common[rank] = np.concatenate([processes.copies[rank], added])
        return common


def distribute(mesh: Mesh | None, comm: Any = None) -> MeshPart:
    """Give each process a part of a mesh: a collective call.

    Parameters
    ----------
    mesh
        The whole mesh on process 0, straight triangles or tetrahedra; the others may give None.
    comm
        The processes, a communicator of mpi4py; None for all that mpiexec has started.

    Returns
    -------
    MeshPart
        To be used like any mesh, ``Problem(mesh=...)``, and refined.

    Raises
    ------
    ImportError
        If mpi4py is missing.
    TypeError, ValueError
        If it is no such mesh, or has fewer elements than there are processes.
    """
    if MPI is None:
        raise ImportError(INSTALL)
    comm = MPI.COMM_WORLD if comm is None else comm
    work = partial(_pieces, mesh, comm.size) if comm.rank == 0 else list
    piece = comm.scatter(Team(comm).together(work))
    return MeshPart(piece, Team(comm, piece.copies, len(piece.points)))


def _pieces(mesh: Mesh, count: int) -> list[Piece]:
    """The pieces of a mesh for ``count`` processes."""
    elements = _simplices(mesh)
    if len(elements) < count:
        raise ValueError(
            f"mesh has {mesh.ne} elements: one for each of {count} processes is needed"
        )
    keys, owners = element_facets(mesh)
    if connected(len(elements), *check_conforming(keys, owners)).any():
        raise ValueError("mesh has several parts: one that hangs together is needed")
    points = vertex_coordinates(mesh)
    part = partition(points[elements].mean(axis=1), count)
    listed = list(mesh.Elements(BND))
    facets = np.array([sorted(v.nr for v in facet.vertices) for facet in listed])
    index, wanted = np.array([facet.index for facet in listed]), combine(facets, mesh)
    order = np.argsort(keys, kind="stable")
    owner = part[owners[order[np.searchsorted(keys, wanted, sorter=order)]]]
    inner = index[np.isin(wanted, keys[order][1:][np.diff(keys[order]) == 0])]
    regions = mesh.GetMaterials(), mesh.GetBoundaries()
    kinds = mesh.ngmesh.Elements2D() if mesh.dim == 2 else mesh.ngmesh.Elements3D()
    materials = kinds.NumPy()["index"].astype(int) - 1
    vertices, result = [np.unique(elements[part == rank]) for rank in range(count)], []
    for rank, mine in enumerate(vertices):
        common = {r: np.intersect1d(mine, other) for r, other in enumerate(vertices) if r != rank}
        has, its = part == rank, owner == rank
        result.append(
            Piece(
                points[mine],
                *regions,
                (np.searchsorted(mine, elements[has]), materials[has]),
                (np.searchsorted(mine, facets[its]), index[its]),
                {r: np.searchsorted(mine, v) for r, v in common.items() if len(v)},
                frozenset(regions[1][k] for k in np.unique(inner)),
            )
        )
    return result


def _simplices(mesh: Mesh) -> np.ndarray:
    """The vertices of the elements of a mesh that can be distributed."""
    require_mesh("mesh", mesh)
    corners, nodes = mesh.dim + 1, element_nodes(mesh)
    if mesh.comm.size > 1 or mesh.GetCurveOrder() > 1 or mesh.deformation is not None:
        raise ValueError("mesh is distributed, curved or deformed: a whole, straight one is needed")
    if (nodes[:, corners:] >= 0).any() or (nodes[:, :corners] < 0).any():
        raise ValueError("mesh has other elements: triangles or tetrahedra are needed")
    return nodes[:, :corners]


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
