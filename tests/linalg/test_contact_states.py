"""Parts of the enumeration of contact states; as a whole ``test_friction.py`` tests it."""

import numpy as np
import pytest

from ngepc.linalg.contact_states import _inverses, _solution


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_inverses_of_small_matrices(signs):
    """Regular ones are inverted, however small; those singular but for rounding become NaN."""
    random = np.random.default_rng(0)
    matrices = random.normal(size=(50, 2, 2)) * 10.0 ** random.integers(
        -9, 9, (50, 1, 1)
    )
    found = _inverses(matrices)
    np.testing.assert_allclose(
        found @ matrices, np.tile(np.eye(2), (50, 1, 1)), atol=1e-9
    )
    first, second = signs
    for near, singular in ((1e-12, True), (1e-8, False)):
        row = np.array([first * 1.0, second * 3.0])
        twice = -2 * row
        matrix = np.array([row, twice + np.array([0.0, near])])
        for one in (matrix, matrix[::-1], matrix.T, 1e-12 * matrix):
            assert np.isnan(_inverses(one[None])).all() == singular


def test_a_singular_system_has_no_solution():
    A = np.array([[1.0, 2.0], [2.0, 4.0]])
    assert np.isnan(_solution(A, np.ones(2))).all()
    np.testing.assert_allclose(
        _solution(A + np.eye(2), np.ones(2)), [0.5, 0.0], atol=1e-15
    )
