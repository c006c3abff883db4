"""Coarse spaces of multigrid: aggregates, modes, and what they do for conjugate gradients."""

import numpy as np
import pytest
from scipy.sparse import diags, eye, kron
from scipy.sparse.linalg import LinearOperator, cg, splu

from ngepc.linalg.aggregation import aggregates, coarse_spaces, tentative


def grid_laplacian(n):
    line = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(n, n))
    return (kron(line, eye(n)) + kron(eye(n), line)).tocsr()


def graph_of(matrix):
    return (matrix != 0).astype(np.int32).tocsr()


def test_every_coupled_node_is_in_one_aggregate_with_a_neighbour():
    matrix = grid_laplacian(20).tolil()
    matrix[7], matrix[:, 7] = 0, 0
    matrix[7, 7] = 1
    graph = graph_of(matrix.tocsr())
    number = aggregates(graph)
    assert number[7] == -1
    assert (np.delete(number, 7) >= 0).all()
    sizes = np.bincount(number[number >= 0])
    assert sizes.min() >= 3
    assert len(sizes) < 400 / 4


def test_coarse_functions_are_orthonormal_and_give_back_the_modes():
    rng = np.random.default_rng(1)
    number = rng.integers(0, 12, 200)
    modes = np.column_stack([np.ones(200), rng.standard_normal((200, 2))])
    modes[number == 3, 2] = 2 * modes[number == 3, 1]  # dependent there: left out
    plain, coarse, aggregate = tentative(number, modes)
    assert plain.shape == (200, 12 * 3 - 1)
    assert (plain.T @ plain).toarray() == pytest.approx(np.eye(35), abs=1e-12)
    assert plain @ coarse == pytest.approx(modes, abs=1e-12)
    assert np.bincount(aggregate).tolist() == [3, 3, 3, 2, *8 * [3]]


def iterations(n):
    """Conjugate gradients with two Jacobi steps and the coarse spaces, both times."""
    matrix, count = grid_laplacian(n), []
    spaces = coarse_spaces(matrix, np.ones((n * n, 1)), graph_of(matrix))
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


def test_order_two_has_a_first_level_of_its_own():
    matrix = grid_laplacian(30)
    modes = np.ones((900, 1))
    modes[600:] = 0
    spaces = coarse_spaces(matrix, modes, graph_of(matrix))
    assert (spaces[0] != eye(900, 600)).nnz == 0
    assert spaces[1].shape[0] == 600
