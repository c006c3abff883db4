"""Regularisation and mesh chosen together, from measured errors.

The user asks for an accuracy of the energy and names neither gamma nor a mesh width.  Each mesh is
solved with the gamma that ``Balanced`` derives from stiffness and mesh width.  Two parts of the
error of V are estimated from what was computed:

* Regularisation: by ``regularisation_error``, from the factors of the last Newton step.  If the
  part is too large beside the other one, gamma_T grows on the same mesh by what the power of the
  error asks for; the same factors predict the start.
* Discretisation.  If energies converge like h^r, the error on the finer of two meshes is
  |V_h - V_2h| / (2^r - 1), without their regularisation parts.  RATE = 0.8 is assumed: corners
  and the edge of the contact zone leave P1 elements rates of 0.8 to 1.  Bisecting every element
  halves h after N levels, so that V is compared with the one N levels before.
"""

from __future__ import annotations

import logging
import math
from dataclasses import asdict, dataclass, replace

from ngsolve import Mesh

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.distributed import require_one_process
from ngepc.checks.kinds import require_instance
from ngepc.dual.balanced import Balanced
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.contact_newton import newton_system
from ngepc.dual.functional import DualFunctional
from ngepc.dual.newton import NewtonOptions, checked_options, run, start_vector
from ngepc.dual.regularisation_error import regularisation_part
from ngepc.dual.result import DualResult
from ngepc.model.problem import Problem
from ngepc.path.chord import Chord
from ngepc.results.outcome import Ending, Status

logger = logging.getLogger(__name__)

REGULARISATION_PART = 0.2
"""Largest regularisation part beside the discretisation part, or beside the tolerance."""

SMALLEST_FACTOR, LARGEST_FACTOR = 10.0, 1e4
"""By what gamma_T grows on a mesh at once."""

RATE = 0.8
"""Power of h with which the discretisation error of V is assumed to fall."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One mesh of an automatic run.

    Parameters
    ----------
    nodes
        Vertices of the mesh.
    gamma_tichonov
        gamma_T of the last solve on it (stress / length^2).
    iterations
        Newton steps on this mesh, over all gamma.
    energy
        V = J*_gamma (force times length).
    regularisation, discretisation
        Estimated parts of the error of V; the second is infinite while there is no coarser mesh
        to compare with.
    """

    nodes: int
    gamma_tichonov: float
    iterations: int
    energy: float
    regularisation: float
    discretisation: float

    @property
    def limit(self) -> float:
        """V without its regularisation part: the estimate for large gamma_T on this mesh."""
        return self.energy - self.regularisation

    @property
    def relative_error(self) -> float:
        """Both parts over |V|."""
        return self.relative(self.regularisation + self.discretisation)

    def relative(self, part: float) -> float:
        """A part over |V|; infinite where V = 0 and the part is not."""
        if part == 0:
            return 0.0
        return part / abs(self.energy) if self.energy else math.inf

    def as_row(self) -> dict:
        """Numbers by name, for tables and JSON."""
        return {**asdict(self), "relative_error": self.relative_error}


@dataclass(frozen=True, eq=False, kw_only=True)
class AutomaticResult(Ending):
    """What ``solve_automatically`` returns.

    Parameters
    ----------
    status, message
        CONVERGED if the estimated error of the energy meets the tolerance; what was seen if not.
    levels
        One record for each mesh, coarse meshes first.
    result
        The solution on the finest mesh, with all its fields; ``result.problem.mesh`` is that mesh.
    """

    status: Status
    message: str
    levels: tuple[Level, ...]
    result: DualResult

    @property
    def iterations(self) -> int:
        """Newton steps on all meshes."""
        return sum(level.iterations for level in self.levels)


