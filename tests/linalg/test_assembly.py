"""Sums of sparse blocks by their lower triangles, against dense matrices."""

import numpy as np
import pytest

from ngepc.linalg.assembly import Placed, SparseSum, from_entries

SIZE, FIRST = 12, 5


def symmetric(size: int, seed: int):
    """A sparse symmetric matrix by its lower triangle, and the same, dense."""
    generator = np.random.default_rng(seed)
    dense = generator.standard_normal((size, size)) * (generator.random((size, size)) < 0.4)
    dense = np.tril(dense) + np.eye(size)
    rows, columns = np.nonzero(dense)
    lower = from_entries(rows, columns, dense[rows, columns], size, size)
    return lower, dense + np.tril(dense, -1).T


def mirrored(total: SparseSum) -> np.ndarray:
    lower = np.tril(np.array([[total.matrix[i, j] for j in range(SIZE)] for i in range(SIZE)]))
    return lower + np.tril(lower, -1).T


@pytest.fixture
def total():
    """A block on top of a large matrix, and the dense sum."""
    (large, dense), (block, small) = symmetric(SIZE, 1), symmetric(4, 2)
    result = SparseSum(large, [Placed(block, FIRST)])
    result.entries[:] = 0.0
    result.add(Placed(large))
    result.add(Placed(block, FIRST), 3.0)
    dense[FIRST : FIRST + 4, FIRST : FIRST + 4] += 3.0 * small
    return result, dense


def test_blocks_are_added_where_they_stand(total):
    assert mirrored(total[0]) == pytest.approx(total[1])


def test_rows_and_columns_multiply_and_become_those_of_the_identity(total):
    sparse, dense = total
    dofs, x, y = np.array([2, 6, 7]), np.arange(1.0, SIZE + 1), np.ones(SIZE)
    cross, outside = sparse.cross(dofs), np.setdiff1d(np.arange(SIZE), dofs)
    within = dense.copy()
    within[np.ix_(outside, outside)] = 0.0
    values = cross.values()
    cross.decouple(dofs[1:])
    cross.add_product(values, x, y)
    assert y == pytest.approx(1.0 + within @ x)
    dense[dofs[1:]], dense[:, dofs[1:]] = 0.0, 0.0
    dense[dofs[1:], dofs[1:]] = 1.0
    assert mirrored(sparse) == pytest.approx(dense)
