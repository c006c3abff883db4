"""Algorithms 6.6 and 6.8: the semismooth Newton method in lambda and in v, without globalisation.

Both solve Psi_gamma(lambda) = lambda - M(v(lambda)) = 0 with v(lambda) = N_gamma^(-1)(w^ - lambda).
Algorithm 6.6 iterates on the multiplier lambda = (mu, nu) in H*, Algorithm 6.8 on v = (z, q) in H;
by v = N_gamma^(-1)(w^ - lambda) their iterates are images of each other.  Algorithm 7.1 is 6.8
with the primal variable as a further unknown, so that no inverse of D is needed, and Armijo.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from ngsolve.la import BaseVector

from ngepc.dual.carried import carried_over
from ngepc.dual.functional import DualFunctional
from ngepc.dual.newton import NewtonOptions, prepared, semismooth_newton
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.dual.system import NewtonSystem
from ngepc.model.problem import Problem
from ngepc.results.outcome import Status

FULL_STEPS = NewtonOptions(linesearch=None)


class MultiplierEquation:
    """Psi_gamma(lambda) = 0 of (6.2) on the discrete spaces, with its Newton derivative.

    Functionals are vectors of their values on the basis of H_h.

    Parameters
    ----------
    functional
        J*_gamma with its spaces.
    inverse
        NGSolve's name of the direct solver.
    """

    def __init__(self, functional: DualFunctional, inverse: str) -> None:
        self.functional, self.blocks = functional, functional.blocks
        self._linear, self._newton = (NewtonSystem(functional, inverse) for _ in range(2))
        self._linear.factorise(None)
        zero = self.blocks.H_vector()
        self._minus_w_hat = functional.linear_residual(self._primal(zero), zero)

    def _primal(self, v: BaseVector) -> BaseVector:
        """D^(-1)(Lambda* v - l) by the condensed D that ``N_inverse`` has, roundings included."""
        y = self.blocks.Y_vector()
        self.blocks.primal_of(v, y, refinements=0)
        return y

    def N(self, v: BaseVector) -> BaseVector:
        """N_gamma v = Lambda D^(-1) Lambda* v + B v / gamma."""
        image = self.functional.linear_residual(self._primal(v), v)
        image -= self._minus_w_hat
        return image

    def N_inverse(self, r: BaseVector) -> BaseVector:
        """N_gamma^(-1) r in H_h."""
        return self._linear.solve(r)[1]

    def dual(self, multiplier: BaseVector) -> BaseVector:
        """v(lambda) = N_gamma^(-1)(w^ - lambda)."""
        return self.N_inverse((-self._minus_w_hat - multiplier).Evaluate())

    def multiplier(self, v: BaseVector) -> BaseVector:
        """The lambda with v(lambda) = v, that is w^ - N_gamma v."""
        return (-self._minus_w_hat - self.N(v)).Evaluate()

    def psi(self, multiplier: BaseVector, v: BaseVector) -> BaseVector:
        """Psi_gamma(lambda) = lambda - M(v) for v = v(lambda)."""
        return (multiplier - self.functional.terms(v).gradient).Evaluate()

    def derivative(self, v: BaseVector, delta: BaseVector) -> BaseVector:
        """G_Psi(lambda) delta = delta + G_M(v) N_gamma^(-1) delta for v = v(lambda)."""
        w, image = self.N_inverse(delta), delta.CreateVector()
        image.data = delta
        part_of = self.blocks.part_of
        for name, M in self.functional.terms(v).by_part.items():
            part_of(image, name).data += M.hessian() * part_of(w, name)
        return image

    def step(self, multiplier: BaseVector, v: BaseVector) -> BaseVector:
        """delta of (6.4), from G_Psi = (N_gamma + G_M) N_gamma^(-1) as in Lemma 6.5."""
        self._newton.factorise(self.functional.terms(v))
        minus_psi = (-1 * self.psi(multiplier, v)).Evaluate()
        return self.N(self._newton.solve(minus_psi)[1])


@dataclass(frozen=True, eq=False)
class Iterates:
    """The iterates of Algorithm 6.6 or 6.8, start included.

    Parameters
    ----------
    functional
        J*_gamma with its spaces.
    duals
        v^j; for Algorithm 6.6 the v(lambda^j).
    multipliers
        lambda^j in H*; empty for Algorithm 6.8.
    residual_norms
        ||Psi_gamma(lambda^j)||_{H*}.
    status
        CONVERGED, ITERATION_LIMIT or NONFINITE.
    """

    functional: DualFunctional
    duals: list[BaseVector] = field(default_factory=list)
    multipliers: list[BaseVector] = field(default_factory=list)
    residual_norms: list[float] = field(default_factory=list)
    status: Status = Status.ITERATION_LIMIT

    @property
    def iterations(self) -> int:
        """Newton steps done."""
        return len(self.duals) - 1

    def distance(self, other: Iterates, j: int) -> float:
        """||v^j - w^j||_H / ||w^j||_H to the iterate j of another run on the same spaces."""
        v, w = self.duals[j], other.duals[j]
        d = (v - w).Evaluate()
        size = self.functional.tichonov(w, w)
        return math.sqrt(self.functional.tichonov(d, d) / size) if size > 0 else 0.0


def newton_in_lambda(
    problem: Problem,
    regularisation: Coupled,
    start: DualResult | None = None,
    options: NewtonOptions = FULL_STEPS,
) -> Iterates:
    """Algorithm 6.6, from lambda^0 = w^ - N_gamma v^0 for the v^0 of ``start`` (None: 0).

    Parameters
    ----------
    problem, regularisation
        The data.
    start
        A result on this or another mesh of the body.
    options
        Tolerance, limit, quadrature, solver; ``linesearch`` must be None.

    Raises
    ------
    ValueError
        If a line search is asked for.
    """
    _require_full_steps(options)
    functional = prepared(problem, regularisation, options)
    v = functional.blocks.H_vector() if start is None else carried_over(start, functional)
    equation = MultiplierEquation(functional, options.inverse)
    run, multiplier = Iterates(functional), equation.multiplier(v)
    while True:
        v = equation.dual(multiplier)
        norm = functional.residual_norms(equation.psi(multiplier, v)).total
        run.duals.append(v)
        run.multipliers.append(multiplier)
        run.residual_norms.append(norm)
        status = _ended(run, options)
        if status is not None:
            return replace(run, status=status)
        multiplier = (multiplier + equation.step(multiplier, v)).Evaluate()


def newton_in_v(
    problem: Problem,
    regularisation: Coupled,
    start: DualResult | None = None,
    options: NewtonOptions = FULL_STEPS,
) -> Iterates:
    """Algorithm 6.8 through (7.1), all iterates kept; arguments as for ``newton_in_lambda``."""
    _require_full_steps(options)
    duals: list[BaseVector] = []
    result = semismooth_newton(
        problem,
        None,
        start,
        options,
        lambda record: duals.append(record.snapshot().v),
        regularisation=regularisation,
    )
    norms = result.history.residual_norms
    return Iterates(result.functional, duals, [], norms, result.status)


def compare_algorithms(
    problem: Problem,
    regularisation: Coupled,
    start: DualResult | None = None,
    options: NewtonOptions = FULL_STEPS,
) -> list[dict]:
    """Algorithms 6.6 and 6.8 side by side, one row per iterate.

    Returns
    -------
    list of dict
        ``iteration``, ``residual_norm_lambda``, ``residual_norm_v`` and ``difference``, the
        relative distance of v(lambda^j) and v^j in H.
    """
    in_lambda = newton_in_lambda(problem, regularisation, start, options)
    in_v = newton_in_v(problem, regularisation, start, options)
    return [
        {
            "iteration": j,
            "residual_norm_lambda": in_lambda.residual_norms[j],
            "residual_norm_v": in_v.residual_norms[j],
            "difference": in_lambda.distance(in_v, j),
        }
        for j in range(min(in_lambda.iterations, in_v.iterations) + 1)
    ]


def _require_full_steps(options: NewtonOptions) -> None:
    if options.linesearch is not None:
        raise ValueError(
            f"linesearch={options.linesearch!r}: Algorithms 6.6 and 6.8 take full steps, "
            "linesearch=None is needed (semismooth_newton globalises them)"
        )


def _ended(run: Iterates, options: NewtonOptions) -> Status | None:
    if not math.isfinite(run.residual_norms[-1]):
        return Status.NONFINITE
    if run.residual_norms[-1] < options.tolerance * run.functional.residual_unit:
        return Status.CONVERGED
    return Status.ITERATION_LIMIT if run.iterations == options.max_iterations else None
