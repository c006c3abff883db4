"""The laws of contact and friction for the forces of rows, with random compliances."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from ngepc.linalg import box
from ngepc.linalg import other_forces as search
from ngepc.linalg.box import (
    cut_off_at_bounds,
    exchanged,
    in_box,
    lowered_in_box,
    up_to_the_first_bound,
)
from ngepc.linalg.contact_states import (
    _Laws,
    can_be_enumerated,
    equilibria,
    states_of_rows,
)
from ngepc.linalg.friction import FrictionCone
from ngepc.linalg.friction_equation import FrictionEquation
from ngepc.linalg.other_forces import (
    FACTORS,
    SHIFTS,
    STARTS,
    from_starts,
    other_forces,
    starts,
)
from ngepc.linalg.row_blocks import add_to_rows, matrix_of_rows
from ngepc.linalg.secants import Compliance

LAWS = ("Coulomb", "limited", "Tresca", "mixed", "tied")


def cone(law, m, d, random):
    """A law with other numbers in each row; every third row of ``tied`` stays closed."""
    mu = random.uniform(0.1, 0.5, m)
    cap = np.full(m, np.inf)
    tied = np.zeros(m, dtype=bool)
    if law != "Coulomb":
        cap = random.uniform(0.05, 0.3, m)
    if law == "Tresca":
        mu = np.full(m, np.inf)
    if law == "mixed":
        mu[::2] = np.inf
    if law == "tied":
        tied[::3] = True  # without friction
        mu[::3] = 0.0
    return FrictionCone(cap=cap, coefficient=mu, tied=tied, d=d)


def compliance(n, random):
    """A symmetric positive definite matrix, diagonally heavy as that of an elastic body."""
    Q = random.normal(size=(n, n)) / np.sqrt(n)
    return Q @ Q.T + 2 * np.eye(n)


def offence(law, x, gaps):
    """By how much forces and the gaps that they cause miss the law, row by row in plain words."""
    m = len(law.cap)
    n, g = x[:m], gaps[:m]
    t, slip = x[m:].reshape(m, law.d), -gaps[m:].reshape(m, law.d)
    worst = 0.0
    for k in range(m):
        missed = (abs(g[k]),) if law.tied[k] else (-n[k], -g[k], abs(n[k] * g[k]))
        worst = max(worst, *missed)
        if not law.d:
            continue
        tresca = np.isinf(law.coefficient[k])
        b = law.cap[k] if tresca else min(law.coefficient[k] * n[k], law.cap[k])
        size = np.linalg.norm(t[k])
        if np.isinf(b):
            worst = max(worst, np.linalg.norm(slip[k]))
            continue
        worst = max(
            worst, size - b
        )  # and the slip does all the work that the bound allows
        worst = max(worst, abs(b * np.linalg.norm(slip[k]) - t[k] @ slip[k]))
    return worst


@pytest.mark.parametrize("d", [0, 1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_solutions_meet_the_law(law, d):
    """From no forces and from some forces: only the change is given back."""
    for seed in range(6):
        random = np.random.default_rng(seed)
        m = int(random.integers(2, 12))
        S = compliance(m * (1 + d), random)
        gaps = random.normal(size=len(S))
        rule = cone(law, m, d, random)
        found = []
        for forces in (np.zeros(len(S)), np.append(np.ones(m), np.zeros(m * d))):
            change, exact = rule(Compliance.of(S), gaps + S @ forces, forces)
            assert exact
            found.append(forces + change)
            assert offence(rule, found[-1], gaps + S @ found[-1]) < 1e-10
        if law == "Tresca":
            np.testing.assert_allclose(found[0], found[1], atol=1e-10)


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_slope_of_the_projection(law, d):
    """Against differences at points where it is smooth."""
    random = np.random.default_rng(d)
    m, eps = 9, 1e-7
    rule = cone(law, m, d, random)
    y = random.normal(size=m * (1 + d))
    closed = (y[:m] > 0) | rule.tied
    blocks = rule.slope(y, closed)
    numbers = [rule.numbers(np.array([k])) for k in range(m)]
    for _ in range(3):
        dy = random.normal(size=len(y))
        change = (rule.projected(y + eps * dy) - rule.projected(y - eps * dy)) / eps / 2
        for k in range(m):
            expected = change[numbers[k]]
            np.testing.assert_allclose(blocks[k] @ dy[numbers[k]], expected, atol=1e-6)


def test_projection_is_the_closest_point():
    random = np.random.default_rng(3)
    rule = cone("mixed", 40, 2, random)
    y = 0.2 * random.normal(size=120)
    n, t = rule.split(rule.projected(y))
    b = rule.bound(n)
    size = np.linalg.norm(t, axis=1)
    assert (size <= b * (1 + 1e-12)).all()
    aim = rule.split(y)[1]
    for angle in np.linspace(0, 2 * np.pi, 50):
        other = b[:, None] * [np.cos(angle), np.sin(angle)]
        near = np.linalg.norm(aim - t, axis=1)
        assert (near <= np.linalg.norm(aim - other, axis=1) + 1e-12).all()
    inside = np.linalg.norm(aim, axis=1) < b
    np.testing.assert_allclose(t[inside], aim[inside])
    assert 0 < inside.sum() < 40


def test_work_of_friction_is_convex_in_the_slip():
    """|s + r| >= |s| + e.r at a solution, where friction acts and where it does not yet."""
    random = np.random.default_rng(4)
    m, d = 10, 2
    mu = random.uniform(0.2, 0.5, m)
    rule = FrictionCone(np.full(m, np.inf), mu, np.zeros(m, dtype=bool), d)
    S = compliance(m * (1 + d), random)
    gaps = 3 * random.normal(size=len(S))
    x = rule(Compliance.of(S), gaps, np.zeros(len(S)))[0]
    after = gaps + S @ x
    n = x[:m]
    assert 0 < (n > 0).sum() < m
    slip = -rule.split(after)[1]
    pressed = n + 1e-3  # open rows have a slope as well
    e = rule.follows(np.append(pressed, x[m:]), after, 1e-9) / mu[:, None]
    closed = n > 0
    b = mu * pressed
    np.testing.assert_allclose(e[closed], rule.split(x)[1][closed] / b[closed, None])
    open_rows = rule.follows(np.append(n, x[m:]), after, 1e-9)[~closed]
    np.testing.assert_allclose(open_rows, e_of(mu, slip)[~closed], atol=1e-12)
    at_rest = rule.follows(
        np.zeros(len(x)), np.full(len(x), 0.1), 1.0
    )  # but for rounding
    np.testing.assert_array_equal(at_rest, 0.0)


def e_of(mu, slip):
    """Mu times the directions of slips."""
    return mu[:, None] * slip / np.linalg.norm(slip, axis=1)[:, None]


def test_forces_in_a_box_minimise_the_quadratic():
    """From states at any bound: the gradient has the sign that the bound allows."""
    for seed in range(8):
        random = np.random.default_rng(seed)
        n = 15
        S = compliance(n, random)
        gaps = random.normal(size=n)
        low, high = -random.uniform(0, 1, n), random.uniform(0, 1, n)
        high[:3] = low[:3]  # forces that cannot move
        start = np.clip(random.normal(size=n), low, high)
        W = Compliance.of(S)
        change, exact = in_box(W, gaps + S @ start, start, low=low, high=high)
        assert exact
        x = start + change
        w = gaps + S @ x
        assert (x >= low - 1e-14).all()
        assert (x <= high + 1e-14).all()
        at_low, at_high = x < low + 1e-14, x > high - 1e-14
        free = ~(at_low | at_high)
        np.testing.assert_allclose(w[free], 0.0, atol=1e-12)
        assert (w[at_low & ~at_high] > 0).all()
        assert (w[at_high & ~at_low] < 0).all()
        assert min(at_low.sum(), at_high.sum()) > 0


def test_steps_that_descend_end_where_exchanges_do():
    for seed in range(8):
        random = np.random.default_rng(seed)
        n = 15
        W = Compliance.of(compliance(n, random))
        gaps = random.normal(size=n)
        low, high = -random.uniform(0, 1, n), random.uniform(0, 1, n)
        high[:3] = low[:3]
        forces = np.clip(random.normal(size=n), low, high)
        change, exact = lowered_in_box(W, gaps, forces, low, high)
        assert exact
        expected = exchanged(W, gaps, forces, low, high)
        np.testing.assert_allclose(change, expected, atol=1e-12)


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**60])
@pytest.mark.parametrize("method", [exchanged, lowered_in_box])
def test_forces_in_a_box_are_the_same_in_any_unit(method, unit):
    """To the last bit, as a power of two leaves no rounding."""
    random = np.random.default_rng(8)
    n = 15
    W = Compliance.of(compliance(n, random))
    gaps = random.normal(size=n)
    high = random.uniform(0, 1, n)
    forces = np.clip(2 * random.normal(size=n), -high, high)  # some have to be released

    def changed(unit):
        found = method(W, *(unit * a for a in (gaps, forces, -high, high)))
        return found if method is exchanged else found[0]

    np.testing.assert_array_equal(changed(unit), unit * changed(1.0))


def test_forces_in_a_box_where_exchanges_come_back():
    """A smooth kernel with a condition of 1e9: exchanges alone come back to earlier states."""
    random = np.random.default_rng(5)
    n = 120
    apart = np.arange(n)[:, None] - np.arange(n)
    W = Compliance.of(np.exp(-((apart / 6.0) ** 2)) + 1e-8 * np.eye(n))
    gaps = random.normal(size=n)
    high = random.uniform(0, 1, n)
    forces = np.zeros(n)
    assert exchanged(W, gaps, forces, -high, high) is None
    change, exact = in_box(W, gaps, forces, -high, high)
    assert exact
    w = gaps + W @ change
    inside = np.abs(change) < high
    assert 0 < inside.sum() < n
    np.testing.assert_allclose(w[inside], 0.0, atol=1e-12)
    assert (w * np.sign(change) <= 1e-12)[~inside].all()


@pytest.mark.parametrize("beyond", [0.0, 0.4])
@pytest.mark.parametrize("method", [exchanged, lowered_in_box])
def test_a_solution_is_confirmed_by_one_system(method, beyond, monkeypatch):
    """Forces start at the bounds that they are at or beyond, where others start from none."""
    random = np.random.default_rng(4)
    n = 15
    W = Compliance.of(compliance(n, random))
    gaps = random.normal(size=n)
    low, high = -random.uniform(0, 0.3, n), random.uniform(0, 0.3, n)
    high[:3] = low[:3]
    x = exchanged(W, gaps, np.zeros(n), low, high)
    at_low, at_high = x == low, (x == high) & (x > low)
    assert 0 < at_low.sum() - 3 < n
    assert 0 < at_high.sum() < n
    forces = x + beyond * (1.0 * at_high - at_low)
    asked = []
    block = W.block
    monkeypatch.setattr(W, "block", lambda rows: asked.append(rows) or block(rows))
    found = method(W, gaps + W @ forces, forces, low, high)
    change = found if method is exchanged else found[0]
    np.testing.assert_allclose(forces + change, x, atol=1e-14)
    np.testing.assert_array_equal(asked, [~(at_low | at_high)])


def test_steps_are_cut_off_where_that_lowers_the_quadratic():
    """Of two forces; else they end at the first bound, which always lowers it."""
    random = np.random.default_rng(1)
    low, high = -np.ones(2), np.ones(2)
    taken = []
    for _ in range(200):
        slope = random.uniform(-0.99, 0.99)
        S = np.array([[1.0, slope], [slope, 1.0]])
        x = random.uniform(low, high)
        w = random.normal(size=2)
        step = -np.linalg.solve(S, w)
        first = up_to_the_first_bound(x, step, low, high)
        points = np.clip(x + step, low, high), first
        lowered = [w @ (p - x) + (p - x) @ S @ (p - x) / 2 < 0 for p in points]
        chosen = points[0] if lowered[0] else first
        found = cut_off_at_bounds(Compliance.of(S), w, x, step, low, high)
        np.testing.assert_array_equal(found, chosen)
        taken.append(lowered[0])
        if (np.abs(x + step) > 1).any():
            assert lowered[1]
    assert 10 < sum(taken) < 190


def test_forces_that_do_not_act_on_each_other_take_one_step():
    """All of them end at their own minimum or bound at once."""
    random = np.random.default_rng(3)
    S = random.uniform(1, 2, 6)
    gaps = 3 * random.normal(size=6)
    step = -gaps / S
    assert 1 < (np.abs(step) > 1).sum() < 6
    bounds = -np.ones(6), np.ones(6)
    found = cut_off_at_bounds(Compliance(S), gaps, np.zeros(6), step, *bounds)
    np.testing.assert_array_equal(found, np.clip(step, *bounds))


@pytest.mark.parametrize("method", [exchanged, lowered_in_box])
def test_forces_may_reach_a_bound_without_pressing_on_it(method):
    """Their gradient is zero there; the change ends exactly at the bound."""
    W = Compliance(np.array([1.0, 2.0, 4.0]))
    low, high = np.full(3, -1.0), np.full(3, 2.0)
    forces = np.array([0.5, 0.5, 0.25])
    solution = np.array([2.0, -1.0, 1.0])
    gaps = -(W @ (solution - forces))
    found = method(W, gaps, forces, low, high)
    change = found if method is exchanged else found[0]
    np.testing.assert_array_equal(forces + change, solution)


@pytest.mark.parametrize("descents", [0, 1])
def test_steps_that_descend_say_if_they_have_not_ended(descents, monkeypatch):
    """What they have by then obeys the bounds, and has no more energy than the start."""
    monkeypatch.setattr(box, "DESCENTS", descents)
    random = np.random.default_rng(2)
    n = 20
    apart = np.arange(n)[:, None] - np.arange(n)
    W = Compliance.of(np.exp(-((apart / 6.0) ** 2)) + 1e-8 * np.eye(n))
    gaps = random.normal(size=n)
    high = random.uniform(0, 1, n)
    forces = 2 * random.normal(size=n)
    start = np.clip(forces, -high, high) - forces
    change, exact = lowered_in_box(W, gaps, forces, -high, high)
    assert not exact
    assert (np.abs(forces + change) <= high * (1 + 1e-14)).all()
    energy = [gaps @ d + d @ (W @ d) / 2 for d in (start, change)]
    if descents:
        assert energy[1] < energy[0]
    else:
        np.testing.assert_array_equal(change, start)


def test_the_first_bound_on_a_way():
    """Force by force: the way ends where one of them meets a bound, exactly there."""
    random = np.random.default_rng(6)
    for _ in range(20):
        low, high = -random.uniform(0.1, 1, 6), random.uniform(0.1, 1, 6)
        x = random.uniform(low, high)
        step = random.normal(size=6)
        step[2] = 0.0
        lengths = [
            ((b if s > 0 else a) - here) / s if s else np.inf
            for here, s, a, b in zip(x, step, low, high, strict=True)
        ]
        first = int(np.argmin(lengths))
        end = up_to_the_first_bound(x, step, low, high)
        np.testing.assert_allclose(end, x + lengths[first] * step, atol=1e-15)
        assert end[first] == (high if step[first] > 0 else low)[first]


@pytest.mark.parametrize("rows", ["Tresca", "tied", "without tangents"])
def test_given_bounds_in_the_plane_need_no_newton_steps(rows, monkeypatch):
    """They are a box, which exchanges solve a hundred times faster where rows are many."""
    monkeypatch.setattr(FrictionEquation, "solved", None)
    random = np.random.default_rng(7)
    m, d = 8, int(rows != "without tangents")
    rule = cone("Tresca" if rows == "Tresca" else "tied", m, d, random)
    if rows == "tied":
        rule = replace(rule, tied=np.ones(m, dtype=bool), coefficient=np.zeros(m))
    S = compliance(m * (1 + d), random)
    gaps = random.normal(size=len(S))
    x, exact = rule(Compliance.of(S), gaps, np.zeros(len(S)))
    assert exact
    assert offence(rule, x, gaps + S @ x) < 1e-10


def one_row(law, S, gaps):
    """All equilibria of one row, from the text book: the states one by one."""
    mu, cap = law.coefficient[0], law.cap[0]
    found = []
    if gaps[0] >= 0:
        found.append((0.0, 0.0))
    stuck = np.linalg.solve(S, -gaps)
    if stuck[0] >= 0 and abs(stuck[1]) <= min(mu * stuck[0], cap):
        found.append(tuple(stuck))
    for sign in (1, -1):
        n = -gaps[0] / (S[0, 0] + sign * mu * S[0, 1])
        slips = [(n, sign * mu * n)] if n >= 0 and mu * n <= cap else []
        n = -(gaps[0] + sign * cap * S[0, 1]) / S[0, 0]
        slips += [(n, sign * cap)] if mu * n >= cap and np.isfinite(cap) else []
        for x in slips:
            back = gaps[1] + S[1] @ x
            if back * sign <= 0:
                found.append(x)
    return found


@pytest.mark.parametrize("limit", [np.inf, 0.4])
def test_enumeration_of_one_row(limit):
    """Of 120 rows, large coefficients among them: as many equilibria as by hand, the same ones."""
    counts = set()
    for seed in range(120):
        random = np.random.default_rng(seed)
        Q = random.normal(size=(2, 2))
        S = Q @ Q.T + 0.05 * np.eye(2)
        mu = np.array([10 ** random.uniform(-1, 1)])
        rule = FrictionCone(np.array([limit]), mu, np.zeros(1, dtype=bool), 1)
        gaps = random.normal(size=2)
        expected = one_row(rule, S, gaps)
        forces = random.normal(size=2)
        found = equilibria(
            S, gaps + S @ forces, forces, mu, rule.cap, rule.tied, S.diagonal()
        )
        distinct = {tuple(np.round(x, 8) + 0.0) for x in found}
        assert distinct == {tuple(np.round(x, 8) + 0.0) for x in expected}
        counts.add(len(expected))
        if expected:
            x = np.array(expected[0])
            found = other_forces(rule, S, gaps + S @ x, x)
            assert (found is not None) == (len(distinct) > 1)
        else:  # what is given back obeys the bounds
            change, exact = rule(Compliance.of(S), gaps + S @ forces, forces)
            n, t = forces + change
            assert not exact
            assert n >= 0
            assert abs(t) <= rule.bound(np.array([n]))[0] * (1 + 1e-12)
    assert counts >= {1, 3}


@pytest.mark.parametrize("law", ["Coulomb", "limited", "tied"])
def test_enumeration_of_rows(law):
    """What is found meets the law, and what Newton's method finds is among it."""
    for seed in range(5):
        random = np.random.default_rng(seed)
        m = 3
        S = compliance(2 * m, random)
        gaps = random.normal(size=2 * m)
        rule = cone(law, m, 1, random)
        forces = random.normal(size=2 * m)
        found = rule.equilibria(S, gaps + S @ forces, forces, S.diagonal())
        assert len(found)
        for x in found:
            assert offence(rule, x, gaps + S @ x) < 1e-8
        x = rule(Compliance.of(S), gaps, np.zeros(2 * m))[0]
        assert min(np.abs(found - x).max(axis=1)) < 1e-8
        near = [(x - forces) @ S @ (x - forces) for x in found]
        assert near == sorted(near)


