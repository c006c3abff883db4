"""Receipts: files that prove intervals of energies and goals to somebody who has numpy only."""

import json
import subprocess
import sys
import warnings
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from campaigns.receipts import (
    Judge,
    bernstein,
    falsifies,
    opened,
    passes,
    rule,
    tampered,
)
from ngsolve import CF, IfPos, x, y
from pairs import in_turn

from ngepc import (
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    evolve,
    goal_bound,
    semismooth_newton,
    write_receipt,
)
from ngepc.__main__ import main
from ngepc.bounds.of_state import bound_data_of, bound_of
from ngepc.geometries import block
from ngepc.goals import check_receipt, receipt
from ngepc.goals.receipt_arrays import NO_OBSTACLE
from ngepc.goals.receipt_file import (
    arguments_of_supremum,
    back_stress,
    least_supremum,
    packed,
    proved_intervals,
)
from ngepc.studies.examples import example

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)
COMBINED = Material(
    lame_lambda=1.5e3,
    lame_mu=1e3,
    yield_stress=5.0,
    hardening=50.0,
    hardening_modulus=2.0,
    hardening_stiffness=1.0,
)
ROUNDED = 1e-9
"""Part of the bound that rounding may add."""


def plate(**data):
    """A rectangle in plane strain."""
    return Problem(block.mesh(0.25, (1.0, 0.7)), MATERIAL, **data)


PULLED = {"traction": {"contact": (0.5, -8.0 - x)}, "body_force": (0.0, -2.0)}
PRESSED = {"contact": "contact", "gap": -0.002 - 0.002 * x, "body_force": (1.0, -2.0)}
ROLLING = {
    "clamped": None,
    "prescribed": {"left": (0.0, None), "clamped": (None, 0.0)},
    "traction": {"right": (6.0 + y, 1.0)},
}
WARPED = CF((3e-3, 1e-3, 0.0, 1e-3, -1e-3, 0.0, 0.0, 0.0, 2e-3), dims=(3, 3))
MOVED = {
    "clamped": None,
    "prescribed": {"left": (0.001 * y, 0.0), "right": (0.002, None)},
}
LEANING = {"traction": {"contact": (0.0, 1.0, -7.0)}}
ROLLING_CUBE = {
    "clamped": None,
    "prescribed": {
        "left": (0.0, None, None),
        "back": (None, 0.0, None),
        "clamped": (None, None, 0.0),
    },
    "traction": {"right": (6.0 + y, 1.0, x)},
}
SQUEEZED = {
    "contact": "contact",
    "gap": -0.002 - 0.001 * x,
    "body_force": (0.0, 1.0, 3.0),
}


def cube(order, cells=3, **data):
    """A cube of tetrahedra."""
    mesh = block.structured_mesh(cells, cells, cells, simplices=True)
    return Problem(mesh, MATERIAL, order=order, **data)


CASES = {
    "lshape": lambda order: replace(example("lshape", 225), order=order),
    "wrench": lambda order: replace(example("wrench", 245), order=order),
    "pulled": lambda order: plate(order=order, **PULLED),
    "pressed": lambda order: plate(order=order, **PRESSED),
    "rolling": lambda order: plate(order=order, **ROLLING),
    "moved": lambda order: plate(order=order, **MOVED),
    "combined": lambda order: replace(plate(order=order, **PULLED), material=COMBINED),
    "heated": lambda order: plate(order=order, initial_strain=0.002, **PRESSED),
    "warped": lambda order: plate(order=order, initial_strain=WARPED, **PULLED),
}


@pytest.mark.parametrize(("order", "name"), in_turn([1, 2], list(CASES)))
def test_a_receipt_shows_what_the_bound_says(name, order, tmp_path):
    """The checker knows no element and no tangent, and comes to the same interval."""
    result = semismooth_newton(CASES[name](order))
    bound = bound_of(bound_data_of(result.discrete), result.state)
    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    assert check_receipt.check(tmp_path / "receipt.npz")
    header = opened(tmp_path / "receipt.npz")[1]
    assert (header["lower"], header["upper"]) == (lower, upper)
    assert upper - lower == pytest.approx(bound.total, rel=receipt.LOSS)
    assert upper >= bound.energy - receipt.LOSS * bound.total
    assert lower <= bound.least_energy + receipt.LOSS * bound.total


@pytest.mark.parametrize("data", [LEANING, SQUEEZED, ROLLING_CUBE])
@pytest.mark.parametrize("order", [1, 2])
def test_a_receipt_in_space(data, order, tmp_path):
    """The interval of the bound on the mesh of the result; with order two it has no copy."""
    result = semismooth_newton(cube(order, **data))
    bound = bound_of(bound_data_of(result.discrete), result.state)
    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    assert upper - lower == pytest.approx(bound.total, rel=receipt.LOSS)
    assert upper >= bound.energy - receipt.LOSS * bound.total
    arrays, header = opened(tmp_path / "receipt.npz")
    assert passes(arrays, header)
    judge = Judge(arrays, header)
    assert not judge.falsified
    high, low = judge.energies()
    assert 0.8 * bound.total < high - low <= upper - lower


@pytest.mark.parametrize("order", [1, 2])
def test_a_cube_with_a_uniform_stress_has_an_exact_receipt(order, tmp_path):
    """Pulled by s and heated by e on rollers: J = -s^2/2E - s e, the work s (s/E + e)."""
    path = tmp_path / "receipt.npz"
    pull, swelling = 4.0, 0.001
    data = ROLLING_CUBE | {"traction": {"right": (pull, 0, 0)}}
    problem = cube(order, initial_strain=swelling, **data)
    young = 1e3 * (3 * 1.5e3 + 2 * 1e3) / (1.5e3 + 1e3)
    result = semismooth_newton(problem)
    exact = -(pull**2) / (2 * young) - pull * swelling
    lower, upper = write_receipt(result, path)
    assert lower <= exact <= upper
    assert upper - lower < 1e-6 * abs(exact)
    work = pull * (pull / young + swelling)
    lower, upper = write_receipt(goal_bound(result, "work"), path)
    assert lower <= work <= upper
    assert (
        upper - lower < 0.01 * work
    )  # lambda is large where nothing is left but rounding


