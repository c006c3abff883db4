"""Factors of symmetric matrices by direct solvers, also on meshes of several MPI processes.

There the matrix is gathered and factorised on process 0, which ``netgen.meshing.Mesh.Distribute``
leaves without elements.  The symbolic factorisation is kept when the values change, as on a mesh of
one process.
"""

from __future__ import annotations

import numpy as np
from netgen.meshing import NgException
from ngsolve import BitArray, FESpace
from ngsolve.la import BaseMatrix, BaseVector, SparseMatrixd

from ngepc.linalg.assembly import from_entries
from ngepc.linalg.operators import SquareOperator
from ngepc.linalg.ordering import OrderedFactors, dof_points, swept
from ngepc.parallel import is_distributed

SOLVER_ERRORS = (NgException, RuntimeError, MemoryError)
"""What assembly and factorisation raise: NGSolve's own exception, RuntimeError where a library is
missing or gives up, MemoryError where the fill-in does not fit."""

ROOT = 0
"""The process that factorises."""


def factors(matrix: SparseMatrixd, space: FESpace, free: BitArray, name: str) -> BaseMatrix:
    """The inverse of a symmetric matrix on the free degrees of freedom of a space.

    Parameters
    ----------
    matrix
        Its lower triangle; on a distributed mesh what this process contributes to it.
    space
        Its space.
    free
        The degrees of freedom that are not fixed.
    name
        NGSolve's name of a direct solver.

    Returns
    -------
    BaseMatrix
        Maps functionals to functions, both as vectors of this process, see ``ngepc.parallel``.
    """
    if is_distributed(space.mesh):
        return GatheredFactors(matrix, space, free, name)
    return OrderedFactors(matrix, swept(space, free), name)


class GatheredFactors(SquareOperator):
    """The factors of a sum of contributions of all processes.

    Parameters
    ----------
    matrix, space, free, name
        As for ``factors``; ``Update`` looks at the entries of the same matrix again.

    Raises
    ------
    RuntimeError
        On all processes, if the solver gives up.
    """

    def __init__(self, matrix: SparseMatrixd, space: FESpace, free: BitArray, name: str) -> None:
        super().__init__(matrix)
        self._matrix, self._name = matrix, name
        self._comm = space.mesh.comm.mpi4py
        numbers, size = space.ParallelDofs().EnumerateGlobally(free)
        numbers = np.array(numbers, dtype=np.int64)
        self._own = np.flatnonzero(numbers >= 0)
        parts = self._comm.gather(numbers[self._own], root=ROOT)
        points = self._gather(dof_points(space, numbers >= 0)[self._own])
        keys = self._keys(numbers, int(size))
        self._inverse, self._sum = None, None
        if parts is not None:
            self._dofs, self._ends = np.concatenate(parts), np.cumsum([len(p) for p in parts])[:-1]
            keys, self._where = np.unique(keys, return_inverse=True)
            rows, columns = np.divmod(keys, size)
            self._sum = from_entries(rows, columns, np.zeros(len(keys)), size, size)
            self._right, self._solution = (self._sum.CreateColVector() for _ in range(2))
            self._order = self._swept(points, int(size))
        self.Update()

    def _swept(self, points: np.ndarray, size: int) -> np.ndarray:
        """All degrees of freedom in a sweep by their points, as ``ngepc.linalg.ordering`` does it."""
        places = np.empty((size, points.shape[1]))
        places[self._dofs] = points
        return np.lexsort([np.arange(size), *places.T])

    def _keys(self, numbers: np.ndarray, size: int) -> np.ndarray | None:
        """Row * size + column of the entries of all processes, within the lower triangle."""
        _, columns, starts = (np.asarray(a) for a in self._matrix.CSR())
        rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts.astype(np.int64)))
        i, j = numbers[rows], numbers[columns]
        self._kept = np.flatnonzero((columns <= rows) & (i >= 0) & (j >= 0))
        i, j = i[self._kept], j[self._kept]
        return self._gather(np.maximum(i, j) * size + np.minimum(i, j))

    def _gather(self, values: np.ndarray) -> np.ndarray | None:
        """The values of all processes on the one that factorises, None on the others."""
        parts = self._comm.gather(values, root=ROOT)
        return None if parts is None else np.concatenate(parts)

    def Update(self) -> None:
        """Factorise anew with the entries that the matrix has now."""
        values = self._gather(np.asarray(self._matrix.AsVector().FV())[self._kept])
        failure = ""
        if self._comm.rank == ROOT:
            entries = self._sum.AsVector().FV().NumPy()
            entries[:] = np.bincount(self._where, values, len(entries))
            try:
                self._factorise()
            except SOLVER_ERRORS as error:
                failure = str(error) or type(error).__name__
        failure = self._comm.bcast(failure, root=ROOT)
        if failure:
            raise RuntimeError(failure)

    def _factorise(self) -> None:
        if self._inverse is None:
            self._inverse = OrderedFactors(self._sum, self._order, self._name)
        else:
            self._inverse.Update()

    def Mult(self, x: BaseVector, y: BaseVector) -> None:
        """Values of a function on this process from what it contributes to a functional."""
        values = self._gather(x.FV().NumPy()[self._own])
        parts = None
        if self._comm.rank == ROOT:
            self._right.FV().NumPy()[:] = np.bincount(self._dofs, values, self._right.size)
            self._solution.data = self._inverse * self._right
            parts = np.split(self._solution.FV().NumPy()[self._dofs], self._ends)
        entries = y.FV().NumPy()
        entries[:] = 0.0
        entries[self._own] = self._comm.scatter(parts, root=ROOT)
