"""The semismooth Newton method in lambda and in v; what the line search buys."""

from itertools import pairwise

import numpy as np
import pytest

from ngepc import (
    Armijo,
    Coupled,
    NewtonOptions,
    Status,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.newton import prepared
from ngepc.dual.tichonov import Fractional, FullProduct
from ngepc.geometries import lshape, wrench
from ngepc.theory.lambda_newton import (
    MultiplierEquation,
    compare_algorithms,
    newton_in_lambda,
    newton_in_v,
)

FULL_STEPS = NewtonOptions(linesearch=None, quadrature_points=49, max_iterations=60)
GLOBALISED = NewtonOptions(linesearch=Armijo(), quadrature_points=49, max_iterations=60)


def lshape_225():
    return lshape_problem(lshape.paper_mesh(225))


CASES = {
    "L-shape, gamma = 1e2": lambda: (lshape_225(), Coupled(1e2)),
    "L-shape, gamma = 1e3": lambda: (lshape_225(), Coupled(1e3)),
    "L-shape, full product": lambda: (lshape_225(), Coupled(1e3, tichonov=FullProduct())),
    "L-shape, (R1)": lambda: (lshape_225(), Coupled(1e3, tichonov=Fractional())),
    "L-shape, shifts": lambda: (
        lshape_225(),
        Coupled(1e3, contact_shift=0.01, plastic_shift=0.1),
    ),
    "wrench, gamma = 1e2": lambda: (wrench_problem(wrench.paper_mesh(245)), Coupled(1e2)),
}


@pytest.mark.parametrize("name", CASES)
def test_both_algorithms_have_the_same_iterates(name):
    """V(lambda^j) = v^j to rounding in every step, up to the solution."""
    rows = compare_algorithms(*CASES[name](), options=FULL_STEPS)
    assert len(rows) > 2
    assert max(row["difference"] for row in rows) < 1e-8
    for row in rows:  # gamma times the distance of v: wild steps lose digits here first
        assert row["residual_norm_lambda"] == pytest.approx(
            row["residual_norm_v"], rel=1e-6, abs=1e-11
        )
    assert rows[-1]["residual_norm_v"] < 1e-10


def test_full_steps_are_algorithm_68():
    """``linesearch=None`` in semismooth_newton runs Algorithm 6.8: same residuals, same end."""
    problem, regularisation = CASES["L-shape, gamma = 1e3"]()
    in_v = newton_in_v(problem, regularisation, options=FULL_STEPS)
    result = semismooth_newton(problem, options=FULL_STEPS, regularisation=regularisation)
    assert in_v.status is result.status is Status.CONVERGED
    assert result.history.residual_norms == pytest.approx(in_v.residual_norms, rel=1e-12)
    assert result.history.halvings == 0


def test_start_is_carried_over():
    """From the solution of a smaller gamma both algorithms need fewer steps, the same ones."""
    problem = lshape_225()
    start = semismooth_newton(problem, 5e2, options=GLOBALISED)
    cold = newton_in_lambda(problem, Coupled(1e3), options=FULL_STEPS)
    warm = newton_in_lambda(problem, Coupled(1e3), start, FULL_STEPS)
    assert warm.status is cold.status is Status.CONVERGED
    assert warm.iterations < cold.iterations
    assert warm.residual_norms[0] < 0.5 * cold.residual_norms[0]
    in_v = newton_in_v(problem, Coupled(1e3), start, FULL_STEPS)
    assert max(warm.distance(in_v, j) for j in range(warm.iterations + 1)) < 1e-8


@pytest.fixture(scope="module")
def equation():
    problem, regularisation = CASES["L-shape, gamma = 1e3"]()
    return MultiplierEquation(prepared(problem, regularisation, FULL_STEPS), "sparsecholesky")


def functional_on_H(equation, seed, size=1.0):
    r = equation.blocks.H_vector()
    random = np.random.default_rng(seed).standard_normal(len(r))
    r.FV().NumPy()[:] = size * random * np.array(equation.blocks.H.FreeDofs())
    return r


def dual_norm(equation, r):
    return equation.functional.residual_norms(r).total


def test_N_inverse_undoes_N(equation):
    r = functional_on_H(equation, 1)
    difference = (equation.N(equation.N_inverse(r)) - r).Evaluate()
    assert dual_norm(equation, difference) < 1e-10 * dual_norm(equation, r)


def test_multiplier_and_dual_are_inverse_maps(equation):
    v = functional_on_H(equation, 2)
    back = equation.dual(equation.multiplier(v))
    back -= v
    assert back.Norm() < 1e-10 * v.Norm()


def test_step_solves_its_equation(equation):
    """(6.4): delta + G_M N^(-1) delta = -Psi, with N^(-1) from a factorisation of its own."""
    v = functional_on_H(equation, 3, 2.0)
    multiplier = equation.multiplier(v)
    psi = equation.psi(multiplier, v)
    defect = equation.derivative(v, equation.step(multiplier, v))
    defect += psi
    assert dual_norm(equation, defect) < 1e-9 * dual_norm(equation, psi)


def test_newton_derivative_in_lambda(equation):
    """G_Psi against central differences of Psi_gamma(lambda) = lambda - M(v(lambda))."""
    v, delta = functional_on_H(equation, 4, 2.0), functional_on_H(equation, 5, 1e-2)
    multiplier, step = equation.multiplier(v), 1e-6

    def psi(t):
        there = (multiplier + t * delta).Evaluate()
        return equation.psi(there, equation.dual(there))

    difference = (1 / (2 * step) * (psi(step) - psi(-step))).Evaluate()
    image = equation.derivative(v, delta)
    difference -= image
    assert dual_norm(equation, difference) < 1e-6 * dual_norm(equation, image)


@pytest.mark.parametrize("name", CASES)
def test_superlinear_convergence(name):
    """Corollary 6.7: the quotients of successive residuals fall, the last is the smallest."""
    run = newton_in_lambda(*CASES[name](), options=FULL_STEPS)
    assert run.status is Status.CONVERGED
    quotients = [b / a for a, b in pairwise(run.residual_norms)]
    assert quotients[-1] < 1e-4
    assert quotients[-1] == min(quotients)


def test_only_the_line_search_converges():
    """At gamma = 1e4 full steps jump between active sets; Armijo's rule converges."""
    full = semismooth_newton(lshape_225(), 1e4, options=FULL_STEPS)
    damped = semismooth_newton(lshape_225(), 1e4, options=GLOBALISED)
    assert full.status is Status.ITERATION_LIMIT
    assert full.residual_norm > 1e-3
    assert damped.status is Status.CONVERGED
    assert damped.iterations < 40
    assert damped.history.halvings > 0
    assert all(b <= a for a, b in pairwise(damped.history.energies[:-2]))
    assert any(b > a for a, b in pairwise(full.history.energies))


def test_a_line_search_is_refused():
    with pytest.raises(ValueError, match=r"linesearch=Armijo.*linesearch=None is needed"):
        newton_in_lambda(lshape_225(), Coupled(1.0), options=GLOBALISED)


def test_iteration_limit_is_named():
    options = NewtonOptions(linesearch=None, quadrature_points=9, max_iterations=2)
    run = newton_in_lambda(lshape_225(), Coupled(1e3), options=options)
    assert run.status is Status.ITERATION_LIMIT
    assert run.iterations == 2
