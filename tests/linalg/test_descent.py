"""Conjugate gradients step by step."""

import numpy as np
import pytest

from ngepc.linalg.descent import conjugate_gradients


def system(n):
    """A positive definite matrix with n different eigenvalues, and a right side."""
    rng = np.random.default_rng(n)
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return Q @ np.diag(np.arange(1.0, n + 1)) @ Q.T, rng.normal(size=n)


@pytest.mark.parametrize("n", [1, 5, 12])
def test_n_steps_solve_n_equations(n):
    A, b = system(n)
    steps = list(conjugate_gradients(A.dot, lambda r: r, b))
    x, left, _ = steps[n - 1]
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-10)
    np.testing.assert_allclose(left, b - A @ x, atol=1e-12)


def test_each_step_says_by_how_much_the_energy_fell():
    A, b = system(8)
    energy, before = (lambda x: x @ A @ x / 2 - b @ x), 0.0
    for k, (x, _, gained) in enumerate(conjugate_gradients(A.dot, lambda r: r / A.diagonal(), b)):
        assert before - energy(x) == pytest.approx(gained, rel=1e-9, abs=1e-13)
        before = energy(x)
        if k == 6:
            break


def test_the_inverse_as_preconditioner_takes_one_step():
    A, b = system(8)
    x, _, _ = next(conjugate_gradients(A.dot, lambda r: np.linalg.solve(A, r), b))
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-12)


def test_indefinite_matrices_end_the_steps():
    assert not list(conjugate_gradients(lambda x: -x, lambda r: r, np.ones(3)))
    assert not list(conjugate_gradients(lambda x: x, lambda r: -r, np.ones(3)))
