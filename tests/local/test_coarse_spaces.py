"""Coarse spaces of multigrid by PyAMG: what they do for conjugate gradients."""

import numpy as np
import pytest
from samples import grid_laplacian
from scipy.sparse.linalg import LinearOperator, cg, splu

from ngepc.local.pyamg import coarse_spaces

pytest.importorskip("pyamg")


def iterations(n):
    """Conjugate gradients with two Jacobi steps and the coarse spaces, both times."""
    matrix, count = grid_laplacian(n), []
    spaces = coarse_spaces(matrix, np.ones((n * n, 1)), 1)
    levels = [matrix]
    for space in spaces:
        levels.append((space.T @ levels[-1] @ space).tocsr())
    coarsest = splu(levels[-1].tocsc())

    def cycle(r, level=0):
        if level == len(spaces):
            return coarsest.solve(r)
        A, P = levels[level], spaces[level]
        x = 0.6 * r / A.diagonal()
        x = x + P @ cycle(P.T @ (r - A @ x), level + 1)
        return x + 0.6 * (r - A @ x) / A.diagonal()

    operator = LinearOperator(matrix.shape, cycle)
    right = np.random.default_rng(2).standard_normal(n * n)
    cg(matrix, right, M=operator, callback=count.append)
    return len(count)


def test_iterations_do_not_grow_with_the_grid():
    assert iterations(40) <= 20
    assert iterations(120) <= iterations(40) + 4
