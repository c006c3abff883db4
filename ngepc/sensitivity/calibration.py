"""Calibration: material constants from measured curves, by least squares with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.optimize import OptimizeResult, least_squares

from ngepc.checks.arguments import is_number, require_integer, require_number
from ngepc.checks.kinds import require_instance, require_mapping, require_sequence
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.result import Evolution
from ngepc.evolution.solver import evolve
from ngepc.local.system import State
from ngepc.model.problem import Problem
from ngepc.sensitivity.forms import Form, as_functional
from ngepc.sensitivity.functionals import Functional
from ngepc.sensitivity.parameters import MATERIAL
from ngepc.sensitivity.states import states_of
from ngepc.sensitivity.tangent import tangents_at

ILL_CONDITIONED = 1e8
"""Condition of the Gauss-Newton matrix above which the data do not identify all constants."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A functional measured at the end of each step of a load path.

    Parameters
    ----------
    schedule
        The load path.
    functional
        What was measured, see ``gradient``.
    measured
        Its value at each time of the schedule.
    noise
        Standard deviation of the measurements, a number or one for each; None if unknown: then
        all curves have unit weight and the deviation is estimated from the residuals.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, the numbers of times and values differ, or a deviation
        is not positive.
    """

    schedule: Schedule
    functional: str | Form | Functional
    measured: Sequence[float]
    noise: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        require_instance("schedule", self.schedule, Schedule, "a Schedule")
        as_functional(self.functional)
        require_numbers("measured", self.measured)
        if is_number(self.noise):
            require_number("noise", self.noise, 0, strict=True)
        elif self.noise is not None:
            require_numbers("noise", self.noise)
        count, times = len(self.measured), len(self.schedule.times)
        if count != times:
            raise ValueError(
                f"measured={self.measured!r}: one value for each of {times} times is needed"
            )
        if np.ndim(self.noise) and len(self.noise) != count:
            raise ValueError(f"noise={self.noise!r}: one number or {count} are needed")
        if self.noise is not None and not (np.asarray(self.noise, dtype=float) > 0).all():
            raise ValueError(f"noise={self.noise!r}: positive numbers are needed")

    @property
    def weights(self) -> np.ndarray:
        """1 / noise of each measurement."""
        noise = 1.0 if self.noise is None else np.asarray(self.noise, dtype=float)
        return np.ones(len(self.measured)) / noise

    def measured_steps(self, evolution: Evolution) -> list[int]:
        """The steps at whose ends was measured; others come from cuts."""
        times = evolution.times
        return [times.index(time) for time in self.schedule.times]


@dataclass(frozen=True, eq=False)
class Calibration:
    """Material constants found, and how well the data determine them.

    Parameters
    ----------
    values
        Name -> constant.
    intervals
        Name -> (lower, upper) of the confidence interval, linearised in the logarithms.
    problem
        The problem with these constants.
    residuals
        (predicted - measured) / noise.
    condition
        Of the Gauss-Newton matrix J' J in the logarithms; 1 is best.
    evaluations
        How often the whole load path was solved.
    converged
        Whether ``scipy.optimize.least_squares`` met a tolerance.
    message
        How it ended, and whether the data identify the constants.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    problem: Problem
    residuals: np.ndarray
    condition: float
    evaluations: int
    converged: bool
    message: str


