"""PETSc does the linear algebra of large bodies: ``NewtonOptions(inverse=PETSc())``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import count

import numpy as np

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_text
from ngepc.local.iterative import FullPattern, IterativeTangent
from ngepc.local.system import DiscreteProblem

try:
    from petsc4py import PETSc as petsc
except ImportError:  # said when PETSc() is made
    petsc = None

INSTALL = (
    "PETSc() needs petsc4py: 'conda install -c conda-forge petsc4py', or on Debian and Ubuntu "
    "'apt install python3-petsc4py' with PETSC_DIR=$(echo /usr/lib/petscdir/petsc3*/*-real)"
)

GAMG = (
    "-pc_type gamg -pc_gamg_threshold 0.0 "
    "-pc_gamg_square_graph 10 -pc_gamg_aggressive_coarsening 10"  # before and since PETSc 3.19
)
"""Smoothed aggregation that coarsens fast on all levels: a third of the time to set up."""

_numbers = count()


@dataclass(frozen=True, kw_only=True)
class PETSc:
    """Conjugate gradients with a preconditioner of PETSc, multigrid by default.

    Parameters
    ----------
    options
        PETSc's own option string for the preconditioner, for instance "-pc_type hypre".
    forcing
        Relative residual at which the solves of the first Newton steps end.
    patience
        Iterations of a solve beyond which the next one makes a new hierarchy.
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
    patience: int = 20
    max_iterations: int = 500

    def __post_init__(self) -> None:
        if petsc is None:
            raise ImportError(INSTALL)
        require_text("options", self.options)
        require_number("forcing", self.forcing, 1e-12)
        require_integer("patience", self.patience, 1)
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
        self._values = np.zeros(len(self._columns))
        self._matrix = self._wrapped(self._values)
        self._pc, self._kept, self._prefix = None, None, f"ngepc{next(_numbers)}_"
        self._set(f"{GAMG} {options}")
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

    def build(self, values: np.ndarray, modes: np.ndarray) -> None:
        """A new preconditioner."""
        if self._pc is not None:
            self._pc.destroy()  # one that is set up again keeps parts of its old hierarchy
            self._kept = None
        entries = np.empty_like(self._values)
        entries[self._places] = values.ravel()
        matrix, columns = self._summed(self._wrapped(entries)), self._orthonormal(modes)
        vectors = [petsc.Vec().createWithArray(c, bsize=self._N, comm=self._comm) for c in columns]
        matrix.setNearNullSpace(petsc.NullSpace().create(vectors=vectors, comm=self._comm))
        self._pc, self._kept = petsc.PC().create(self._comm), (entries, columns)
        self._sides = matrix.createVecs()
        self._pc.setOptionsPrefix(self._prefix)
        self._pc.setOperators(matrix, matrix)
        self._pc.setFromOptions()
        self._pc.setUp()

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
        return np.linalg.solve(np.linalg.qr(R, mode="r").T, own.T)


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
