"""The small problems of contact and their compliance, against dense linear algebra."""

import itertools
from functools import partial

import numpy as np
import pytest

from ngepc.linalg.box import in_box
from ngepc.linalg.friction import FrictionCone
from ngepc.linalg.secants import Compliance, in_same_state, solve_by_secants


def spd(rng, n, condition):
    """A random symmetric positive definite matrix."""
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (Q * np.geomspace(1, condition, n)) @ Q.T


def known(S):
    """A compliance that has learned all of S."""
    W = Compliance(np.ones(len(S)))
    for e in np.eye(len(S)):
        W.learn(e, S @ e)
    return W


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_compliance_knows_what_it_has_learned_and_stays_positive(rng):
    S, T = spd(rng, 12, 1e4), spd(rng, 12, 1e2)
    W = Compliance(np.ones(12))
    for matrix in (T, S):
        W.restart()
        learned = rng.normal(size=(5, 12))
        assert all(W.learn(v, matrix @ v) for v in learned)
        assert np.array([W @ v for v in learned]) == pytest.approx(
            learned @ matrix, rel=1e-9
        )
        assert not W.learn(
            learned[0] - 2 * learned[3], matrix @ (learned[0] - 2 * learned[3])
        )
    dense = W.block(np.ones(12, dtype=bool))
    assert dense @ learned[1] == pytest.approx(W @ learned[1])
    assert np.linalg.eigvalsh(dense).min() > 0


def test_a_force_that_moves_nothing_has_the_largest_compliance(rng):
    """A compliance that is known from the start is symmetric; its zero rows leave it definite."""
    S = np.zeros((6, 6))
    S[2:, 2:] = 0.01 * spd(rng, 4, 10.0)
    skew = 1e-3 * np.triu(S, 1)
    W = Compliance.of(S + skew - skew.T)
    expected = S + np.diag([S.diagonal().max()] * 2 + [0.0] * 4)
    np.testing.assert_allclose(W.block(np.arange(6)), expected, rtol=1e-14)


def test_a_compliance_that_has_learned_much_is_the_same_matrix_and_stays_definite(rng):
    S = spd(rng, 8, 1e3)
    W = Compliance(np.ones(8))
    for _ in range(3):
        for v in rng.normal(size=(4, 8)):
            W.learn(v, S @ v)
        before = W.block(np.arange(8))
        W.restart()
        assert W.block(np.arange(8)) == pytest.approx(before, rel=1e-12)
        assert np.linalg.eigvalsh(W.block(np.arange(8))).min() > 0
        assert W.copy() @ v == pytest.approx(W @ v, rel=1e-14)


@pytest.mark.parametrize("condition", [1e1, 1e5])
def test_exchange_meets_the_conditions(rng, condition):
    for n in (1, 3, 20, 60):
        W = known(spd(rng, n, condition))
        gaps, forces = rng.normal(size=n), np.maximum(rng.normal(size=n), 0)
        change, exact = in_box(W, gaps, forces)
        assert exact
        x, w = forces + change, gaps + W @ change
        assert x.min() >= 0
        assert np.abs(np.minimum(x, w)).max() <= 1e-9 * np.abs(gaps).max()


def test_exchange_finds_the_solution_among_all_active_sets(rng):
    for _ in range(40):
        A, q, x0 = rng.normal(size=(6, 6)), rng.normal(size=6), rng.normal(size=6)
        S, x0 = A @ A.T + 1e-3 * np.eye(6), np.maximum(x0, 0)
        found = x0 + in_box(known(S), q + S @ x0, x0)[0]
        candidates = []
        for active in itertools.product([False, True], repeat=6):
            s, z = np.array(active), np.zeros(6)
            z[s] = -np.linalg.solve(S[np.ix_(s, s)], q[s])
            if z.min() >= 0 and (q + S @ z)[~s].min(initial=0) >= 0:
                candidates.append(z)
        assert len(candidates) == 1
        assert found == pytest.approx(candidates[0], rel=1e-6, abs=1e-8)


def test_secants_find_the_forces_with_few_products(rng):
    """As many products as rows at most, two or three from a compliance that is nearly right."""
    S = spd(rng, 40, 1e3)
    gaps, nothing, products = rng.normal(size=40), np.zeros(40), []

    def product(d):
        products.append(d)
        return S @ d

    W = Compliance(np.diag(S).copy())
    x, parts = solve_by_secants(in_box, product, W, gaps, nothing, 1e-12)
    assert np.abs(np.minimum(x, gaps + S @ x)).max() < 1e-11
    assert len(products) <= 41
    assert parts @ products == pytest.approx(x, abs=1e-12)
    products.clear()
    S *= 1 + 1e-6
    again, _ = solve_by_secants(in_box, product, W, gaps + S @ x, x, 1e-12)
    assert np.abs(np.minimum(again, gaps + S @ again)).max() < 1e-11
    assert len(products) <= 3


