"""Multigrid by PyAMG for large bodies where PETSc is not at hand: ``inverse=PyAMG()``."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.sparse import csr_matrix

from ngepc.discretisation.balance import Frame
from ngepc.linalg.aggregation import coarse_spaces
from ngepc.linalg.descent import Linear
from ngepc.local.iterative import FullPattern, Iterative, Preconditioner, low_energy_modes
from ngepc.model.processes import require_whole

try:
    import pyamg
except ImportError:  # said when PyAMG() is made
    pyamg = None

SMOOTHER = ("gauss_seidel", {"sweep": "symmetric", "iterations": 2})


@dataclass(frozen=True, kw_only=True)
class PyAMG(Iterative):
    """Conjugate gradients with smoothed aggregation: a wheel, one process, no compiler.

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

    def preconditioner(self, pattern: FullPattern, frame: Frame) -> Preconditioner:
        """V-cycles on the coarse spaces of the first tangent."""
        require_whole("inverse=PyAMG()", frame.problem.mesh)
        modes, spaces = low_energy_modes(frame), []

        def prepared(matrix: csr_matrix, pinned: csr_matrix) -> Linear:
            if not spaces:
                spaces.extend([*coarse_spaces(matrix, modes, pattern.graph), None])
            levels = []
            for space in spaces:
                level = pyamg.multilevel.MultilevelSolver.Level()
                level.A = pinned
                if space is not None:
                    level.P, level.R = space, space.T.tocsr()
                    pinned = (level.R @ pinned @ space).tocsr()
                levels.append(level)
            solver = pyamg.multilevel.MultilevelSolver(levels, coarse_solver="splu")
            pyamg.relaxation.smoothing.change_smoothers(solver, SMOOTHER, SMOOTHER)
            return solver.aspreconditioner().matvec

        return prepared
