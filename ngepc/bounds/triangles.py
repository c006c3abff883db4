"""The triangles and edges of a mesh as arrays, with the names of two dimensions."""

from __future__ import annotations

import numpy as np
from ngsolve import Mesh

from ngepc.bounds.simplices import FACETS, Simplices

PAIRS = FACETS[2]
"""Local vertices of edge k: it runs counterclockwise."""


class Triangles(Simplices):
    """Geometry and neighbours of the triangles of a mesh with straight edges.

    Edge k runs from the lower to the higher vertex where ``forward`` (nt, 3).
    """

    def __init__(self, mesh: Mesh) -> None:
        super().__init__(mesh)
        self.forward = self.place[:, :, 0] == 0

    def around(self, chosen: np.ndarray, rings: int) -> np.ndarray:
        """Numbers of the chosen triangles and of so many rings around them, one at least."""
        for _ in range(rings):
            there = np.zeros(len(self.points), dtype=bool)
            there[self.nodes[chosen]] = True
            first, second, third = there[self.nodes.T]
            chosen = first | second | third
        return np.flatnonzero(chosen)

    def per_triangle(self, of_edges: np.ndarray) -> np.ndarray:
        """Vectors at the edge ends (ne, 2, 2), outward and counterclockwise, (nt, 3, 2, 2)."""
        values = of_edges[self.facet_of] * self.sign[:, :, None, None]
        return np.where(self.forward[:, :, None, None], values, values[:, :, ::-1])
