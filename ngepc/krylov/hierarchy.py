"""The nested P1 spaces of a mesh that came about by refinement, as prolongation matrices.

NGSolve remembers the two vertices between which refinement has put a new one.  P1 functions of a
coarser mesh have the mean of its values there, and the vertices of coarser meshes come first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from ngsolve import FESpace, Mesh
from ngsolve.la import SparseMatrixd

from ngepc.linalg.assembly import from_entries


@dataclass(frozen=True, eq=False)
class Prolongation:
    """P1 on one mesh of a family to P1 on the next finer one.

    Parameters
    ----------
    coarse
        Number of coarse vertices; on the finer mesh they have the same numbers.
    parents
        Coarse vertices on both sides of each new vertex, shape (new vertices, 2).
    """

    coarse: int
    parents: np.ndarray

    @property
    def fine(self) -> int:
        """Number of vertices of the finer mesh."""
        return self.coarse + len(self.parents)

    def coarse_part(self, free: np.ndarray) -> np.ndarray:
        """``free``, shape (components * fine,), at the coarse vertices."""
        return free.reshape(-1, self.fine)[:, : self.coarse].ravel()

    def matrix(self, free: np.ndarray) -> SparseMatrixd:
        """The matrix for vector-valued functions, zero where a degree of freedom is not free.

        Parameters
        ----------
        free
            Free degrees of freedom of the finer mesh, component by component, shape
            (components * fine,).
        """
        old, new = np.arange(self.coarse), np.arange(self.coarse, self.fine)
        i = np.concatenate([old, new, new])
        j = np.concatenate([old, *self.parents.T])
        w = np.concatenate([np.ones(self.coarse), np.full(2 * len(new), 0.5)])
        components = np.arange(len(free) // self.fine)
        i, j = (components[:, None] * n + k for n, k in ((self.fine, i), (self.coarse, j)))
        i, j, w = i.ravel(), j.ravel(), np.tile(w, len(components))
        kept = free[i] & self.coarse_part(free)[j]
        size = len(free), len(components) * self.coarse
        return from_entries(i[kept], j[kept], w[kept], *size)


def prolongations(mesh: Mesh) -> tuple[Prolongation, ...]:
    """Those of the family that ends with ``mesh``, coarsest first; empty without refinement.

    A vertex belongs to the generation after that of its younger parent: uniform refinement makes
    one generation, bisection may make several.
    """
    parents = np.array([mesh.GetParentVertices(v) for v in range(mesh.nv)], dtype=int)
    parents = parents.reshape(-1, 2)
    generation = np.zeros(mesh.nv, dtype=int)
    for v, (a, b) in enumerate(parents.tolist()):
        if a >= 0:
            generation[v] = 1 + max(generation[a], generation[b])
    if (np.diff(generation) < 0).any():
        return ()
    ends = np.searchsorted(generation, np.arange(generation.max() + 2))
    return tuple(
        Prolongation(int(first), parents[first:last]) for first, last in pairwise(ends[1:])
    )


@dataclass(frozen=True, eq=False)
class Level:
    """One mesh of a family for vector-valued P1 with boundary conditions.

    Parameters
    ----------
    free
        Free degrees of freedom, component by component, boolean.
    prolongation
        From the next coarser mesh; None on the coarsest.
    """

    free: np.ndarray
    prolongation: Prolongation | None

    @cached_property
    def P(self) -> SparseMatrixd:
        """The prolongation to this mesh."""
        return self.prolongation.matrix(self.free)

    @cached_property
    def P_T(self) -> SparseMatrixd:
        """Its transpose."""
        return self.P.CreateTranspose()

    @cached_property
    def vertex_blocks(self) -> list[list[int]]:
        """The free degrees of freedom at each vertex that has any."""
        components = self.free.reshape(-1, self.prolongation.fine)
        numbers = np.arange(self.free.size).reshape(components.shape)
        if components.all():
            return numbers.T.tolist()
        blocks = (n[f].tolist() for n, f in zip(numbers.T, components.T, strict=True))
        return [block for block in blocks if block]


def levels(space: FESpace) -> tuple[Level, ...]:
    """The meshes of a P1 space, finest first; a single one for spaces on a part of the mesh."""
    free = np.array(space.FreeDofs(), dtype=bool)
    whole = space.ndof % space.mesh.nv == 0
    found = []
    for prolongation in reversed(prolongations(space.mesh) if whole else ()):
        found.append(Level(free, prolongation))
        free = prolongation.coarse_part(free)
    return (*found, Level(free, None))
