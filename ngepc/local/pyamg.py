"""Multigrid by PyAMG for large bodies where PETSc is not at hand: ``inverse=PyAMG()``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ngepc.discretisation.balance import Frame
from ngepc.linalg.aggregation import coarse_spaces
from ngepc.local.iterative import FullPattern, Iterative, low_energy_modes
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

    def engine(self, pattern: FullPattern, frame: Frame) -> PyAMGEngine:
        """Matrix and preconditioner."""
        require_whole("inverse=PyAMG()", frame.problem.mesh)
        return PyAMGEngine(pattern, frame)


class PyAMGEngine:
    """Matrix of SciPy, preconditioner of PyAMG."""

    def __init__(self, pattern: FullPattern, frame: Frame) -> None:
        self._pattern, self._size = pattern, frame.free.size
        self._graph = pattern.graph(~frame.free.any(axis=1))
        self._modes = low_energy_modes(frame)
        self._matrix = self._cycle = self._spaces = None

    def _scalar_matrix(self, values: np.ndarray) -> csr_matrix:
        rows = (values, self._pattern.columns, self._pattern.starts)
        return csr_matrix(rows, shape=(self._size, self._size))

    def take(self, values: np.ndarray) -> None:
        """The matrix for multiplication."""
        self._matrix = self._scalar_matrix(values)

    def build(self, values: np.ndarray) -> None:
        """A new preconditioner on the coarse spaces of the first one."""
        if self._spaces is None:
            self._spaces = coarse_spaces(self._matrix, self._modes, self._graph)
        matrix, levels = self._scalar_matrix(values), []
        for space in [*self._spaces, None]:
            level = pyamg.multilevel.MultilevelSolver.Level()
            level.A = matrix
            if space is not None:
                level.P, level.R = space, space.T.tocsr()
                matrix = (level.R @ matrix @ space).tocsr()
            levels.append(level)
        solver = pyamg.multilevel.MultilevelSolver(levels, coarse_solver="splu")
        pyamg.relaxation.smoothing.change_smoothers(solver, SMOOTHER, SMOOTHER)
        self._cycle = solver.aspreconditioner()

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The matrix times x."""
        return self._matrix @ x

    def precondition(self, r: np.ndarray) -> np.ndarray:
        """The preconditioner times r."""
        return self._cycle @ r
