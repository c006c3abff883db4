"""Rules of the cells and parts: products of linear and of quadratic functions are exact."""

import math

import numpy as np
import pytest

from ngepc.bounds.polynomials import AT_POINTS, RULE, SIX, TO_NODES, WEIGHTS


@pytest.mark.parametrize("k", [3, 4])
def test_products_of_linear_functions(k):
    """Of the hat functions of a triangle or tetrahedron: (1 + delta) / (N + 1) (N + 2)."""
    mass = RULE[k].T @ (WEIGHTS[k][:, None] * RULE[k])
    N = k - 1
    expected = (1 + np.eye(k)) / ((N + 1) * (N + 2))
    np.testing.assert_allclose(mass, expected, rtol=1e-13)
    np.testing.assert_allclose(RULE[k].sum(axis=1), 1.0, rtol=1e-14)


def test_six_points_have_degree_four():
    """Powers of barycentric coordinates: 2 a! b! c! / (a + b + c + 2)!."""
    assert WEIGHTS[6].sum() == pytest.approx(1.0, rel=1e-14)
    for a in range(5):
        for b in range(5 - a):
            for c in range(5 - a - b):
                values = np.prod(SIX ** np.array([a, b, c]), axis=1)
                exact = 2 * math.prod(map(math.factorial, (a, b, c)))
                exact /= math.factorial(a + b + c + 2)
                assert WEIGHTS[6] @ values == pytest.approx(exact, rel=1e-12)


def test_points_of_parts_lie_in_them():
    """Barycentric coordinates of the cell from those of its parts."""
    for shares in (*AT_POINTS.values(), *TO_NODES.values()):
        assert shares.shape in ((18, 3), (16, 4))
        assert (shares >= 0).all()
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-14)