def test_a_receipt_of_a_step_with_a_history(tmp_path):
    steps = [(1.0, {}), (2.0, {"gap": 1.0})]
    problem = plate(contact="contact", gap=-0.01, order=1)
    last = evolve(problem, steps).steps[-1].problem
    lower, upper = write_receipt(semismooth_newton(last), tmp_path / "receipt.npz")
    assert lower < upper
    arrays, header = opened(tmp_path / "receipt.npz")
    assert np.abs(arrays["law"][4:]).max() > 0
    assert not falsifies(arrays, header)


@pytest.mark.parametrize("name", ["heated", "warped"])
def test_initial_strains_are_in_the_energy(name, tmp_path):
    """That of the library, by the rules of a program that knows the numbers of the file alone."""
    result = semismooth_newton(CASES[name](1))
    bound = bound_of(bound_data_of(result.discrete), result.state)
    path = tmp_path / "receipt.npz"
    write_receipt(result, path)
    judge = Judge(*opened(path))
    assert not judge.falsified
    upper, _ = judge.energies()
    assert upper == pytest.approx(bound.energy, rel=1e-6)
    write_receipt(goal_bound(result, "work"), path)
    assert not falsifies(*opened(path))


def test_an_unfinished_iteration_has_a_wider_receipt(tmp_path):
    """A receipt is about the problem, not about a solver."""

    def stop(record):
        if record.iteration == 2:
            raise StopIteration

    problem = replace(example("lshape", 225), order=1)
    unfinished = semismooth_newton(problem, monitor=stop)
    wide = np.diff(write_receipt(unfinished, tmp_path / "unfinished.npz"))
    done = semismooth_newton(problem)
    narrow = np.diff(write_receipt(done, tmp_path / "done.npz"))
    assert narrow < wide


@pytest.mark.parametrize("order", [1, 2])
def test_a_body_on_a_floor_that_is_held_at_its_side_has_a_receipt(order, tmp_path):
    """The gap is closed at a held vertex, exactly: a floor that is any higher there is refused."""
    floor = {"clamped": "left", "contact": "clamped", "gap": 0.0}
    problem = plate(order=order, body_force=(0.5, -8.0), **floor)
    result = semismooth_newton(problem)
    bound = bound_of(bound_data_of(result.discrete), result.state)
    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    assert upper - lower == pytest.approx(bound.total, rel=receipt.LOSS)
    arrays, header = opened(tmp_path / "receipt.npz")
    assert passes(arrays, header)
    arrays["gap"][arrays["gap"] == 0] = -1e-19
    assert not passes(arrays, header)


GOALS = {
    "lshape": ["work", "contact_force"],
    "pressed": ["contact_force", Reaction("clamped", 1)],
    "rolling": [MeanDisplacement("right", 0)],
    "moved": [Reaction("right", 0)],
    "combined": ["work"],
    "heated": ["contact_force"],
    "warped": ["work"],
}
NAMED = [(name, goal) for name, goals in GOALS.items() for goal in goals]


@pytest.mark.parametrize(("named", "order"), in_turn(NAMED, [1, 2]))
def test_a_receipt_of_a_goal_shows_its_interval(named, order, tmp_path):
    """The checker has another supremum and other bounds of its integral, and no tangent."""
    name, goal = named
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES[name](order)), goal)
    lower, upper = write_receipt(found, path)
    assert found.name in check_receipt.check(path)
    header = opened(path)[1]
    assert (header["goal lower"], header["goal upper"]) == (lower, upper)
    assert header["goal"] == found.name
    assert upper - lower == pytest.approx(found.width, rel=0.2)
    assert lower < found.upper
    assert found.lower < upper
    assert header["lower"] < found.bound.energy


@pytest.mark.parametrize("order", [1, 2])
def test_the_judge_has_the_interval_of_a_goal_by_other_means(order, tmp_path):
    """The theorem as it is on the page, by a rule and trial strains: inside."""
    path = tmp_path / "receipt.npz"
    for problem in (CASES["pressed"](order), cube(order, cells=1, **SQUEEZED)):
        write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
        arrays, header = opened(path)
        judge = Judge(arrays, header)
        assert not judge.falsified
        lower, upper = judge.goal()
        assert header["goal lower"] <= lower <= upper <= header["goal upper"]


@pytest.mark.parametrize("order", [1, 2])
def test_the_judge_sees_what_changed(order, tmp_path):
    """A number of an array, or the factor, where the adjoint is zero: as with no judge before."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](order)), "contact_force")
    write_receipt(found, path)
    arrays, header = opened(path)
    for name in ("u", "stress"):
        arrays[name][1] = 0.0
    before = Judge(arrays, header)
    before._densities()
    cells = arrays["cells"].copy()
    cells[:2, -1] = cells[1::-1, -1]
    factor = {"factor": 2 * header["factor"]}
    cases = [(arrays, header | factor), (arrays | {"cells": cells}, header)]
    for name in ("points", "u", "stress", "law"):
        for row in np.ndindex(arrays[name].shape[:-1]):
            values = arrays[name].copy()
            values[row][-1] += 0.01 * np.abs(values).max()
            cases.append((arrays | {name: values}, header))
    for other, claims in cases:
        again = Judge(other, claims, before)._densities()
        fresh = Judge(other, claims)._densities()
        assert np.abs(again - fresh).max() < 1e-12 * np.abs(fresh).max()


@pytest.mark.parametrize("order", [1, 2])
def test_bounds_of_the_checker_approach_the_integrals(order, tmp_path, monkeypatch):
    """Two bisections of all cells halve their edges; the next two gain less than half as much."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](order)), "contact_force")
    widths = []
    for times in (0, 2, 4):
        rounds = iter([True] * times + [False])

        def lossy(body, allowed, rounds=rounds):
            return np.full(body.K, next(rounds))

        monkeypatch.setattr(receipt, "lossy", lossy)
        monkeypatch.setattr(receipt, "LOSS_OF_GOAL", np.inf)
        lower, upper = write_receipt(found, path)
        widths.append(upper - lower)
    first, second = -np.diff(widths)
    assert 0 < second < first / 2


