"""PETSc does the linear algebra of large bodies: ``NewtonOptions(inverse=PETSc())``."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np
from scipy.sparse import csr_matrix, eye

from ngepc.checks.declared import Text
from ngepc.discretisation.balance import Frame
from ngepc.linalg.aggregation import COARSEST, DAMPING, aggregates, incidence, tentative
from ngepc.local.iterative import FullPattern, Iterative, low_energy_modes
from ngepc.model.processes import Team

try:
    from petsc4py import PETSc as petsc
except ImportError:  # said when PETSc() is made
    petsc = None

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


@dataclass(frozen=True, kw_only=True)
class PETSc(Iterative):
    """Conjugate gradients with a preconditioner of PETSc, multigrid by default.

    Parameters
    ----------
    options
        PETSc's own option string for the preconditioner: added to ``MULTIGRID``, or in its place
        if it says "-pc_type", for instance "-pc_type hypre".
    forcing
        Relative residual at which the solves of the first Newton steps end.
    max_iterations
        Iterations after which a solve gives up.

    Raises
    ------
    ImportError
        If petsc4py is missing.
    TypeError, ValueError
        If an option is out of its range.
    """

    options: Text = ""

    def __post_init__(self) -> None:
        if petsc is None:
            raise ImportError(INSTALL)
        super().__post_init__()

    def engine(self, pattern: FullPattern, frame: Frame) -> PETScEngine:
        """Matrix and preconditioner."""
        return PETScEngine(pattern, frame, self.options)


class PETScEngine:
    """Matrix and preconditioner of PETSc.

    A process multiplies by the matrix of its own elements and adds up what comes out; the
    preconditioner has the sum of these matrices, with the rows of a process on that process.
    """

    def __init__(self, pattern: FullPattern, frame: Frame, options: str) -> None:
        self._N, self._processes = frame.free.shape[1], frame.contact.processes
        self._shared, own = self._processes.size > 1, self._processes.own
        self._comm = self._processes.comm if self._shared else petsc.COMM_SELF
        petsc.garbage_cleanup(self._comm)  # Python frees shared objects only when all do
        self._rows, self._size = (pattern.starts, pattern.columns), len(pattern.starts) - 1
        self._values, self._matrix = self._wrapped()
        if self._shared:
            self._pinned = self._total(pattern)
        else:
            self._entries, self._pinned = self._wrapped()
        self._pc, self._levels = None, "-pc_type" not in options.split()
        usual = MULTIGRID + (SHARED if self._shared else ALONE)
        self._prefix = self._set(usual + options if self._levels else options)
        self._graph = pattern.graph(~frame.free.any(axis=1))[own][:, own]
        self._modes = self._orthonormal(low_energy_modes(frame))
        self._pair = tuple(petsc.Vec().createSeq(self._size, bsize=self._N) for _ in range(2))

    def _wrapped(self) -> tuple[np.ndarray, object]:
        """Values and a matrix of this process that has them."""
        values = np.zeros(len(self._rows[1]))
        rows = (*self._rows, values)
        matrix = petsc.Mat().createAIJWithArrays(self._size, rows, comm=petsc.COMM_SELF)
        matrix.setBlockSize(self._N)
        return values, matrix

    def _total(self, pattern: FullPattern) -> object:
        """Room for the sum of the matrices of all processes, by global numbers."""
        processes, N = self._processes, self._N
        numbers = processes.numbers.astype(petsc.IntType)
        places = petsc.LGMap().create(numbers, bsize=N, comm=self._comm)
        own = processes.owned(slice(None))
        near, far = (pattern.blocks @ chosen.astype(np.int32) for chosen in (own, ~own))
        theirs = processes.summed(near + far) - near - far  # at most: others may have the same ones
        counts = [np.repeat(N * (n + theirs)[own], N) for n in (near, far)]
        size = (N * len(processes.own), N * processes.count)
        matrix = petsc.Mat().create(self._comm)
        matrix.setSizes((size, size), bsize=N)
        matrix.setType("aij")
        matrix.setLGMap(places, places)
        matrix.setPreallocationNNZ(counts)
        return matrix

    def _fill(self, values: np.ndarray) -> None:
        """The preconditioner's matrix with the sum of these values of all processes."""
        if self._shared:
            self._pinned.zeroEntries()
            self._pinned.setValuesLocalIJV(*self._rows, values, addv=True)
        else:
            self._entries[:] = values
        self._pinned.assemble()

    def _set(self, options: str) -> str:
        """The prefix of these options in PETSc's data base, which has room for 512 in all."""
        words, prefix = options.split(), f"ngepc{crc32(options.encode()):x}_"
        base = petsc.Options(prefix)
        for word, following in zip(words, [*words[1:], "-"], strict=True):
            if is_name(word):
                base[word.lstrip("-")] = None if is_name(following) else following
        return prefix

    def take(self, values: np.ndarray) -> None:
        """The matrix for multiplication."""
        self._values[:] = values
        self._matrix.stateIncrease()

    def build(self, values: np.ndarray) -> None:
        """A new preconditioner; multigrid keeps its coarse spaces."""
        spaces = None
        if self._pc is None and self._levels:
            self._fill(self._values)
            spaces = interpolations(self._pinned, self._modes.T, self._graph, self._processes)
        self._fill(values)
        if self._pc is None or not self._levels:
            self._create(spaces)
        self._pc.setUp()

    def _create(self, spaces: list[object] | None) -> None:
        if self._pc is not None:
            self._pc.destroy()  # one that is set up again keeps parts of its old hierarchy
        self._pc, self._sides = petsc.PC().create(self._comm), self._pinned.createVecs()
        self._pc.setOptionsPrefix(self._prefix)
        self._pc.setOperators(self._pinned, self._pinned)
        self._pc.setFromOptions()
        if self._levels:
            self._coarsen(spaces)
        else:
            kind = {"bsize": self._N, "comm": self._comm}
            vectors = [petsc.Vec().createWithArray(mode, **kind) for mode in self._modes]
            space = petsc.NullSpace().create(vectors=vectors, comm=self._comm)
            self._pinned.setNearNullSpace(space)

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


