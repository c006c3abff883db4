"""Krylov methods step by step."""

from itertools import islice

import numpy as np
import pytest

from ngepc.linalg import descent
from ngepc.linalg.descent import (
    conjugate_gradients,
    conjugate_gradients_by_pairs,
    minimal_residuals,
)


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
    for k, (x, _, gained) in enumerate(
        conjugate_gradients(A.dot, lambda r: r / A.diagonal(), b)
    ):
        assert before - energy(x) == pytest.approx(gained, rel=1e-9, abs=1e-13)
        before = energy(x)
        if k == 6:
            break


def test_the_inverse_as_preconditioner_takes_one_step():
    A, b = system(8)
    x, _, _ = next(conjugate_gradients(A.dot, lambda r: np.linalg.solve(A, r), b))
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-12)


def test_pairs_give_the_same_steps():
    """The preconditioner that finds the image of its result, too; x is the same array."""
    A, b = system(12)
    d = A.diagonal()
    pairs = conjugate_gradients_by_pairs(lambda r: (r / d, A @ (r / d)), b)
    steps = conjugate_gradients(A.dot, lambda r: r / d, b)
    for (x, gained), (wanted, _, same) in zip(islice(pairs, 8), steps, strict=False):
        np.testing.assert_allclose(x, wanted, rtol=1e-9)
        assert gained == pytest.approx(same, rel=1e-9)


def test_indefinite_matrices_end_the_steps():
    assert not list(conjugate_gradients(lambda x: -x, lambda r: r, np.ones(3)))
    assert not list(conjugate_gradients(lambda x: x, lambda r: -r, np.ones(3)))
    assert not list(conjugate_gradients_by_pairs(lambda r: (r, -r), np.ones(3)))
    assert not list(conjugate_gradients_by_pairs(lambda r: (-r, -r), np.ones(3)))


def test_minimal_residuals_are_the_smallest_of_their_krylov_space():
    A, b = system(12)
    A[0, :] += 3.0  # not symmetric
    scale, basis, before = 1 / A.diagonal(), [], b @ b
    steps = minimal_residuals(A.dot, lambda r: scale * r, b, np.vdot)
    for k, (x, left, lost) in zip(range(10), steps, strict=False):
        basis.append(A @ (scale * (basis[-1] if k else b)))
        least = (
            b - np.array(basis).T @ np.linalg.lstsq(np.array(basis).T, b, rcond=None)[0]
        )
        np.testing.assert_allclose(left, least, atol=1e-8)
        np.testing.assert_allclose(left, b - A @ x, atol=1e-11)
        assert before - left @ left == pytest.approx(lost, abs=1e-10)
        before = left @ left


def test_minimal_residuals_go_on_after_a_restart(monkeypatch):
    monkeypatch.setattr(descent, "KEPT", 3)
    A, b = system(12)
    A[0, :] += 3.0
    steps = minimal_residuals(A.dot, lambda r: r, b, np.vdot)
    x = next(x for x, left, _ in steps if np.linalg.norm(left) < 1e-10)
    np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=1e-8)
