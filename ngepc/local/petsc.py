"""PETSc as the linear solver of large bodies: ``NewtonOptions(inverse=PETSc())``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from zlib import crc32

import numpy as np
from scipy.sparse import csr_matrix, eye

from ngepc.checks.declared import Text
from ngepc.discretisation.body import DiscreteBody
from ngepc.discretisation.stiffness import Stiffness
from ngepc.linalg.aggregation import COARSEST, DAMPING, aggregates, incidence, tentative
from ngepc.linalg.cycle import v_cycle
from ngepc.linalg.descent import Linear
from ngepc.local.iterative import (
    FullPattern,
    FullStorage,
    Iterative,
    Preconditioner,
    Storage,
    low_energy_modes,
)
from ngepc.local.lower import LowerStorage
from ngepc.model.processes import Team

try:
    from petsc4py import PETSc as petsc
except ImportError:  # said when PETSc() is made
    petsc = None

INSTALL = (
    "PETSc() needs petsc4py: 'conda install -c conda-forge petsc4py', or on Debian and Ubuntu "
    "'apt install python3-petsc4py' with PETSC_DIR=$(echo /usr/lib/petscdir/petsc3*/*-real)"
)

MULTIGRID = "-pc_type mg -pc_mg_galerkin pmat -mg_levels_pc_type sor "
"""Levels of smoothed aggregation, smoothed by Gauss-Seidel."""

ALONE = (
    "-mg_levels_ksp_type richardson -mg_levels_ksp_max_it 2 -mg_levels_pc_sor_forward "
    "-pc_mg_distinct_smoothup -mg_levels_up_pc_type sor -mg_levels_up_pc_sor_backward "
    "-mg_levels_up_ksp_type richardson -mg_levels_up_ksp_max_it 2 "
    "-mg_coarse_pc_type cholesky "
)
"""Two sweeps forwards, and two backwards after the coarse correction, the adjoint of these."""

SHARED = (
    "-mg_levels_ksp_type chebyshev -mg_levels_ksp_max_it 2 "
    "-mg_levels_ksp_chebyshev_eigenvalues {0:g},{1:g} -mg_coarse_pc_type redundant "
)
"""Symmetric sweeps under Chebyshev's polynomial: those at the same time may amplify errors.

Eigenvalues of the matrix times the inverse of symmetric Gauss-Seidel are at most 1 on one process,
on several at most the number of colours that tell neighbours apart, and that of processes.
"""

REACH = 2.0
"""Assumed largest eigenvalue of the smoother on several processes, enough for up to 8."""


FORCING_SHARED = 1e-3
"""The usual ``forcing`` with order two.

With 3e-3 the number of Newton steps depends on how processes share the body.
"""


def shared_options(processes: int) -> str:
    """The rest of the options where some processes share a body."""
    largest = min(float(processes), REACH)
    return SHARED.format(0.1 * largest, largest)


@dataclass(frozen=True, kw_only=True)
class PETSc(Iterative):
    """Conjugate gradients with a preconditioner of PETSc, multigrid by default.

    With displacements of order two the multigrid of PETSc is for the linear functions, below a
    level of all nodes that is smoothed by Chebyshev's polynomial.

    Parameters
    ----------
    options
        PETSc's own option string for the preconditioner: added to ``MULTIGRID``, or in its place
        if it says "-pc_type", for instance "-pc_type hypre".
    forcing
        Relative residual at which the solves of the first Newton steps end; None for 3e-3, and
        1e-3 with displacements of order two.
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

    def forcing_of(self, order: int) -> float:
        """See ``Iterative``."""
        if order == 2 and self.forcing is None:
            return FORCING_SHARED
        return super().forcing_of(order)

    @property
    def _has_levels(self) -> bool:
        """Whether it is multigrid."""
        return "-pc_type" not in self.options.split()

    def storage(self, stiffness: Stiffness) -> Storage:
        """Matrices of both triangles; of order two, for multigrid, half of the blocks."""
        smoothed = self._has_levels and stiffness.order == 2
        return LowerStorage(stiffness) if smoothed else super().storage(stiffness)

    def preconditioner(
        self, storage: FullStorage | LowerStorage, body: DiscreteBody
    ) -> Preconditioner:
        """A preconditioner of PETSc that is set up anew for each matrix."""
        if isinstance(storage, LowerStorage):
            return FromVertices(storage, body, self.options)
        processes = body.contact.processes
        given = storage.pattern, low_energy_modes(body), processes
        return PETScPreconditioner(*given, self.options)


