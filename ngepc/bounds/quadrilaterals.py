"""The triangle counterpart of a result on a plane mesh with quadrilaterals.

Each quadrilateral is cut along a diagonal.  The displacement v on the triangles has degree two: it
has the values of u_h at the vertices, along the edges and at the middle of each diagonal.  On the
edges of the quadrilaterals v and u_h are the same polynomials, so that v satisfies supports and
obstacles as u_h does.  If u_h has order one and the quadrilaterals are parallelograms, v is u_h:
bilinear functions of affine coordinates are polynomials of degree two.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from netgen.meshing import Element1D, Element2D, FaceDescriptor
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import VOL, ElementId, GridFunction, Mesh, VectorH1

from ngepc.bounds.contact import MIDDLE
from ngepc.bounds.transfer import (
    check_carried,
    forces_of_rows,
    is_displacement,
    on_mesh,
    tractions_at_vertices,
)
from ngepc.discretisation.loads import nodal, shapes_at
from ngepc.discretisation.points import Points
from ngepc.discretisation.sampling import with_last_share
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.elements import (
    edge_ends,
    elements_by_shape,
    has_more_corners,
    vertex_coordinates,
)
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status

ITERATIONS = 20
"""Newton steps for the reference coordinates of the middle of a diagonal."""
CENTRE = 0.5
"""Both reference coordinates of the centre."""


def has_quadrilaterals(problem: Problem) -> bool:
    """Whether an element of a plane mesh is a quadrilateral."""
    return problem.N == 2 and has_more_corners(problem.mesh)


@dataclass(frozen=True, eq=False)
class CutMesh:
    """A mesh whose quadrilaterals are cut into two triangles each.

    Parameters
    ----------
    mesh
        The triangles; vertices have the same numbers as before.
    parents
        The element of the original mesh that each triangle lies in.
    numbers, corners
        The quadrilaterals: their numbers, and their vertices (quadrilaterals, 4), turned such that
        the diagonal joins the first and the third.
    turned
        By how many corners each was turned, 0 or 1.
    """

    mesh: Mesh
    parents: np.ndarray
    numbers: np.ndarray
    corners: np.ndarray
    turned: np.ndarray


def cut_into_triangles(mesh: Mesh) -> CutMesh:
    """The mesh with each quadrilateral cut along the diagonal that gives the larger triangles."""
    triangles = [np.empty((0, 3), dtype=int)]
    parents = [np.empty(0, dtype=int)]
    quadrilaterals = np.empty((0, 4), dtype=int)
    numbers = turned = np.empty(0, dtype=int)
    for of_shape, nodes in elements_by_shape(mesh):
        if nodes.shape[1] == 3:
            triangles.append(nodes)
            parents.append(of_shape)
            continue
        numbers = of_shape
        turned = (
            least_part(mesh, nodes) < least_part(mesh, nodes[:, [1, 2, 3, 0]])
        ) * 1
        quadrilaterals = np.where(turned[:, None], nodes[:, [1, 2, 3, 0]], nodes)
        halves = quadrilaterals[:, [[0, 1, 2], [0, 2, 3]]]
        triangles.append(halves.reshape(-1, 3))
        parents.append(np.repeat(of_shape, 2))
    nodes = np.concatenate(triangles)
    parent = np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    made = with_triangles(mesh, nodes[order], parent[order])
    return CutMesh(made, parent[order], numbers, quadrilaterals, turned)


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


def on_triangles(problem: Problem, cut_mesh: CutMesh) -> Problem:
    """The problem with displacements of order two on the triangles."""
    still = problem
    start = problem.initial_displacement
    moved = is_displacement(start, problem)
    if moved:
        still = copy(problem)
        vars(still)["initial_displacement"] = None
    made = on_mesh(still, cut_mesh.mesh, cut_mesh.parents, 2, constant_on_parents)
    if moved:
        points = Points(problem.mesh, problem.kinematics, problem.order)
        values = interpolant(nodal(start.vec.FV().NumPy(), problem), points, cut_mesh)
        function = GridFunction(VectorH1(cut_mesh.mesh, order=2))
        function.vec.FV().NumPy()[:] = values.T.ravel()
        vars(made)["initial_displacement"] = function
    return made


def constant_on_parents(
    values: np.ndarray, before: Points, after: Points, parents: np.ndarray
) -> np.ndarray:
    """Values at the points of triangles of functions that are constant on their parents."""
    first = np.empty(before.mesh.ne, dtype=int)
    alike = elements_by_shape(before.mesh)
    for (numbers, _), block in zip(alike, before.blocks, strict=True):
        first[numbers] = block.points[:, 0]
    each = len(after) // len(parents)
    return np.repeat(values[first[parents]], each, axis=0)


def triangulated(result: ExactResult, cut_mesh: CutMesh) -> ExactResult:
    """The result with the displacement v on the triangles of the cut mesh, see above."""
    discrete = DiscreteProblem(on_triangles(result.problem, cut_mesh))
    contact = forces_of_rows(discrete, tractions_at_vertices(result))
    u = interpolant(result.state.u, result.discrete.points, cut_mesh)
    supports = discrete.supports
    u = np.where(supports.free, u, supports.values)
    state = discrete.state(u, contact=contact)
    return ExactResult(state, Status.STOPPED, "", History())


def on_simplices(result: ExactResult) -> ExactResult:
    """The result itself, or the displacement v on triangles if its mesh has quadrilaterals."""
    if not has_quadrilaterals(result.problem):
        return result
    check_carried(result.problem)
    return triangulated(result, cut_into_triangles(result.problem.mesh))


def problem_on_simplices(problem: Problem) -> Problem:
    """The problem itself, or that of order two on triangles if its mesh has quadrilaterals."""
    if not has_quadrilaterals(problem):
        return problem
    return on_triangles(problem, cut_into_triangles(problem.mesh))


def interpolant(given: np.ndarray, points: Points, cut_mesh: CutMesh) -> np.ndarray:
    """Nodal values (nodes, N) of v, from those of u_h and the points of its mesh."""
    mesh = points.mesh
    count = mesh.nv
    ends = np.sort(edge_ends(cut_mesh.mesh), axis=1)
    keys = ends @ [count, 1]
    order = np.argsort(keys)

    def numbers_of(pairs: np.ndarray) -> np.ndarray:
        """The nodes of the edges of the triangles with these ends."""
        wanted = np.sort(pairs, axis=1) @ [count, 1]
        return count + order[np.searchsorted(keys[order], wanted)]

    u = np.zeros((count + len(ends), given.shape[1]))
    u[:count] = given[:count]
    if points.order == 2:
        old = edge_ends(mesh)
        u[numbers_of(old)] = given[count : count + len(old)]
    diagonals = cut_mesh.corners[:, [0, 2]]
    bent = on_diagonals(given, points, cut_mesh) - u[diagonals].mean(axis=1)
    u[numbers_of(diagonals)] = bent / MIDDLE
    return u


def on_diagonals(u: np.ndarray, points: Points, cut_mesh: CutMesh) -> np.ndarray:
    """The displacements at the middles of the diagonals, (quadrilaterals, N)."""
    mesh = points.mesh
    pairs = zip(elements_by_shape(mesh), points.blocks, strict=True)
    found = next(pair for pair in pairs if pair[0][1].shape[1] == 4)
    (numbers, corners), block = found
    first = ElementId(VOL, int(numbers[0]))
    places = diagonal_middles(vertex_coordinates(mesh)[corners], cut_mesh.turned)
    shapes = shapes_at(points.scalar, first, with_last_share(places))
    return np.einsum("qk,qkc->qc", shapes, u[block.nodes])


def diagonal_middles(corners: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Reference coordinates of the middles of diagonals, (quadrilaterals, 2).

    ``corners`` (quadrilaterals, 4, 2) are in the order of the reference square (0, 0), (1, 0),
    (1, 1), (0, 1); the diagonal joins the first and the third, or ``turned`` the others.  Newton's
    method for the bilinear map.
    """
    p = corners
    ends = np.where(turned[:, None, None], p[:, [1, 3]], p[:, [0, 2]])
    wanted = ends.mean(axis=1)
    a = p[:, 1] - p[:, 0]
    b = p[:, 3] - p[:, 0]
    c = p[:, 0] - p[:, 1] + p[:, 2] - p[:, 3]
    place = np.full((len(p), 2), CENTRE)
    for _ in range(ITERATIONS):
        x = place[:, :1]
        y = place[:, 1:]
        missed = wanted - p[:, 0] - x * a - y * b - x * y * c
        along_x = a + y * c
        along_y = b + x * c
        size = parallelogram(along_x, along_y)
        step = np.stack(
            [parallelogram(missed, along_y), parallelogram(along_x, missed)], axis=1
        )
        place = place + step / size[:, None]
    return place
