"""Calibration: material constants from measured curves, by least squares with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.optimize import least_squares

from ngepc.checks.arguments import is_number, require_integer, require_number
from ngepc.checks.kinds import (
    require_instance,
    require_mapping,
    require_sequence,
    require_text,
)
from ngepc.checks.sentences import in_words
from ngepc.evolution.load_path import Schedule, numbers_in
from ngepc.evolution.solver import evolve
from ngepc.linalg.blas import one_blas_thread
from ngepc.model.problem import Problem
from ngepc.sensitivity.functionals import Form, Functional, as_functional
from ngepc.sensitivity.gradient import states_of
from ngepc.sensitivity.law_data import PARTS, PartDatum, is_of_part, with_constants
from ngepc.sensitivity.parameters import MATERIAL
from ngepc.sensitivity.tangent import tangents_at

ILL_CONDITIONED = 1e8
"""Condition of J' J; above it the data do not identify all constants."""


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
        count = len(numbers_in("measured", self.measured))
        times = len(self.schedule.times)
        if count != times:
            raise ValueError(
                f"measured={in_words(self.measured)}: one value for each time, {times} in all, "
                "is needed"
            )
        given = 1.0 if self.noise is None else self.noise
        noise = [given] if is_number(given) else numbers_in("noise", given)
        if len(noise) not in (1, count):
            raise ValueError(
                f"noise={in_words(given)}: one number or {count} are needed"
            )
        for value in noise:
            require_number("noise", value, 0, strict=True)

    def fit(
        self, problem: Problem
    ) -> tuple[np.ndarray, Callable[[Sequence[str]], np.ndarray]]:
        """(predicted - measured) / noise, and a function for its derivatives by material constants.

        SolverError if a step does not converge.
        """
        run = evolve(problem, self.schedule).or_interrupted()
        functional = as_functional(self.functional)
        states = [give_state() for give_state in states_of(run)]
        # halved steps add times between
        steps = [run.times.index(time) for time in self.schedule.times]
        predicted = np.array([functional.slope(states[step]).value for step in steps])
        weights = weights_of(self)

        def slopes(names: Sequence[str]) -> np.ndarray:
            """Shape (measurements, names)."""
            found = tangents_at(states, [{name: 1.0} for name in names], problem)
            slopes = [
                [change[step].of(functional) for change in found] for step in steps
            ]
            return weights[:, None] * slopes

        return weights * (predicted - self.measured), slopes


def weights_of(curve: Curve) -> np.ndarray:
    """1 / noise for each measurement, 1 where it is unknown."""
    noise = 1.0 if curve.noise is None else curve.noise
    return np.ones(len(curve.measured)) / noise


@dataclass(frozen=True, eq=False)
class Calibration:
    """Material constants found, and how well the data determine them.

    Parameters
    ----------
    values, intervals
        Name -> constant, and (lower, upper) of its confidence interval, linearised in logarithms:
        (0, inf) for a constant that the data do not identify.
    problem
        The problem with these constants.
    residuals, condition
        (predicted - measured) / noise; condition of J' J in the logarithms, 1 is best.
    evaluations
        Number of solutions of the whole load path.
    converged, message
        Whether ``scipy.optimize.least_squares`` met a tolerance; names of constants that the data
        do not identify, empty if there are none.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    problem: Problem
    residuals: np.ndarray
    condition: float
    evaluations: int
    converged: bool
    message: str


@one_blas_thread
def calibrate(
    problem: Problem,
    curves: Curve | Sequence[Curve],
    start: Mapping[str, float],
    *,
    confidence: float = 0.95,
    max_evaluations: int = 15,
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
        Largest number of solutions of the whole load path.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or there are fewer measurements than unknowns.
    SolverError
        If the load path cannot be solved with some constants.
    """
    require_instance("problem", problem, Problem, "a Problem")
    require_number("confidence", confidence, 0, strict=True, below=1)
    limit = require_integer("max_evaluations", max_evaluations, 1)
    names, curves = _checked(start, [curves] if isinstance(curves, Curve) else curves)
    for name in names:
        if is_of_part(name):
            PartDatum.of(problem.material, name)
    fits = _Fits(problem, start, curves)
    # "dogbox" takes minimum-norm Gauss-Newton steps if the data do not identify a constant.
    given = {"method": "dogbox", "max_nfev": limit}
    unchanged = np.zeros(len(names))
    found = least_squares(fits.residuals, unchanged, fits.jacobian, **given)
    values = fits.constants(found.x)
    residuals = fits.size * found.fun
    known = all(curve.noise is not None for curve in curves)
    condition, factors = _statistics(
        fits.size * found.jac, residuals, confidence, known
    )
    ends = values * factors
    return Calibration(
        values=dict(zip(names, values.tolist(), strict=True)),
        intervals=dict(zip(names, map(tuple, ends.T.tolist()), strict=True)),
        problem=fits.fitted(found.x),
        residuals=residuals,
        condition=condition,
        evaluations=fits.evaluations,
        converged=bool(found.success),
        message=found.message + _doubt(names, condition),
    )


