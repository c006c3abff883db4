"""Aggregates of nodes, and the modes on them."""

import numpy as np
import pytest
from samples import grid_laplacian

from ngepc.linalg.aggregation import aggregates, tentative


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
