"""Factors of a sparse matrix, with its degrees of freedom in an order that suits the body.

sparsecholesky eliminates by minimum degree.  Many degrees are equal, and then the numbering of the
matrix decides; NGSolve's follows the history of the mesh and jumps through the body.  A sweep from
vertex to vertex takes a fifth to a third off a factorisation on meshes made by bisection and
less than a tenth on others, docs/cost.md.
"""

from __future__ import annotations

import numpy as np
from netgen.meshing import NgException
from ngsolve import BitArray, FESpace
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.discretisation.prolongation import vertex_dofs
from ngepc.linalg.assembly import from_entries
from ngepc.linalg.operators import SquareOperator

FROM_LOWER_TRIANGLE = ("sparsecholesky",)
"""Solvers that never look above the diagonal; the others are given both triangles."""


def swept(space: FESpace, free: BitArray) -> np.ndarray:
    """Free degrees of freedom in a sweep: by the last coordinate, then by those before it.

    Parameters
    ----------
    space
        A P1 space or a product of such; other components must not have free ones.
    free
        The free degrees of freedom.
    """
    mesh, chosen = space.mesh, np.array(free, dtype=bool)
    points = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]
    place = np.empty(mesh.nv, dtype=int)
    place[np.lexsort(points.T)] = np.arange(mesh.nv)
    vertices = vertices_of_dofs(space, chosen)[chosen]
    return np.flatnonzero(chosen)[np.argsort(place[vertices], kind="stable")]


def dof_points(space: FESpace, chosen: np.ndarray) -> np.ndarray:
    """The point of each chosen degree of freedom, shape (degrees of freedom, N)."""
    mesh = space.mesh
    points = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]
    result = np.zeros((space.ndof, mesh.dim))
    result[chosen] = points[vertices_of_dofs(space, chosen)[chosen]]
    return result


def vertices_of_dofs(space: FESpace, chosen: np.ndarray) -> np.ndarray:
    """The vertex of each chosen degree of freedom of a P1 space or a product of such."""
    result, first = np.zeros(space.ndof, dtype=int), 0
    for component in components(space):
        last = first + component.ndof
        if component is space:
            vertices, dofs = vertex_dofs(space, space.mesh)
            result[dofs] = vertices
        elif chosen[first:last].any():
            result[first:last] = vertices_of_dofs(component, chosen[first:last])
        first = last
    return result


def components(space: FESpace) -> list[FESpace]:
    """The components of a product, else the space itself."""
    try:
        return list(space.components)
    except NgException:
        return [space]


class OrderedFactors(SquareOperator):
    """The inverse of some rows and columns of a symmetric matrix, zero elsewhere.

    Parameters
    ----------
    matrix
        The matrix by its lower triangle; ``Update`` factorises the values that it has then.
    order
        The rows and columns, in the order in which they are numbered for the solver.
    name
        NGSolve's name of the direct solver.
    """

    def __init__(self, matrix: SparseMatrixd, order: np.ndarray, name: str) -> None:
        super().__init__(matrix)
        self._matrix, self._order = matrix, order
        _, columns, starts = (np.asarray(a) for a in matrix.CSR())
        place = np.full(matrix.height, -1, dtype=np.int32)
        place[order] = np.arange(len(order))
        rows = np.repeat(np.arange(matrix.height, dtype=np.int32), np.diff(starts.astype(np.int64)))
        i, j = place[rows], place[columns]
        number = np.flatnonzero((columns <= rows) & (i >= 0) & (j >= 0))
        i, j = i[number], j[number]
        i, j = np.maximum(i, j), np.minimum(i, j)
        if name not in FROM_LOWER_TRIANGLE:
            strict = i > j
            i, j = np.concatenate([i, j[strict]]), np.concatenate([j, i[strict]])
            number = np.concatenate([number, number[strict]])
        self._ordered = from_entries(i, j, number, len(order), len(order))
        self._entries = self._ordered.AsVector().FV().NumPy()
        self._number = self._entries.astype(np.int64)
        self._take_values()
        self._inverse = self._ordered.Inverse(inverse=name)
        self._right, self._solution = (self._ordered.CreateColVector() for _ in range(2))

    def _take_values(self) -> None:
        self._entries[:] = self._matrix.AsVector().FV().NumPy()[self._number]

    def Update(self) -> None:
        """Factorise anew."""
        self._take_values()
        self._inverse.Update()

    def Mult(self, x: BaseVector, y: BaseVector) -> None:
        """Multiply x by the inverse."""
        self._right.FV().NumPy()[:] = x.FV().NumPy()[self._order]
        self._solution.data = self._inverse * self._right
        y[:] = 0.0
        y.FV().NumPy()[self._order] = self._solution.FV().NumPy()
