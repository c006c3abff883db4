"""Entries of symmetric matrices on P1 with d components, gathered from simplices.

NGSolve numbers the degrees of freedom component by component.  With n vertices, row a n + i of a
lower triangle holds, one after the other, the blocks b < a with all neighbours of vertex i, and
the block b = a with the neighbours j <= i: the place of an entry is known without a search.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from ngsolve import ET, BilinearForm, FESpace, InnerProduct, IntegrationRule, dx
from ngsolve.la import SparseMatrixd


class SimplexPattern:
    """The lower triangle of a matrix on d >= 2 components of P1, and where its entries are.

    Parameters
    ----------
    space
        A vector-valued H1 space of order 1.
    nodes
        Vertex numbers of the elements, shape (elements, N+1).
    components
        Number of components d.
    """

    def __init__(self, space: FESpace, nodes: np.ndarray, components: int) -> None:
        self.components, self._nodes, self._space = components, nodes, space

    @cached_property
    def matrix(self) -> SparseMatrixd:
        """The matrix that ``write`` overwrites."""
        r, q = self._space.TnT()
        shape = ET.TRIG if self._nodes.shape[1] == 3 else ET.TET
        once = dx(intrules={shape: IntegrationRule(shape, 0)})
        form = BilinearForm(self._space, symmetric=True, symmetric_storage=True)
        form += InnerProduct(q, r) * once
        return form.Assemble().mat.local_mat

    @cached_property
    def _starts(self) -> np.ndarray:
        """First entry of each row of the matrix, one row of the array for each component."""
        starts = np.asarray(self.matrix.CSR()[2]).astype(np.int64)
        return starts[:-1].reshape(self.components, -1)

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertex i, place among its neighbours and neighbour j of all pairs (i, j), by rows."""
        below = np.diff(self._starts[0], append=self._length(0))
        degree = np.diff(self._starts[1], append=self._length(1)) - below
        i = np.repeat(np.arange(len(degree)), degree)
        place = np.arange(len(i)) - np.repeat(np.cumsum(degree) - degree, degree)
        j = np.asarray(self.matrix.CSR()[1])[self._starts[1][i] + place]
        return i, place, j

    def _length(self, component: int) -> int:
        """Number of entries in the rows of the components up to this one."""
        return int(np.asarray(self.matrix.CSR()[2])[(component + 1) * self._starts.shape[1]])

    @cached_property
    def _entry(self) -> np.ndarray:
        """Number of the pair for each two vertices of an element, shape (elements, (N+1)^2)."""
        i, _, j = self._pairs
        n = np.int64(self._starts.shape[1])
        keys = (self._nodes[:, :, None] * n + self._nodes[:, None, :]).ravel()
        found = np.searchsorted(i * n + j, keys)
        return found.astype(np.int32).reshape(len(self._nodes), -1)

    def blocks(self) -> Iterator[tuple[int, int]]:
        """The blocks (a, b) of the lower triangle, b <= a."""
        return ((a, b) for a in range(self.components) for b in range(a + 1))

    def zeros(self) -> dict[tuple[int, int], np.ndarray]:
        """Room for the values at all pairs of neighbours, for each block."""
        return {block: np.zeros(len(self._pairs[0])) for block in self.blocks()}

    def add(self, values: np.ndarray, elements: np.ndarray, local: np.ndarray) -> None:
        """Add symmetric element matrices, entries i <= j given in rows of ``local``."""
        np.add.at(values, self._entry[elements].ravel(), local[:, self._mirrored].ravel())

    @cached_property
    def _mirrored(self) -> np.ndarray:
        """Number of the entry i <= j for all entries of an element matrix, shape ((N+1)^2,)."""
        vertices = self._nodes.shape[1]
        i, j = np.triu_indices(vertices)
        full = np.empty((vertices, vertices), int)
        full[i, j] = full[j, i] = np.arange(len(i))
        return full.ravel()

    def write(self, values: dict[tuple[int, int], np.ndarray]) -> SparseMatrixd:
        """The matrix with these values."""
        entries = np.asarray(self.matrix.AsVector().FV())
        i, place, j = self._pairs
        degree = np.bincount(i, minlength=self._starts.shape[1])[i]
        low = j <= i
        for (a, b), block in values.items():
            if a == b:
                entries[(self._starts[a][i] + b * degree + place)[low]] = block[low]
            else:
                entries[self._starts[a][i] + b * degree + place] = block
        return self.matrix
