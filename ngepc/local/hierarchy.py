"""Coarse spaces of multigrid as matrices of PETSc, on one process or several.

The loop of ``linalg.aggregation.coarse_spaces`` with aggregates that end at the processes.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, eye

from ngepc.linalg.aggregation import COARSEST, DAMPING, aggregates, incidence, tentative
from ngepc.model.processes import Team

try:
    from petsc4py import PETSc as petsc
except ImportError:  # said when PETSc() is made
    petsc = None


def interpolations(
    matrix: object, modes: np.ndarray, graph: csr_matrix, processes: Team
) -> list[object]:
    """Interpolations from each level to the next finer one, the finest first.

    Parameters
    ----------
    matrix
        A matrix of PETSc.
    modes
        The own entries of vectors of low energy, shape (own unknowns, k).
    graph
        Which of the own nodes are coupled.
    processes
        Those that have rows of the matrix.
    """
    found, spare, node = [], [], np.arange(len(modes)) // (len(modes) // graph.shape[0])
    linear = (modes != 0).any(axis=1)
    if (
        matrix.comm.tompi4py().allreduce(not linear.all())
        if matrix.comm.size > 1
        else not linear.all()
    ):
        found.append(
            spread(eye(len(modes), format="csr")[:, np.flatnonzero(linear)], matrix, processes)
        )
        matrix, modes, node = matrix.ptap(found[0]), modes[linear], node[linear]
        spare.append(matrix)
    while matrix.size[0] > COARSEST:
        number = aggregates(graph)
        local, modes, coarse_node = tentative(number[node], modes)
        plain, members = spread(local, matrix, processes), incidence(number)
        if 2 * plain.size[1] > plain.size[0]:
            break
        image = matrix.matMult(plain)
        coarse = plain.transposeMatMult(image)
        smooth = jacobi_smoothed(matrix, plain, image)
        found.append(smooth.duplicate(copy=True))  # without what products keep for the next one
        spare += [plain, image, coarse]
        matrix, graph, node = coarse, members.T @ graph @ members, coarse_node
    for used in spare:
        used.destroy()  # Python frees shared objects only when all processes do
    return found


def spread(local: csr_matrix, matrix: object, processes: Team) -> object:
    """The matrix of all processes from their own rows, whose columns follow each other."""
    rows, own = local.shape
    sizes = ((rows, None), (own, None))
    first = sum(processes.all(own)[: processes.rank])
    columns = (local.indices + first).astype(petsc.IntType)
    parts = (local.indptr.astype(petsc.IntType), columns, local.data)
    return petsc.Mat().createAIJ(sizes, csr=parts, comm=matrix.comm)


def jacobi_smoothed(matrix: object, plain: object, image: object) -> object:
    """One damped Jacobi step on the columns of ``plain``; ``image`` is the matrix times it."""
    scale = matrix.getDiagonal()
    scale.reciprocal()
    x, y = matrix.createVecs()
    x.setArray(np.random.default_rng(matrix.comm.rank).standard_normal(x.local_size))
    for _ in range(10):
        matrix.mult(x, y)
        y.pointwiseMult(y, scale)
        largest = y.norm()
        y.copy(x)
        x.scale(1 / largest)
    scale.scale(-DAMPING / largest)
    image.diagonalScale(L=scale)
    image.axpy(1.0, plain, petsc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    return image