class FromVertices:
    """A cycle for displacements of order two, above PETSc's one for the linear functions.

    The finest level is smoothed by products, which do not depend on how processes share the body.
    """

    def __init__(self, storage: LowerStorage, body: DiscreteBody, options: str) -> None:
        problem = body.problem
        vertices = problem.mesh.nv
        self._processes = body.contact.processes
        self._linear = storage.leading(vertices)
        modes = low_energy_modes(body)[: problem.N * vertices]
        given = self._linear.pattern, modes, problem.processes
        self._coarse = PETScPreconditioner(*given, options)
        self._space = eye(body.free.size, len(modes), format="csr")

    def coarsen(self, matrix: LowerStorage) -> None:
        """See ``Preconditioner``."""
        self._coarse.coarsen(self._linear.matrix())

    def update(self, pinned: LowerStorage) -> Linear:
        """See ``Preconditioner``."""
        coarse = self._coarse.update(self._linear.matrix())
        restriction = self._space.T.tocsr()
        level = pinned.level(self._space, restriction, self._processes)
        return partial(v_cycle, [level], coarse)


class PETScPreconditioner:
    """A preconditioner of PETSc for the sum of the matrices of all processes.

    The rows of a process are on that process; multigrid keeps its coarse spaces.
    """

    def __init__(
        self, pattern: FullPattern, modes: np.ndarray, processes: Team, options: str
    ) -> None:
        self._N = len(modes) // pattern.blocks.shape[0]
        self._processes = processes
        self._shared = self._processes.size > 1
        self._comm = self._processes.comm if self._shared else petsc.COMM_SELF
        # shared objects are destroyed by all processes together
        petsc.garbage_cleanup(self._comm)
        self._matrix = self._total(pattern) if self._shared else None
        self._levels = "-pc_type" not in options.split()
        self._pc: object | None = None
        self._spaces: list[object] | None = None
        size = self._processes.size
        rest = shared_options(size) if self._shared else ALONE
        usual = MULTIGRID + rest
        self._options = usual + options if self._levels else options
        own = self._processes.own
        self._graph = pattern.graph[own][:, own]
        self._modes = self._orthonormal(modes)

    def coarsen(self, matrix: csr_matrix) -> None:
        """See ``Preconditioner``."""
        if not self._levels:
            return
        whole = self._filled(matrix)
        given = whole, self._modes.T, self._graph, self._processes
        self._spaces = interpolations(*given)
        if whole is not self._matrix:
            whole.destroy()

    def update(self, pinned: csr_matrix) -> Linear:
        """See ``Preconditioner``."""
        if self._matrix is None:
            self._matrix = self._filled(pinned)
        elif self._shared:
            self._filled(pinned)
        self._matrix.assemble()  # the values of ``pinned`` have changed in place
        if self._pc is None or not self._levels:
            self._create()
        self._pc.setUp()
        return self._precondition

    def _total(self, pattern: FullPattern) -> object:
        """An empty matrix with the pattern of the sum over the processes, by global numbers."""
        processes = self._processes
        N = self._N
        numbers = processes.numbers.astype(petsc.IntType)
        places = petsc.LGMap().create(numbers, bsize=N, comm=self._comm)
        own = processes.owned(slice(None))
        near, far = (pattern.blocks @ chosen.astype(np.int32) for chosen in (own, ~own))
        # an upper bound: other processes may have the same entries
        theirs = processes.summed(near + far) - near - far
        counts = [np.repeat(N * (n + theirs)[own], N) for n in (near, far)]
        size = (N * len(processes.own), N * processes.node_count)
        matrix = petsc.Mat().create(self._comm)
        matrix.setSizes((size, size), bsize=N)
        matrix.setType("aij")
        matrix.setLGMap(places, places)
        matrix.setPreallocationNNZ(counts)
        return matrix

    def _filled(self, matrix: csr_matrix) -> object:
        """The sum of these matrices over the processes; alone one that shares their arrays."""
        rows = matrix.indptr, matrix.indices
        if self._shared:
            self._matrix.zeroEntries()
            self._matrix.setValuesLocalIJV(*rows, matrix.data, addv=True)
            self._matrix.assemble()
            return self._matrix
        arrays = *rows, matrix.data
        whole = petsc.Mat().createAIJWithArrays(
            len(rows[0]) - 1, arrays, comm=self._comm
        )
        whole.setBlockSize(self._N)
        whole.assemble()
        return whole

    def _create(self) -> None:
        if self._pc is not None:
            self._pc.destroy()  # set up again, it would keep parts of the old hierarchy
        prefix = f"ngepc{crc32(self._options.encode()):x}_"
        known = petsc.Options()
        known.prefixPush(prefix)  # PETSc's data base holds at most 512 options
        known.insertString(self._options)
        known.prefixPop()
        self._pc = petsc.PC().create(self._comm)
        self._sides = self._matrix.createVecs()
        self._pc.setOptionsPrefix(prefix)
        self._pc.setOperators(self._matrix, self._matrix)
        self._pc.setFromOptions()
        if not self._levels:
            kind = {"bsize": self._N, "comm": self._comm}
            vectors = [
                petsc.Vec().createWithArray(mode, **kind) for mode in self._modes
            ]
            space = petsc.NullSpace().create(vectors=vectors, comm=self._comm)
            self._matrix.setNearNullSpace(space)
        elif not self._spaces:  # small enough to be solved directly
            self._pc.setType("redundant")
        else:
            self._pc.setMGLevels(len(self._spaces) + 1)
            for level, space in enumerate(reversed(self._spaces), start=1):
                self._pc.setMGInterpolation(level, space)
            self._pc.setFromOptions()

    def _precondition(self, r: np.ndarray) -> np.ndarray:
        """The preconditioner times r."""
        z = np.empty((len(r) // self._N, self._N))
        own = self._processes.own
        left, right = self._sides
        left.getArray()[:] = r.reshape(z.shape)[own].ravel()
        self._pc.apply(left, right)
        z[own] = right.getArray().reshape(-1, self._N)
        return self._processes.spread(z).ravel()

    def _orthonormal(self, modes: np.ndarray) -> np.ndarray:
        """The own entries of an orthonormal basis of the modes, one mode in each row."""
        N = self._N
        k = modes.shape[1]
        own = modes.reshape(-1, N, k)[self._processes.own].reshape(-1, k)
        R = np.vstack(self._processes.all(np.linalg.qr(own, mode="r")))
        return np.ascontiguousarray(np.linalg.solve(np.linalg.qr(R, mode="r").T, own.T))


def interpolations(
    matrix: object, modes: np.ndarray, graph: csr_matrix, processes: Team
) -> list[object]:
    """Interpolations from each level to the next finer one, the finest first.

    Smoothed aggregation, see ``linalg.aggregation``, with aggregates that end at the processes;
    ``modes`` (own unknowns, k) and ``graph`` are of the own nodes.
    """
    found = []
    spare = []
    node = np.arange(len(modes)) // (len(modes) // graph.shape[0])
    while matrix.size[0] > COARSEST:
        number = aggregates(graph)
        local, modes, coarse_node = tentative(number[node], modes)
        plain = spread(local, matrix, processes)
        members = incidence(number)
        if 2 * plain.size[1] > plain.size[0]:
            break
        image = matrix.matMult(plain)
        coarse = plain.transposeMatMult(image)
        smooth = jacobi_smoothed(matrix, plain, image)
        # without data that PETSc keeps for repeated products
        found.append(smooth.duplicate(copy=True))
        spare += [plain, image, coarse]
        matrix = coarse
        graph = members.T @ graph @ members
        node = coarse_node
    for used in spare:
        used.destroy()  # shared objects are destroyed by all processes together
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
