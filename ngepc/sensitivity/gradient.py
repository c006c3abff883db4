"""Gradients of functionals by the adjoint, backwards through the time steps.

One step is a history of one.  Backwards from the last one the derivative with respect to what a
step has inherited, p_0, dev alpha_2, alpha_1 and u_0, is carried to the step before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from ngepc.checks.arguments import require_integer
from ngepc.checks.kinds import require_instance
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.points import Points
from ngepc.evolution.result import Evolution, EvolutionStep
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.limits import require_without
from ngepc.model.problem import Problem
from ngepc.sensitivity.contact import Biactive, biactive_set, told
from ngepc.sensitivity.functionals import Form, Functional, as_functional
from ngepc.sensitivity.linear import LinearStep
from ngepc.sensitivity.parameters import Parameters, changed_data, directions
from ngepc.sensitivity.radial import INHERITED, Data
from ngepc.sensitivity.shape import by_the_mesh

Solution = ExactResult | Evolution
"""What has derivatives."""


class Gradient(dict[str, float]):
    """Name of each parameter -> derivative, and whether the functional has one.

    Parameters
    ----------
    derivatives
        The derivatives by name.
    functional
        The value of the functional.
    biactive
        The weakly active rows and points of each time step that the functional depends on.
    """

    def __init__(
        self, derivatives: Mapping[str, float], functional: float, biactive: tuple[Biactive, ...]
    ) -> None:
        super().__init__(derivatives)
        self.functional, self.biactive = functional, biactive

    @property
    def differentiable(self) -> bool:
        """Whether no row and no point is biactive; if False the numbers are those of one side."""
        return not any(len(found) for found in self.biactive)

    @property
    def message(self) -> str:
        """What is biactive, step by step; empty where the functional is differentiable."""
        return told(self.biactive)


def gradient(
    result: Solution, functional: str | Form | Functional, parameters: Parameters, *, step: int = -1
) -> Gradient:
    """The derivatives of a functional of a solution with respect to data of its problem.

    Parameters
    ----------
    result
        A converged result of ``semismooth_newton`` without gamma, or of ``evolve``.
    functional
        "contact_force", "primal_energy", "elastic_energy", "dissipation", ``DisplacementAt``,
        ``Reaction``, ``misfit``, or a form, see ``FormFunctional``.
    parameters
        Names such as ["hardening", "traction"], or name -> ``Direction``.  In a history a load or
        gap changes in all steps, an initial plastic strain at the begin.
    step
        The time step of a history whose solution the functional is of.

    Returns
    -------
    Gradient
        A dict; look at ``differentiable`` or ``message``.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem lacks such data.
    SolverError
        If the result is not that of a converged run.
    TangentError
        If the derivative does not exist because the tangent is singular.
    """
    wanted, functional = directions(parameters), as_functional(functional)
    steps = states_of(result)
    last = range(len(steps))[require_integer("step", step, -len(steps), len(steps) - 1)]
    derivatives, found, later = dict.fromkeys(wanted, 0.0), [], Data()
    for number in range(last, -1, -1):
        linear = LinearStep(steps[number]())
        state = linear.state
        found.insert(0, biactive_set(state))
        by = linear.radial.returned(later)
        if number == last:
            value, by = functional.slope(state)
        by = linear.reverse(by)
        for name, direction in wanted.items():
            if number == 0 or not direction.inherited:
                change = changed_data(state, direction)
                derivatives[name] += by.paired(change, state.discrete.points)
                if number == last:
                    derivatives[name] += by_the_mesh(functional, state, change)
        later = Data({name: by[name] for name in INHERITED})
    return Gradient(derivatives, value, tuple(found))


def states_of(result: Solution) -> list[Callable[[], State]]:
    """For each time step what gives its solution: states of a history are rebuilt when needed.

    TypeError, ValueError for results of other solvers. SolverError if the run did not converge:
    what is no solution has no derivative.
    """
    needed = "a result of semismooth_newton without gamma, or an Evolution,"
    require_instance("result", result, Solution, needed)
    result.raise_for_status()
    require_without(result.problem, "a derivative", "law", "strain")
    if isinstance(result, ExactResult):
        return [lambda: result.state]
    problems = [step.problem for step in result.steps]
    if not problems:
        raise ValueError("result has no finished step: at least one is needed")
    if any(problem.mesh != result.problem.mesh for problem in problems):
        raise ValueError("result has steps on several meshes: one mesh is needed")
    if any(step.contact is None for step in result.steps):
        raise ValueError("result has steps with gamma: steps of the exact methods are needed")
    names = ("initial_plastic_strain", "initial_hardening")
    problems[0] = replace(problems[0], **{name: getattr(result.problem, name) for name in names})
    points = result.memory.functions.points
    steps = zip(problems, result.steps, strict=True)
    return [partial(restored_state, problem, step, points) for problem, step in steps]


def restored_state(problem: Problem, step: EvolutionStep, points: Points) -> State:
    """The state of a finished step from its displacement and its forces of contact."""
    u = nodal(step.fields.displacement.vec.FV().NumPy(), problem).copy()
    return DiscreteProblem(problem, points).state(u, contact=step.contact)
