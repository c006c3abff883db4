"""The semismooth Newton method in lambda and in v; what the line search buys."""

from itertools import pairwise

import numpy as np
import pytest
from lambda_newton import MultiplierEquation, compare_algorithms, newton_in_lambda

from ngepc import (
    Armijo,
    Coupled,
    NewtonOptions,
    Status,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.functional import DualIterate, total
from ngepc.dual.solver import prepared
from ngepc.dual.spaces import FullProduct
from ngepc.geometries import lshape, wrench

FULL_STEPS = NewtonOptions(linesearch=None, quadrature_points=49, max_iterations=60)
GLOBALISED = NewtonOptions(linesearch=Armijo(), quadrature_points=49, max_iterations=60)


def lshape_225():
    return lshape_problem(lshape.paper_mesh(225))


CASES = {
    "L-shape, gamma = 1e2": lambda: (lshape_225(), Coupled(1e2)),
    "L-shape, gamma = 1e3": lambda: (lshape_225(), Coupled(1e3)),
    "L-shape, full product": lambda: (
        lshape_225(),
        Coupled(1e3, tichonov=FullProduct()),
    ),
    "wrench, gamma = 1e2": lambda: (
        wrench_problem(wrench.paper_mesh(245)),
        Coupled(1e2),
    ),
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


def test_start_is_carried_over():
    """From the solution of a smaller gamma both algorithms need fewer steps, the same ones."""
    problem = lshape_225()
    start = semismooth_newton(problem, 5e2, options=GLOBALISED)
    cold, warm = (
        compare_algorithms(problem, Coupled(1e3), begin, FULL_STEPS)
        for begin in (None, start)
    )
    assert len(warm) < len(cold)
    assert warm[0]["residual_norm_lambda"] < 0.5 * cold[0]["residual_norm_lambda"]
    assert max(row["difference"] for row in warm) < 1e-8


@pytest.fixture(scope="module")
def equation():
    problem, regularisation = CASES["L-shape, gamma = 1e3"]()
    return MultiplierEquation(
        prepared(problem, regularisation, FULL_STEPS), "sparsecholesky"
    )


def functional_on_H(equation, seed, size=1.0):
    r = equation.blocks.H_vector()
    random = np.random.default_rng(seed).standard_normal(len(r))
    r.FV().NumPy()[:] = size * random * np.array(equation.blocks.H.FreeDofs())
    return r


def derivative(equation, v, delta):
    """G_Psi(lambda) delta = delta + G_M(v) N_gamma^(-1) delta for v = v(lambda)."""
    hessian = DualIterate(equation.functional, v).hessian()
    return (delta + hessian * equation.N_inverse(delta)).Evaluate()


def dual_norm(equation, r):
    return total(equation.functional.residual_norms(r))


def test_N_inverse_undoes_N(equation):
    r = functional_on_H(equation, 1)
    difference = (equation.N(equation.N_inverse(r)) - r).Evaluate()
    assert dual_norm(equation, difference) < 1e-10 * dual_norm(equation, r)


def test_multiplier_and_dual_are_inverse_maps(equation):
    v = functional_on_H(equation, 2)
    back = equation.dual(equation.multiplier(v))
    back -= v
    assert back.Norm() < 1e-10 * v.Norm()


def test_psi_is_minus_the_derivative_of_the_energy(equation):
    """Proof of Proposition 6.9: the gradient that Algorithm 7.1 has is -Psi_gamma of (6.2)."""
    v = functional_on_H(equation, 6, 2.0)
    psi = equation.psi(equation.multiplier(v), v)
    defect = (psi + DualIterate(equation.functional, v).residual).Evaluate()
    assert dual_norm(equation, defect) < 1e-9 * dual_norm(equation, psi)


def test_step_solves_its_equation(equation):
    """(6.4): delta + G_M N^(-1) delta = -Psi, with N^(-1) from a factorisation of its own."""
    v = functional_on_H(equation, 3, 2.0)
    multiplier = equation.multiplier(v)
    psi = equation.psi(multiplier, v)
    defect = derivative(equation, v, equation.step(multiplier, v))
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
    image = derivative(equation, v, delta)
    difference -= image
    assert dual_norm(equation, difference) < 1e-6 * dual_norm(equation, image)


@pytest.mark.parametrize("name", CASES)
def test_superlinear_convergence(name):
    """Corollary 6.7: the quotients of successive residuals fall, the last is the smallest."""
    functional = prepared(*CASES[name](), FULL_STEPS)
    norms = [
        n
        for _, n in newton_in_lambda(
            functional, functional.blocks.H_vector(), FULL_STEPS
        )
    ]
    quotients = [b / a for a, b in pairwise(norms)]
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


def test_iteration_limit_ends_both():
    options = NewtonOptions(linesearch=None, quadrature_points=9, max_iterations=2)
    assert len(compare_algorithms(lshape_225(), Coupled(1e3), options=options)) == 3
