"""Nodes that supports hold along directions that are no axes of coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix


def unit_columns(chosen: np.ndarray) -> csr_matrix:
    """Unit displacements of the chosen components (nodes, N), as columns."""
    rows = np.flatnonzero(chosen)
    places = rows, np.arange(len(rows))
    return csr_matrix((np.ones(len(rows)), places), shape=(chosen.size, len(rows)))


@dataclass(frozen=True, eq=False)
class SlantedNodes:
    """Nodes that supports hold along directions that are no axes.

    ``nodes`` (k,) are their numbers, ascending; ``projectors`` (k, N, N) give the free part of a
    vector; ``values`` (k, N) is the prescribed displacement along what is held.
    """

    nodes: np.ndarray
    projectors: np.ndarray
    values: np.ndarray

    def free_parts(self, vectors: np.ndarray) -> np.ndarray:
        """The free parts of vectors (k, N) at these nodes."""
        return np.einsum("kij,kj->ki", self.projectors, vectors)

    def keep_at(
        self, nodes: np.ndarray, vectors: np.ndarray, result: np.ndarray
    ) -> None:
        """Enter the free parts of vectors (n, N) at ``nodes`` (n,), as far as these are slanted."""
        place = np.searchsorted(self.nodes, nodes)
        place = np.minimum(place, len(self.nodes) - 1)
        there = np.flatnonzero(self.nodes[place] == nodes)
        turned = self.projectors[place[there]]
        result[there] = np.einsum("kij,kj->ki", turned, vectors[there])

    def columns(self, there: np.ndarray) -> coo_matrix:
        """Orthonormal free displacements of the nodes ``there`` (booleans), as columns."""
        N = self.values.shape[1]
        chosen = np.flatnonzero(there[self.nodes])
        sizes, axes = np.linalg.eigh(self.projectors[chosen])
        node, free = np.nonzero(sizes > 0.5)
        entries = np.swapaxes(axes, 1, 2)[node, free]
        rows = N * self.nodes[chosen[node], None] + np.arange(N)
        columns = np.repeat(np.arange(len(node)), N)
        shape = (N * len(there), len(node))
        return coo_matrix((entries.ravel(), (rows.ravel(), columns)), shape=shape)
