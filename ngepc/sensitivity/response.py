"""A functional of the solution as a function of some data, with its derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ngepc.checks.arguments import require_vector
from ngepc.checks.kinds import require_instance, require_text
from ngepc.checks.sentences import in_words
from ngepc.evolution.load_path import scaled
from ngepc.local.result import ExactResult
from ngepc.local.solver import RepeatedSolver
from ngepc.model.data import moved_gap
from ngepc.model.problem import Problem
from ngepc.sensitivity.functionals import Form, Functional, as_functional
from ngepc.sensitivity.gradient import gradient
from ngepc.sensitivity.law_data import numeric_data, with_constants
from ngepc.sensitivity.parameters import Direction

FACTORS = ("traction", "pressure", "body_force", "prescribed")
"""Data whose parameter is a factor of the given value."""


class Response:
    """The function theta (n,) -> a functional of the solution and its derivatives (n,).

    ``scipy.optimize.minimize(response, response.start, jac=True)`` accepts it.  Each call solves
    the problem, starting from the solution of the last call.

    Parameters
    ----------
    problem
        The problem; its parameters are ``start``.
    functional
        As for ``gradient``: "contact_force", ``Reaction(...)``, ...
    parameters
        The components of theta: names of numbers of the material, such as "yield_stress",
        "law.saturation", "rate.overstress", "hill.N" or "overlay.bounds[0]"; "gap",
        the distance by which the obstacles are moved away; "traction", "pressure", "body_force" or
        "prescribed", factors of the given values.

    ``last`` is the last solution; ``start`` (n,) are the parameters of the given problem.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem has no such number.
    """

    last: ExactResult | None = None

    def __init__(
        self,
        problem: Problem,
        functional: str | Form | Functional,
        parameters: Sequence[str],
    ) -> None:
        self.problem = require_instance("problem", problem, Problem, "a Problem")
        self.functional = as_functional(functional)
        if isinstance(parameters, str | bytes) or not isinstance(parameters, Sequence):
            raise TypeError(
                f"parameters={in_words(parameters)}: a list of names is needed"
            )
        if not parameters:
            raise ValueError(
                f"parameters={in_words(parameters)}: at least one name is needed"
            )
        self.parameters = tuple(require_text("parameters", one) for one in parameters)
        self.start = np.array([self._given(name) for name in self.parameters])
        self._solver = RepeatedSolver()

    def __call__(self, theta: Sequence[float]) -> tuple[float, np.ndarray]:
        """The number and its derivatives; SolverError if a solve does not converge."""
        n = len(self.parameters)
        given = np.asarray(theta) if np.ndim(theta) else theta
        values = require_vector("theta", given, (n,))
        problem = self.at(values)
        result = self._solver(problem, start=self.last)
        result.or_interrupted().raise_for_status()
        self.last = result
        slopes = gradient(result, self.functional, self._directions)
        return slopes.functional, np.array([slopes[name] for name in self.parameters])

    def at(self, theta: Sequence[float]) -> Problem:
        """The problem with these parameters."""
        constants = {}
        changes: dict[str, object] = {}
        for name, value in zip(self.parameters, theta, strict=True):
            given = getattr(self.problem, name, None)
            if name in FACTORS:
                changes[name] = scaled(given, value)
            elif name == "gap":
                changes[name] = moved_gap(given, value)
            else:
                constants[name] = value
        problem = self.problem.changed(**changes)
        return with_constants(problem, constants) if constants else problem

    @property
    def _directions(self) -> dict[str, Direction]:
        """The direction of each parameter."""
        return {
            name: Direction(name, getattr(self.problem, name))
            if name in FACTORS
            else Direction(name)
            for name in self.parameters
        }

    def _given(self, name: str) -> float:
        """The value of a parameter in the given problem; ValueError if the problem has none."""
        problem = self.problem
        if name in (*FACTORS, "gap"):
            if getattr(problem, name) is not None:
                return 0.0 if name == "gap" else 1.0
        elif name in (numbers := numeric_data(problem.material)):
            return numbers[name]
        there = [n for n in (*FACTORS, "gap") if getattr(problem, n) is not None]
        legal = ", ".join([*numeric_data(problem.material), *there])
        raise ValueError(f"parameters: {name!r} is none of {legal}")