class _Fits:
    """The fits of all curves as functions of the logarithms of constants over their guesses.

    Residuals are divided by the ``size`` of the measurements, as tolerances of SciPy are absolute.
    The last fits are kept, as SciPy asks for the Jacobian at the last point of evaluation.
    """

    def __init__(
        self, problem: Problem, start: Mapping[str, float], curves: Sequence[Curve]
    ) -> None:
        self._problem = problem
        self._names = tuple(start)
        self._guesses = np.array(list(start.values()), dtype=float)
        self._curves = curves
        weighted = [weights_of(curve) * curve.measured for curve in curves]
        self.size = float(np.linalg.norm(np.concatenate(weighted))) or 1.0
        self._at: np.ndarray | None = None
        self._last: list = []
        self.evaluations = 0

    def constants(self, logarithms: np.ndarray) -> np.ndarray:
        """The material constants."""
        return self._guesses * np.exp(logarithms)

    def fitted(self, logarithms: np.ndarray) -> Problem:
        """The problem with other material constants."""
        constants = self.constants(logarithms).tolist()
        return with_constants(
            self._problem, dict(zip(self._names, constants, strict=True))
        )

    def residuals(self, logarithms: np.ndarray) -> np.ndarray:
        """The residuals of all curves."""
        each = [residuals for residuals, _ in self._fits(logarithms)]
        return np.concatenate(each) / self.size

    def jacobian(self, logarithms: np.ndarray) -> np.ndarray:
        """The derivatives of the residuals by the logarithms."""
        fits = self._fits(logarithms)
        by_constants = [slopes(self._names) for _, slopes in fits]
        return np.concatenate(by_constants) * self.constants(logarithms) / self.size

    def _fits(self, logarithms: np.ndarray) -> list:
        """The fit of each curve."""
        if self._at is None or not np.array_equal(self._at, logarithms):
            problem = self.fitted(logarithms)
            self._last = [curve.fit(problem) for curve in self._curves]
            self._at = logarithms.copy()
            self.evaluations += 1
        return self._last


def _doubt(names: Sequence[str], condition: float) -> str:
    """A message if the data do not identify all constants; otherwise empty."""
    if condition <= ILL_CONDITIONED:
        return ""
    matrix = f"the condition number of the Gauss-Newton matrix is {condition:.2g}."
    which = names[0] if len(names) == 1 else f"all of {', '.join(names)}"
    return f" The data do not identify {which}: {matrix}"


def _checked(
    start: Mapping, curves: Sequence[Curve]
) -> tuple[tuple[str, ...], Sequence[Curve]]:
    """Names of material constants with positive guesses, and curves that have as many values."""
    require_mapping("start", start, "material constant -> first guess")
    for name, guess in start.items():
        require_text("start", name)
        if name not in MATERIAL and not is_of_part(name):
            legal = ", ".join([*MATERIAL, *(f"{part}.<datum>" for part in PARTS)])
            raise ValueError(f"start names {name!r}: one of {legal} is needed")
        require_number(f"start[{name!r}]", guess, 0, strict=True)
    require_sequence("curves", curves, "Curve objects")
    for number, curve in enumerate(curves):
        require_instance(f"curves[{number}]", curve, Curve, "Curve(...)")
    count = sum(len(curve.measured) for curve in curves)
    if count < len(start):
        raise ValueError(
            f"curves={curves!r}: no fewer measurements than parameters, {len(start)}, are needed"
        )
    return tuple(start), curves


def _statistics(
    slopes: np.ndarray, residuals: np.ndarray, confidence: float, known: bool
) -> tuple[float, np.ndarray]:
    """Condition of J' J for the ``slopes`` J, and the ends of intervals over the constants, (2, n).

    They belong to the problem linearised at the solution; noise that is not ``known`` is estimated
    from the residuals.
    """
    m, n = slopes.shape
    _, singular, right = np.linalg.svd(slopes, full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        condition = (
            float((singular[0] / singular[-1]) ** 2) if singular[-1] > 0 else np.inf
        )
        error = np.sqrt(
            np.nan_to_num((right / singular[:, None]) ** 2, posinf=np.inf).sum(0)
        )
        factor = special.ndtri(0.5 + confidence / 2)
        # the noise cannot be estimated from as many measurements as constants
        if not known:
            error = (
                error * np.linalg.norm(residuals) / np.sqrt(m - n)
                if m > n
                else np.full(n, np.inf)
            )
            factor = special.stdtrit(max(m - n, 1), 0.5 + confidence / 2)
        return condition, np.exp(np.outer([-1, 1], factor * error))