@pytest.mark.parametrize("limit", [0.4, np.inf])
def test_no_equilibrium_is_given_up(limit):
    """Of 30 triples of rows: as many equilibria as when all states are solved one by one."""
    counts = set()
    for seed in range(30):
        random = np.random.default_rng(seed)
        Q = random.normal(size=(6, 6))
        S = Q @ Q.T + 0.05 * np.eye(6)
        mu = 10 ** random.uniform(-1, 1, 3)
        cap = np.full(3, limit)
        free = np.zeros(3, dtype=bool)
        gaps = random.normal(size=6)
        none = np.zeros(6)
        laws = _Laws(S, gaps, none, mu, cap, S.diagonal())
        states = np.array(list(product(*states_of_rows(cap, free))))
        x = laws.solved(states)
        every = x[laws.hold(states, x)]
        found = equilibria(S, gaps, none, mu, cap, free, S.diagonal())
        distinct = {tuple(np.round(x, 8) + 0.0) for x in found}
        assert distinct == {tuple(np.round(x, 8) + 0.0) for x in every}
        counts.add(len(distinct))
    assert max(counts) >= 3


def test_how_many_rows_are_enumerated():
    """Four states of a row to ten rows, six with a limit to eight; a tied row has one."""
    free, tied = np.zeros(11, dtype=bool), np.ones(11, dtype=bool)
    infinite, limited = np.full(11, np.inf), np.ones(11)
    assert can_be_enumerated(infinite[:10], free[:10])
    assert not can_be_enumerated(infinite, free)
    assert can_be_enumerated(limited[:8], free[:8])
    assert not can_be_enumerated(limited[:9], free[:9])
    assert can_be_enumerated(limited, tied)
    rule = FrictionCone(infinite[:8], np.full(8, 0.3), free[:8], 1)
    assert rule.enumerable
    assert not FrictionCone(rule.cap, rule.coefficient, rule.tied, 2).enumerable
    tresca = FrictionCone(limited[:4], np.full(4, np.inf), free[:4], 1)
    assert not tresca.enumerable


