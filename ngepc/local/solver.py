"""Solve discrete problems of time steps exactly, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

from ngepc.checks.declared import Check, Declared
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.discretisation.factors import Factors, tangent_of
from ngepc.discretisation.stiffness import Stiffness
from ngepc.discretisation.symbolic_stiffness import by_moduli
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.cores import crew
from ngepc.linalg.direct import require_solver
from ngepc.linalg.secants import Compliance
from ngepc.local.active_set import InexactTarget
from ngepc.local.choice import DIRECT, fastest_solver, solver_name
from ngepc.local.iterative import Iterative, IterativeTangent
from ngepc.local.result import ExactResult
from ngepc.local.start import starting_state
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
from ngepc.results.outcome import Monitor, Status

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


UNSOLVED = (Status.NONFINITE, Status.LINESEARCH_FAILED, Status.STAGNATED)
"""How runs end that lost their way."""

NEARER = (1e-2, 1e-4, 1e-6)
NEARBY_STEPS = 20
"""Tolerances with stiffer springs, to find contact where springs hold a part loosely, and the most
steps to each."""

FEW_FORCES = 600
"""The most forces of contact rows whose compliance is computed for the elastic body."""


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
        """What the compliance of the contact rows is taken for at first."""
        return first_compliance(discrete)

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
        discrete = state.discrete
        tangent = self._tangent_for(discrete)
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

    def _tangent_for(self, discrete: DiscreteProblem) -> Factors | IterativeTangent:
        """The tangent of a body; factors of the last one if it has the same pattern."""
        known = self._tangent
        last = self._discrete
        self._discrete = discrete
        if known is not None and discrete.stiffness is last.stiffness:
            return known
        given = self.options.inverse
        self._chosen = self._fastest(discrete) if given is None else given
        tangent = tangent_of(discrete, self._chosen)
        self._tangent = tangent if isinstance(tangent, Factors) else None
        return tangent

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
            near = run(state, **held, **nearer)
            if near.status is Status.STOPPED:
                return near
            state = near.state
            result = run(state)
            if result.status not in UNSOLVED:
                return result
        said = f"{result.ending} {body.loosely_held.sentence}"
        return replace(result, ending=said)


def first_compliance(discrete: DiscreteProblem) -> Compliance:
    """What the compliance of the contact rows is taken for at first.

    With friction on few rows it is that of the elastic body, which is computed once for a
    sequence of problems: where most of the body is elastic it halves the solves for the rows.
    It depends on the problem alone, not on the problems before.
    """
    with_friction = discrete.contact.friction.d > 0
    if with_friction and len(discrete.contact) <= FEW_FORCES:
        return discrete.elastic_compliance.copy()
    return discrete.compliance()


def misled_by_forces(start: State, result: ExactResult) -> bool:
    """Whether forces of another problem may have led nowhere, under friction: once more without."""
    if result.status is not Status.NONFINITE:
        return False
    return start.discrete.problem.processes.any(start.contact != 0)


def misled_by_compliances(result: ExactResult) -> bool:
    """Whether new compliances of the rows may lead to other forces, from where a run failed."""
    coulomb = not result.discrete.contact.friction.is_convex
    return coulomb and result.status is Status.LINESEARCH_FAILED
