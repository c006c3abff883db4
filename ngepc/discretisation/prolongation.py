"""Carrying P1 fields from one mesh of a body to another: the nested starts of Table 1."""

from __future__ import annotations

import numpy as np
import scipy
from ngsolve import BND, H1, VERTEX, FESpace, GridFunction, Mesh, NodeId
from ngsolve.la import BaseVector

from ngepc.checks.sentences import counted, in_words
from ngepc.discretisation.facets import MIDDLE
from ngepc.model.elements import edge_ends, has_straight_simplices, vertex_coordinates
from ngepc.model.located import located
from ngepc.model.problem import Problem
from ngepc.model.processes import require_whole


def vertex_dofs(space: FESpace, mesh: Mesh) -> np.ndarray:
    """Vertices that carry a degree of freedom of a scalar P1 space, and these degrees, (2, k)."""
    if space.ndof == mesh.nv:
        return np.tile(np.arange(mesh.nv), (2, 1))
    on_boundary = sorted(
        {v.nr for element in mesh.Elements(BND) for v in element.vertices}
    )
    pairs = [(v, space.GetDofNrs(NodeId(VERTEX, v))[0]) for v in on_boundary]
    return (
        np.array([pair for pair in pairs if pair[1] >= 0], dtype=int).reshape(-1, 2).T
    )


def at_points(mesh: Mesh, vertex_values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The P1 function with vertex values (nv, k) at points (n, N), outside at a nearest vertex."""
    component = GridFunction(H1(mesh, order=1))
    places = located(mesh, points)
    inside = places["nr"] >= 0
    result = np.empty((len(points), vertex_values.shape[1]))
    for k, values in enumerate(vertex_values.T):
        component.vec.FV().NumPy()[:] = values
        result[inside, k] = np.ravel(component(places[inside]))
    if not inside.all():
        _, nearest = scipy.spatial.cKDTree(vertex_coordinates(mesh)).query(
            points[~inside]
        )
        result[~inside] = vertex_values[nearest]
    return result


def at_vertices(
    own: Mesh, values: np.ndarray, mesh: Mesh, chosen: np.ndarray
) -> np.ndarray:
    """A P1 function of one mesh at chosen vertices of another: (chosen, k) from (own.nv, k).

    Where processes share ``mesh`` it has to be refined from ``own``, otherwise a ValueError.
    """
    if own is getattr(mesh, "coarse", None):
        fine = np.concatenate([values, values[mesh.parents].mean(axis=1)])
        return fine[chosen]
    require_whole("start on a mesh that this one was not refined from", mesh)
    return at_points(own, values, vertex_coordinates(mesh)[chosen])


def nodal_values(start: object, problem: Problem) -> np.ndarray:
    """A displacement, or the ``displacement`` of a result, at a problem's nodes, shape (nodes, N).

    On the same mesh and for the same order it is itself, otherwise it is evaluated at the vertices,
    for order two on straight simplices at the middles of the edges too.  A TypeError or ValueError
    if it has not N components.
    """
    source = (
        start
        if isinstance(start, GridFunction)
        else getattr(start, "displacement", start)
    )
    N = problem.N
    mesh = problem.mesh
    if not isinstance(source, GridFunction):
        raise TypeError(
            f"start={in_words(start)}: a displacement or a result that has one is needed"
        )
    own = source.space.mesh
    if own.dim != N or source.dim != N:
        raise ValueError(
            f"start has {counted(source.dim, 'component')}: a displacement of {N} is needed"
        )
    given = np.stack([part.vec.FV().NumPy() for part in source.components], axis=1)
    if own is mesh and source.space.globalorder == problem.order:
        return given
    count = H1(mesh, order=problem.order).ndof
    same = np.array_equal(vertex_coordinates(mesh), vertex_coordinates(own))
    if same and len(given) == count:
        return given
    values = np.zeros((count, N))
    if problem.order == 2 and has_straight_simplices(mesh):
        values[:] = _quadratic(source, problem)
        return problem.nodal_processes.spread(values)
    there = given[: own.nv]
    values[: mesh.nv] = (
        there if same else at_vertices(own, there, mesh, np.arange(mesh.nv))
    )
    return values


def _quadratic(source: GridFunction, problem: Problem) -> np.ndarray:
    """Coefficients of the quadratic function with the values of another one, (nodes, N).

    It has the same values at the vertices and at the middles of the edges.
    """
    own = source.space.mesh
    mesh = problem.mesh
    if own is not mesh and own is not getattr(mesh, "coarse", None):
        require_whole("start on a mesh that this one was not refined from", mesh)
    ends = edge_ends(mesh)
    vertices = vertex_coordinates(mesh)
    points = np.concatenate([vertices, vertices[ends].mean(axis=1)])
    values = values_at_points(source, points)
    at_vertices, at_middles = np.split(values, [len(vertices)])
    bend = at_middles - at_vertices[ends].mean(axis=1)
    return np.concatenate([at_vertices, bend / MIDDLE])


def values_at_points(function: GridFunction, points: np.ndarray) -> np.ndarray:
    """A function of N components at points (n, N), outside at a nearest vertex."""
    mesh = function.space.mesh
    places = located(mesh, points)
    inside = places["nr"] >= 0
    result = np.empty(points.shape)
    result[inside] = np.asarray(function(places[inside]))
    if not inside.all():
        vertices = vertex_coordinates(mesh)
        _, nearest = scipy.spatial.cKDTree(vertices).query(points[~inside])
        parts = [part.vec.FV().NumPy()[nearest] for part in function.components]
        result[~inside] = np.stack(parts, axis=1)
    return result


def prolongate(source: FESpace, values: BaseVector, target: FESpace) -> np.ndarray:
    """Degrees of freedom in ``target`` of a P1 function in ``source``, a space of the same kind.

    They are zero where not free, and functions on a part of the boundary are zero at other
    vertices; to the same or a refined mesh this is exact.
    """
    old = source.mesh
    new = target.mesh
    components = GridFunction(source).dim
    first_of = (
        (lambda space: space)
        if components == 1
        else (lambda space: space.components[0])
    )
    old_vertices, old_dofs = vertex_dofs(first_of(source), old)
    new_vertices, new_dofs = vertex_dofs(first_of(target), new)
    known = np.zeros((old.nv, components))
    known[old_vertices] = values.FV().NumPy().reshape(components, -1)[:, old_dofs].T
    result = np.zeros((components, target.ndof // components))
    points = vertex_coordinates(new)[new_vertices]
    same = old is new
    result[:, new_dofs] = (
        known[new_vertices] if same else at_points(old, known, points)
    ).T
    return result.ravel() * np.array(target.FreeDofs(), dtype=float)
