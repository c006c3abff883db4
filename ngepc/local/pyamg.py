"""Multigrid by PyAMG for large bodies without PETSc: ``inverse=PyAMG()``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, eye

from ngepc.discretisation.body import DiscreteBody
from ngepc.discretisation.stiffness import Stiffness
from ngepc.discretisation.summands import element_parts
from ngepc.linalg.aggregation import COARSEST
from ngepc.linalg.cores import in_order
from ngepc.linalg.cycle import Level, coarsest_solver, level_and_coarser, v_cycle
from ngepc.linalg.descent import Linear
from ngepc.local.iterative import Iterative, Preconditioner, low_energy_modes
from ngepc.local.lower import FinestLevel, LowerStorage
from ngepc.model.processes import ALONE, require_whole

try:
    import pyamg
except ImportError:  # said when PyAMG() is made
    pyamg = None


FORCING_ALONE = 1e-2
"""The usual ``forcing``: with 0.03 steps on thin plates do not lower the energy."""

Pair = tuple[csr_matrix | bsr_matrix, csr_matrix | bsr_matrix]
"""The interpolation from a level to the next finer one, and its transpose."""


@dataclass(frozen=True, kw_only=True)
class PyAMG(Iterative):
    """Conjugate gradients with smoothed aggregation of PyAMG, on one process.

    Parameters
    ----------
    forcing, max_iterations
        As for ``PETSc``; a ``forcing`` of None is 0.01.

    Raises
    ------
    ImportError
        If pyamg is missing.
    TypeError, ValueError
        If an option is out of its range.
    """

    def __post_init__(self) -> None:
        if pyamg is None:
            raise ImportError("PyAMG() needs pyamg: 'pip install pyamg'")
        super().__post_init__()

    def forcing_of(self, order: int) -> float:
        """See ``Iterative``."""
        return FORCING_ALONE if self.forcing is None else self.forcing

    def storage(self, stiffness: Stiffness) -> LowerStorage:
        """Tangents as blocks on and below the diagonal, those of large bodies in two parts."""
        parts = element_parts(stiffness.mesh, stiffness.free.size)
        return LowerStorage(stiffness, parts)

    def preconditioner(
        self, storage: LowerStorage, body: DiscreteBody
    ) -> Preconditioner:
        """V-cycles on the coarse spaces of the first tangent."""
        require_whole("inverse=PyAMG()", body.problem.mesh)
        return VCycles(storage, body)


class VCycles:
    """V-cycles on the coarse spaces of the first tangent, see ``Preconditioner``.

    With displacements of order two the linear functions at the vertices form the second level.
    """

    def __init__(self, storage: LowerStorage, body: DiscreteBody) -> None:
        self._N = body.problem.N
        vertices = body.problem.mesh.nv
        self._linear = storage.leading(vertices)
        self._modes = low_energy_modes(body)[: self._N * vertices]
        self._size = body.free.size
        self._pairs: list[Pair] = []

    def coarsen(self, matrix: LowerStorage) -> None:
        """See ``Preconditioner``."""
        spaces = coarse_spaces(self._linear.matrix(), self._modes, self._N)
        if self._has_more_nodes:
            spaces.insert(0, eye(self._size, len(self._modes), format="csr"))
        self._pairs = [(space, transposed(space)) for space in spaces]

    @property
    def _has_more_nodes(self) -> bool:
        """Whether there are nodes that are no vertices."""
        return self._size > len(self._modes)

    def update(self, pinned: LowerStorage) -> Linear:
        """See ``Preconditioner``; the level of all nodes is made beside those of the vertices."""
        if not self._has_more_nodes:
            levels, coarsest = self._below(pinned, self._pairs)
            return partial(v_cycle, levels, coarsest)
        pair, *coarser = self._pairs
        work = [
            partial(pinned.level, *pair, ALONE),
            partial(self._below, None, coarser),
        ]
        level, (levels, coarsest) = in_order(lambda task: task(), work)
        return partial(v_cycle, [level, *levels], coarsest)

    def _below(
        self, finest: LowerStorage | None, pairs: list[Pair]
    ) -> tuple[list[Level | FinestLevel], Linear]:
        """The levels from that of the vertices on, and the solver of the coarsest one.

        ``finest`` is the tangent if that is the first of these levels.
        """

        def first(_: csr_matrix, *pair: csr_matrix) -> FinestLevel:
            """The level of the pinned matrix."""
            return finest.level(*pair, ALONE)

        sweeping = partial(Level, sweep=pyamg.amg_core.gauss_seidel)
        matrix = self._linear.matrix()
        levels = []
        for pair in pairs:
            make = sweeping if levels or finest is None else first
            level, matrix = level_and_coarser(make, matrix, *pair)
            levels.append(level)
        return levels, coarsest_solver(matrix)


def transposed(space: csr_matrix | bsr_matrix) -> csr_matrix | bsr_matrix:
    """The transpose, row by row as the matrix."""
    return space.T if isinstance(space, bsr_matrix) else space.T.tocsr()


def coarse_spaces(matrix: csr_matrix, modes: np.ndarray, N: int) -> list[bsr_matrix]:
    """Interpolations from each level to the next finer one by smoothed aggregation, finest first.

    Of a positive definite matrix with N unknowns for each node, and of vectors of low energy
    (unknowns, k).  Weights of the smoothing are computed from rows, without random vectors.
    """
    blocks = bsr_matrix(matrix, blocksize=(N, N))
    choices = {"smooth": ("jacobi", {"weighting": "local"}), "improve_candidates": None}
    levels = pyamg.smoothed_aggregation_solver(
        blocks, modes, strength=None, max_coarse=COARSEST, **choices
    ).levels
    spaces = []
    for level, coarser in pairwise(levels):
        size = (level.A.blocksize[0], coarser.A.blocksize[0])
        spaces.append(csr_matrix(level.P).tobsr(size))
    return spaces
