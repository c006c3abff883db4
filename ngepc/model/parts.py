"""Meshes of which each process has a part: made on one process, refined on all at once.

A part is a mesh of its own for NGSolve, which knows nothing of the other ones.  Uniform refinement
halves all edges, also those between two parts, so that parts stay conforming without any search,
and no process ever has the fine mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import BND, Mesh

from ngepc.checks.kinds import require_mesh
from ngepc.geometries.outlines import netgen_mesh
from ngepc.model.elements import combine, element_facets, element_nodes, vertex_coordinates
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


Numbered = tuple[np.ndarray, np.ndarray]
"""Vertices of simplices, shape (k, corners), and the number of the region of each."""

_CHILDREN = {
    2: (("0", "01"), ("01", "1")),
    3: (("0", "01", "02"), ("01", "1", "12"), ("02", "12", "2"), ("01", "12", "02")),
    4: (
        ("0", "01", "02", "03"),
        ("01", "1", "12", "13"),
        ("02", "12", "2", "23"),
        ("03", "13", "23", "3"),
    ),
}
"""Children of a simplex by its corners, with their corners; 01 is the middle of corners 0 and 1."""

_RINGS = {
    ("01", "23"): ("02", "12", "13", "03"),
    ("02", "13"): ("01", "12", "23", "03"),
    ("03", "12"): ("01", "13", "23", "02"),
}
"""Diagonals of the octahedron that is left inside a tetrahedron, and the corners around each."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Some of the simplices of a mesh."""

    points: np.ndarray  # coordinates of the vertices, shape (vertices, N)
    materials: tuple[str, ...]  # names of all regions, also of those without anything here
    boundaries: tuple[str, ...]
    elements: Numbered  # simplices of the body
    facets: Numbered  # and of its boundaries
    copies: dict[int, np.ndarray]  # number of another process -> the vertices it has as well
    interfaces: frozenset[str]  # names of boundaries inside the body

    def mesh(self) -> NetgenMesh:
        """The piece as a mesh of Netgen."""
        N = self.points.shape[1]
        kinds = (N, self.materials, self.elements), (N - 1, self.boundaries, self.facets)
        groups = [
            (d, name, nodes[index == number])
            for d, names, (nodes, index) in kinds
            for number, name in enumerate(names)
        ]
        return netgen_mesh(N, self.points, groups)

    def refined(self) -> tuple[Piece, np.ndarray]:
        """The piece with all edges halved, and the ends of each edge, in the order of middles."""
        corners, count = self.elements[0], len(self.points)
        pairs = list(combinations(range(corners.shape[1]), 2))
        ends = np.sort(np.concatenate([corners[:, pair] for pair in pairs]), axis=1)
        keys = np.unique(ends[:, 0] * count + ends[:, 1])
        parents = np.column_stack(np.divmod(keys, count))
        points = np.concatenate([self.points, self.points[parents].mean(axis=1)])
        elements, facets = (_halved(*kind, keys, points) for kind in (self.elements, self.facets))
        fine = replace(self, points=points, elements=elements, facets=facets, copies={})
        return fine, parents


def _halved(corners: np.ndarray, index: np.ndarray, keys: np.ndarray, points: np.ndarray) -> tuple:
    """Simplices cut at the middles of their edges: the middle of edge k is vertex count + k."""
    k, count = corners.shape[1], len(points) - len(keys)
    at = {str(i): corners[:, i] for i in range(k)}
    for a, b in combinations(range(k), 2):
        low, high = np.sort(corners[:, [a, b]], axis=1).T
        at[f"{a}{b}"] = count + np.searchsorted(keys, low * count + high)
    children = [np.stack([at[name] for name in child], axis=1) for child in _CHILDREN[k]]
    if k == 4:
        children += _inner(at, points)
        sign = np.sign(_volume(points[corners]))
        children = [_turned(child, _volume(points[child]) * sign < 0) for child in children]
    return np.concatenate(children), np.tile(index, len(children))


def _inner(at: dict[str, np.ndarray], points: np.ndarray) -> list[np.ndarray]:
    """The four tetrahedra inside, around the shortest diagonal of the octahedron (Bey, 1995)."""
    choices, lengths = [], []
    for (a, b), ring in _RINGS.items():
        around = zip(ring, (*ring[1:], ring[0]), strict=True)
        choices.append([np.stack([at[name] for name in (a, b, c, d)], axis=1) for c, d in around])
        lengths.append(np.linalg.norm(points[at[a]] - points[at[b]], axis=1))
    shortest = np.argmin(np.round(lengths, 12), axis=0)[:, None]
    return [np.choose(shortest, [choice[i] for choice in choices]) for i in range(4)]


def _volume(x: np.ndarray) -> np.ndarray:
    """Six times the signed volume of tetrahedra, corners (k, 4, 3)."""
    return np.linalg.det(x[:, 1:] - x[:, :1])


def _turned(corners: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Simplices with two corners exchanged where asked."""
    corners[where, :2] = corners[where, 1::-1]
    return corners


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
