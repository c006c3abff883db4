"""Chebyshev's polynomial as a smoother: against its closed form, and the estimate of its end."""

import numpy as np
import pytest
from samples import scaled_laplacian
from scipy.special import eval_chebyt

from ngepc.linalg.chebyshev import BEYOND, DEGREE, LEAST, Chebyshev, largest_eigenvalue


@pytest.fixture
def matrix():
    return scaled_laplacian(12)


@pytest.fixture
def divide(matrix):
    diagonal = matrix.diagonal()
    return lambda r: r / diagonal


START = np.random.default_rng(0).standard_normal(144)


def exact_largest(matrix, divide):
    return np.linalg.eigvals(divide(matrix.toarray().T).T).real.max()


def test_the_largest_eigenvalue_is_found_from_below(matrix, divide):
    found = largest_eigenvalue(matrix.dot, divide, START)
    exact = exact_largest(matrix, divide)
    assert 0.95 * exact < found < exact
    assert BEYOND * found > exact


def test_all_steps_find_it_exactly(matrix, divide):
    found = largest_eigenvalue(matrix.dot, divide, START, steps=200)
    assert found == pytest.approx(exact_largest(matrix, divide), rel=1e-8)


def test_a_diagonal_matrix_has_one_eigenvalue():
    diagonal = np.linspace(1.0, 3.0, 7)
    found = largest_eigenvalue(
        lambda x: diagonal * x, lambda r: r / diagonal, START[:7]
    )
    assert found == pytest.approx(1.0, rel=1e-12)


def test_errors_are_multiplied_by_the_polynomial(matrix, divide):
    """In the basis of eigenvectors of D^-1 A, T((m - t)/h) / T(m/h)."""
    upper = BEYOND * largest_eigenvalue(matrix.dot, divide, START)
    middle = upper * (1 + LEAST) / 2
    half = upper * (1 - LEAST) / 2
    values, vectors = np.linalg.eig(divide(matrix.toarray().T).T)
    factors = eval_chebyt(DEGREE, (middle - values.real) / half)
    factors /= eval_chebyt(DEGREE, middle / half)
    smooth = Chebyshev(matrix.dot, divide, START)
    for factor, vector in zip(factors, vectors.T.real, strict=True):
        error = vector.copy()
        smooth(error, np.zeros(144))
        assert error == pytest.approx(factor * vector, abs=1e-12)
    assert np.abs(factors).max() < 1


def test_a_step_from_zero_is_symmetric_and_positive(matrix, divide):
    smooth = Chebyshev(matrix.dot, divide, START)
    columns = []
    for right in np.eye(144):
        x = np.zeros(144)
        smooth(x, right)
        y = np.zeros(144)
        smooth.from_zero(y, right)
        assert np.array_equal(x, y)
        columns.append(x)
    steps = np.array(columns)
    assert steps == pytest.approx(steps.T, abs=1e-13)
    assert np.linalg.eigvalsh(steps + steps.T).min() > 0