@pytest.mark.parametrize(
    ("data", "goal"),
    [(LEANING, "work"), (SQUEEZED, "contact_force"), (SQUEEZED, "work")],
)
@pytest.mark.parametrize("order", [1, 2])
def test_a_goal_in_space_has_a_receipt(data, goal, order, tmp_path):
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(cube(order, **data)), goal)
    lower, upper = write_receipt(found, path)
    assert upper - lower == pytest.approx(found.width, rel=0.2)
    assert passes(*opened(path))


@pytest.mark.parametrize("order", [1, 2])
def test_cells_are_bisected_where_a_goal_needs_it(order, tmp_path):
    """Little hardening, at the edge of the yielding zone: 2.4 and 3.3 times as wide otherwise."""
    soft = replace(MATERIAL, hardening=1.0)
    mesh = block.mesh(0.5, (1.0, 0.7))
    pulled = {"traction": {"right": (4.0, -0.3)}}
    problem = Problem(mesh, soft, clamped="left", order=order, **pulled)
    found = goal_bound(semismooth_newton(problem), "work")
    lower, upper = write_receipt(found, tmp_path / "receipt.npz")
    assert upper - lower < 1.25 * found.width


@pytest.mark.parametrize("order", [1, 2])
def test_cells_are_not_bisected_for_a_goal_that_is_exact(order, tmp_path):
    """The force of the only support: its interval is as wide as rounding errors."""
    path = tmp_path / "receipt.npz"
    result = semismooth_newton(CASES["pulled"](order))
    write_receipt(result, path)
    _, header = opened(path)
    write_receipt(goal_bound(result, Reaction("clamped", 1)), path)
    assert opened(path)[1]["sizes"] == header["sizes"]


DRAWN = {
    "clamped": None,
    "prescribed": {"left": (0.0, 0.0, 0.0), "right": (0.002, None, None)},
}


@pytest.mark.parametrize("order", [1, 2])
def test_a_displacement_that_is_given_has_a_narrow_receipt(order, tmp_path):
    """Its adjoint is at rest and lambda near zero: with that it was +- 2.1 and 4.2."""
    result = semismooth_newton(cube(order, cells=2, **DRAWN))
    found = goal_bound(result, MeanDisplacement("right", 0))
    lower, upper = write_receipt(found, tmp_path / "receipt.npz")
    assert lower <= 0.002 <= upper
    assert upper - lower < 1e-3 * 0.002


def test_a_goal_that_is_zero_has_a_receipt(tmp_path):
    """The work of no loads: lambda is 1e-52, less than what the checker reads."""
    mesh = block.structured_mesh(5, 5, simplices=True)
    pressed = {"contact": "contact", "gap": -0.002 - 0.001 * x}
    problem = Problem(mesh, MATERIAL, **{**ROLLING, **pressed, "traction": None})
    found = goal_bound(semismooth_newton(problem), "work")
    assert found.factor < 1e-20
    with pytest.warns(UserWarning, match="rounding errors"):
        lower, upper = write_receipt(found, tmp_path / "receipt.npz")
    assert lower <= 0.0 <= upper
    assert upper - lower < 1e-12


@pytest.mark.parametrize("vertices", [2, 3, 4])
def test_means_of_products_by_a_rule(vertices):
    """Bernstein's polynomials of degree one and two on segments, triangles and tetrahedra."""
    shares, weights = rule(vertices - 1, 4)
    quadratic = len(check_receipt.PAIRS[vertices][0])
    for k, table in (
        (vertices, check_receipt.MEANS[vertices]),
        (quadratic, check_receipt.MEANS[2, vertices]),
    ):
        values = bernstein(shares, k)
        exact = values.T @ (weights[:, None] * values)
        np.testing.assert_allclose(table, exact, rtol=1e-12, atol=1e-15)


def test_a_tangent_of_the_norm_is_above_it():
    """Paragraph 3 of the checker: the largest F(q) = |A + q v| - q (V + b q), for any r > 0."""
    random = np.random.default_rng(5)
    A, v = random.normal(size=(2, 3, 500)) * 10 ** random.uniform(-1, 1, (2, 1, 500))
    b, r = 10 ** random.uniform(-2, 0, (2, 500))
    V = 10 ** random.uniform(-2, 0, 500)
    slope = V + 2 * b * r
    short = np.maximum(slope - (length(A + r * v) - length(A)) / r, 0.0)
    over = np.maximum(length(v) - slope, 0.0)
    bound = length(A + r * v) - r * (V + b * r) + np.maximum(over, short) ** 2 / (4 * b)
    q = np.append(0.0, np.geomspace(1e-3, 1e3, 400))[:, None, None]
    best = (length(A + q * v, 1) - V * q[:, 0] - b * q[:, 0] ** 2).max(axis=0)
    assert (best <= bound * (1 + 1e-12) + 1e-12).all()
    assert 100 < (short > 0).sum() < 400
    without = bound - np.maximum(over, short) ** 2 / (4 * b) + over**2 / (4 * b)
    assert not (best <= without).all()


def length(x, axis=0):
    """Sizes of vectors, one component after the other."""
    return np.sqrt(sum(component**2 for component in np.moveaxis(x, axis, 0)))


