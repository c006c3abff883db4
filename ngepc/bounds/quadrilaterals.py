"""A plane mesh with each quadrilateral cut along a diagonal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from netgen.meshing import Element1D, Element2D, FaceDescriptor
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.bounds.mapping import places_of
from ngepc.model.elements import elements_by_shape, vertex_coordinates


@dataclass(frozen=True, eq=False)
class CutMesh:
    """A mesh whose elements are cut into triangles, or tetrahedra, without new vertices.

    Parameters
    ----------
    mesh
        The simplices; vertices have the same numbers as before.
    parents
        The element of the original mesh that each simplex lies in.
    diagonals
        The ends (diagonals, 2) of the edges inside elements and across their facets.
    owners, places
        An element with each diagonal, and its reference coordinates (diagonals, N) of the middle.
    """

    mesh: Mesh
    parents: np.ndarray
    diagonals: np.ndarray
    owners: np.ndarray
    places: np.ndarray


def cut_into_triangles(mesh: Mesh) -> CutMesh:
    """The mesh with each quadrilateral cut along the diagonal that gives the larger triangles."""
    triangles = [np.empty((0, 3), dtype=int)]
    parents = [np.empty(0, dtype=int)]
    diagonals = np.empty((0, 2), dtype=int)
    owners = np.empty(0, dtype=int)
    places = np.empty((0, 2))
    for of_shape, nodes in elements_by_shape(mesh):
        if nodes.shape[1] == 3:
            triangles.append(nodes)
            parents.append(of_shape)
            continue
        owners = of_shape
        turned = (
            least_part(mesh, nodes) < least_part(mesh, nodes[:, [1, 2, 3, 0]])
        ) * 1
        quadrilaterals = np.where(turned[:, None], nodes[:, [1, 2, 3, 0]], nodes)
        halves = quadrilaterals[:, [[0, 1, 2], [0, 2, 3]]]
        triangles.append(halves.reshape(-1, 3))
        parents.append(np.repeat(of_shape, 2))
        diagonals = quadrilaterals[:, [0, 2]]
        places = diagonal_middles(vertex_coordinates(mesh)[nodes], turned)
    nodes = np.concatenate(triangles)
    parent = np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    made = with_triangles(mesh, nodes[order], parent[order])
    return CutMesh(made, parent[order], diagonals, owners, places)


def least_part(mesh: Mesh, nodes: np.ndarray) -> np.ndarray:
    """The area of the smaller triangle beside the first diagonal of quadrilaterals."""
    corners = vertex_coordinates(mesh)[nodes]
    along = corners[:, 2] - corners[:, 0]
    areas = [
        np.abs(parallelogram(along, corners[:, k] - corners[:, 0])) / 2 for k in (1, 3)
    ]
    return np.minimum(*areas)


def parallelogram(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The signed areas of the parallelograms that plane vectors span."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def with_triangles(mesh: Mesh, nodes: np.ndarray, parents: np.ndarray) -> Mesh:
    """A mesh with the same vertices, boundaries and regions, and these triangles."""
    old = mesh.ngmesh
    new = NetgenMesh(dim=2)
    points = [new.Add(point) for point in old.Points()]
    regions = [element.index for element in old.Elements2D()]
    for number, name in enumerate(mesh.GetMaterials()):
        new.Add(FaceDescriptor(surfnr=number + 1, domin=number + 1, bc=number + 1))
        new.SetMaterial(number + 1, name)
    for corners, parent in zip(nodes.tolist(), parents.tolist(), strict=True):
        new.Add(Element2D(regions[parent], [points[k] for k in corners]))
    for element in old.Elements1D():
        ends = [points[vertex.nr - 1] for vertex in element.vertices]
        new.Add(Element1D(ends, index=element.index))
    for number, name in enumerate(mesh.GetBoundaries()):
        new.SetBCName(number, name)
    return Mesh(new)


def diagonal_middles(corners: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Reference coordinates of the middles of diagonals, (quadrilaterals, 2).

    ``corners`` (quadrilaterals, 4, 2) are in the order of the reference square; the diagonal joins
    the first and the third, or ``turned`` the others.
    """
    ends = np.where(turned[:, None, None], corners[:, [1, 3]], corners[:, [0, 2]])
    return places_of(ends.mean(axis=1), corners)