def test_searches_have_so_many_starts():
    """Each of them obeys the bounds of the law; no contact is one of them."""
    random = np.random.default_rng(1)
    m, d = 4, 2
    rule = cone("Coulomb", m, d, random)
    S = compliance(m * (1 + d), random)
    W = Compliance.of(S)
    gaps = random.normal(size=len(S))
    x = rule(W, gaps, np.zeros(len(S)))[0]
    found = list(starts(rule, W, gaps + S @ x, x))
    assert len(found) == STARTS
    assert min(np.abs(s).max() for s in found) == 0
    for start in found:
        n, t = rule.split(start)
        assert (n >= 0).all()
        assert (np.linalg.norm(t, axis=1) <= rule.bound(n) + 1e-12).all()


@pytest.mark.parametrize("d", [1, 2])
def test_where_searches_start(d):
    """Stuck rows, slips the other way, friction at its bound, solutions of neighbours."""
    random = np.random.default_rng(2)
    m = 4
    rule = cone("limited", m, d, random)
    S = compliance(m * (1 + d), random)
    gaps = random.normal(size=len(S))
    x = rule(Compliance.of(S), gaps, np.zeros(len(S)))[0]
    there = gaps + S @ x
    found = list(starts(rule, Compliance.of(S), there, x))
    stuck = -np.linalg.solve(S, gaps)
    np.testing.assert_allclose(found[1], rule.projected(stuck))

    n, t = rule.split(x)
    back, ahead, behind = (rule.split(start) for start in found[2:5])
    np.testing.assert_allclose(back[1], -t)
    for pressing, _ in (back, ahead, behind):
        np.testing.assert_allclose(pressing, np.maximum(n, np.maximum(stuck[:m], 0)))
    presses_more = stuck[:m] >= n
    assert presses_more.any()
    one_way = np.repeat(rule.bound(stuck[:m])[:, None], d, axis=1) / np.sqrt(d)
    np.testing.assert_allclose(ahead[1][presses_more], one_way[presses_more])
    np.testing.assert_allclose(behind[1], -ahead[1])

    for factor, start in zip(FACTORS, found[5:], strict=False):
        other = replace(rule, coefficient=factor * rule.coefficient)
        neighbour = other(Compliance.of(S), gaps, np.zeros(len(S)))[0]
        np.testing.assert_allclose(start, rule.projected(neighbour), atol=1e-12)
    size = np.abs(gaps).max()
    normal = np.append(np.ones(m), np.zeros(m * d))
    others = [factor * gaps for factor in FACTORS]
    others += [gaps + shift * size * normal for shift in SHIFTS]
    others += [gaps + shift * size * (1 - normal) for shift in SHIFTS]
    for loaded, start in zip(others, found[5 + len(FACTORS) :], strict=True):
        assert offence(rule, start, loaded + S @ start) < 1e-10