def at_many(x, n=40):
    """Values (points, c, K) of fields (k, c, K) at the centres of n^N equal parts of simplices."""
    N = 3 if len(x) in {4, 10} else 2
    first = np.indices((n,) * N).reshape(N, -1).T
    centres = np.array(list(permutations(range(1, N + 1)))) / (N + 1)
    at = (first[:, None] + centres).reshape(-1, N) / n
    at = at[(np.diff(at, axis=1) < 0).all(axis=1)]
    ends = np.ones(len(at))
    shares = -np.diff(np.column_stack([ends, at, 0 * ends]), axis=1)
    return np.einsum("qi,icK->qcK", bernstein(shares, len(x)), x)


def best_of(p, w, law):
    """The supremum of the lemma by trial, at points (c, K); mu is one half."""
    h, beta = law
    y = p + w
    g = np.append(0.0, np.geomspace(1e-3, 1e3, 600))[:, None]
    slope = p + h * y
    square = beta**2 * (y * y).sum(axis=0) + 2 * beta * g * (y * slope).sum(axis=0)
    square = square + g**2 * (slope * slope).sum(axis=0)  # of beta y + g slope
    outside = np.sqrt(np.maximum(square, 0.0)) - (beta + (1 + h) * g) * (beta + h * g)
    t = np.minimum(length(y) / 2, beta)
    return np.maximum(outside.max(axis=0), length(y) * t - t**2)


def random_law(random, count):
    """Numbers h and beta for mu of one half."""
    h = 10 ** random.uniform(-2, 0, count)
    beta = 10 ** random.uniform(-1, 1, count)
    return np.array([h, beta])


def fields(p, w, law):
    """What the checker's supremum takes: p + w, and the vector that plastic strains meet."""
    y = p + w
    return np.concatenate([y, p + law[0] * y], axis=-2)


def supremum(x, law, parts=(0.0, 0.25, 0.5, 0.75, 0.9, 1.0)):
    """The checker's bound of suprema on triangles, with the best of some tangents."""
    h, beta = law
    _, v = np.split(x, 2, axis=1)
    more = length(v, 1).mean(axis=0) - beta * (1 + 2 * h)
    r = np.maximum(more, 0.0) / (2 * h * (1 + h))
    return np.min([with_tangent(x, part * r, law) for part in parts], axis=0)


def with_tangent(x, r, law):
    """The checker's bound for one tangent, with the square that it leaves to others."""
    y, v = np.split(x, 2, axis=1)
    return check_receipt.supremum(y, v, r, *law) + check_receipt.inner(y, y) / 4


def test_the_supremum_of_the_checker_is_one():
    """No less than the integrand at random plastic strains; near it where the tangents agree."""
    random = np.random.default_rng(4)
    law = random_law(random, 400)
    h, beta = law
    n = random.normal(size=(3, 400))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, 400)
    size = np.repeat([0.0, 0.01, 0.1, 1.0], 100)
    p = (beta + h * g) * n + size * random.normal(size=n.shape)
    w = (beta + (1 + h) * g) * n + size * random.normal(size=n.shape)
    x = fields(p, w, law)[None].repeat(3, axis=0)
    bound = supremum(x, law)
    best = best_of(p, w, law)
    assert (bound >= best * (1 - 1e-12)).all()
    excess = (bound / best - 1).reshape(4, -1)
    assert excess[0].max() < 1e-3
    assert np.median(excess[1]) < 1e-3
    assert np.median(excess[2]) < 0.02


def test_the_supremum_of_an_elastic_point_is_a_square():
    """|p + w|^2/4 where neither p nor w leaves the ball."""
    random = np.random.default_rng(8)
    law = random_law(random, 100)
    _, beta = law
    p, w = 0.5 * beta * random.uniform(-1, 1, (2, 3, 100)) / np.sqrt(3)
    x = fields(p, w, law)[None].repeat(3, axis=0)
    bound = supremum(x, law)
    np.testing.assert_allclose(bound, length(p + w) ** 2 / 4, rtol=1e-12)


def test_plastic_strains_pay_for_what_the_stress_lacks_to_yield():
    """|y| < 2 beta: strains of vectors beyond V along y, and along random directions."""
    random = np.random.default_rng(9)
    law = random_law(random, 600)
    h, beta = law
    n, other = random.normal(size=(2, 3, 600))
    n /= length(n)
    other /= length(other)
    beyond = beta * (1 + 2 * h) * 10 ** random.uniform(-0.5, 0.5, 600)
    y = 2 * beta * random.uniform(0.5, 1, 600) * n
    for v, limit in ((beyond * n, 2e-3), (beyond * other, np.inf)):
        p = v - h * y
        best = best_of(p, y - p, law)
        bound = supremum(fields(p, y - p, law)[None].repeat(3, axis=0), law)
        assert (bound >= best * (1 - 1e-12)).all()
        assert (bound <= best * (1 + limit)).all()


@pytest.mark.parametrize("k", [3, 6, 4, 10])
def test_means_of_suprema_near_yielding_are_bounded(k):
    """Fields y of size up to 2 beta, and v that leave the ball; half of the cells in one line."""
    random = np.random.default_rng(10 + k)
    law = random_law(random, 100)
    h, beta = law
    y, v = random.normal(size=(2, k, 3, 100))
    line = random.normal(size=(3, 50))
    y[..., :50] = random.uniform(0, 1, (k, 1, 50)) * line
    v[..., :50] = random.uniform(0.8, 1, (k, 1, 50)) * line
    y *= 2 * beta * random.uniform(0.3, 1, 100) / length(y, 1).max(axis=0)
    v *= (
        beta
        * (1 + 2 * h)
        * 10 ** random.uniform(0, 0.7, 100)
        / length(v, 1).max(axis=0)
    )
    bound = with_tangent(np.concatenate([y, v], axis=1), np.zeros(100), law)
    y, v = at_many(y, 12), at_many(v, 12)
    p = v - h * y
    best = np.mean([best_of(*pw, law) for pw in zip(p, y - p, strict=True)], axis=0)
    assert (bound >= best * (1 - 1e-3)).all()


