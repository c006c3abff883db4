"""The stiffness matrix of the displacements for NGSolve's direct solvers, filled in place.

Its entries are N x N blocks, one for each pair of nodes: the direct solver orders and eliminates
nodes instead of single components, which takes a third of the time.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1

from ngepc.discretisation.blocks import StiffnessBlocks, mass_matrix
from ngepc.discretisation.points import Moduli, Points


class Stiffness:
    """The matrix B' C B on one sparsity pattern, with rows of held components as the identity.

    Parameters
    ----------
    points
        The points with their strain rows.
    free
        Boolean, shape (nodes, N): components that no support holds.

    Attributes
    ----------
    matrix
        The lower triangle as an NGSolve matrix of N x N blocks.
    """

    def __init__(self, points: Points, free: np.ndarray) -> None:
        self._blocks = StiffnessBlocks(points, free)
        self.matrix = mass_matrix(H1(points.mesh, order=points.order, dim=points.kinematics.N))
        if self.entries.shape[0] != len(self._blocks.rows):
            raise RuntimeError("the block matrix has another pattern than the scalar one")

    @property
    def entries(self) -> np.ndarray:
        """View of the entries, shape (entries, N, N)."""
        N = self._blocks.N
        return self.matrix.AsVector().FV().NumPy().reshape(-1, N, N)

    def fill(self, moduli: Moduli) -> None:
        """Assemble the entries for these moduli at the points."""
        self.entries[:] = self._blocks.values(moduli)