@pytest.mark.parametrize("law", ["Tresca", "tied"])
def test_proximal_points_reach_the_minimum(law):
    """What takes over where Newton's method cycles, from far away: the only solution."""
    random = np.random.default_rng(6)
    m, d = 6, 2
    rule = cone(law, m, d, random)
    rule = replace(rule, coefficient=np.where(rule.tied, 0.0, np.inf))
    S = compliance(m * (1 + d), random)
    gaps = random.normal(size=len(S))
    forces = random.normal(size=len(S))
    W = Compliance.of(S)
    c = np.full(len(S), 0.1)  # the same for all tangents of a row
    equation = FrictionEquation(rule, W, gaps + S @ forces, forces, c)
    change, exact = equation.approached(np.full(len(S), 5.0))
    assert exact
    assert offence(rule, forces + change, gaps + S @ (forces + change)) < 1e-10
    expected = rule(W, gaps, np.zeros(len(S)))[0]
    np.testing.assert_allclose(forces + change, expected, atol=1e-10)


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("law", LAWS)
def test_newton_needs_one_step_at_a_solution(law, d, monkeypatch):
    """It sees by the residual that rounding is reached, and shortens no step there."""
    random = np.random.default_rng(8)
    m = 7
    rule = cone(law, m, d, random)
    S = compliance(m * (1 + d), random)
    W = Compliance.of(S)
    gaps = random.normal(size=len(S))
    x = rule(W, gaps, np.zeros(len(S)))[0]
    there = gaps + S @ x
    equation = FrictionEquation(rule, W, there, x, np.full(len(S), 0.1))
    tried = []
    shortened = equation.at

    def counted(change):
        tried.append(change)
        return shortened(change)

    monkeypatch.setattr(FrictionEquation, "at", lambda _, change: counted(change))
    left, change, exact = equation.solved(np.zeros(len(S)))
    assert exact
    assert left <= 2e-15 * np.abs(x).max()
    assert np.abs(change).max() <= 1e-13 * np.abs(x).max()
    assert len(tried) == 2  # the start, and one step