@pytest.mark.parametrize("order", [1, 2])
def test_a_plate_that_almost_yields_has_a_receipt(order, tmp_path):
    """On rollers: 1.11 times as wide as the interval at most; without the Lemma's end 5.7, 8."""
    for pull in (5.0, 5.5):
        loads = {"traction": {"right": (pull, y)}}
        problem = plate(order=order, **{**ROLLING, **loads})
        found = goal_bound(semismooth_newton(problem), "work")
        lower, upper = write_receipt(found, tmp_path / "receipt.npz")
        assert upper - lower < 1.2 * found.width


def test_a_vector_against_the_strain_gains_nothing():
    """A points against v: the bound may not use the tangent at r > 0."""
    law = np.array([[0.1], [1.0]])
    y = np.array([[-6.0], [0.0]])
    v = np.array([[3.0], [0.0]])
    p = v - 0.1 * y
    x = np.concatenate([y, v])[None].repeat(3, axis=0)
    bound = supremum(x, law)
    assert bound[0] >= best_of(p, y - p, law)[0]


@pytest.mark.parametrize("k", [3, 6, 4, 10])
@pytest.mark.parametrize("tangent", ["best", "random"])
def test_means_of_suprema_are_bounded(k, tangent):
    """Of fields that vary, at many points; with any tangent, as it is only a hint."""
    random = np.random.default_rng(k)
    law = random_law(random, 30)
    n = random.normal(size=(3, 30))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, 30)
    moduli = law[1] + np.array([law[0], 1 + law[0]]) * g
    mean = np.concatenate([moduli[0] * n, moduli[1] * n])
    size = np.repeat([0.01, 0.1, 1.0], 10) * law[1]
    x = mean + size * random.normal(size=(k, 6, 30))
    x = fields(x[:, :3], x[:, 3:], law)
    y, v = np.split(at_many(x, 12), 2, axis=1)
    p = v - law[0] * y
    best = np.mean([best_of(*pw, law) for pw in zip(p, y - p, strict=True)], axis=0)
    if tangent == "best":
        bound = supremum(x, law)
        assert np.median((bound / best - 1)[:10]) < 1e-3
    else:
        r = g * 10 ** random.uniform(-2, 2, 30)
        bound = with_tangent(x, r, law)
    assert (bound >= best * (1 - 1e-3)).all()


@pytest.mark.parametrize("k", [3, 4])
def test_means_of_suprema_in_one_line_are_bounded(k):
    """Affine fields that yield by amounts that vary, with tangents beyond all of them."""
    random = np.random.default_rng(20 + k)
    law = random_law(random, 60)
    h, beta = law
    n = random.normal(size=(3, 60))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, (k, 1, 60))
    x = fields((beta + h * g) * n, (beta + (1 + h) * g) * n, law)
    bound = with_tangent(x, g.max(axis=(0, 1)) * random.uniform(1, 2, 60), law)
    y, v = np.split(at_many(x, 12), 2, axis=1)
    p = v - h * y
    best = np.mean([best_of(*pw, law) for pw in zip(p, y - p, strict=True)], axis=0)
    assert (bound >= best).all()


@pytest.mark.parametrize("order", [1, 2])
def test_hints_of_tangents_are_near_the_best_ones(order, tmp_path):
    """Cell by cell against many tangents: suprema lose a part of what tangents gain at all."""
    path = tmp_path / "receipt.npz"
    problem = plate(order=order, **PRESSED)
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    body = check_receipt.Body(packed(arrays), header)
    hints = body.tangent.copy()

    def suprema(tangents):
        body.tangent = tangents
        return body.volume * body.densities(slice(None))[2:]

    at_zero = suprema(0 * hints)
    tried = hints.max() * np.geomspace(1e-3, 10, 100)
    best = np.min([at_zero, *(suprema(np.full_like(hints, r)) for r in tried)], axis=0)
    lost = (suprema(hints) - best).sum(axis=1)
    assert (lost < 0.3 * (at_zero - best).sum(axis=1)).all()

    # stresses count from the back stress
    back = back_stress(body)
    more = body.beta * np.random.default_rng(order).normal(size=back.shape)
    back += more
    for field in (body.stress, body.trial):
        field[0, :, 1:] += more
    moved = [
        least_supremum(*arguments_of_supremum(body, sign), body.beta)[0]
        for sign in (-1, 1)
    ]
    np.testing.assert_allclose(moved, hints, atol=1e-9 * hints.max())


@pytest.mark.parametrize(("order", "size"), in_turn([1, 2], [0.1, 1.0, 10.0]))
def test_densities_are_bounded(size, order, tmp_path):
    """Of random stresses and displacements, by the law of the step at many points."""
    path = tmp_path / "receipt.npz"
    mesh = block.mesh(0.5, (1.0, 0.7))
    problem = Problem(mesh, MATERIAL, order=order, **PRESSED)
    write_receipt(semismooth_newton(problem), path)
    arrays, header = opened(path)
    random = np.random.default_rng(order)
    large = size * MATERIAL.yield_stress
    u, stress = arrays["u"], arrays["stress"]
    u += large / 1e4 * random.normal(size=u.shape)
    stress += large * random.normal(size=stress.shape)
    arrays["law"][4:] = random.normal(size=(8, 1))
    arrays["gap"][:] = NO_OBSTACLE
    r = check_receipt.Body(packed(arrays), header)
    J, gap = r.densities(slice(None))
    exact_J, exact_gap = exact_densities(r)
    assert (J - exact_J >= -1e-3 * np.abs(exact_J)).all()
    assert (gap >= exact_gap * (1 - 1e-3)).all()
    assert np.median((J - exact_J) / exact_gap) < 0.1
    assert np.median(gap / exact_gap) < 1.2