def solve_automatically(
    problem: Problem,
    tolerance: float = 0.01,
    max_nodes: int = 30_000,
    options: NewtonOptions | None = None,
) -> AutomaticResult:
    """Solve on bisected meshes until the energy is known to a relative tolerance.

    Parameters
    ----------
    problem
        The problem on a mesh of triangles or tetrahedra to begin with, which is not changed.  Its
        coefficients must make sense on finer meshes: no grid functions.
    tolerance
        Relative error of the energy V, in (0, 1).
    max_nodes
        Most vertices of a mesh.
    options
        Newton options; the tolerance refers to the units of ``Balanced.resolved``.

    Returns
    -------
    AutomaticResult
        Status, levels and the last solution.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_one_process("problem", problem.mesh, "semismooth_newton takes such a mesh")
    if require_number("tolerance", tolerance, 0, strict=True) >= 1:
        raise ValueError(f"tolerance={tolerance!r}: a number in (0, 1) is needed")
    require_integer("max_nodes", max_nodes, 1)
    options = checked_options(options)
    levels: list[Level] = []
    result = None
    while True:
        try:
            result, level = _solve_level(problem, result, levels, tolerance, options)
        except KeyboardInterrupt:
            if result is None:
                raise  # there is no result yet
            status = Status.STOPPED
            break
        levels.append(level)
        logger.info("nodes:%d relative error:%.2e", level.nodes, level.relative_error)
        status = result.status
        if status is not Status.CONVERGED or level.relative_error <= tolerance:
            break
        finer = bisected(problem.mesh)
        if finer.nv > max_nodes:
            status = Status.ITERATION_LIMIT
            break
        problem = replace(problem, mesh=finer)
    return AutomaticResult(
        status=status,
        message=_describe(status, result, levels, tolerance, max_nodes),
        levels=tuple(levels),
        result=result,
    )


def bisected(mesh: Mesh) -> Mesh:
    """A copy of ``mesh`` in which every element is bisected."""
    finer = Mesh(mesh.ngmesh.Copy())
    finer.Refine(onlyonce=True)
    return finer


class _OnMesh:
    """The problem on one mesh: its matrices, and the results for one gamma at a time."""

    def __init__(self, problem: Problem, options: NewtonOptions) -> None:
        self.options, self.regularisation = options, Balanced().resolved(problem)
        self._blocks = LinearBlocks(problem, self.regularisation, options.inverse)
        self._functional = self._with(self.regularisation)
        self.system = newton_system(self._functional, options.inverse)

    def _with(self, regularisation: Balanced) -> DualFunctional:
        return DualFunctional(self._blocks, regularisation, self.options.quadrature_points)

    def solve(self, start: DualResult | None) -> DualResult:
        """The result for the gamma of the mesh."""
        v = start_vector(self._functional, start, self.options)
        return run(self._functional, self.system, v, self.options)

    def sharpen(self, result: DualResult, factor: float) -> DualResult:
        """The result for a gamma larger by ``factor``, predicted by the factors at hand."""
        self.regularisation = replace(self.regularisation, gamma=factor * self.regularisation.gamma)
        functional = self._with(self.regularisation)
        v = Chord().start(self.system, functional, result.v)
        self.system = newton_system(functional, self.options.inverse)
        return run(functional, self.system, v, self.options)


def _solve_level(
    problem: Problem,
    start: DualResult | None,
    levels: list[Level],
    tolerance: float,
    options: NewtonOptions,
) -> tuple[DualResult, Level]:
    """The solution on one mesh, with gamma raised until its error counts little."""
    mesh = _OnMesh(problem, options)
    result, iterations = mesh.solve(start), 0
    while True:
        iterations += result.iterations
        part, power = regularisation_part(result, mesh.system)
        level = Level(
            nodes=problem.mesh.nv,
            gamma_tichonov=mesh.regularisation.gamma_tichonov,
            iterations=iterations,
            energy=result.dual_energy,
            regularisation=part,
            discretisation=math.inf,
        )
        level = replace(level, discretisation=_discretisation_part(level.limit, levels, problem.N))
        allowed = REGULARISATION_PART * max(level.discretisation, tolerance * abs(level.energy))
        if part <= allowed or result.status is not Status.CONVERGED:
            return result, level
        result = mesh.sharpen(result, _factor(part / allowed if allowed else math.inf, power))


def _factor(excess: float, power: float) -> float:
    """The factor for gamma that takes the part from ``excess`` times the allowed one to half."""
    return min(max((2 * excess) ** (1 / power), SMALLEST_FACTOR), LARGEST_FACTOR)


def _discretisation_part(limit: float, levels: list[Level], N: int) -> float:
    if len(levels) < N:
        return math.inf
    return abs(limit - levels[-N].limit) / (2**RATE - 1)


def _describe(
    status: Status,
    result: DualResult,
    levels: list[Level],
    tolerance: float,
    max_nodes: int,
) -> str:
    if status is Status.CONVERGED:
        return ""
    if result.status is not Status.CONVERGED:
        return result.message
    last = levels[-1]
    if status is Status.STOPPED:
        return f"The result is that on {last.nodes} nodes."
    return (
        f"On {last.nodes} nodes the estimated relative error is {last.relative_error:.2g} "
        f"(regularisation {last.relative(last.regularisation):.2g}, discretisation "
        f"{last.relative(last.discretisation):.2g}), the tolerance {tolerance:g}; the next "
        f"mesh has more than max_nodes={max_nodes} nodes."
    )