@pytest.mark.parametrize(
    ("until", "length"), [(1.0, 1.0), (0.3, 0.25), (2e-3, 2**-9), (1e-4, 1.0)]
)
def test_steps_are_halved_until_the_residual_falls(until, length, monkeypatch):
    """A whole one is taken where none of a thousandth or more lowers it."""

    def at(equation, change):
        return SimpleNamespace(left=0.5 if change[0] <= until else 1.0)

    monkeypatch.setattr(FrictionEquation, "at", at)
    equation = FrictionEquation(None, None, None, None, None)
    taken, found = equation._shortened(np.zeros(1), np.ones(1), 1.0)
    assert taken == length
    assert found.left == (0.5 if length <= until else 1.0)


@pytest.mark.parametrize("d", [0, 1, 2])
def test_blocks_of_rows_are_added_to_a_dense_matrix(d):
    random = np.random.default_rng(9)
    blocks = random.normal(size=(4, 1 + d, 1 + d))
    A = random.normal(size=(4 * (1 + d), 4 * (1 + d)))
    expected = A + matrix_of_rows(blocks).toarray()
    add_to_rows(A, blocks)
    np.testing.assert_array_equal(A, expected)


def test_other_solutions_are_searched_from_starts():
    """In space: each one that is yielded meets the law."""
    random = np.random.default_rng(7)
    m, d = 3, 2
    rule = cone("Coulomb", m, d, random)
    S = compliance(m * (1 + d), random)
    gaps = random.normal(size=len(S))
    x = rule(Compliance.of(S), gaps, np.zeros(len(S)))[0]
    found = list(from_starts(rule, S, gaps + S @ x, x, np.zeros((len(x), 0))))
    assert len(found) > STARTS // 2
    for other in found:
        assert offence(rule, other, gaps + S @ other) < 1e-10
    assert other_forces(rule, S, gaps + S @ x, x) is None