def exact_densities(r):
    """Means of the energy, and of what S and it leave between, by radial returns."""
    t, S = at_many(r.trial[0]), at_many(r.stress[0])
    mu, h, beta = r.mu, r.hardening, r.beta
    stored, start = r.law[4], r.law[5:9]
    back = back_stress(r)
    p_0 = start / r.moduli
    over = np.maximum(length(t[:, 1:] - back, 1) - beta, 0.0)
    energy = (t**2 / r.moduli).sum(axis=1) / 2 - stored
    energy -= over**2 / (2 * (2 * mu + h))
    over = np.maximum(length(S[:, 1:] - back, 1) - beta, 0.0)
    dual = (S * (S / r.moduli / 2 + p_0)).sum(axis=1) + stored
    dual += over**2 / (2 * h)
    work = (S * (t / r.moduli + p_0)).sum(axis=1)
    return energy.mean(axis=0), (energy + dual - work).mean(axis=0)


@pytest.mark.parametrize("order", [1, 2])
def test_no_change_that_falsifies_an_interval_of_a_goal_passes(order, tmp_path):
    """``python -m campaigns receipts`` has 600 of them."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](order)), "contact_force")
    write_receipt(found, path)
    found = tampered(path, np.random.default_rng(order), 12)
    wrong = [row for row in found if row[1]]
    assert len(wrong) == 12
    assert [what for what, _, passed in wrong if passed] == []


def test_each_part_of_the_proof_of_a_goal_is_needed(tmp_path):
    """One number of each array of the adjoint, changed by a tenth of the largest."""
    path = tmp_path / "receipt.npz"
    problem = CASES["pressed"](1)
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    for name in ("u", "stress", "pressure", "body_force", "gap"):
        values = arrays[name].copy()
        adjoint = values[1]
        place = np.unravel_index(np.abs(adjoint).argmax(), adjoint.shape)
        adjoint[place] += 0.1 * (np.abs(adjoint).max() or 1.0)
        assert not passes(arrays | {name: values}, header)
    width = header["goal upper"] - header["goal lower"]
    narrow = {"goal lower": header["goal lower"] + 1e-4 * width}
    assert not passes(arrays, header | narrow)
    assert not passes(arrays, header | {"factor": 0.5 * header["factor"]})
    assert not passes(arrays, header | {"goal upper": float("nan")})


@pytest.mark.parametrize(
    ("problem", "order"),
    [
        (CASES["pressed"], 1),
        (CASES["pressed"], 2),
        (partial(cube, cells=1, **SQUEEZED), 2),
    ],
)
def test_no_change_that_falsifies_a_claim_passes(problem, order, tmp_path):
    """``python -m campaigns receipts`` has many of them."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(problem(order)), path)
    assert not falsifies(*opened(path))
    found = tampered(path, np.random.default_rng(order), 25)
    wrong = [row for row in found if row[1]]
    assert len(wrong) == 25
    assert [what for what, _, passed in wrong if passed] == []


