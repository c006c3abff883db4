"""Conic programs: a linear cost over equations, inequalities and second-order cones.

Clarabel solves them, an interior point method; it comes with the extra ``conic``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, vstack

EXTRA = "Clarabel is needed for conic programs: pip install 'ngepc[conic]'"
SOLVED = ("Solved", "AlmostSolved")


@dataclass(frozen=True)
class ConicAccuracy:
    """What a conic program is solved to; residuals and refinement are those of Clarabel by default.

    Parameters
    ----------
    gap
        Between the program and its dual; relative where their value is above one.
    residuals
        Of the conditions, relative.
    refinement
        Residual of the linear systems of each step, relative.
    regularisation
        What is added to the pivots of free unknowns, relative.
    """

    gap: float = 1e-8
    residuals: float = 1e-8
    refinement: float = 1e-13
    regularisation: float = 1e-8


ACCURATE = ConicAccuracy()


@dataclass(frozen=True, eq=False)
class ConeProgram:
    """Minimise cost . x over the x with three kinds of conditions.

    Parameters
    ----------
    cost
        Shape (n,).
    equations, values
        Matrix and right side of ``equations x = values``.
    above, least
        Matrix and right side of ``above x >= least``.
    cones
        Triples (rows, offset, size): the entries of ``rows x + offset``, taken ``size`` at a time,
        are (t, y) with t >= |y|.
    """

    cost: np.ndarray
    equations: csr_matrix
    values: np.ndarray
    above: csr_matrix
    least: np.ndarray
    cones: list[tuple[csr_matrix, np.ndarray, int]]


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """The solution of a conic program.

    Parameters
    ----------
    x
        The unknowns, shape (n,).
    status
        The status that the solver reports: 'Solved', 'PrimalInfeasible', ...
    steps
        Steps of the interior point method.
    multipliers
        Those of the conditions of each entry of ``ConeProgram.cones``, of the shape of its offset.
    """

    x: np.ndarray
    status: str
    steps: int
    multipliers: list[np.ndarray]

    @property
    def is_success(self) -> bool:
        """Whether ``x`` is a solution, possibly of reduced accuracy."""
        return self.status in SOLVED


def cone_solution(
    program: ConeProgram, accuracy: ConicAccuracy = ACCURATE
) -> ConeSolution:
    """Solve a conic program by Clarabel on one thread.

    Parameters
    ----------
    program
        The program.
    accuracy
        What it is solved to.

    Raises
    ------
    ImportError
        If Clarabel is not installed.
    """
    try:
        import clarabel
    except ImportError as error:
        raise ImportError(EXTRA) from error
    parts = [
        (program.equations, -program.values),
        (-program.above, program.least),
        *((-rows, -offset) for rows, offset, _ in program.cones),
    ]
    cones = [
        clarabel.ZeroConeT(len(program.values)),
        clarabel.NonnegativeConeT(len(program.least)),
    ]
    for rows, _, size in program.cones:
        cones += [clarabel.SecondOrderConeT(size)] * (rows.shape[0] // size)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.tol_gap_abs = accuracy.gap
    settings.tol_gap_rel = accuracy.gap
    settings.tol_feas = accuracy.residuals
    settings.static_regularization_constant = accuracy.regularisation
    settings.iterative_refinement_reltol = accuracy.refinement
    settings.iterative_refinement_abstol = accuracy.refinement
    n = len(program.cost)
    solver = clarabel.DefaultSolver(
        csc_matrix((n, n)),
        program.cost,
        vstack([matrix for matrix, _ in parts], format="csc"),
        -np.concatenate([offset for _, offset in parts]),
        cones,
        settings,
    )
    found = solver.solve()
    ends = np.cumsum([len(offset) for _, offset in parts])
    multipliers = np.split(np.array(found.z), ends[:-1])[2:]
    x = np.array(found.x)
    return ConeSolution(x, str(found.status), found.iterations, multipliers)
