"""A mesh of a solid with each hexahedron cut into six tetrahedra.

Every face is cut along the diagonal from its vertex with the lowest number, so that neighbours
agree.  A hexahedron is the union of the tetrahedra that join its lowest vertex to the halves of the
three faces that do not contain it; its other three faces are then cut from the same vertex.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from netgen.meshing import Element2D, Element3D
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.bounds.mapping import CORNERS, places_of
from ngepc.bounds.quadrilaterals import CutMesh
from ngepc.model.elements import SHAPES, elements_by_shape, vertex_coordinates

FACES = np.array([[int(c) for c in f] for f in SHAPES[3, 8][1].split()])
"""The corners of the faces of a hexahedron, around each face."""
EDGES = np.array(list(combinations(range(4), 2)))
"""The ends of the edges of a tetrahedron."""
FLAT = 1e-6
"""Smallest ratio of the volumes of the tetrahedra of a hexahedron."""
BENT = 1e-10
"""Distance of the fourth corner from the plane of a face, relative to its diagonal, that counts as
rounding."""


def check_hexahedra(mesh: Mesh) -> None:
    """Refuse hexahedra that are not convex, or with faces that are not flat."""
    for _, nodes in elements_by_shape(mesh):
        if nodes.shape[1] != 8:
            continue
        corners = vertex_coordinates(mesh)[nodes]
        if not have_flat_faces(corners).all():
            raise ValueError(
                "mesh has hexahedra with faces that are not flat: a bound needs flat faces"
            )
        local = local_tetrahedra(nodes)
        volumes = determinants_of(corners, local)
        volumes = volumes / determinants_of(CORNERS[3][None], local)
        ratio = (volumes / volumes[:, :1]).min(axis=1)
        if (ratio < FLAT).any():
            raise ValueError(
                "mesh has hexahedra that are not convex: a bound needs convex ones"
            )


def have_flat_faces(corners: np.ndarray) -> np.ndarray:
    """Whether all faces of hexahedra with these corners (n, 8, 3) are flat, (n,)."""
    p = corners[:, FACES]
    along = p[:, :, 2] - p[:, :, 0]
    across = p[:, :, 3] - p[:, :, 1]
    normal = np.cross(along, across)
    size = np.linalg.norm(normal, axis=2)
    off = np.abs(np.einsum("nfi,nfi->nf", normal, p[:, :, 1] - p[:, :, 0]))
    diagonal = np.linalg.norm(along, axis=2)
    return (off <= BENT * diagonal * size).all(axis=1)


def determinants_of(corners: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Six times the signed volumes of tetrahedra, (n, 6).

    ``local`` (n, 6, 4) are their corners among those of the hexahedra, (n, 8, 3).
    """
    own = np.arange(len(local))[:, None, None] if len(corners) > 1 else 0
    p = corners[own, local]
    return np.linalg.det(p[:, :, 1:] - p[:, :, :1])


def local_tetrahedra(nodes: np.ndarray) -> np.ndarray:
    """The tetrahedra of hexahedra with these vertices (n, 8), as their corners (n, 6, 4)."""
    lowest = nodes.argmin(axis=1)
    local = np.empty((len(nodes), 6, 4), dtype=int)
    for corner in range(8):
        chosen = np.flatnonzero(lowest == corner)
        opposite = FACES[(corner != FACES).all(axis=1)]
        for k, face in enumerate(opposite):
            first = nodes[chosen][:, face].argmin(axis=1)
            around = face[(first[:, None] + np.arange(4)) % 4]
            halves = around[:, [[0, 1, 2], [0, 2, 3]]]
            local[chosen, 2 * k : 2 * k + 2, 0] = corner
            local[chosen, 2 * k : 2 * k + 2, 1:] = halves
    return local


def cut_into_tetrahedra(mesh: Mesh) -> CutMesh:
    """The mesh with each hexahedron cut into six tetrahedra; other elements are tetrahedra."""
    cells = []
    parents = []
    diagonals = np.empty((0, 2), dtype=int)
    owners = np.empty(0, dtype=int)
    places = np.empty((0, 3))
    for of_shape, nodes in elements_by_shape(mesh):
        if nodes.shape[1] == 4:
            cells.append(nodes)
            parents.append(of_shape)
            continue
        local = local_tetrahedra(nodes)
        cells.append(of_corners(nodes, local).reshape(-1, 4))
        parents.append(np.repeat(of_shape, 6))
        diagonals, hexahedron = diagonals_of(nodes, local)
        owners = of_shape[hexahedron]
        points = vertex_coordinates(mesh)
        middles = points[diagonals].mean(axis=1)
        places = places_of(middles, points[nodes][hexahedron])
    nodes = np.concatenate(cells)
    parent = np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    made = with_tetrahedra(mesh, nodes[order], parent[order])
    return CutMesh(made, parent[order], diagonals, owners, places)


def of_corners(nodes: np.ndarray, local: np.ndarray) -> np.ndarray:
    """The vertices at corners (n, ...) of elements with these vertices (n, 8)."""
    flat = local.reshape(len(nodes), -1)
    return np.take_along_axis(nodes, flat, axis=1).reshape(local.shape)


def diagonals_of(nodes: np.ndarray, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges of tetrahedra that are no edges of hexahedra: ends (k, 2) and a hexahedron (k,)."""
    pairs = local[:, :, EDGES].reshape(len(nodes), -1, 2)
    steps = np.abs(CORNERS[3][pairs[..., 0]] - CORNERS[3][pairs[..., 1]]).sum(axis=2)
    hexahedron, place = np.nonzero(steps > 1)
    ends = np.sort(of_corners(nodes, pairs)[hexahedron, place], axis=1)
    found, first = np.unique(ends, axis=0, return_index=True)
    return found, hexahedron[first]


def with_tetrahedra(mesh: Mesh, nodes: np.ndarray, parents: np.ndarray) -> Mesh:
    """A mesh with the same vertices, boundaries and regions, and these tetrahedra.

    Quadrilaterals of the boundary and of interfaces are cut from their lowest vertices.
    """
    old = mesh.ngmesh
    new = NetgenMesh(dim=3)
    points = [new.Add(point) for point in old.Points()]
    for face in old.FaceDescriptors():
        new.Add(face)
    for number, name in enumerate(mesh.GetMaterials()):
        new.SetMaterial(number + 1, name)
    corners = vertex_coordinates(mesh)[nodes]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0
    nodes = np.where(turned[:, None], nodes[:, [0, 2, 1, 3]], nodes)
    regions = [element.index for element in old.Elements3D()]
    for vertices, parent in zip(nodes.tolist(), parents.tolist(), strict=True):
        new.Add(Element3D(regions[parent], [points[k] for k in vertices]))
    for element in old.Elements2D():
        vertices = [vertex.nr - 1 for vertex in element.vertices]
        first = vertices.index(min(vertices))
        around = vertices[first:] + vertices[:first]
        for k in range(1, len(around) - 1):
            ends = [points[around[i]] for i in (0, k, k + 1)]
            new.Add(Element2D(element.index, ends))
    for number, name in enumerate(mesh.GetBoundaries()):
        new.SetBCName(number, name)
    return Mesh(new)
