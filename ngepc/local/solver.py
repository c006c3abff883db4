"""Solve the discrete problem of one time step exactly, from zero or an earlier result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Annotated

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.declared import Check, Declared
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.discretisation.factors import Factors, tangent_of
from ngepc.discretisation.prolongation import at_vertices
from ngepc.discretisation.stiffness import Stiffness, by_moduli
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.linalg.direct import require_solver
from ngepc.linalg.secants import Compliance
from ngepc.local.active_set import InexactTarget
from ngepc.local.choice import DIRECT, fastest_solver, solver_name
from ngepc.local.iterative import Iterative, IterativeTangent
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.features import (
    BASIC_FEATURES,
    CONTACT_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    SUPPORT_FEATURES,
    require_covered,
)
from ngepc.model.own import OwnCopies
from ngepc.model.problem import Problem
from ngepc.results.iteration import ExactTarget, newton_iteration
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import History, Monitor, Status
from ngepc.results.result import DiscreteSolution

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | KINEMATICS_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | {"anisotropic yield", "cyclic hardening", "shared mesh"}
)
"""Features that the exact method covers."""


SOFT = 0.02
"""Hardening over 2 mu_2 below which a cold solve with order two may go by way of order one."""

FAR = 0.5
"""It does if this part of the load is out of balance after the elastic step."""

ROUGH = 1e-2
"""Tolerance of the solution of order one."""

UNSOLVED = (Status.NONFINITE, Status.LINESEARCH_FAILED, Status.STAGNATED)
"""How runs end that lost their way."""

NEARER = (1e-2, 1e-4, 1e-6)
NEARBY_STEPS = 20
"""Tolerances with stiffer springs, to find contact where springs hold a part loosely, and the most
steps to each."""

FEW_FORCES = 600
"""The most forces of contact rows whose compliance is computed for the elastic body."""

LARGE = 1.0
"""A solution of order one without hardening and with a larger |p| is no good start."""


@dataclass(frozen=True, kw_only=True)
class SymbolicForms(Declared):
    """A linear solver whose tangents are assembled by a form of NGSolve: equal, but slower.

    Parameters
    ----------
    inverse
        The solver, as in ``NewtonOptions``.

    Raises
    ------
    ValueError
        If there is no such solver.
    """

    inverse: Annotated[str | Iterative, Check(require_solver)] = "sparsecholesky"

    def tangent(
        self, discrete: DiscreteProblem, fast: Stiffness
    ) -> Factors | IterativeTangent:
        """The tangent of a discrete problem, in place of the ``fast`` one."""
        if not isinstance(discrete, DiscreteProblem):
            raise ValueError(
                f"inverse={in_words(self)}: primal_newton has symbolic forms of its own"
            )
        stiffness = by_moduli(discrete.points, discrete.free).with_added(discrete.added)
        return tangent_of(discrete, self.inverse, stiffness)


class RepeatedSolver:
    """Solves a sequence of similar problems by the exact method.

    Points, spaces, contact rows and the pattern of the tangent are kept as long as the data that
    determine them do not change.  Nothing is kept that a solution has taught: a history that
    continues from a file has the digits of one that was not interrupted.

    Parameters
    ----------
    options
        Tolerance, limit and linear solver; None for the defaults.  With ``inverse=None`` the linear
        solver is chosen for each body, and where multigrid gives up factors take its place.

    Raises
    ------
    TypeError
        If the options are not ``NewtonOptions``.
    """

    def __init__(self, options: NewtonOptions | None = None) -> None:
        options = NewtonOptions() if options is None else options
        require_instance("options", options, NewtonOptions, "NewtonOptions(...)")
        self.options = options
        self._chosen = options.inverse
        self._own = OwnCopies()
        self._discrete: DiscreteProblem | None = None
        self._tangent: Factors | IterativeTangent | None = None

    @one_blas_thread
    @crew()
    def __call__(
        self,
        problem: Problem,
        start: object | None = None,
        monitor: Monitor | None = None,
    ) -> ExactResult:
        """Solve a problem from an earlier result or displacement, or from zero.

        Raises
        ------
        TypeError, ValueError
            If an argument is not legal.
        """
        discrete = self.discretised(problem)
        state = starting_state(discrete, start)
        return self.solve_from(state, monitor, partial(self._compliance, discrete))

    def discretised(self, problem: Problem) -> DiscreteProblem:
        """The discrete problem, with data of the last one; errors as for a call.

        Data are as they are now: a ``Parameter`` or a GridFunction in them may have other values
        than in the last solve, and the mesh other points.
        """
        require_instance("problem", problem, Problem, "a Problem")
        require_covered(problem, "semismooth_newton", COVERS)
        own = self._own.of(problem)
        like = self._discrete
        if like is not None and like.problem.solved_on != own.solved_on:
            like = None
        return DiscreteProblem(own, like=like)

    def _fastest(self, discrete: DiscreteProblem) -> str | Iterative:
        """The linear solver for a body where the options name none."""
        return fastest_solver(discrete)

    def _compliance(self, discrete: DiscreteProblem) -> Compliance:
        """What the compliance of the contact rows is taken for at first.

        With friction on few rows it is that of the elastic body, which is computed once for a
        sequence of problems: where most of the body is elastic it halves the solves for the rows.
        It depends on the problem alone, not on the problems before.
        """
        with_friction = discrete.contact.friction.d > 0
        if with_friction and len(discrete.contact) <= FEW_FORCES:
            return discrete.elastic_compliance.copy()
        return discrete.compliance()

    def solve_from(
        self,
        state: State,
        monitor: Monitor | None = None,
        compliance: Callable[[], Compliance] | None = None,
        second: Callable[[State], State] | None = None,
    ) -> ExactResult:
        """Solve the problem of a state, from there.

        ``compliance`` gives a guess for that of the contact rows, which factors of tangents
        correct; ``second`` may replace the iterate after the first step.
        """
        before = self._discrete
        discrete = state.discrete
        tangent = self._tangent
        if tangent is None or discrete.stiffness is not before.stiffness:
            given = self.options.inverse
            self._chosen = self._fastest(discrete) if given is None else given
            tangent = tangent_of(discrete, self._chosen)
        self._discrete = discrete
        self._tangent = tangent if isinstance(tangent, Factors) else None
        iterative = isinstance(tangent, IterativeTangent)
        target = ExactTarget(discrete, compliance)
        if iterative:
            target = InexactTarget(discrete, tangent.forcing, self.options.tolerance)
        run = partial(
            newton_iteration,
            tangent=tangent,
            result=partial(ExactResult, linear_solver=solver_name(self._chosen)),
            tolerance=self.options.tolerance,
            max_iterations=self.options.max_iterations,
            monitor=monitor,
        )
        result = run(state, target=target, second=second)
        if misled_by_forces(state, result):
            result = run(discrete.state(state.u), target=target if iterative else None)
        elif misled_by_compliances(result):
            again = {"target": target if iterative else None, "history": result.history}
            result = run(result.state, **again)
        if result.status in UNSOLVED and discrete.loosely_held:
            result = self._from_contact(discrete, run)
        gave_up = iterative and result.status is Status.NONFINITE
        alone = discrete.problem.processes.size == 1
        if gave_up and alone and self.options.inverse is None:
            self._chosen = DIRECT
            self._tangent = tangent_of(discrete, DIRECT)
            made = partial(ExactResult, linear_solver=DIRECT)
            result = run(state, tangent=self._tangent, result=made)
        return result

    def _from_contact(
        self, body: DiscreteProblem, run: Callable[..., ExactResult]
    ) -> ExactResult:
        """What ``run`` finds from states near the solution where springs hold a part loosely.

        Stiffer springs, which resist the change of a step, keep the part near the obstacle until
        contact is found.
        """
        springs = body.added + body.loosely_held.springs
        stiffness = body.stiffness.with_added(springs.tocsr())
        held = {"tangent": tangent_of(body, self._chosen, stiffness), "monitor": None}
        state = body.state(body.starting_displacement(None))
        for tolerance in NEARER:
            nearer = {"tolerance": tolerance, "max_iterations": NEARBY_STEPS}
            state = run(state, **held, **nearer).state
            result = run(state)
            if result.status not in UNSOLVED:
                return result
        said = f"{result.ending} {body.loosely_held.sentence}"
        return replace(result, ending=said)


def misled_by_forces(start: State, result: ExactResult) -> bool:
    """Whether forces of another problem may have led nowhere, under friction: once more without."""
    if result.status is not Status.NONFINITE:
        return False
    return start.discrete.problem.processes.any(start.contact != 0)


def misled_by_compliances(result: ExactResult) -> bool:
    """Whether new compliances of the rows may lead to other forces, from where a run failed."""
    coulomb = not result.discrete.contact.friction.is_convex
    return coulomb and result.status is Status.LINESEARCH_FAILED


@one_blas_thread
@crew()
def solve_exactly(
    problem: Problem,
    start: object | None,
    tolerance: float,
    max_iterations: int,
    inverse: str | Iterative | SymbolicForms | None,
    monitor: Monitor | None,
) -> ExactResult:
    """Minimise J(u, p) of (2.14) over the discrete displacements with N u <= gaps.

    The same arguments as ``semismooth_newton`` and ``NewtonOptions``.  Without a ``start`` soft
    plane bodies with displacements of order two start from the solution of order one.
    """
    limits = {"tolerance": tolerance, "max_iterations": max_iterations}
    options = NewtonOptions(**limits, inverse=inverse)
    solver = RepeatedSolver(options)
    discrete = solver.discretised(problem)
    state = starting_state(discrete, start)
    compliance = cache(discrete.compliance)
    order_one = None
    if start is None and gains_by_order_one(discrete):
        order_one = OrderOne(options)
    result = solver.solve_from(state, monitor, compliance, order_one)
    if order_one is not None:
        result = replace(result, order_one=order_one.history)
    learned = compliance.cache_info().currsize > 0
    if learned and len(discrete.contact) <= FEW_FORCES:
        result = replace(result, compliance=compliance())
    return result


def gains_by_order_one(discrete: DiscreteProblem) -> bool:
    """Whether a cold solve with order two may take less time by way of order one.

    It does for plane bodies that soften much when they yield.  A history starts from its last step
    instead, and with friction the start could decide which of several equilibria is found.
    """
    problem = discrete.problem
    law = discrete.law
    plane = problem.N == 2 and problem.order == 2 and problem.processes.size == 1
    history = (
        problem.initial_plastic_strain,
        problem.initial_hardening,
        problem.initial_accumulated,
        problem.initial_displacement,
    )
    virgin = all(value is None for value in history)
    soft = float((law.least_hardening / law.two_mu).min()) < SOFT
    return plane and virgin and soft and problem.friction is None


class OrderOne:
    """Replaces the elastic iterate by a rough solution with displacements of order one.

    About half of the steps from an elastic solution only find the size of the displacement and the
    plastic zone.  With order one they take a fifth of the time.  ``history`` has their records.
    """

    history: History | None = None

    def __init__(self, options: NewtonOptions) -> None:
        self._options = replace(options, tolerance=max(ROUGH, options.tolerance))

    def __call__(self, here: State) -> State:
        """The state to go on from; the same one if it is near or order one does not converge."""
        if here.residual_norm < FAR:
            return here
        solver = RepeatedSolver(self._options)
        first = solver(replace(here.discrete.problem, order=1)).or_interrupted()
        self.history = first.history
        if first.status is not Status.CONVERGED or first.state.flowing > LARGE:
            return here
        return starting_state(here.discrete, first)


def starting_state(discrete: DiscreteProblem, start: object | None) -> State:
    """The initial state: prescribed displacements, and elsewhere those of ``start`` or zero.

    ``start`` is a displacement or a result that has one, on this or another mesh; contact forces
    are transferred as stresses.  TypeError or ValueError if it is no displacement.
    """
    u = discrete.starting_displacement(start)
    pressure = getattr(start, "contact_pressure", None)
    rows = discrete.rows
    if not isinstance(pressure, GridFunction) or not len(rows):
        return discrete.state(u)
    if isinstance(start, DiscreteSolution) and _same_rows(start, discrete):
        return discrete.state(u, contact=start.state.contact)

    def on_rows(function: GridFunction) -> np.ndarray:
        """A P1 function, on this or another mesh, at the nodes of the rows: (m, components)."""
        own = function.space.mesh
        mesh = discrete.problem.mesh
        values = function.vec.FV().NumPy().reshape(-1, own.nv).T
        if own is mesh:
            return rows.between(values)
        vertices, where = np.unique(rows.corners, return_inverse=True)
        there = at_vertices(own, values, mesh, vertices)
        return there[where.reshape(rows.corners.shape)].mean(axis=1)

    forces = np.where(
        rows.tied, 0.0, np.maximum(on_rows(pressure)[:, 0], 0.0) * rows.weights
    )
    if discrete.contact.friction.d:
        tangential = np.zeros(rows.tangents.shape[:2])
        friction = getattr(start, "friction_stress", None)
        if isinstance(friction, GridFunction):
            stress = on_rows(friction)
            tangential = -np.einsum("mdj,mj,m->md", rows.tangents, stress, rows.weights)
        forces = np.concatenate([forces, tangential.ravel()])
    return discrete.state(u, contact=forces)


def _same_rows(start: DiscreteSolution, discrete: DiscreteProblem) -> bool:
    """Whether a result has the same rows, so that its contact forces can be used directly."""
    same = start.state.body.problem.mesh is discrete.problem.mesh
    alike = len(start.state.contact) == len(discrete.contact)
    nodes = start.rows.nodes
    tied = start.rows.tied.any() or discrete.rows.tied.any()
    return same and alike and not tied and np.array_equal(nodes, discrete.rows.nodes)
