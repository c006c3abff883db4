"""Aggregates of nodes and coarse functions on them, for multigrid by smoothed aggregation.

Vanek, Mandel, Brezina, Computing 56 (1996).  The coarse functions on an aggregate are the modes
there, orthonormal; they are smoothed by Jacobi's method.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

COARSEST = 400  # number of unknowns that a direct solver takes
DAMPING = 1.4  # of the Jacobi step that smooths, divided by the largest eigenvalue
DEPENDENT = 1e-10
"""Modes of an aggregate count as dependent below this squared relative size."""


def incidence(number: np.ndarray) -> csr_matrix:
    """Which node belongs to which aggregate."""
    chosen = np.flatnonzero(number >= 0)
    pairs = (np.ones(len(chosen), dtype=np.int32), (chosen, number[chosen]))
    return csr_matrix(pairs, shape=(len(number), number.max(initial=-1) + 1))


def aggregates(graph: csr_matrix) -> np.ndarray:
    """A number for each node, -1 for those without neighbours.

    A node whose neighbours are all free starts an aggregate with them; others join a neighbour.
    """
    starts = graph.indptr.tolist()
    columns = graph.indices.tolist()
    size = len(starts) - 1
    count = 0
    number = [-1] * size
    for i in range(size):
        around = columns[starts[i] : starts[i + 1]]
        if len(around) > 1 and all(number[j] < 0 for j in around):
            for j in around:
                number[j] = count
            count += 1
    while True:
        before = list(number)
        left = [i for i in range(size) if number[i] < 0]
        for i in left:
            joined = (
                before[j] for j in columns[starts[i] : starts[i + 1]] if before[j] >= 0
            )
            number[i] = next(joined, -1)
        if number == before:
            return np.array(number)


def tentative(
    aggregate: np.ndarray, modes: np.ndarray
) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
    """Interpolation by the modes (unknowns, k), restricted to aggregates and orthonormal there.

    With it come the modes on the coarse level, without dependent ones, and their aggregates.
    """
    chosen = np.flatnonzero(aggregate >= 0)
    k = modes.shape[1]
    here = aggregate[chosen]
    part = modes[chosen]
    size = int(aggregate.max(initial=-1)) + 1
    gram = np.empty((size, k, k))
    for i, j in np.ndindex(k, k):
        gram[:, i, j] = np.bincount(here, part[:, i] * part[:, j], minlength=size)
    squares, vectors = np.linalg.eigh(gram)
    kept = squares > DEPENDENT * squares[:, -1:]
    roots = np.sqrt(np.where(kept, squares, 1.0))
    values = np.einsum("ui,uij->uj", part, (vectors / roots[:, None, :])[here])
    place = np.where(kept.ravel(), np.cumsum(kept) - 1, -1).reshape(kept.shape)[here]
    rows = np.repeat(chosen, k).reshape(-1, k)
    used = place >= 0
    shape = (len(modes), int(kept.sum()))
    plain = csr_matrix((values[used], (rows[used], place[used])), shape=shape)
    coarse = (vectors * roots[:, None, :]).swapaxes(1, 2)[kept]
    return plain, coarse, np.nonzero(kept)[0]
