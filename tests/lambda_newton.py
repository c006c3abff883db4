"""Algorithms 6.6 and 6.8: the semismooth Newton method in lambda and in v, without globalisation.

Both solve Psi_gamma(lambda) = lambda - M(v(lambda)) = 0 with v(lambda) = N_gamma^(-1)(w^ - lambda).
Algorithm 6.6 iterates on the multiplier lambda = (mu, nu) in H*, Algorithm 6.8 on v = (z, q) in H;
by v = N_gamma^(-1)(w^ - lambda) their iterates are images of each other.  Algorithm 7.1 is 6.8
with the primal variable as a further unknown, so that no inverse of D is needed, and Armijo.
"""

import math

from ngepc.dual.algorithm import NewtonSystem
from ngepc.dual.functional import DualIterate, total
from ngepc.dual.solver import prepared
from ngepc.methods.newton import semismooth_newton
from ngepc.results.options import NewtonOptions

FULL_STEPS = NewtonOptions(linesearch=None)


class MultiplierEquation:
    """Psi_gamma(lambda) = 0 of (6.2) on the discrete spaces; functionals are vectors."""

    def __init__(self, functional, inverse):
        self.functional, self.blocks = functional, functional.blocks
        self._linear, self._newton = (
            NewtonSystem(self.blocks, inverse) for _ in range(2)
        )
        self._linear.factorise(functional, None)
        self._minus_w_hat = self._affine(self.blocks.H_vector())

    def _affine(self, v):
        """N_gamma v - w^, by the condensed D that ``N_inverse`` has, roundings included."""
        right = (
            self.blocks.Lambda.T * v + self.blocks.load - self.blocks.D_lift
        ).Evaluate()
        y = (self.blocks.lift.vec + self.blocks.primal_response(right)).Evaluate()
        return self.functional.linear_residual(y, v)

    def N(self, v):
        """N_gamma v = Lambda D^(-1) Lambda* v + B v / gamma."""
        return (self._affine(v) - self._minus_w_hat).Evaluate()

    def N_inverse(self, r):
        """N_gamma^(-1) r in H_h."""
        return self._linear.solve(r)[1]

    def dual(self, multiplier):
        """v(lambda) = N_gamma^(-1)(w^ - lambda)."""
        return self.N_inverse((-self._minus_w_hat - multiplier).Evaluate())

    def multiplier(self, v):
        """The lambda with v(lambda) = v, that is w^ - N_gamma v."""
        return (-1 * self._affine(v)).Evaluate()

    def psi(self, multiplier, v):
        """Psi_gamma(lambda) = lambda - M(v) for v = v(lambda)."""
        return (multiplier - DualIterate(self.functional, v).multipliers).Evaluate()

    def step(self, multiplier, v):
        """delta of (6.4), from G_Psi = (N_gamma + G_M) N_gamma^(-1) as in Lemma 6.5."""
        self._newton.factorise(
            self.functional, DualIterate(self.functional, v).hessian()
        )
        return self.N(self._newton.solve((-1 * self.psi(multiplier, v)).Evaluate())[1])


def newton_in_lambda(functional, v, options=FULL_STEPS):
    """Algorithm 6.6 from lambda^0 = w^ - N_gamma v: each v(lambda^j) and ||Psi_gamma||_{H*}."""
    equation, iterates = MultiplierEquation(functional, options.direct_solver), []
    multiplier = equation.multiplier(v)
    while True:
        v = equation.dual(multiplier)
        norm = total(functional.residual_norms(equation.psi(multiplier, v)))
        iterates.append((v, norm))
        small = norm < options.tolerance * functional.blocks.residual_unit
        if small or not math.isfinite(norm) or len(iterates) > options.max_iterations:
            return iterates
        multiplier = (multiplier + equation.step(multiplier, v)).Evaluate()


def compare_algorithms(problem, regularisation, start=None, options=FULL_STEPS):
    """Algorithms 6.6 and 6.8 side by side: a row for each iterate, 'difference' is that in H."""
    functional, duals = prepared(problem, regularisation, options), []
    v = functional.blocks.H_vector()
    if start is not None:
        v = functional.carried(start.functional, start.v)
    in_lambda = newton_in_lambda(functional, v, options)
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
            "residual_norm_lambda": norm,
            "residual_norm_v": norms[j],
            "difference": distance(functional, v, duals[j]),
        }
        for j, (v, norm) in enumerate(in_lambda[: len(duals)])
    ]


def distance(functional, v, w):
    """||v - w||_H / ||w||_H."""
    d, size = (v - w).Evaluate(), functional.tichonov(w, w)
    return math.sqrt(functional.tichonov(d, d) / size) if size > 0 else 0.0
