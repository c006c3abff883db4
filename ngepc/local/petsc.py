"""PETSc does the linear algebra of large bodies: ``NewtonOptions(inverse=PETSc())``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_text
from ngepc.local.hierarchy import interpolations, petsc
from ngepc.local.iterative import FullPattern, IterativeTangent, low_energy_modes
from ngepc.local.system import DiscreteProblem

INSTALL = (
    "PETSc() needs petsc4py: 'conda install -c conda-forge petsc4py', or on Debian and Ubuntu "
    "'apt install python3-petsc4py' with PETSC_DIR=$(echo /usr/lib/petscdir/petsc3*/*-real)"
)

MULTIGRID = (
    "-pc_type mg -pc_mg_galerkin pmat -mg_levels_pc_type sor "
    "-mg_levels_ksp_type chebyshev -mg_levels_ksp_max_it 2 "
)
"""Levels of smoothed aggregation, symmetric Gauss-Seidel under Chebyshev's polynomial.

No matrix times the inverse of symmetric Gauss-Seidel has an eigenvalue above 1, and none above 2
where neighbouring processes sweep at the same time, so that the bounds hold for all of them.
"""

ALONE = "-mg_levels_ksp_chebyshev_eigenvalues 0.1,1.02 -mg_coarse_pc_type cholesky "
SHARED = "-mg_levels_ksp_chebyshev_eigenvalues 0.2,2.0 -mg_coarse_pc_type redundant "

_numbers = count()


@dataclass(frozen=True, kw_only=True)
class PETSc:
    """Conjugate gradients with a preconditioner of PETSc, multigrid by default.

    Parameters
    ----------
    options
        PETSc's own option string for the preconditioner: added to ``MULTIGRID``, or in its place
        if it says "-pc_type", for instance "-pc_type hypre".
    forcing
        Relative residual at which the solves of the first Newton steps end.
    patience
        Iterations of a solve beyond which the next tangent gets a new hierarchy.
    max_iterations
        Iterations after which a solve gives up.

    Raises
    ------
    ImportError
        If petsc4py is missing.
    TypeError, ValueError
        If an option is out of its range.
    """

    options: str = ""
    forcing: float = 1e-2
    patience: int = 0
    max_iterations: int = 500

    def __post_init__(self) -> None:
        if petsc is None:
            raise ImportError(INSTALL)
        require_text("options", self.options)
        require_number("forcing", self.forcing, 1e-12)
        require_integer("patience", self.patience, 0)
        require_integer("max_iterations", self.max_iterations, 1)

    def tangent(self, discrete: DiscreteProblem) -> IterativeTangent:
        """The tangent of a discrete problem."""
        engine = partial(PETScEngine, options=self.options)
        return IterativeTangent(discrete, engine, self.patience, self.max_iterations)


class PETScEngine:
    """Matrix and preconditioner of PETSc.

    A process multiplies by the matrix of its own elements and adds up what comes out; the
    preconditioner has the sum of these matrices, with the rows of a process on that process.

    Parameters
    ----------
    pattern, discrete
        The blocks and the discrete problem that they come from.
    options
        PETSc's option string.
    """

    def __init__(self, pattern: FullPattern, discrete: DiscreteProblem, options: str) -> None:
        self._N, self._processes = discrete.problem.N, discrete.points.processes
        self._comm = petsc.COMM_SELF
        if self._processes.size > 1:
            self._comm = self._processes.comm
        self._starts, self._columns, self._places = _scalar_rows(pattern, self._N)
        self._size = len(self._starts) - 1
        self._values, self._entries = (np.zeros(len(self._columns)) for _ in range(2))
        self._matrix, self._pinned = self._wrapped(self._values), self._wrapped(self._entries)
        self._pc, self._prefix = None, f"ngepc{next(_numbers)}_"
        self._levels = "-pc_type" not in options.split()
        usual, own = (
            MULTIGRID + (SHARED if self._processes.size > 1 else ALONE),
            self._processes.own,
        )
        self._set(usual + options if self._levels else options)
        self._graph = pattern.graph(~discrete.supports.free.any(axis=1))[own][:, own]
        self._modes = self._orthonormal(low_energy_modes(discrete))
        self._pair = tuple(petsc.Vec().createSeq(self._size, bsize=self._N) for _ in range(2))

    def _wrapped(self, values: np.ndarray) -> object:
        rows = (self._starts, self._columns, values)
        matrix = petsc.Mat().createAIJWithArrays(self._size, rows, comm=petsc.COMM_SELF)
        matrix.setBlockSize(self._N)
        return matrix

    def _set(self, options: str) -> None:
        """PETSc's data base with these options under the preconditioner's own prefix."""
        base = petsc.Options(self._prefix)
        words = options.split()
        for word, following in zip(words, [*words[1:], "-"], strict=True):
            if is_name(word):
                base[word.lstrip("-")] = None if is_name(following) else following

    def take(self, values: np.ndarray) -> None:
        """The matrix for multiplication."""
        self._values[self._places] = values.ravel()
        self._matrix.stateIncrease()

    def build(self, values: np.ndarray) -> None:
        """A new preconditioner; multigrid keeps its coarse spaces."""
        self._entries[self._places] = values.ravel()
        self._pinned.assemble()
        if self._pc is None or not self._levels:
            self._create(self._summed(self._pinned))
        elif self._processes.size > 1:
            matrix = self._pc.getOperators()[1]  # coarse products know this object; patterns differ
            self._summed(self._pinned).copy(matrix, petsc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        self._pc.setUp()

    def _create(self, matrix: object) -> None:
        if self._pc is not None:
            self._pc.destroy()  # one that is set up again keeps parts of its old hierarchy
        self._pc, self._sides = petsc.PC().create(self._comm), matrix.createVecs()
        self._pc.setOptionsPrefix(self._prefix)
        self._pc.setOperators(matrix, matrix)
        self._pc.setFromOptions()
        if self._levels:
            given = self._modes.T, self._graph, self._processes
            self._coarsen(interpolations(self._summed(self._matrix), *given))
        else:
            kind = {"bsize": self._N, "comm": self._comm}
            vectors = [petsc.Vec().createWithArray(mode, **kind) for mode in self._modes]
            space = petsc.NullSpace().create(vectors=vectors, comm=self._comm)
            matrix.setNearNullSpace(space)

    def _coarsen(self, spaces: list[object]) -> None:
        """Give multigrid its levels; a body that is small enough is solved directly."""
        if not spaces:
            self._pc.setType("redundant")
            return
        self._pc.setMGLevels(len(spaces) + 1)
        for level, space in enumerate(reversed(spaces), start=1):
            self._pc.setMGInterpolation(level, space)
        self._pc.setFromOptions()

    def multiply(self, x: np.ndarray) -> np.ndarray:
        """The matrix times x."""
        return self._processes.summed(
            _applied(self._matrix.mult, self._pair, self._nodal(x))
        ).ravel()

    def precondition(self, r: np.ndarray) -> np.ndarray:
        """The preconditioner times r."""
        z, own = np.empty((len(r) // self._N, self._N)), self._processes.own
        z[own] = _applied(self._pc.apply, self._sides, self._nodal(r)[own])
        return self._processes.spread(z).ravel()

    def _nodal(self, x: np.ndarray) -> np.ndarray:
        return x.reshape(-1, self._N)

    def _summed(self, matrix: object) -> object:
        """The sum of the matrices of all processes, by global numbers."""
        processes, N = self._processes, self._N
        if processes.size == 1:
            return matrix
        numbers = processes.numbers.astype(petsc.IntType)
        places = petsc.LGMap().create(numbers, bsize=N, comm=self._comm)
        size = (N * len(processes.own), N * processes.count)
        parts = petsc.Mat().createIS((size, size), lgmapr=places, lgmapc=places, comm=self._comm)
        parts.setISLocalMat(matrix)
        parts.assemble()
        total = parts.convert("aij", petsc.Mat())
        total.setBlockSize(N)
        return total

    def _orthonormal(self, modes: np.ndarray) -> np.ndarray:
        """The own entries of an orthonormal basis of the modes, one mode in each row."""
        N, k = self._N, modes.shape[1]
        own = modes.reshape(-1, N, k)[self._processes.own].reshape(-1, k)
        R = np.vstack(self._processes.all(np.linalg.qr(own, mode="r")))
        return np.ascontiguousarray(np.linalg.solve(np.linalg.qr(R, mode="r").T, own.T))


def _applied(operator: object, vectors: tuple, x: np.ndarray) -> np.ndarray:
    """A linear operator of PETSc, with a vector for each side, applied to a nodal array."""
    left, right = vectors
    left.getArray()[:] = x.ravel()
    operator(left, right)
    return right.getArray().reshape(x.shape).copy()


def is_name(word: str) -> bool:
    """Whether a word of an option string is a name, not a value: -pc_type, but not -1e-3."""
    return word.startswith("-") and not word[1:2].isdigit() and word[1:2] != "."


def _scalar_rows(pattern: FullPattern, N: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """CSR of the scalar matrix: starts, columns, and the place there of each entry of a block."""
    counts = np.diff(pattern.starts)
    starts = np.zeros(N * len(counts) + 1, dtype=np.int32)
    np.cumsum(np.repeat(N * counts, N), out=starts[1:])
    within = np.arange(len(pattern.rows), dtype=np.int32) - pattern.starts[pattern.rows]
    first = starts[N * pattern.rows] + N * within
    along = np.arange(N, dtype=np.int32)
    step = (N * counts[pattern.rows]).astype(np.int32)
    places = first[:, None, None] + step[:, None, None] * along[:, None] + along
    columns = np.empty(starts[-1], dtype=np.int32)
    columns[places] = (N * pattern.columns)[:, None, None] + along
    return starts, columns, places.ravel()
