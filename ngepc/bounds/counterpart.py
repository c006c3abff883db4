"""The counterpart on simplices of a result on quadrilaterals or hexahedra.

Elements are cut without new vertices.  The displacement v on the triangles or tetrahedra has degree
two; it has the values of u_h at the vertices, along the edges of the elements and at the middle of
each diagonal.

On straight edges v and u_h are the same polynomials, and for order one they are on parallelograms:
bilinear functions of affine coordinates are polynomials of degree two.  There v satisfies supports
and obstacles as u_h does.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import VOL, ElementId, GridFunction, VectorH1

from ngepc.bounds.coverage import check_data_inside, check_each_feature
from ngepc.bounds.hexahedra import check_hexahedra, cut_into_tetrahedra
from ngepc.bounds.quadrilaterals import CutMesh, cut_into_triangles
from ngepc.bounds.rollers import by_nodes
from ngepc.bounds.row_stresses import MIDDLE
from ngepc.bounds.transfer import (
    check_carried,
    check_free_of_functions,
    forces_of_rows,
    is_displacement,
    on_mesh,
    tractions_at_vertices,
)
from ngepc.discretisation.lattices import with_last_share
from ngepc.discretisation.loads import shapes_at
from ngepc.discretisation.points import Points
from ngepc.discretisation.spaces import nodal
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.elements import edge_ends, elements_by_shape, has_more_corners
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, Status


def cut_into_simplices(problem: Problem) -> CutMesh:
    """The mesh of a problem with its elements cut into triangles or tetrahedra."""
    cut = cut_into_triangles if problem.N == 2 else cut_into_tetrahedra
    return cut(problem.mesh)


def on_cut_mesh(problem: Problem, cut_mesh: CutMesh) -> Problem:
    """The problem with displacements of order two on the simplices."""
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
    """Values at the points of simplices of functions that are constant on their parents."""
    first = np.empty(before.mesh.ne, dtype=int)
    alike = elements_by_shape(before.mesh)
    for (numbers, _), block in zip(alike, before.blocks, strict=True):
        first[numbers] = block.points[:, 0]
    each = len(after) // len(parents)
    return np.repeat(values[first[parents]], each, axis=0)


def carried_result(result: ExactResult, cut_mesh: CutMesh) -> ExactResult:
    """The result with the displacement v on the simplices of the cut mesh, see above."""
    discrete = by_nodes(DiscreteProblem(on_cut_mesh(result.problem, cut_mesh)))
    contact = forces_of_rows(discrete, tractions_at_vertices(result))
    u = interpolant(result.state.u, result.discrete.points, cut_mesh)
    state = discrete.state(discrete.supports.admissible(u), contact=contact)
    return ExactResult(state, Status.STOPPED, "", History())


def on_simplices(result: ExactResult) -> ExactResult:
    """The result itself, or the displacement v on simplices if its mesh has other elements."""
    problem = result.problem
    if not has_more_corners(problem.mesh):
        return result
    check_carried(problem)
    return carried_result(result, cut_into_simplices(problem))


def problem_on_simplices(problem: Problem) -> Problem:
    """The problem itself, or that of order two on simplices if its mesh has other elements."""
    if not has_more_corners(problem.mesh):
        return problem
    return on_cut_mesh(problem, cut_into_simplices(problem))


def check_on_simplices(problem: Problem) -> None:
    """Refuse problems that no bound covers after elements are cut into simplices."""
    if not has_more_corners(problem.mesh):
        check_carried(problem)
        return
    check_each_feature(problem)
    if problem.N == 3:
        check_hexahedra(problem.mesh)
    check_data_inside(problem)
    check_free_of_functions(problem)
    check_carried(problem_on_simplices(problem))


def interpolant(given: np.ndarray, points: Points, cut_mesh: CutMesh) -> np.ndarray:
    """Nodal values (nodes, N) of v, from those of u_h and the points of its mesh."""
    mesh = points.mesh
    count = mesh.nv
    ends = np.sort(edge_ends(cut_mesh.mesh), axis=1)
    keys = ends @ [count, 1]
    order = np.argsort(keys)

    def numbers_of(pairs: np.ndarray) -> np.ndarray:
        """The nodes of the edges of the simplices with these ends."""
        wanted = np.sort(pairs, axis=1) @ [count, 1]
        return count + order[np.searchsorted(keys[order], wanted)]

    u = np.zeros((count + len(ends), given.shape[1]))
    u[:count] = given[:count]
    if points.order == 2:
        old = edge_ends(mesh)
        u[numbers_of(old)] = given[count : count + len(old)]
    diagonals = cut_mesh.diagonals
    bent = on_diagonals(given, points, cut_mesh) - u[diagonals].mean(axis=1)
    u[numbers_of(diagonals)] = bent / MIDDLE
    return u


def on_diagonals(u: np.ndarray, points: Points, cut_mesh: CutMesh) -> np.ndarray:
    """The displacements at the middles of the diagonals, (diagonals, N)."""
    mesh = points.mesh
    corners = 2**mesh.dim
    pairs = zip(elements_by_shape(mesh), points.blocks, strict=True)
    found = next(pair for pair in pairs if pair[0][1].shape[1] == corners)
    (numbers, _), block = found
    first = ElementId(VOL, int(numbers[0]))
    shapes = shapes_at(points.scalar, first, with_last_share(cut_mesh.places))
    nodes = block.nodes[np.searchsorted(numbers, cut_mesh.owners)]
    return np.einsum("qk,qkc->qc", shapes, u[nodes])