def test_springs_of_a_floating_part_carry_nothing_of_what_a_search_finds():
    """Forces on a part that only contact holds balance the load, whatever the springs."""
    rng = np.random.default_rng(3)
    d = 2
    m = 3
    A = rng.standard_normal((m * (d + 1),) * 2)
    S = A @ A.T + np.eye(len(A))
    rigid = 30 * np.repeat(np.eye(d + 1), m, axis=0)  # the three translations
    law = FrictionCone(np.full(m, np.inf), np.full(m, 0.3), np.zeros(m, dtype=bool), d)
    forces = np.append(np.full(m, 1.0), np.zeros(m * d))
    gaps = np.append(np.zeros(m), np.full(m * d, 0.3))
    load = rigid.T @ forces
    found = list(from_starts(law, S + rigid @ rigid.T, gaps, forces, rigid))
    assert found
    for x in found:
        np.testing.assert_allclose(rigid.T @ x, load, atol=1e-8 * np.abs(load).max())


@pytest.mark.parametrize("law", ["tied", "Tresca"])
def test_newton_leaves_out_forces_that_are_zero(law):
    """Tangents of rows without friction, and open rows: the step is that of the whole system."""
    random = np.random.default_rng(10)
    m, d, c = 9, 2, 0.1
    rule = cone(law, m, d, random)
    without = np.arange(m) % 3 == 0  # the tied rows, or a bound that is zero there
    rule = replace(rule, cap=np.where(without, 0.0, rule.cap))
    S = compliance(m * (1 + d), random)
    gaps = random.normal(size=len(S))
    forces = rule.projected(random.normal(size=len(S)))
    equation = FrictionEquation(
        rule, Compliance.of(S), gaps, forces, np.full(len(S), c)
    )
    closed = ((forces - c * gaps)[:m] > 0) | rule.tied
    rubbing = (closed | rule.given) & ~without

    # open rows lose their forces first
    kept = np.append(closed, np.repeat(rubbing, d))
    lost = np.where(kept, 0.0, -forces)
    y = forces + lost - c * (gaps + S @ lost)
    D = matrix_of_rows(rule.slope(y, closed)).toarray()
    nearest = rule.projected(y)
    nearest[:m] = np.where(closed, y[:m], 0.0)
    whole = np.eye(len(S)) - D + c * D @ S
    expected = lost + np.linalg.solve(whole, nearest - forces - lost)
    step = equation.step(np.zeros(len(S)), equation.at(np.zeros(len(S))))
    np.testing.assert_allclose(step, expected, atol=1e-12)

    rows, chosen = rule.with_forces(closed)
    _, J = equation.linearised(y, closed, rows, chosen)
    assert len(J) == (closed | rubbing).sum() + d * rubbing.sum()


def test_forces_that_depend_on_each_other_are_no_other_equilibrium(monkeypatch):
    """Two equal rows share their forces in any way, and springs answer what moves nothing."""
    random = np.random.default_rng(4)
    m, d = 3, 2
    S = compliance(m * (1 + d), random)
    first, second = ([0, m, m + 1], [1, m + 2, m + 3])
    S[second] = S[first]
    S[:, second] = S[:, first]
    law = FrictionCone(
        np.full(m, np.inf), np.full(m, 0.3), np.zeros(m, bool), d, independent=False
    )
    gaps = -np.append(np.ones(m), np.zeros(m * d))
    gaps[m:] = 0.1 * random.normal(size=m * d)
    gaps[second] = gaps[first]
    springs = 1e-8 * S.diagonal()
    x, exact = law(Compliance.of(S + np.diag(springs)), gaps, np.zeros(len(S)))
    assert exact
    there = gaps + S @ x
    other = x.copy()
    other[first] += x[second] / 2
    other[second] /= 2
    assert max(offence(law, split, there) for split in (x, other)) < 1e-7
    monkeypatch.setattr(search, "from_starts", lambda *_: [other])
    assert other_forces(law, S, there, x, rigid=np.diag(springs**0.5)) is None
