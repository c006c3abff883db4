"""``semismooth_newton``, the door to the exact method and to the paper's, and its options."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, overload

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.kinds import require_function, require_instance
from ngepc.dual.algorithm import NewtonSystem, algorithm_7_1
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.dual.stopping import Tolerances
from ngepc.linalg.direct import require_solver
from ngepc.linalg.linesearch import Armijo, LineSearch
from ngepc.local.iterative import Iterative
from ngepc.local.result import ExactResult
from ngepc.local.solver import SymbolicForms, solve_exactly
from ngepc.model.own import own_copy
from ngepc.model.problem import Problem
from ngepc.results.outcome import Monitor


@dataclass(frozen=True, kw_only=True)
class NewtonOptions(Declared):
    """How Newton's method is run; what is marked (D_gamma) is for regularised problems alone.

    Parameters
    ----------
    tolerance
        Bound for the relative forces out of balance; (D_gamma): for ||Psi_gamma||_{H*} in the
        regularisation's reference units, 1e-10 in the paper.
    max_iterations
        Most Newton steps.
    quadrature_points
        (D_gamma) Points for nonsmooth terms on each element that a kink crosses; 400 in the paper.
    linesearch
        (D_gamma) ``Armijo()``, or None for full steps.
    inverse
        NGSolve's name of a direct solver that does LDL^T, or, without gamma, ``PETSc()`` or
        ``PyAMG()`` for large bodies, ``SymbolicForms()`` for tangents by NGSolve's form.

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    tolerance: Annotated[float, Check(require_number, least=1e-16)] = 1e-10
    max_iterations: Count = 300
    quadrature_points: Annotated[int, Check(require_integer, least=1, most=900)] = 400
    linesearch: LineSearch | None = field(default_factory=Armijo)
    inverse: Annotated[str | Iterative | SymbolicForms, Check(require_solver)] = (
        "sparsecholesky"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.linesearch is not None and not hasattr(self.linesearch, "search"):
            raise TypeError(
                f"linesearch={self.linesearch!r}: Armijo(...) or None is needed"
            )


@overload
def semismooth_newton(
    problem: Problem,
    gamma: None = None,
    start: object | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: None = None,
) -> ExactResult: ...


@overload
def semismooth_newton(
    problem: Problem,
    gamma: float | None = None,
    start: DualResult | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: Coupled | None = None,
) -> DualResult: ...


def semismooth_newton(
    problem: Problem,
    gamma: float | None = None,
    start: object | None = None,
    options: NewtonOptions | None = None,
    monitor: Monitor | None = None,
    *,
    regularisation: Coupled | None = None,
) -> ExactResult | DualResult:
    """Solve one time step: the discrete problem itself, or its regularisation (D_gamma).

    With neither ``gamma`` nor ``regularisation`` nothing is regularised: J(u, p) of (2.14) is
    minimised over the discrete displacements with N u <= gaps by a primal-dual Newton method,
    ``ngepc.local``.  With one of them Algorithm 7.1 solves the paper's (D_gamma).

    Parameters
    ----------
    problem
        The data.
    gamma
        Short for ``regularisation=Coupled(gamma)``.
    start
        An earlier result (exact: or a displacement) on this or another mesh of the body; None
        starts from zero.
    options
        Tolerance, limits and solver; None for the defaults.
    monitor
        Called with the record of each iterate, start included; raising StopIteration stops.
    regularisation
        The regularisation; give this or ``gamma``.

    Returns
    -------
    ExactResult or DualResult
        Status, history and fields; the state reached is always there.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("problem", problem, Problem, "a Problem")
    options = NewtonOptions() if options is None else options
    require_instance("options", options, NewtonOptions, "NewtonOptions(...)")
    require_function("monitor", monitor, "a record", optional=True)
    if gamma is not None and regularisation is not None:
        raise ValueError(f"gamma={gamma!r}: give either gamma or regularisation")
    if gamma is None and regularisation is None:
        tolerance = options.tolerance
        limit = options.max_iterations
        own = own_copy(problem)
        return solve_exactly(own, start, tolerance, limit, options.inverse, monitor)
    if not isinstance(options.inverse, str):
        raise ValueError(
            f"inverse={options.inverse!r}: a direct solver is needed with gamma"
        )
    regularisation = Coupled(gamma) if regularisation is None else regularisation
    require_instance("regularisation", regularisation, Coupled, "Coupled(...)")
    kinds = (DualResult, type(None))
    require_instance("start", start, kinds, "a result of semismooth_newton or None")
    functional = prepared(own_copy(problem), regularisation, options)
    aim = Tolerances(options.tolerance * functional.blocks.residual_unit)
    system = NewtonSystem(functional.blocks, options.inverse)
    v = functional.blocks.H_vector()
    v = v if start is None else functional.carried(start.functional, start.v)
    how = aim, options.linesearch, options.max_iterations, monitor
    return algorithm_7_1(system, functional, v, *how)


def prepared(
    problem: Problem, regularisation: Coupled, options: NewtonOptions
) -> DualFunctional:
    """J*_gamma of a regularised problem with its matrices assembled."""
    blocks = LinearBlocks(problem, regularisation, options.inverse)
    gammas = regularisation.gamma, regularisation.gamma_tichonov
    return DualFunctional(blocks, options.quadrature_points, *gammas)
