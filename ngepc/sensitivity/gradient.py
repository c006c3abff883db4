"""Gradients by the adjoint method, backwards through the time steps.

A single solve is a history of one step.  The derivatives with respect to the history variables of a
step, p_0, dev alpha_2,0, alpha_1, PEEQ and u_0, are passed to the step before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ngepc._deprecated import old_names
from ngepc.checks.arguments import Coefficient, require_integer
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.discretisation.sampled import unseen_changes
from ngepc.discretisation.spaces import nodal
from ngepc.evolution.result import Evolution, EvolutionStep
from ngepc.linalg.blas import one_blas_thread
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
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.sensitivity.contact import Biactive, biactive_message, biactive_set
from ngepc.sensitivity.equations import INHERITED, Data
from ngepc.sensitivity.functionals import Form, Functional, as_functional, slope_by_mesh
from ngepc.sensitivity.law_data import PARTS
from ngepc.sensitivity.linear import LinearStep
from ngepc.sensitivity.parameters import (
    MATERIAL,
    Direction,
    Parameters,
    change_in_step,
    directions,
    what_lacks,
)

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | ELEMENT_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | (KINEMATICS_FEATURES - {"other kinematics"})
    | LAW_FEATURES
    | {"anisotropic yield", "cyclic hardening"}
)
"""Features that derivatives cover."""


Solution = ExactResult | Evolution
"""Results that have derivatives."""


class Gradient(dict[str, float]):
    """Derivatives of a functional by parameter, and whether the functional is differentiable.

    Parameters
    ----------
    derivatives
        The derivatives by name.
    functional
        The value of the functional.
    biactive
        The weakly active rows and points of each time step that the functional depends on.

    ``differentiable`` is False if a row or point is biactive: the numbers are then derivatives from
    one side.  ``message`` lists the biactive rows and points of each step, and the changes that
    are known from samples only.
    """

    def __init__(
        self,
        derivatives: Mapping[str, float],
        functional: float,
        biactive: tuple[Biactive, ...],
        unseen: str = "",
    ) -> None:
        super().__init__(derivatives)
        self.functional = functional
        self.biactive = biactive
        one_sided = biactive_message(biactive)
        self.message = " ".join(filter(None, (one_sided, unseen)))
        self.differentiable = not one_sided


@one_blas_thread
def gradient(
    result: Solution,
    functional: str | Form | Functional,
    parameters: Parameters,
    *,
    step: int = -1,
) -> Gradient:
    """The derivatives of a functional of a solution with respect to data of its problem.

    Parameters
    ----------
    result
        A converged result of ``semismooth_newton`` without gamma, or of ``evolve``.
    functional
        "contact_force", "primal_energy", "elastic_energy", "dissipation", ``DisplacementAt``,
        ``Reaction``, ``misfit``, or a function of displacement, plastic strain, stress and, if it
        takes a fourth argument, contact pressure, that returns integrals of them.
    parameters
        Names such as ["hardening", "traction"], or name -> ``Direction``.  In a history a load or
        gap changes in all steps that have it, an initial plastic strain at the beginning.
    step
        The time step of a history at which the functional is evaluated.

    Returns
    -------
    Gradient
        A dict with the attributes ``differentiable`` and ``message``.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem lacks such data.
    SolverError
        If the result is not that of a converged run.
    TangentError
        If the derivative does not exist because the tangent is singular.
    """
    wanted = directions(parameters)
    functional = as_functional(functional)
    steps = states_of(result)
    last = range(len(steps))[require_integer("step", step, -len(steps), len(steps) - 1)]
    require_data(result, wanted.values(), last + 1)
    derivatives = dict.fromkeys(wanted, 0.0)
    found = []
    by = Data()
    for number in range(last, -1, -1):
        linear = LinearStep(steps[number]())
        found.insert(0, biactive_set(linear.contact))
        by = Data({f"next_{name}": by[name] for name in INHERITED if name in by})
        if number == last:
            value, by = functional.slope(linear.state)
        by = linear.reverse(by)
        for name, direction in wanted.items():
            change = change_in_step(linear.state, direction, result.problem, number)
            if change is not None:
                moved = linear.with_supports(change) if "values" in change else change
                derivatives[name] += by.paired(moved)
                if number == last:
                    derivatives[name] += slope_by_mesh(functional, linear.state, change)
    changes = {n: (d.datum.partition(":")[0], d.change) for n, d in wanted.items()}
    unseen = unseen_changes(result.problem, changes)
    return Gradient(derivatives, value, tuple(found), unseen)


def require_data(
    result: Solution, wanted: Iterable[Direction], count: int | None = None
) -> None:
    """Refuse a datum that none of the first ``count`` steps has, or of all for None."""
    given = [result.problem]
    steps = given
    if isinstance(result, Evolution):
        steps = [step.problem for step in result.steps[:count]]
    for direction in wanted:
        problems = given if direction.inherited else steps
        reasons = [what_lacks(problem, direction) for problem in problems]
        if all(reasons):
            raise ValueError(reasons[0])


def states_of(result: Solution) -> list[Callable[[], State]]:
    """For each time step a function that returns its state; states of histories are restored.

    TypeError, ValueError for results of other solvers. SolverError if the run did not converge:
    only solutions have derivatives.
    """
    needed = "a result of semismooth_newton without gamma, or an Evolution,"
    require_instance("result", result, Solution, needed)
    result.raise_for_status()
    require_covered(result.problem, "a derivative", COVERS)
    if isinstance(result, ExactResult):
        return [lambda: result.state]
    problems = [step.problem for step in result.steps]
    if not problems:
        raise ValueError("result has no finished step: at least one is needed")
    if any(problem.mesh != result.problem.mesh for problem in problems):
        raise ValueError("result has steps on several meshes: one mesh is needed")
    if any(step.contact is None for step in result.steps):
        raise ValueError(
            "result has steps with gamma: steps of the exact methods are needed"
        )
    require_one_material(result)
    names = ("initial_plastic_strain", "initial_hardening", "initial_accumulated")
    problems[0] = replace(
        problems[0], **{name: getattr(result.problem, name) for name in names}
    )

    def restored(problem: Problem, step: EvolutionStep) -> State:
        """The state of a finished step from its displacement and its forces of contact."""
        u = nodal(step.fields.displacement.vec.FV().NumPy(), problem).copy()
        discrete = DiscreteProblem(problem, result.memory.functions.points)
        return discrete.state(u, contact=step.contact)

    return [
        partial(restored, *pair) for pair in zip(problems, result.steps, strict=True)
    ]


def require_one_material(result: Evolution) -> None:
    """Refuse a history whose material changes, as the derivative would be ambiguous."""
    at = result.memory.functions.points.at
    first = result.steps[0] if result.steps else result
    given = first.problem.material
    expected = [at(one) for one in _data_of(given)]
    for number, step in enumerate(result.steps, start=1):
        material = step.problem.material
        found = [at(one) for one in _data_of(material)]
        pairs = zip(found, expected, strict=False)
        same = len(found) == len(expected)
        if not (same and all(np.array_equal(*pair) for pair in pairs)):
            raise ValueError(
                f"the material of step {number} is {in_words(material)}: derivatives "
                "need one material "
                f"for the whole history, here {in_words(given)}"
            )


def _data_of(material: Material) -> list[Coefficient]:
    """All numbers and coefficients of a material and of its parts."""
    found = [getattr(material, name) for name in MATERIAL]
    for name in PARTS:
        part = getattr(material, name)
        for value in [] if part is None else vars(part).values():
            found += value if isinstance(value, tuple) else (value,)
    return found


__getattr__ = old_names(__name__)