def test_the_judge_has_the_energies_by_other_means(tmp_path):
    """They are inside the interval of the checker, and near its ends."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    judge = Judge(arrays, header)
    assert not judge.falsified
    upper, lower = judge.energies()
    width = header["upper"] - header["lower"]
    assert upper == pytest.approx(header["upper"], abs=1e-6 * width)
    assert lower == pytest.approx(header["lower"], abs=receipt.LOSS * width)


def test_claims_that_are_too_good_do_not_pass(tmp_path):
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    width = header["upper"] - header["lower"]
    assert not passes(arrays, header | {"upper": header["upper"] - 1e-4 * width})
    assert not passes(arrays, header | {"lower": header["lower"] + 1e-4 * width})
    assert not passes(arrays, header | {"upper": float("nan")})
    assert passes(arrays, header | {"upper": header["upper"] + width})


def small_receipt(path):
    """Arrays and header of the receipt of a force on a few cells."""
    mesh = block.mesh(0.5, (1.0, 0.7))
    problem = Problem(mesh, MATERIAL, order=1, **PRESSED)
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    return opened(path)


def sides_of(arrays):
    """Places (side of a cell, cell) on the boundary, and inside."""
    other = arrays["other"].ravel()
    out = other == np.arange(other.size)
    return np.flatnonzero(out), np.flatnonzero(~out)


def beside(arrays, header):
    """A second body beside that of a receipt: no support, and a small body force."""
    P, K, B = header["sizes"]
    two = {}
    for name, values in arrays.items():
        same = name in {"law", "passed"}
        two[name] = np.concatenate([values, values * same], axis=-1)
    two["points"][:, P:] = arrays["points"] + 3
    two["cells"][:, K:] = arrays["cells"] + P
    side, cell = np.divmod(arrays["other"], K)
    two["other"] = np.concatenate(
        [side * 2 * K + cell, side * 2 * K + cell + K], axis=1
    )
    two["body_force"][0, 1, K:] = 1e-17
    on_side = np.argsort(
        np.r_[sides_of(arrays)[0] // K, sides_of(arrays)[0] // K], kind="stable"
    )
    for name in ("held", "traction", "gap", "pressure"):
        two[name] = two[name][..., on_side]
    return two, header | {"sizes": [2 * P, 2 * K, 2 * B]}


def tangled(arrays, header):
    """Cells that pass on forces to each other, and other wrong hints."""
    flow = arrays["passed"]

    inner = sides_of(arrays)[1][0]
    pair = [inner, arrays["other"].ravel()[inner]]
    yield {"passed": onwards(flow, pair)}
    yield {"passed": onwards(0 * flow + 1.0, pair)}
    for wrong in (0.5 * flow, 0 * flow, 0 * flow + np.inf, 0 * flow + np.nan):
        yield {"passed": wrong}
    for axis in (1, 2):
        yield {"passed": np.roll(flow, 1, axis=axis)}
    free = sides_of(arrays)[0][~arrays["held"].astype(bool).any(axis=0)][0]
    yield {"passed": onwards(flow, [free])}


def onwards(flow, places, size=None):
    """Forces that the cells of ``places`` pass by these sides alone, as many as before."""
    flow = flow.copy()
    K = flow.shape[2]
    for place in places:
        side, cell = divmod(place, K)
        total = flow[:, :, cell].sum(axis=1) if size is None else size
        flow[:, :, cell] = 0
        flow[:, side, cell] = total
    return flow


def test_supports_of_one_body_do_not_hold_another(tmp_path):
    """The second one flies away: the least energy is minus infinity."""
    path = tmp_path / "receipt.npz"
    problem = Problem(block.mesh(0.5, (1.0, 0.7)), MATERIAL, order=1, **PRESSED)
    write_receipt(semismooth_newton(problem), path)
    arrays, header = beside(*opened(path))
    words = packed(arrays)
    with pytest.raises(ValueError, match=r"^passed: "):
        proved_intervals(words, header)


def test_numbers_whose_products_vanish_do_not_pass(tmp_path):
    """Rounding errors are known without underflow, and for sums that do not cancel."""
    arrays, header = small_receipt(tmp_path / "receipt.npz")
    law = arrays["law"].copy()
    law[3] = 1e-20
    for changed, message in (
        ({"points": 1e-25 * arrays["points"]}, "cells: too flat"),
        ({"u": 1e160 * arrays["u"]}, "numbers: too large, or none"),
        ({"law": np.nan * arrays["law"]}, "numbers: too large, or none"),
        ({"law": law}, "law: a modulus is not positive"),
    ):
        words = packed(arrays | changed)
        with pytest.raises(ValueError, match=f"^{message}"):
            check_receipt.Body(words, header)
    assert not passes(arrays, header | {"factor": float("inf")})


def changed_words(words):
    """Words of other types and shapes."""
    yield words.view(np.int64)
    yield words.astype(np.longdouble)
    yield words.astype(np.float32)
    yield words.astype(words.dtype.newbyteorder())
    yield words[:-1]
    yield np.append(words, 0)
    yield words[None]


@pytest.mark.parametrize("order", [1, 2])
def test_a_load_along_a_roller_has_to_be_in_equilibrium(order, tmp_path):
    """The component that a roller holds is free there, the other one is not."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["rolling"](order)), path)
    arrays, header = opened(path)
    held = arrays["held"] != 0
    side = np.flatnonzero(held.sum(axis=0) == 1)[0]
    before = check_receipt.Body(packed(arrays), header)
    for component in range(2):
        traction = arrays["traction"].copy()
        traction[0, component, :, side] += 1.0
        body = check_receipt.Body(packed(arrays | {"traction": traction}), header)
        more = np.abs(body.force - before.force).sum()
        missed = 0.0 if held[component, side] else before.outer[side]
        assert more == pytest.approx(missed, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_other_types_and_shapes_do_not_pass(order, tmp_path):
    """Each array has its place in the file, so that its shape is what the sizes say."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pressed"](order)), path)
    arrays, header = opened(path)
    words = packed(arrays)
    assert passes(arrays, header)
    for changed in changed_words(words):
        with pytest.raises(ValueError, match=r"^receipt: other"):
            check_receipt.Body(changed, header)
    for order in (0, 3 - header["order"], 3):
        with pytest.raises(ValueError, match=r"^receipt: other"):
            check_receipt.Body(words, header | {"order": order})
    P, K, B = header["sizes"]
    for sizes in ([P, K + 1, B], [0, K, B], [P, K, -1], [1.5, K, B], [True, K, B]):
        with pytest.raises((ValueError, TypeError)):
            check_receipt.Body(words, header | {"sizes": sizes})


def test_forces_that_go_round_do_not_pass(tmp_path):
    """Each cell passes on more than it gets, so that forces end at supports."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    assert passes(arrays, header)
    for hints in tangled(arrays, header):
        assert not passes(arrays | hints, header)


def test_cells_in_a_ring_do_not_pass(tmp_path):
    """All cells around a vertex pass on their forces to the next one, without a support."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    cells, other = arrays["cells"], arrays["other"]
    K = header["sizes"][1]
    on_boundary = [np.delete(cells[:, p % K], p // K) for p in sides_of(arrays)[0]]
    inside = np.setdiff1d(cells, on_boundary)[0]
    ring = np.flatnonzero((cells == inside).any(axis=0))
    middle = arrays["points"][:, cells[:, ring]].mean(axis=1)
    middle -= arrays["points"][:, [inside]]
    ring = ring[np.arctan2(middle[1], middle[0]).argsort()]
    sides = [
        np.flatnonzero(other[:, cell] % K == after)[0] * K + cell
        for cell, after in zip(ring, np.roll(ring, 1), strict=True)
    ]
    names = "stress", "body_force", "traction", "pressure"
    nothing = {name: 0 * arrays[name] for name in names}
    for size, data in ((1e-20, {}), (1.0, {}), (1e19, {}), (0.0, nothing)):
        flow = onwards(arrays["passed"], sides, size)
        words = packed(arrays | {"passed": flow} | data)
        with pytest.raises(ValueError, match=r"^passed: too little"):
            proved_intervals(words, header)


def test_cells_that_owe_forces_to_each_other_do_not_pass(tmp_path):
    """Negative numbers would grow along a ring of two cells: only their sizes count."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    inner = sides_of(arrays)[1][0]
    pair = [inner, arrays["other"].ravel()[inner]]
    words = packed(arrays | {"passed": onwards(arrays["passed"], pair, -1e19)})
    with pytest.raises(ValueError, match=r"^passed: too little"):
        proved_intervals(words, header)


@pytest.mark.parametrize("order", [1, 2])
def test_any_tangent_proves_something_true(order, tmp_path):
    """Random hints make the interval wider, and never lose what the judge finds."""
    path = tmp_path / "receipt.npz"
    problem = CASES["pressed"](order)
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    judge = Judge(arrays, header)
    assert not judge.falsified
    lower, upper = judge.goal()
    random = np.random.default_rng(order)
    shape = arrays["tangent"].shape
    width = header["goal upper"] - header["goal lower"]
    for size in (0.0, 1e-25, 1e-6, 1e-3, 1.0, 1e19):
        hint = size * random.uniform(-0.5, 1.0, shape)
        words = packed(arrays | {"tangent": hint})
        proved = proved_intervals(words, header)
        assert proved["goal lower"] <= lower
        assert proved["goal upper"] >= upper
        assert proved["goal upper"] - proved["goal lower"] > 0.999 * width


def test_the_checker_needs_numpy_alone(tmp_path):
    """A copy of the file in an empty folder, Python without site packages but numpy's."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](1)), "contact_force")
    write_receipt(found, path)
    file = Path(check_receipt.__file__)
    (tmp_path / file.name).write_text(file.read_text())
    alone = "import sys; sys.modules.update(ngepc=None, ngsolve=None, scipy=None); "
    code = f"import check_receipt; print(check_receipt.check({str(path)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", alone + code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    assert "cells, plane strain: least energy in (" in done.stdout


def test_the_file_says_pass_or_fail_and_why(tmp_path):
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pressed"](1)), path)
    command = [sys.executable, check_receipt.__file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.startswith("PASS: ")
    path.write_bytes(b"something else")
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("FAIL: ")
    assert "Traceback" not in done.stderr
    assert "pickle" not in done.stderr


def test_sums_are_enclosed():
    """Of numbers that cancel, beside their exact sum."""
    random = np.random.default_rng(8)
    for _ in range(20):
        x = random.normal(size=1000) * 10.0 ** random.integers(-12, 12, 1000)
        exact = sum(map(Fraction, x.tolist()))
        assert Fraction(check_receipt.most(x[:400], x[400:])) >= exact
        assert Fraction(check_receipt.most(-x)) >= -exact


def test_the_checker_is_short():
    """All lines: what an examiner has to read."""
    text = Path(check_receipt.__file__).read_text()
    assert len(text.splitlines()) <= 300


def test_a_body_at_rest_has_a_receipt_of_its_energy_only(tmp_path):
    path = tmp_path / "receipt.npz"
    result = semismooth_newton(plate(contact="contact", gap=0.01))
    with pytest.raises(ValueError, match="nothing strains the body"):
        write_receipt(goal_bound(result, "contact_force"), path)
    assert not path.exists()
    lower, upper = write_receipt(result, path)
    assert lower <= 0 <= upper
    assert upper - lower < 1e-40


def test_a_receipt_of_an_older_format_says_so(tmp_path):
    path = tmp_path / "receipt.npz"
    np.savez(path, header=json.dumps({"format": "ngepc receipt 9"}))
    with pytest.raises(ValueError, match="not 'ngepc receipt 12', write it again"):
        check_receipt.check(path)


def test_a_damaged_file_fails(tmp_path, capsys):
    path = tmp_path / "receipt.npz"
    path.write_bytes(b"no receipt")
    assert main(["check", str(path)]) == 1
    np.savez(path, header=json.dumps({"format": "another"}))
    assert main(["check", str(path)]) == 1
    out = capsys.readouterr().out
    assert out.count("FAIL") == 2
    assert "no receipt" in out
    assert "pickle" not in out
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    assert main(["check", str(path)]) == 0
    assert "PASS" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("data", "named"),
    [
        ({"contact": "contact", "gap": 0.001, "friction": 0.1}, "friction"),
        ({"body_force": (0.0, IfPos(x - 0.5, -1.0, 0.0))}, "body_force"),
        ({"body_force": (0.0, -x * y)}, "body_force"),
        ({"contact": "contact", "gap": -0.01 * x * x, "order": 1}, "gap"),
        ({"kinematics": "plane stress", "order": 1}, "plane stress"),
        (
            {
                "clamped": None,
                "prescribed": {"left": (0.0, 0.001)},
                "contact": "clamped",
                "gap": -0.001,
                "body_force": (1.0, -8.0),
            },
            "contact='clamped': a receipt needs an open gap",
        ),
    ],
)
def test_what_has_no_receipt_is_refused_by_name(data, named, tmp_path):
    with pytest.raises(ValueError, match=named):
        write_receipt(semismooth_newton(plate(**data)), tmp_path / "receipt.npz")


def test_an_obstacle_that_is_curved_on_facets_is_refused(tmp_path):
    """In space displacements of order two have bounds for quadratic obstacles, no receipts."""
    bent = cube(2, cells=1, contact="contact", gap=-0.002 - 0.001 * x * x)
    with pytest.raises(
        ValueError, match="gap: a receipt needs an obstacle that is affi"
    ):
        write_receipt(semismooth_newton(bent), tmp_path / "receipt.npz")


def test_a_receipt_ends_in_npz(tmp_path):
    result = semismooth_newton(CASES["pulled"](1))
    with pytest.raises(ValueError, match="npz"):
        write_receipt(result, tmp_path / "receipt.txt")


def test_a_receipt_that_rounding_rules_says_so():
    """Three times as wide as the interval of the goal, and more than a hundredth of its ends."""
    with pytest.warns(UserWarning, match="rounding errors of small cells"):
        receipt.warn_if_wide((3.86, 4.25), (-3.7, 11.8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        receipt.warn_if_wide((3.86, 4.25), (3.8, 4.3))
        receipt.warn_if_wide((2.0, 2.0), (2.0 - 1e-6, 2.0 + 1e-6))