def calibrate(
    problem: Problem,
    curves: Curve | Sequence[Curve],
    start: Mapping[str, float],
    *,
    confidence: float = 0.95,
    max_evaluations: int = 15,
    tolerance: float = 1e-8,
) -> Calibration:
    """Find material constants with which the problem reproduces measured curves.

    Least squares by ``scipy.optimize`` in the logarithms of the constants; the Jacobian is that of
    the discrete problem, step by step.

    Parameters
    ----------
    problem
        The body; its constants named in ``start`` are replaced.
    curves
        What was measured.
    start
        Name of each unknown material constant -> first guess > 0.
    confidence
        Probability of the intervals, in (0, 1).
    max_evaluations
        Most solutions of the whole load path.
    tolerance
        Relative change of the sum of squares or of the logarithms at which the search ends.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or there are fewer measurements than unknowns.
    SolverError
        If the load path cannot be solved with some constants.
    """
    require_instance("problem", problem, Problem, "a Problem")
    curves = [curves] if isinstance(curves, Curve) else curves
    require_sequence("curves", curves, "Curve objects")
    if not len(curves):
        raise ValueError(f"curves={curves!r}: at least one Curve is needed")
    for number, curve in enumerate(curves):
        require_instance(f"curves[{number}]", curve, Curve, "Curve(...)")
    require_number("tolerance", tolerance, 0, strict=True)
    if not 0 < require_number("confidence", confidence) < 1:
        raise ValueError(f"confidence={confidence!r}: a number in (0, 1) is needed")
    limit = require_integer("max_evaluations", max_evaluations, 1)
    search = _Search(problem, list(curves), tuple(checked_start(start)))
    count = sum(len(curve.measured) for curve in curves)
    if count < len(start):
        raise ValueError(f"{count} measurements: at least {len(start)} are needed")
    found = least_squares(
        search.residuals,
        np.log(list(start.values())),
        search.jacobian,
        method="dogbox",  # shortest Gauss-Newton steps where the data do not identify a constant
        max_nfev=limit,
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return search.calibration(found, confidence)


def require_numbers(name: str, values: object) -> None:
    """Accept a sequence of finite numbers."""
    require_sequence(name, values, "numbers")
    for i, value in enumerate(values):
        require_number(f"{name}[{i}]", value)


def checked_start(start: Mapping[str, float]) -> Mapping[str, float]:
    """Refuse what is no material constant with a positive guess."""
    require_mapping("start", start, "material constant -> first guess")
    for name, guess in start.items():
        if name not in MATERIAL:
            raise ValueError(f"start names {name!r}: one of {', '.join(MATERIAL)} is needed")
        require_number(f"start[{name!r}]", guess, 0, strict=True)
    return start


@dataclass(frozen=True, eq=False)
class SolvedPath:
    """A load path solved with some constants, beside the curve measured along it."""

    curve: Curve
    states: list[State]
    steps: list[int]

    @classmethod
    def of(cls, problem: Problem, curve: Curve) -> SolvedPath:
        """Solve the load path of a curve.

        Raises
        ------
        SolverError
            If a step does not converge.
        """
        run = evolve(problem, curve.schedule)
        states = [give_state() for give_state in states_of(run)]
        return cls(curve, states, curve.measured_steps(run))

    @property
    def residuals(self) -> np.ndarray:
        """(predicted - measured) / noise."""
        functional = as_functional(self.curve.functional)
        predicted = [functional.slope(self.states[step]).value for step in self.steps]
        return (np.array(predicted) - self.curve.measured) * self.curve.weights

    def slopes(self, name: str) -> np.ndarray:
        """The derivatives of the residuals with respect to a material constant."""
        found = tangents_at(self.states, {name: 1.0})
        slopes = [found[step].of(self.curve.functional) for step in self.steps]
        return np.array(slopes) * self.curve.weights


@dataclass(eq=False)
class _Search:
    """The residuals at logarithms of the constants, and their Jacobian at the same point."""

    problem: Problem
    curves: list[Curve]
    names: tuple[str, ...]
    paths: list[SolvedPath] = field(default_factory=list)
    evaluations: int = 0
    at: np.ndarray | None = None

    def values(self, logarithms: np.ndarray) -> dict[str, float]:
        return dict(zip(self.names, np.exp(logarithms).tolist(), strict=True))

    def problem_at(self, logarithms: np.ndarray) -> Problem:
        material = replace(self.problem.material, **self.values(logarithms))
        return replace(self.problem, material=material)

    def solve(self, logarithms: np.ndarray) -> list[SolvedPath]:
        if self.at is None or (self.at != logarithms).any():
            problem = self.problem_at(logarithms)
            self.paths = [SolvedPath.of(problem, curve) for curve in self.curves]
            self.at, self.evaluations = logarithms.copy(), self.evaluations + 1
        return self.paths

    def residuals(self, logarithms: np.ndarray) -> np.ndarray:
        return np.concatenate([path.residuals for path in self.solve(logarithms)])

    def jacobian(self, logarithms: np.ndarray) -> np.ndarray:
        paths, values = self.solve(logarithms), self.values(logarithms)
        columns = [
            value * np.concatenate([path.slopes(name) for path in paths])
            for name, value in values.items()
        ]
        return np.stack(columns, axis=1)

    def calibration(self, found: OptimizeResult, confidence: float) -> Calibration:
        """Statistics of the linearised problem at the end of the search."""
        m, n = found.jac.shape
        _, singular, right = np.linalg.svd(found.jac, full_matrices=False)
        with np.errstate(divide="ignore", invalid="ignore"):
            condition = float((singular[0] / singular[-1]) ** 2) if singular[-1] > 0 else np.inf
            error = np.sqrt(np.nan_to_num((right / singular[:, None]) ** 2, posinf=np.inf).sum(0))
        factor = stats.norm.ppf(0.5 + confidence / 2)
        if any(curve.noise is None for curve in self.curves):
            error = error * np.sqrt(2 * found.cost / max(m - n, 1))
            factor = stats.t.ppf(0.5 + confidence / 2, max(m - n, 1))
        with np.errstate(over="ignore"):
            ends = np.exp(found.x + factor * np.outer([-1, 1], error)).T.tolist()
        texts = [found.message]
        if not condition <= ILL_CONDITIONED:
            texts.append(
                f"The data do not identify all of {', '.join(self.names)}: the Gauss-Newton "
                f"matrix has condition {condition:.2g}."
            )
        return Calibration(
            values=self.values(found.x),
            intervals={name: tuple(end) for name, end in zip(self.names, ends, strict=True)},
            problem=self.problem_at(found.x),
            residuals=found.fun,
            condition=condition,
            evaluations=self.evaluations,
            converged=bool(found.success),
            message=" ".join(texts),
        )
