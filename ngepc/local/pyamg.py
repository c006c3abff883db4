"""Multigrid by PyAMG for large bodies without PETSc: ``inverse=PyAMG()``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, eye

from ngepc.discretisation.body import DiscreteBody
from ngepc.linalg.aggregation import COARSEST
from ngepc.linalg.cycle import Level, coarsest_solver, level_and_coarser, v_cycle
from ngepc.linalg.descent import Linear
from ngepc.local.iterative import (
    FullPattern,
    Iterative,
    Preconditioner,
    low_energy_modes,
)
from ngepc.model.processes import require_whole

try:
    import pyamg
except ImportError:  # said when PyAMG() is made
    pyamg = None


@dataclass(frozen=True, kw_only=True)
class PyAMG(Iterative):
    """Conjugate gradients with smoothed aggregation of PyAMG, on one process.

    Parameters
    ----------
    forcing, max_iterations
        As for ``PETSc``.

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

    def preconditioner(
        self, pattern: FullPattern, body: DiscreteBody
    ) -> Preconditioner:
        """V-cycles on the coarse spaces of the first tangent."""
        require_whole("inverse=PyAMG()", body.problem.mesh)
        return VCycles(pattern, body)


class VCycles:
    """V-cycles on the coarse spaces of the first tangent, see ``Preconditioner``."""

    def __init__(self, pattern: FullPattern, body: DiscreteBody) -> None:
        self._N = body.problem.N
        self._modes = low_energy_modes(body)
        self._spaces: list[csr_matrix] = []
        self._restrictions: list[csr_matrix] = []

    def coarsen(self, matrix: csr_matrix) -> None:
        """See ``Preconditioner``."""
        self._spaces = coarse_spaces(matrix, self._modes, self._N)
        self._restrictions = [space.T.tocsr() for space in self._spaces]

    def update(self, pinned: csr_matrix) -> Linear:
        """See ``Preconditioner``."""
        make = partial(Level, sweep=pyamg.amg_core.gauss_seidel)
        levels = []
        for pair in zip(self._spaces, self._restrictions, strict=True):
            level, pinned = level_and_coarser(make, pinned, *pair)
            levels.append(level)
        return partial(v_cycle, levels, coarsest_solver(pinned))


def coarse_spaces(matrix: csr_matrix, modes: np.ndarray, N: int) -> list[csr_matrix]:
    """Interpolations from each level to the next finer one by smoothed aggregation, finest first.

    Of a positive definite matrix with N unknowns for each node, and of vectors of low energy
    (unknowns, k).  Trailing unknowns that no mode has, those of order two, form a level of their
    own.  Weights of the smoothing are computed from rows, without random vectors.
    """
    found = []
    count = len(modes) - int((modes != 0).any(axis=1)[::-1].argmax())
    if count < len(modes):
        found.append(eye(len(modes), count, format="csr"))
    blocks = bsr_matrix(matrix[:count, :count], blocksize=(N, N))
    choices = {"smooth": ("jacobi", {"weighting": "local"}), "improve_candidates": None}
    levels = pyamg.smoothed_aggregation_solver(
        blocks, modes[:count], strength=None, max_coarse=COARSEST, **choices
    ).levels
    return found + [level.P.tocsr() for level in levels[:-1]]