def interpolations(
    matrix: object, modes: np.ndarray, graph: csr_matrix, processes: Team
) -> list[object]:
    """Interpolations from each level to the next finer one, the finest first.

    The loop of ``linalg.aggregation.coarse_spaces`` with a matrix of PETSc and aggregates that end
    at the processes; ``modes`` (own unknowns, k) and ``graph`` are of the own nodes.
    """
    found, spare, node = [], [], np.arange(len(modes)) // (len(modes) // graph.shape[0])
    linear = (modes != 0).any(axis=1)
    if processes.any(~linear):
        chosen = eye(len(modes), format="csr")[:, np.flatnonzero(linear)]
        found.append(spread(chosen, matrix, processes))
        matrix, modes, node = matrix.ptap(found[0]), modes[linear], node[linear]
        spare.append(matrix)
    while matrix.size[0] > COARSEST:
        number = aggregates(graph)
        local, modes, coarse_node = tentative(number[node], modes)
        plain, members = spread(local, matrix, processes), incidence(number)
        if 2 * plain.size[1] > plain.size[0]:
            break
        image = matrix.matMult(plain)
        coarse = plain.transposeMatMult(image)
        smooth = jacobi_smoothed(matrix, plain, image)
        found.append(smooth.duplicate(copy=True))  # without what products keep for the next one
        spare += [plain, image, coarse]
        matrix, graph, node = coarse, members.T @ graph @ members, coarse_node
    for used in spare:
        used.destroy()  # Python frees shared objects only when all processes do
    return found


def spread(local: csr_matrix, matrix: object, processes: Team) -> object:
    """The matrix of all processes from their own rows, whose columns follow each other."""
    rows, own = local.shape
    sizes = ((rows, None), (own, None))
    first = sum(processes.all(own)[: processes.rank])
    columns = (local.indices + first).astype(petsc.IntType)
    parts = (local.indptr.astype(petsc.IntType), columns, local.data)
    return petsc.Mat().createAIJ(sizes, csr=parts, comm=matrix.comm)


def jacobi_smoothed(matrix: object, plain: object, image: object) -> object:
    """One damped Jacobi step on the columns of ``plain``; ``image`` is the matrix times it."""
    scale = matrix.getDiagonal()
    scale.reciprocal()
    x, y = matrix.createVecs()
    x.setArray(np.random.default_rng(matrix.comm.rank).standard_normal(x.local_size))
    for _ in range(10):
        matrix.mult(x, y)
        y.pointwiseMult(y, scale)
        largest = y.norm()
        y.copy(x)
        x.scale(1 / largest)
    scale.scale(-DAMPING / largest)
    image.diagonalScale(L=scale)
    image.axpy(1.0, plain, petsc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    return image
