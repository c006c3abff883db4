"""V-cycles: symmetric and positive, sweeps against matrices, products by halves."""

import numpy as np
import pytest
from samples import scaled_laplacian
from scipy.sparse import csr_matrix, tril
from scipy.sparse.linalg import splu, spsolve_triangular

from ngepc.linalg import cycle
from ngepc.linalg.cores import crew
from ngepc.linalg.cycle import (
    Level,
    Product,
    coarsest_solver,
    from_the_end,
    level_and_coarser,
    v_cycle,
)

amg_core = pytest.importorskip("pyamg").amg_core
SWEEP = amg_core.gauss_seidel


@pytest.fixture
def matrix():
    return scaled_laplacian(12)


@pytest.fixture
def space():
    coarse = np.arange(144) // 3
    return csr_matrix((np.ones(144), (np.arange(144), coarse)), shape=(144, 48))


def test_forwards_is_gauss_seidel(matrix, space):
    random = np.random.default_rng(0)
    x = random.standard_normal(144)
    right = random.standard_normal(144)
    expected = x.copy()
    for _ in range(cycle.SWEEPS):
        rest = right - matrix @ expected
        expected = expected + spsolve_triangular(tril(matrix).tocsr(), rest)
    Level(matrix, space, space.T.tocsr(), SWEEP).forwards(x, right)
    assert x == pytest.approx(expected, abs=1e-13)


def test_the_cycle_is_symmetric_and_positive(matrix, space):
    level = Level(matrix, space, space.T.tocsr(), SWEEP)
    coarse = splu((space.T @ matrix @ space).tocsc()).solve
    cycles = np.array([v_cycle([level], coarse, e) for e in np.eye(144)])
    assert cycles == pytest.approx(cycles.T, abs=1e-13)
    error = np.linalg.eigvals(cycles @ matrix.toarray())
    assert error.real.min() > 0
    assert error.real.max() < 1 + 1e-12


def test_threads_do_not_change_a_digit(matrix, space, monkeypatch):
    monkeypatch.setattr(cycle, "LARGE", 100)
    level = Level(matrix, space, space.T.tocsr(), SWEEP)
    coarse = splu((space.T @ matrix @ space).tocsc()).solve
    r = np.random.default_rng(1).standard_normal(144)
    alone = v_cycle([level], coarse, r)
    with crew(2):
        assert np.array_equal(v_cycle([level], coarse, r), alone)


@pytest.mark.parametrize("large", [100, 1000])
def test_the_next_matrix_is_galerkin_s(matrix, space, large, monkeypatch):
    monkeypatch.setattr(cycle, "LARGE", large)
    space = space.tobsr((3, 1))
    restriction = space.T

    def make(*given):
        return Level(*given, SWEEP)

    with crew(2):
        level, coarser = level_and_coarser(make, matrix, space, restriction)
    assert level.space is space
    assert np.array_equal(coarser.toarray(), (restriction @ matrix @ space).toarray())


def test_unknowns_without_entries_stay_zero(matrix):
    padded = csr_matrix((matrix.data, matrix.indices, matrix.indptr), (144, 144))
    padded.resize(150, 150)
    right = np.random.default_rng(4).standard_normal(150)
    x = coarsest_solver(padded)(right)
    assert (x[144:] == 0).all()
    assert matrix @ x[:144] == pytest.approx(right[:144], abs=1e-12)


def test_numbers_from_the_end(matrix):
    turned = from_the_end(matrix).toarray()
    assert np.array_equal(turned, matrix.toarray()[::-1, ::-1])


def test_products_by_halves_follow_values_that_change(matrix, monkeypatch):
    monkeypatch.setattr(cycle, "LARGE", 100)
    x = np.random.default_rng(2).standard_normal(144)
    product = Product(matrix)
    assert np.array_equal(product @ x, matrix @ x)
    matrix.data *= 2.0
    assert np.array_equal(product @ x, matrix @ x)
