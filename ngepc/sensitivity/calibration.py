"""Calibration: material constants from measured curves, by least squares with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.optimize import OptimizeResult, least_squares

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_instance, require_mapping
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.result import Evolution
from ngepc.evolution.solver import evolve
from ngepc.model.problem import Problem
from ngepc.sensitivity.functionals import Form, Functional, as_functional
from ngepc.sensitivity.parameters import MATERIAL
from ngepc.sensitivity.states import restored_state
from ngepc.sensitivity.tangent import tangents

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
    ValueError
        If the numbers of times and values differ, or a deviation is not positive.
    """

    schedule: Schedule
    functional: str | Form | Functional
    measured: Sequence[float]
    noise: float | Sequence[float] | None = None

    def __post_init__(self) -> None:
        require_instance("schedule", self.schedule, Schedule, "a Schedule")
        count, times = len(self.measured), len(self.schedule.times)
        if count != times:
            raise ValueError(f"measured has {count} values: one for each of {times} times needed")
        if self.noise is not None and not (np.asarray(self.noise, dtype=float) > 0).all():
            raise ValueError(f"noise={self.noise!r}: positive numbers are needed")

    @property
    def weights(self) -> np.ndarray:
        """1 / noise of each measurement."""
        noise = 1.0 if self.noise is None else np.asarray(self.noise, dtype=float)
        return np.ones(len(self.measured)) / noise

    def steps(self, evolution: Evolution) -> list[int]:
        """The steps at whose ends was measured; others come from cuts."""
        times = evolution.times
        return [times.index(time) for time in self.schedule.times]

    def predicted(self, evolution: Evolution) -> np.ndarray:
        """The functional at the times of the schedule."""
        functional = as_functional(self.functional)
        steps = [evolution.steps[number] for number in self.steps(evolution)]
        return np.array([functional.slope(restored_state(step)).value for step in steps])

    def slopes(self, evolution: Evolution, name: str) -> np.ndarray:
        """The derivatives of ``predicted`` with respect to a material constant."""
        found = tangents(evolution, name)
        return np.array([found[number].of(self.functional) for number in self.steps(evolution)])


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
    correlation
        Of the logarithms, shape (unknowns, unknowns), in the order of ``values``.
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
    correlation: np.ndarray
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
    curves = [curves] if isinstance(curves, Curve) else list(curves)
    confidence = require_number("confidence", confidence, 0.0, 1.0)
    limit = require_integer("max_evaluations", max_evaluations, 1)
    search = _Search(problem, curves, tuple(checked_start(start)))
    count = sum(len(curve.measured) for curve in curves)
    if count < len(start):
        raise ValueError(f"{count} measurements: at least {len(start)} are needed")
    found = least_squares(
        search.residuals,
        np.log(list(start.values())),
        search.jacobian,
        max_nfev=limit,
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return search.calibration(found, confidence)


def checked_start(start: Mapping[str, float]) -> Mapping[str, float]:
    """Refuse what is no material constant with a positive guess."""
    require_mapping("start", start, "material constant -> first guess")
    for name, guess in start.items():
        if name not in MATERIAL:
            raise ValueError(f"start names {name!r}: one of {', '.join(MATERIAL)} is needed")
        require_number(f"start[{name!r}]", guess, 0, strict=True)
    return start


@dataclass(eq=False)
class _Search:
    """The residuals at logarithms of the constants, and their Jacobian at the same point."""

    problem: Problem
    curves: list[Curve]
    names: tuple[str, ...]
    evolutions: list[Evolution] = field(default_factory=list)
    evaluations: int = 0
    at: np.ndarray | None = None

    def values(self, logarithms: np.ndarray) -> dict[str, float]:
        return dict(zip(self.names, np.exp(logarithms).tolist(), strict=True))

    def problem_at(self, logarithms: np.ndarray) -> Problem:
        material = replace(self.problem.material, **self.values(logarithms))
        return replace(self.problem, material=material)

    def solve(self, logarithms: np.ndarray) -> list[Evolution]:
        if self.at is None or (self.at != logarithms).any():
            problem = self.problem_at(logarithms)
            runs = [evolve(problem, curve.schedule) for curve in self.curves]
            self.evolutions = [run.raise_for_status() for run in runs]
            self.at, self.evaluations = logarithms.copy(), self.evaluations + 1
        return self.evolutions

    def residuals(self, logarithms: np.ndarray) -> np.ndarray:
        pairs = zip(self.curves, self.solve(logarithms), strict=True)
        return np.concatenate(
            [(curve.predicted(run) - curve.measured) * curve.weights for curve, run in pairs]
        )

    def jacobian(self, logarithms: np.ndarray) -> np.ndarray:
        values, rows = self.values(logarithms), []
        for curve, run in zip(self.curves, self.solve(logarithms), strict=True):
            columns = [value * curve.slopes(run, name) for name, value in values.items()]
            rows.append(np.stack(columns, axis=1) * curve.weights[:, None])
        return np.concatenate(rows)

    def calibration(self, found: OptimizeResult, confidence: float) -> Calibration:
        """Statistics of the linearised problem at the end of the search."""
        m, n = found.jac.shape
        singular = np.linalg.svd(found.jac, compute_uv=False)
        condition = float((singular[0] / singular[-1]) ** 2) if singular[-1] > 0 else np.inf
        covariance = np.linalg.pinv(found.jac.T @ found.jac)
        known = all(curve.noise is not None for curve in self.curves)
        factor = stats.norm.ppf(0.5 + confidence / 2)
        if not known:
            covariance = covariance * (2 * found.cost / max(m - n, 1))
            factor = stats.t.ppf(0.5 + confidence / 2, max(m - n, 1))
        error = np.sqrt(np.diag(covariance))
        ends = np.exp(found.x + factor * np.outer([-1, 1], error)).T.tolist()
        texts = [found.message]
        if condition > ILL_CONDITIONED:
            texts.append(
                f"The data do not identify all of {', '.join(self.names)}: the Gauss-Newton "
                f"matrix has condition {condition:.2g}."
            )
        return Calibration(
            values=self.values(found.x),
            intervals={name: tuple(end) for name, end in zip(self.names, ends, strict=True)},
            problem=self.problem_at(found.x),
            residuals=found.fun,
            correlation=covariance / np.outer(error, error),
            condition=condition,
            evaluations=self.evaluations,
            converged=bool(found.success),
            message=" ".join(texts),
        )
