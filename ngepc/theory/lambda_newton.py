"""Algorithms 6.6 and 6.8: the semismooth Newton method in lambda and in v, without globalisation.

Both solve Psi_gamma(lambda) = lambda - M(v(lambda)) = 0 with v(lambda) = N_gamma^(-1)(w^ - lambda).
Algorithm 6.6 iterates on the multiplier lambda = (mu, nu) in H*, Algorithm 6.8 on v = (z, q) in H;
by v = N_gamma^(-1)(w^ - lambda) their iterates are images of each other.  Algorithm 7.1 is 6.8
with the primal variable as a further unknown, so that no inverse of D is needed, and Armijo.
"""

from __future__ import annotations

import math

from ngsolve.la import BaseVector

from ngepc.dual.carried import carried_over
from ngepc.dual.functional import DualFunctional
from ngepc.dual.newton import NewtonOptions, prepared, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.dual.system import NewtonSystem
from ngepc.model.problem import Problem

FULL_STEPS = NewtonOptions(linesearch=None)


class MultiplierEquation:
    """Psi_gamma(lambda) = 0 of (6.2) on the discrete spaces; functionals are vectors.

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
        self._minus_w_hat = self._affine(self.blocks.H_vector())

    def _affine(self, v: BaseVector) -> BaseVector:
        """N_gamma v - w^, by the condensed D that ``N_inverse`` has, roundings included."""
        return self.functional.linear_residual(self.blocks.primal_of(v, refinements=0), v)

    def N(self, v: BaseVector) -> BaseVector:
        """N_gamma v = Lambda D^(-1) Lambda* v + B v / gamma."""
        return (self._affine(v) - self._minus_w_hat).Evaluate()

    def N_inverse(self, r: BaseVector) -> BaseVector:
        """N_gamma^(-1) r in H_h."""
        return self._linear.solve(r)[1]

    def dual(self, multiplier: BaseVector) -> BaseVector:
        """v(lambda) = N_gamma^(-1)(w^ - lambda)."""
        return self.N_inverse((-self._minus_w_hat - multiplier).Evaluate())

    def multiplier(self, v: BaseVector) -> BaseVector:
        """The lambda with v(lambda) = v, that is w^ - N_gamma v."""
        return (-1 * self._affine(v)).Evaluate()

    def psi(self, multiplier: BaseVector, v: BaseVector) -> BaseVector:
        """Psi_gamma(lambda) = lambda - M(v) for v = v(lambda)."""
        return (multiplier - self.functional.terms(v).gradient).Evaluate()

    def step(self, multiplier: BaseVector, v: BaseVector) -> BaseVector:
        """delta of (6.4), from G_Psi = (N_gamma + G_M) N_gamma^(-1) as in Lemma 6.5."""
        self._newton.factorise(self.functional.terms(v))
        return self.N(self._newton.solve((-1 * self.psi(multiplier, v)).Evaluate())[1])


def newton_in_lambda(
    functional: DualFunctional, v: BaseVector, options: NewtonOptions = FULL_STEPS
) -> list[tuple[BaseVector, float]]:
    """Algorithm 6.6 from lambda^0 = w^ - N_gamma v: each v(lambda^j) and ||Psi_gamma||_{H*}."""
    equation, iterates = MultiplierEquation(functional, options.inverse), []
    multiplier = equation.multiplier(v)
    while True:
        v = equation.dual(multiplier)
        norm = functional.residual_norms(equation.psi(multiplier, v)).total
        iterates.append((v, norm))
        small = norm < options.tolerance * functional.blocks.residual_unit
        if small or not math.isfinite(norm) or len(iterates) > options.max_iterations:
            return iterates
        multiplier = (multiplier + equation.step(multiplier, v)).Evaluate()


def compare_algorithms(
    problem: Problem,
    regularisation: Coupled,
    start: DualResult | None = None,
    options: NewtonOptions = FULL_STEPS,
) -> list[dict]:
    """Algorithms 6.6 and 6.8 side by side, one row per iterate.

    Parameters
    ----------
    problem, regularisation
        The data.
    start
        A result on this or another mesh of the body; None starts from v = 0.
    options
        Tolerance, limit, quadrature, solver; ``linesearch`` is None.

    Returns
    -------
    list of dict
        ``iteration``, ``residual_norm_lambda``, ``residual_norm_v`` and ``difference``, the
        relative distance of v(lambda^j) and v^j in H.

    Raises
    ------
    ValueError
        If a line search is asked for.
    """
    if options.linesearch is not None:
        raise ValueError(
            f"linesearch={options.linesearch!r}: Algorithms 6.6 and 6.8 take full steps, "
            "linesearch=None is needed (semismooth_newton globalises them)"
        )
    functional, duals = prepared(problem, regularisation, options), []
    in_lambda = newton_in_lambda(functional, carried_over(start, functional), options)
    result = semismooth_newton(
        problem,
        None,
        start,
        options,
        lambda record: duals.append(record.snapshot().v),
        regularisation=regularisation,
    )
    norms = result.history.residual_norms
    return [
        {
            "iteration": j,
            "residual_norm_lambda": norm,
            "residual_norm_v": norms[j],
            "difference": distance(functional, v, duals[j]),
        }
        for j, (v, norm) in enumerate(in_lambda[: len(duals)])
    ]


def distance(functional: DualFunctional, v: BaseVector, w: BaseVector) -> float:
    """||v - w||_H / ||w||_H."""
    d, size = (v - w).Evaluate(), functional.tichonov(w, w)
    return math.sqrt(functional.tichonov(d, d) / size) if size > 0 else 0.0
