"""Regularisation and mesh chosen together, from measured errors.

The user asks for an accuracy of the energy and names neither gamma nor a mesh width.  Each mesh is
solved with the gamma that ``Balanced`` derives from stiffness and mesh width.  Two parts of the
error of V are estimated from what was computed:

* Regularisation.  V as a function of 1/gamma_T is concave with the derivative b(v, v) / 2.  The
  Tichonov term b(v, v) / (2 gamma_T) at gamma_T and at gamma_T / 10 shows the power s with which
  it decays; V - V_inf is then that term divided by s.  If the part is too large beside the other
  one, gamma_T grows by 100 on the same mesh.
* Discretisation.  If energies converge like h^r, the error on the finer of two meshes is
  |V_h - V_2h| / (2^r - 1).  RATE = 0.8 is assumed: corners and the edge of the contact zone leave
  P1 elements rates of 0.8 to 1.  Bisecting every element halves h after N levels, so that V is
  compared with the one N levels before.
"""

from __future__ import annotations

import logging
import math
from dataclasses import asdict, dataclass, replace

from ngsolve import Mesh

from ngepc.balanced import Balanced
from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_instance
from ngepc.dual_result import DualResult
from ngepc.newton import NewtonOptions, checked_options, semismooth_newton
from ngepc.problem import Problem
from ngepc.results import Ending, Status

logger = logging.getLogger(__name__)

REGULARISATION_PART = 0.2
"""Largest regularisation part beside the discretisation part, or beside the tolerance."""

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
    def relative_error(self) -> float:
        """Both parts over |V|."""
        return (self.regularisation + self.discretisation) / abs(self.energy)

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


def _solve_level(
    problem: Problem,
    start: DualResult | None,
    levels: list[Level],
    tolerance: float,
    options: NewtonOptions,
) -> tuple[DualResult, Level]:
    """The solution on one mesh, with gamma raised until its error counts little."""
    regularisation, iterations = Balanced().resolved(problem), 0
    while True:
        result = semismooth_newton(
            problem, start=start, options=options, regularisation=regularisation
        )
        iterations += result.iterations
        V = result.dual_energy
        part, more = regularisation_part(result, options)
        iterations += more
        discretisation = _discretisation_part(V, levels, problem.N)
        known = discretisation if math.isfinite(discretisation) else tolerance * abs(V)
        level = Level(
            nodes=problem.mesh.nv,
            gamma_tichonov=regularisation.gamma_tichonov,
            iterations=iterations,
            energy=V,
            regularisation=part,
            discretisation=discretisation,
        )
        enough = part <= REGULARISATION_PART * max(known, tolerance * abs(V))
        if enough or result.status is not Status.CONVERGED:
            return result, level
        regularisation, start = replace(regularisation, gamma=100 * regularisation.gamma), result


def regularisation_part(result: DualResult, options: NewtonOptions) -> tuple[float, int]:
    """The estimate of V - V_inf for a balanced result, and the Newton steps that it took.

    Parameters
    ----------
    result
        A result with ``Balanced``.
    options
        Newton options for the solve with gamma_T / 10.
    """
    if result.status is not Status.CONVERGED:
        return math.inf, 0
    f = result.functional
    less = replace(f.regularisation, gamma=f.regularisation.gamma / 10)
    smoother = semismooth_newton(result.problem, start=result, options=options, regularisation=less)
    smoother.or_interrupted()
    here, there = (r.functional.tichonov(r.v, r.v) / 2 for r in (result, smoother))
    if not 0 < here < there:
        return here, smoother.iterations
    power = min(1.0, max(0.1, math.log10(there / here)))
    return here / power, smoother.iterations


def _discretisation_part(V: float, levels: list[Level], N: int) -> float:
    if len(levels) < N:
        return math.inf
    return abs(V - levels[-N].energy) / (2**RATE - 1)


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
        f"(regularisation {last.regularisation / abs(last.energy):.2g}, discretisation "
        f"{last.discretisation / abs(last.energy):.2g}), the tolerance {tolerance:g}; the next "
        f"mesh has more than max_nodes={max_nodes} nodes."
    )