@pytest.mark.parametrize("d", [1, 2])
def test_minimal_residuals_between_small_problems_find_the_same_forces(rng, d):
    """Open, sticking and slipping rows: the same forces, with half of the small problems."""
    m = 20
    n = m * (1 + d)
    S, nothing = spd(rng, n, 30), np.zeros(n)
    cone = FrictionCone(np.full(m, np.inf), np.full(m, 0.3), np.zeros(m, dtype=bool), d)
    gaps, found, counts = rng.normal(size=n) - 0.5 * (np.arange(n) < m), [], []
    for response in (None, cone.response):
        asked, products = [], []

        def small(*given, asked=asked):
            asked.append(given)
            return cone(*given)

        def product(change, products=products):
            products.append(change)
            return S @ change

        W = Compliance(np.diag(S).copy())
        x, parts = solve_by_secants(small, product, W, gaps, nothing, 1e-13, response)
        assert parts @ products == pytest.approx(x, abs=1e-11)
        y = x - (gaps + S @ x)
        assert cone.projected(y) == pytest.approx(x, abs=1e-11)
        found.append(x)
        counts.append(len(asked))
    assert found[1] == pytest.approx(found[0], abs=1e-11)
    assert counts[1] < counts[0] / 2
    n, t = cone.split(found[0])
    assert set(n > 0) == {True, False}
    slips = cone.sizes(t)[n > 0] > (1 - 1e-9) * 0.3 * n[n > 0]
    assert set(slips) == {True, False}


def test_a_product_that_agrees_with_a_known_compliance_ends_the_search(rng):
    """One small problem and one product, if W is S: the forces are those of the small problem."""
    S = spd(rng, 12, 1e2)
    gaps = rng.normal(size=12)
    asked = []

    def small(*given):
        asked.append(given)
        return in_box(*given)

    products = []

    def product(d):
        products.append(d)
        return S @ d

    given = gaps, np.zeros(12), 1e-12
    found, parts = solve_by_secants(small, product, Compliance.of(S), *given)
    assert len(asked) == len(products) == len(parts) == 1
    assert np.abs(np.minimum(found, gaps + S @ found)).max() < 1e-12


def test_dependent_rows_share_a_force():
    """Two rows with one compliance: any split for the same gap, the deeper one alone for two."""
    S = np.ones((2, 2))
    for gaps, forces in (([-1.0, -1.0], [0.5, 0.5]), ([-1.0, -2.0], [0.0, 2.0])):
        W = Compliance(np.ones(2))
        found, _ = solve_by_secants(
            in_box, S.dot, W, np.array(gaps), np.zeros(2), 1e-12
        )
        assert found == pytest.approx(forces)
        assert (np.array(gaps) + S @ found >= -1e-12).all()


def test_springs_of_dependent_rows_leave_nothing(rng):
    """Three bounded forces on two gaps: the gaps are closed, and W without springs is singular."""
    R = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    S = R.T @ R
    loads = R.T @ rng.uniform(-1, -0.5, 2)
    small = partial(in_box, low=-10.0, high=10.0)
    W = Compliance.of(S)
    springs = np.full(3, 1e-6)
    given = loads, np.zeros(3), 1e-14
    found, _ = solve_by_secants(small, S.dot, W, *given, springs=springs)
    assert np.abs(loads + S @ found).max() < 1e-13
    assert np.abs(found).max() < 1.0


@pytest.mark.parametrize("solvable", [True, False])
def test_a_small_problem_that_is_not_solved_is_tried_with_the_diagonal(rng, solvable):
    """Where it leaves the forces as they are nothing is learned, however often it is called."""
    S = spd(rng, 12, 1e2)
    gaps = rng.normal(size=12)
    every = np.arange(12)
    asked = []

    def small(W, *given):
        S_or_less = W.block(every)
        asked.append(np.count_nonzero(S_or_less) == 12)
        return in_box(W, *given) if solvable and any(asked) else (0 * gaps, False)

    found = solve_by_secants(small, S.dot, Compliance.of(S), gaps, 0 * gaps, 1e-12)
    assert len(asked) <= 15
    assert (found is not None) == solvable
    if solvable:
        assert np.abs(np.minimum(found[0], gaps + S @ found[0])).max() < 1e-11


def test_numbers_that_are_not_finite_are_refused():
    W = Compliance(np.ones(2))
    gaps = np.array([-1.0, -1.0])
    assert (
        solve_by_secants(in_box, lambda d: d * np.nan, W, gaps, np.zeros(2), 1e-12)
        is None
    )


def test_minimal_residuals_of_dependent_rows_are_those_with_springs(rng):
    """Gaps that no force closes: rounding of products without an answer is no direction."""
    n, rank = 30, 20
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    S = (Q[:, :rank] * np.geomspace(1, 30, rank)) @ Q[:, :rank].T
    springs = 1e-8 * S.diagonal()
    gaps = S @ rng.normal(size=n) + 1e-9 * Q[:, -1]

    def product(d):
        answer = S @ d
        return answer + 1e-15 * np.abs(answer).max() * rng.normal(size=n)

    A = np.linalg.inv(S + np.diag(springs))
    W = Compliance.of(S)
    more = in_same_state(A, product, W, gaps, 1e-12, 1e-12, springs=springs)
    change = more.parts @ more.forces
    left = gaps + S @ change + springs * change
    # the rounding of products over the springs
    assert np.abs(left).max() < 1e-6
