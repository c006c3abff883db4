"""The distance of the steps of a history from those of the continuous problem, in the energy norm.

Let y = (u, p, alpha) be the state at the end of a step, a(y, y) twice its stored energy, and
B_n a bound of the energy error of step n, from the history that it starts with.  Then

    |y_h^N - y^N|^2  <=  2 (B_1 + ... + B_N),        |y|^2 = a(y, y),

where y^n are the steps of the same length of the continuous problem.

Proof.  A step minimises J_n(y) = a(y, y)/2 - l_n(y) + D(y - y^{n-1}) with a convex D, which has
dissipation and growth of the yield surface.  d = y_h^n - y^n, and d' = y_h^{n-1} - y^{n-1}, which
vanishes on supports.  Compare y^n with y_h^n - d', and y_h^n with y^n + d': D is the same in both
pairs, l_n cancels, and

    |d - d'|^2/2 - B_n  <=  J_n(y_h^n - d') - J_n(y^n) + J_n^h(y^n + d') - J_n^h(y_h^n)
                         =  |d'|^2 - a(d, d'),

that is |d|^2 <= |d'|^2 + 2 B_n.  With unilateral contact y_h^n - d' need not be admissible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ngepc.bounds.bound import error_bound
from ngepc.bounds.outcome import ErrorBound
from ngepc.checks.arguments import is_number
from ngepc.checks.sentences import outward
from ngepc.evolution.memory import Memory
from ngepc.local.exact import solve_exactly
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.data import same_fields
from ngepc.model.elements import has_straight_simplices
from ngepc.model.material import Material
from ngepc.model.problem import Problem

PROVED = {
    "contact": "unilateral contact",
    "order 2": "order 2 (plastic strains are interpolated between steps)",
    "material": "a material that changes between steps",
    "law": "a nonlinear hardening law",
    "springs": "springs that change between steps",
    "means": "hardening that varies inside elements (its means on elements are taken)",
}
"""Properties that the proof does not cover."""
CONSTANT = 1e-10
"""Relative variation of hardening on an element that counts as none."""
TOLERANCE = 1e-9
MOST_STEPS = 100


class SolvedStep(Protocol):
    """A step of a history: its problem, and the step as a result."""

    problem: Problem

    def solution_like(self, like: DiscreteProblem | None) -> ExactResult:
        """The step as a result, with unchanged data of an earlier discrete problem."""


@dataclass(frozen=True)
class DistanceBound:
    """The distance of a history to the steps of the continuous problem, in the energy norm.

    Parameters
    ----------
    by_step
        (2 (B_1 + ... + B_n))^(1/2) after each step: its square bounds
        int C^-1 d : d + k |p_h - p|^2 for the error d of the stress (energy^(1/2)).
    message
        Why it is an estimate only; empty where it is proved.
    """

    by_step: np.ndarray = field(repr=False)
    message: str

    @property
    def value(self) -> float:
        """The bound after the last step."""
        return float(self.by_step[-1])

    @property
    def guaranteed(self) -> bool:
        """Whether the bound is proved."""
        return not self.message

    def __str__(self) -> str:
        most = outward(0.0, self.value, 3)[1]
        size = f"distance of the last step, in the energy norm, at most {most}"
        return f"{size} (guaranteed)" if self.guaranteed else f"{size}. {self.message}"


def distance_of(steps: Sequence[SolvedStep]) -> DistanceBound:
    """The bound of the distance after each step.

    ValueError for a history without steps, and for what has no error bound.
    """
    if not steps:
        raise ValueError("steps: a history with a finished step is needed")
    averaged = [problem_with_means(step.problem) for step in steps]
    bounds = bounds_of(steps, averaged)
    totals = np.array([max(bound.total, 0.0) for bound in bounds])
    problems = [step.problem for step in steps]
    material = problems[0].material
    changed = [not same_fields(problems[0], p, "springs") for p in problems]
    found = {
        "contact": any(p.contact_names or p.contact_pairs for p in problems),
        "order 2": any(problem.order == 2 for problem in problems),
        "material": not all(same_data(p.material, material) for p in problems),
        "law": material.law is not None,
        "springs": any(changed),
        "means": any(problem is not None for problem in averaged),
    }
    reasons = [PROVED[name] for name, there in found.items() if there]
    messages = {bound.message for bound in bounds if not bound.guaranteed}
    text = f"Not proved for {', '.join(reasons)}." if reasons else ""
    message = " ".join(filter(None, [text, *sorted(messages)]))
    return DistanceBound(np.sqrt(2 * np.cumsum(totals)), message)


def problem_with_means(problem: Problem) -> Problem | None:
    """The problem of a step with the means of its hardening on elements, as error bounds need it.

    None where the hardening does not vary inside elements.
    """
    if problem.order == 1 and has_straight_simplices(problem.mesh):
        return None  # one point in each element
    memory = Memory.initial(problem)
    means = memory.as_bounds_need_it()
    pairs = [(value, means.arrays[name]) for name, value in memory.arrays.items()]
    if all(np.allclose(value, mean, CONSTANT, 0.0) for value, mean in pairs):
        return None
    return means.before(problem)


def bounds_of(
    steps: Sequence[SolvedStep], averaged: Sequence[Problem | None]
) -> list[ErrorBound]:
    """The error bounds of the steps; what does not change between them is discretised once."""
    bounds = []
    discrete = None
    for step, problem in zip(steps, averaged, strict=True):
        solution = step.solution_like(discrete)
        discrete = solution.discrete
        bounds.append(bound_of_step(solution, problem))
    return bounds


def bound_of_step(start: ExactResult, averaged: Problem | None) -> ErrorBound:
    """The error bound of a step, or of the solution with ``averaged`` hardening.

    RuntimeError if that is not found.
    """
    if averaged is None:
        return error_bound(start)
    solved = solve_exactly(
        averaged, start, TOLERANCE, MOST_STEPS, "sparsecholesky", None
    )
    return error_bound(solved.or_interrupted().raise_for_status())


def same_data(one: Material, other: Material) -> bool:
    """Whether two materials have the same data: a mesh that was refined has a copy of its own."""
    pairs = [(value, vars(other)[name]) for name, value in vars(one).items()]
    return all(a is b or (is_number(a) and is_number(b) and a == b) for a, b in pairs)
