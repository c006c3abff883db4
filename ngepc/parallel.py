"""Meshes that are distributed over MPI processes: what a process has, and what all do together.

A process has some of the elements, and the degrees of freedom on them.  Functions, such as y and v,
have the same values on all processes that share a degree of freedom (NGSolve calls their vectors
cumulated); functionals, such as loads and residuals, are sums of what the processes contribute
(distributed).  A functional applied to a function is then a sum over the processes, and
nothing has to be exchanged to assemble either.

On a mesh of one process everything here returns its argument.  On others all processes must call
it, in the same order.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from ngsolve import H1, BitArray, FESpace, Integrate, Mesh
from ngsolve.comp import SumOfIntegrals
from ngsolve.la import BaseVector

T = TypeVar("T")


def is_distributed(mesh: Mesh) -> bool:
    """Whether the mesh is distributed over several processes."""
    return mesh.comm.size > 1


def from_all(value: T, mesh: Mesh) -> list[T]:
    """The values that the processes give, in their order, on each of them."""
    return mesh.comm.mpi4py.allgather(value) if is_distributed(mesh) else [value]


def gathered(rows: np.ndarray, mesh: Mesh) -> np.ndarray:
    """The rows that the processes give, one after the other, on each of them."""
    return np.concatenate(from_all(rows, mesh)) if is_distributed(mesh) else rows


def total(value: T, mesh: Mesh) -> T:
    """The sum of what the processes give, numbers or arrays."""
    return mesh.comm.mpi4py.allreduce(value) if is_distributed(mesh) else value


def integral(form: SumOfIntegrals, mesh: Mesh) -> float:
    """The integral of f dx, f ds or a sum of such over the whole body.

    NGSolve's ``Integrate`` sums a coefficient over the processes, but not such a form.
    """
    return total(Integrate(form, mesh), mesh)


def accumulated(f: BaseVector) -> BaseVector:
    """A copy of a functional in which each entry is the sum of what the processes contribute."""
    whole = f.CreateVector()
    whole.data = f
    whole.Cumulate()
    return whole


def entries(f: BaseVector) -> np.ndarray:
    """The entries of ``accumulated`` at the degrees of freedom of this process."""
    whole = accumulated(f)
    return np.array(whole.FV().NumPy())


def somewhere(mask: np.ndarray, space: FESpace) -> np.ndarray:
    """Where ``mask``, one truth value for each degree of freedom, holds on any process."""
    if not is_distributed(space.mesh):
        return mask
    numbers, count = global_numbers(space)
    found = np.zeros(count, dtype=bool)
    found[gathered(numbers[mask], space.mesh)] = True
    return found[numbers]


def global_numbers(space: FESpace) -> tuple[np.ndarray, int]:
    """The number of each degree of freedom among those of all processes, and how many there are."""
    if not is_distributed(space.mesh):
        return np.arange(space.ndof), space.ndof
    numbers, count = space.ParallelDofs().EnumerateGlobally()
    return np.array(numbers, dtype=np.int64), int(count)


def vertex_numbers(mesh: Mesh) -> tuple[np.ndarray, int]:
    """The number of each vertex among those of all processes, and how many there are."""
    if not is_distributed(mesh):
        return np.arange(mesh.nv), mesh.nv
    return global_numbers(H1(mesh, order=1))


def vertex_coordinates(mesh: Mesh) -> np.ndarray:
    """The coordinates of all vertices by these numbers, shape (vertices, N)."""
    own = np.asarray(mesh.ngmesh.Coordinates())[: mesh.nv, : mesh.dim]
    if not is_distributed(mesh):
        return own
    numbers, count = vertex_numbers(mesh)
    points = np.empty((count, mesh.dim))
    points[gathered(numbers, mesh)] = gathered(own, mesh)
    return points


class Nodes:
    """Some degrees of freedom of a space, with the values at all of them on each process.

    Parameters
    ----------
    space
        The space.
    chosen
        Truth values, one for each degree of freedom of this process.

    Attributes
    ----------
    dofs
        Those of this process.
    numbers
        Where they stand among all.
    """

    def __init__(self, space: FESpace, chosen: np.ndarray) -> None:
        self._mesh, self.dofs = space.mesh, np.flatnonzero(chosen)
        self.numbers, self._count = np.arange(len(self.dofs)), len(self.dofs)
        self._first = np.ones(len(self.dofs), dtype=bool)
        if is_distributed(self._mesh):
            parallel = space.ParallelDofs()
            numbers, self._count = parallel.EnumerateGlobally(BitArray(chosen.tolist()))
            self.numbers = np.array(numbers, dtype=np.int64)[self.dofs]
            self._first = np.array(parallel.MasterDofs(), dtype=bool)[self.dofs]
        self._gathered_numbers = gathered(self.numbers, self._mesh)

    def of_function(self, v: BaseVector) -> np.ndarray:
        """The values of a function."""
        values = np.empty(self._count)
        values[self._gathered_numbers] = gathered(v.FV().NumPy()[self.dofs], self._mesh)
        return values

    def of_functional(self, f: BaseVector) -> np.ndarray:
        """The entries of a functional, summed over the processes."""
        own = gathered(f.FV().NumPy()[self.dofs], self._mesh)
        return np.bincount(self._gathered_numbers, own, self._count)

    def among(self, mask: np.ndarray) -> np.ndarray:
        """The degrees of freedom of this process where a mask for all nodes holds."""
        return self.dofs[mask[self.numbers]]

    def set_function(self, v: BaseVector, values: np.ndarray, mask: np.ndarray) -> None:
        """Change a function where the mask holds."""
        v.FV().NumPy()[self.among(mask)] = values[self.numbers][mask[self.numbers]]

    def set_functional(self, f: BaseVector, values: np.ndarray, mask: np.ndarray) -> None:
        """Change the sums of a functional where the mask holds: one process has them alone."""
        self.set_function(f, np.zeros(self._count), mask)
        here = self._first & mask[self.numbers]
        f.FV().NumPy()[self.dofs[here]] = values[self.numbers[here]]
