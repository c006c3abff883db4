"""Receipts: files that prove intervals of energies and goals to somebody who has numpy only."""

import json
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from campaigns.receipts import Judge, bernstein, falsifies, opened, passes, tampered
from ngsolve import IfPos, x, y

from ngepc import (
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    error_bound,
    evolve,
    goal_bound,
    semismooth_newton,
    write_receipt,
)
from ngepc.__main__ import main
from ngepc.bounds.bound import bound_data_of, bound_of
from ngepc.geometries import block
from ngepc.goals import check_receipt
from ngepc.goals.receipt_file import numbered_sides, packed, passed, ways
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
MOVED = {
    "clamped": None,
    "prescribed": {"left": (0.001 * y, 0.0), "right": (0.002, None)},
}
CUBE = Problem(
    block.structured_mesh(3, 3, 3, simplices=True),
    MATERIAL,
    traction={"contact": (0.0, 1.0, -7.0)},
    order=1,
)
CASES = {
    "lshape": lambda order: replace(example("lshape", 225), order=order),
    "wrench": lambda order: replace(example("wrench", 245), order=order),
    "pulled": lambda order: plate(order=order, **PULLED),
    "pressed": lambda order: plate(order=order, **PRESSED),
    "rolling": lambda order: plate(order=order, **ROLLING),
    "moved": lambda order: plate(order=order, **MOVED),
    "combined": lambda order: replace(plate(order=order, **PULLED), material=COMBINED),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", list(CASES))
def test_a_receipt_shows_what_the_bound_says(name, order, tmp_path):
    """The checker knows no element and no tangent, and comes to the same interval."""
    result = semismooth_newton(CASES[name](order))
    bound = bound_of(bound_data_of(result.discrete), result.state)
    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    assert check_receipt.check(tmp_path / "receipt.npz")
    header = opened(tmp_path / "receipt.npz")[1]
    assert (header["lower"], header["upper"]) == (lower, upper)
    assert upper - lower == pytest.approx(bound.total, rel=0.05)
    assert upper >= bound.energy - 0.05 * bound.total
    assert lower <= bound.least_energy + 0.05 * bound.total


def test_a_receipt_in_space(tmp_path):
    result = semismooth_newton(CUBE)
    bound = error_bound(result)
    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    assert upper - lower == pytest.approx(bound.total, rel=0.05)
    assert passes(*opened(tmp_path / "receipt.npz"))


def test_a_receipt_of_a_step_with_a_history(tmp_path):
    steps = [(1.0, {}), (2.0, {"gap": 1.0})]
    problem = plate(contact="contact", gap=-0.01, order=1)
    last = evolve(problem, steps).steps[-1].problem
    lower, upper = write_receipt(semismooth_newton(last), tmp_path / "receipt.npz")
    assert lower < upper
    arrays, header = opened(tmp_path / "receipt.npz")
    assert np.abs(arrays["initial"]).max() > 0
    assert not falsifies(arrays, header)


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


GOALS = {
    "lshape": ["work", "contact_force"],
    "pressed": ["contact_force", Reaction("clamped", 1)],
    "rolling": [MeanDisplacement("right", 0)],
    "moved": [Reaction("right", 0)],
    "combined": ["work"],
}
NAMED = [(name, goal) for name, goals in GOALS.items() for goal in goals]


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("name", "goal"), NAMED)
def test_a_receipt_of_a_goal_shows_its_interval(name, goal, order, tmp_path):
    """The checker has another supremum and other bounds of its integral, and no tangent."""
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
    """The theorem as it is on the page, by a rule and trial strains: inside, and nearly as wide."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](order)), "contact_force")
    write_receipt(found, path)
    arrays, header = opened(path)
    judge = Judge(arrays, header)
    assert not judge.falsified
    lower, upper = judge.goal()
    assert header["goal lower"] <= lower <= upper <= header["goal upper"]
    width = header["goal upper"] - header["goal lower"]
    assert upper - lower > (0.89 if order == 1 else 0.74) * width


def test_a_goal_in_space_has_a_receipt(tmp_path):
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CUBE), "work")
    lower, upper = write_receipt(found, path)
    assert upper - lower == pytest.approx(found.width, rel=0.2)
    assert passes(*opened(path))


def test_a_tangent_of_the_norm_is_above_it():
    """Paragraph 3 of the checker: F(q) <= F(r) + [|v| - V - 2 b r]_+^2/(4 b) for all q >= 0."""
    random = np.random.default_rng(5)
    A, v = random.normal(size=(2, 3, 500)) * 10 ** random.uniform(-1, 1, (2, 1, 500))
    b, r = 10 ** random.uniform(-2, 0, (2, 500))
    V = 10 ** random.uniform(-2, 0, 500)
    gained = length(A + r * v) - length(A)
    sure = gained >= r * (V + 2 * b * r)
    assert 50 < sure.sum() < 450
    bound = length(A + r * v) - V * r - b * r**2
    bound += np.maximum(length(v) - V - 2 * b * r, 0.0) ** 2 / (4 * b)
    q = np.append(0.0, np.geomspace(1e-3, 1e3, 400))[:, None, None]
    best = (length(A + q * v, 1) - V * q[:, 0] - b * q[:, 0] ** 2).max(axis=0)
    assert (best <= bound * (1 + 1e-12) + 1e-12)[sure].all()
    assert not (best <= bound)[~sure].all()


def test_a_norm_is_at_most_a_square_over_any_length():
    """Paragraph 3 of the checker: |x| <= y + (|z|^2 + ([Y - y]_+)^2)/(2 Y), also for y < 0."""
    random = np.random.default_rng(6)
    y, z = random.normal(size=(2, 2000))
    Y = 10 ** random.uniform(-2, 1, 2000)
    bound = y + (z**2 + np.maximum(Y - y, 0.0) ** 2) / (2 * Y)
    assert (bound >= np.hypot(y, z) * (1 - 1e-12)).all()
    near = bound / np.hypot(y, z) - 1
    assert near[(np.abs(z) < 0.1 * y) & (y > Y) & (0.9 * y < Y)].max() < 1e-3


@pytest.mark.parametrize("k", [3, 6])
def test_the_tangent_of_a_supremum_is_sure_on_the_whole_part(k):
    """|A + r v| - |A| >= r (V + 2 b r) at many points, with the r of the checker."""
    random = np.random.default_rng(10 + k)
    law = random_law(random, 300)
    n = random.normal(size=(3, 300))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, 300)
    moduli = law[0] * (law[2] + np.array([law[1], 1 + law[1]]) * g)
    noise = np.repeat([0.03, 0.1, 0.3], 100) * law[0] * law[2]
    p, w = random.normal(size=(2, k, 3, 300)) * noise
    p += moduli[0] * n
    w += moduli[1] * n
    x = fields(p, w, law)
    V, kk, h, beta = full(law)
    twice = check_receipt.supremum(2, x, V, kk, h, beta)[1]
    b = kk * h * (1 + h)
    r = twice / (2 * b)
    assert 90 < (r > 0).sum() < 300
    y, v = np.split(x, 2, axis=1)
    A = beta * check_receipt.outside_ball(y, length(y, 1), 2 * kk * beta)
    shares = random.dirichlet(np.ones(3), 200)
    at = bernstein(shares, k)
    A, v = (np.einsum("qi,icM->qcM", at, field) for field in (A, v))
    gained = length(A + r * v, 1) - length(A, 1)
    assert (gained >= r * (V + twice) - 1e-12 * length(A, 1)).all()


def length(x, axis=0):
    """Sizes of vectors."""
    return np.sqrt((x**2).sum(axis=axis))


def best_of(p, w, law):
    """The supremum of the checker's paragraph 6 by trial, at points (c, K); mu is one half."""
    k, h, beta = law
    y = p + w
    g = np.append(0.0, np.geomspace(1e-3, 1e3, 600))[:, None]
    v = (beta + (1 + h) * g)[:, None] * p + (beta + h * g)[:, None] * w
    outside = length(v, 1) - k * (beta + (1 + h) * g) * (beta + h * g)
    t = np.minimum(length(y) / (2 * k), beta)
    return np.maximum(outside.max(axis=0), length(y) * t - k * t**2)


def random_law(random, count):
    """Numbers k, h, beta for mu of one half."""
    k = 10 ** random.uniform(-1, 1, count)
    h = 10 ** random.uniform(-2, 0, count)
    beta = 10 ** random.uniform(-1, 1, count)
    return np.array([k, h, beta])


def fields(p, w, law):
    """What the checker's supremum takes: p + w, and the vector that plastic strains meet."""
    y = p + w
    return np.concatenate([y, p + law[1] * y], axis=-2)


def full(law):
    """The law with the number V of the checker's paragraph 6."""
    k, h, beta = law
    return np.array([k * beta * (1 + 2 * h), k, h, beta])


def supremum(x, law):
    """The checker's bound of suprema on triangles."""
    return check_receipt.supremum(2, x, *full(law))[0]


def test_the_supremum_of_the_checker_is_one():
    """No less than the integrand at random plastic strains; near it where the tangents agree."""
    random = np.random.default_rng(4)
    law = random_law(random, 400)
    k, h, beta = law
    n = random.normal(size=(3, 400))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, 400)
    size = np.repeat([0.0, 0.01, 0.1, 1.0], 100)
    p = k * ((beta + h * g) * n + size * random.normal(size=n.shape))
    w = k * ((beta + (1 + h) * g) * n + size * random.normal(size=n.shape))
    x = fields(p, w, law)[None].repeat(3, axis=0)
    bound = supremum(x, law)
    best = best_of(p, w, law)
    assert (bound >= best * (1 - 1e-12)).all()
    excess = (bound / best - 1).reshape(4, -1)
    assert excess[0].max() < 1e-3
    assert np.median(excess[1]) < 1e-3
    assert np.median(excess[2]) < 0.02


def test_the_supremum_of_an_elastic_point_is_a_square():
    """|p + w|^2/(4 k) where neither p nor w leaves the ball."""
    random = np.random.default_rng(8)
    law = random_law(random, 100)
    k, _, beta = law
    p, w = 0.5 * k * beta * random.uniform(-1, 1, (2, 3, 100)) / np.sqrt(3)
    x = fields(p, w, law)[None].repeat(3, axis=0)
    bound, _, largest = check_receipt.supremum(2, x, *full(law))
    np.testing.assert_allclose(bound, length(p + w) ** 2 / (4 * k), rtol=1e-12)
    assert (largest < 0).all()


def test_a_vector_against_the_strain_gains_nothing():
    """A points against v: the bound may not use the tangent at r > 0."""
    law = np.array([[1.0], [0.1], [1.0]])
    y = np.array([[-6.0], [0.0]])
    v = np.array([[3.0], [0.0]])
    p = v - 0.1 * y
    x = np.concatenate([y, v])[None].repeat(3, axis=0)
    bound = supremum(x, law)
    assert bound[0] >= best_of(p, y - p, law)[0]


@pytest.mark.parametrize("k", [3, 6])
def test_means_of_suprema_are_bounded(k):
    """Of fields that vary; by the suprema on many small parts."""
    random = np.random.default_rng(k)
    law = random_law(random, 30)
    n = random.normal(size=(3, 30))
    n /= length(n)
    g = 10 ** random.uniform(-1, 1, 30)
    moduli = law[0] * (law[2] + np.array([law[1], 1 + law[1]]) * g)
    mean = np.concatenate([moduli[0] * n, moduli[1] * n])
    size = np.repeat([0.01, 0.1, 1.0], 10) * law[0] * law[2]
    x = mean + size * random.normal(size=(k, 6, 30))
    x = fields(x[:, :3], x[:, 3:], law)
    bounds = [
        check_receipt.means(2, check_receipt.supremum, x, full(law), c)
        for c in range(3)
    ]
    for _ in range(3):
        x = check_receipt.subdivided(2, x)
        law = np.tile(law, 4)
    best = np.zeros(30)
    for i, j in combinations(range(3), 2):
        middle = (x[i] + x[j]) / 2
        if k == 6:
            middle = middle / 2 + x[6 - i - j] / 2
        y, v = np.split(middle, 2)
        p = v - law[1] * y
        best += best_of(p, y - p, law).reshape(-1, 30).mean(axis=0) / 3
    assert (np.minimum.reduce(bounds) >= best * (1 - 1e-5)).all()
    for bound, excess in zip(bounds, (1e-3, 1e-3, 1e-3), strict=True):
        assert np.median((bound / best - 1)[:10]) < excess
    assert np.median(bounds[2] / best) <= np.median(bounds[0] / best)


@pytest.mark.parametrize("density", ["flow", "squared_excess"])
def test_plastic_terms_are_bounded(density):
    """By the law of the step at many points; nearly so where all of a cell yields, or with cuts."""
    random = np.random.default_rng(3)
    beta = 10 ** random.uniform(-1, 1, 90)
    size = np.repeat([0.1, 1.0, 3.0], 30) * beta
    s = 2 * beta * np.array([[1.0], [0.0], [0.0]]) + size * random.normal(
        size=(3, 3, 90)
    )
    of = getattr(check_receipt, density)
    bound, cut = (check_receipt.means(2, of, s, beta[None], k) for k in (0, 2))
    exact = s
    for _ in range(5):
        exact = check_receipt.subdivided(2, exact)
    over = np.maximum(length(exact, 1).reshape(3, -1, 90) - beta, 0.0) ** 2
    mean = (-over / 2 if density == "flow" else over).mean(axis=(0, 1))
    least = np.minimum(bound, cut)
    assert (least >= mean - 2e-3 * np.abs(mean)).all()
    excess, less = (np.abs(found / mean - 1) for found in (bound, cut))
    assert np.median(excess[:30]) < 1e-2
    assert np.median(less[30:60]) < 0.3 * np.median(excess[30:60])


@pytest.mark.parametrize("order", [1, 2])
def test_no_change_that_falsifies_an_interval_of_a_goal_passes(order, tmp_path):
    """``python -m campaigns receipts`` has 600 of them."""
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CASES["pressed"](order)), "contact_force")
    write_receipt(found, path)
    found = tampered(path, np.random.default_rng(order), 25)
    wrong = [row for row in found if row[1]]
    assert len(wrong) == 25
    assert [what for what, _, passed in wrong if passed] == []


def test_each_part_of_the_proof_of_a_goal_is_needed(tmp_path):
    """One number of each array of the adjoint, changed by a tenth of the largest."""
    path = tmp_path / "receipt.npz"
    problem = CASES["pressed"](1)
    write_receipt(goal_bound(semismooth_newton(problem), "contact_force"), path)
    arrays, header = opened(path)
    for name in ("u", "stress", "pressure", "body_force", "gap"):
        values = arrays[name].copy()
        adjoint = np.moveaxis(values, -3 if name == "stress" else -2, 0)[1]
        place = np.unravel_index(np.abs(adjoint).argmax(), adjoint.shape)
        adjoint[place] += 0.1 * (np.abs(adjoint).max() or 1.0)
        assert not passes(arrays | {name: values}, header)
    width = header["goal upper"] - header["goal lower"]
    narrow = {"goal lower": header["goal lower"] + 1e-4 * width}
    assert not passes(arrays, header | narrow)
    assert not passes(arrays, header | {"factor": 0.5 * header["factor"]})
    assert not passes(arrays, header | {"goal upper": float("nan")})


@pytest.mark.parametrize(("name", "order"), [("pressed", 1), ("pressed", 2)])
def test_no_change_that_falsifies_a_claim_passes(name, order, tmp_path):
    """``python -m campaigns receipts`` has 500 of them."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES[name](order)), path)
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
    assert lower == pytest.approx(header["lower"], abs=0.02 * width)


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


def to_first(arrays, force):
    """What cells pass on of forces if all of them go to the first cell."""
    cells = arrays["cells"].T
    places = numbered_sides(cells)
    nowhere = np.zeros(arrays["contact"].size, dtype=bool)
    way, levels = ways(cells, places, nowhere)
    return passed(force, way, places, levels)


def beside(arrays, header):
    """A second body beside that of a receipt: no support, and a small body force."""
    K = arrays["mu"].size
    two = {}
    for name, values in arrays.items():
        same = name in {"lame_lambda", "mu", "hardening", "beta"}
        two[name] = np.concatenate([values, values * same], axis=-1)
    points = arrays["points"]
    two["points"] = np.concatenate([points, points + 3], axis=1)
    shifted = arrays["cells"] + points.shape[1]
    two["cells"] = np.concatenate([arrays["cells"], shifted], axis=1)
    two["body_force"][1, 0, K:] = 1e-17
    two["passed"][0, :, K:] = to_first(arrays, np.full(K, 1e-12))
    return two, header | {name: 2 * header[name] for name in "PKSB"}


def tangled(arrays):
    """Two cells that pass on forces to each other, and other wrong flows."""
    forces = arrays["passed"]
    first, second = numbered_sides(arrays["cells"].T)
    inner = np.flatnonzero(first != second)[0]
    K = arrays["mu"].size
    round_trip = forces.copy().reshape(len(forces), -1, K)
    for place in (first[inner], second[inner]):
        side, cell = divmod(place, K)
        round_trip[0, :, cell] = 0.0
        round_trip[0, side, cell] = 1.0
    yield round_trip
    yield -forces
    yield 0.5 * forces
    yield 0 * forces
    yield 0 * forces + np.inf
    yield 0 * forces + np.nan
    yield np.roll(forces, 1, axis=1)
    yield np.roll(forces, 1, axis=2)
    outwards = forces.copy()
    free = ~arrays["held"].all(axis=0)
    side, cell = divmod(first[first == second][free][0], K)
    outwards[0, side, cell] = 1.0
    yield outwards


def test_supports_of_one_body_do_not_hold_another(tmp_path):
    """The second one flies away: the least energy is minus infinity."""
    path = tmp_path / "receipt.npz"
    problem = Problem(block.mesh(0.5, (1.0, 0.7)), MATERIAL, order=1, **PRESSED)
    write_receipt(semismooth_newton(problem), path)
    arrays, header = beside(*opened(path))
    with pytest.raises(ValueError, match=r"^passed: too little"):
        check_receipt.proved_intervals(packed(arrays, header), header)


def test_numbers_whose_products_vanish_do_not_pass(tmp_path):
    """Rounding errors are known without underflow, and for sums that do not cancel."""
    arrays, header = small_receipt(tmp_path / "receipt.npz")
    lame = np.nextafter(-2 * arrays["mu"] / 3, np.inf)
    for changed, message in (
        ({"stress": 1e-160 * arrays["stress"]}, "numbers: too large or small"),
        ({"u": 1e160 * arrays["u"]}, "numbers: too large or small"),
        ({"mu": np.nan * arrays["mu"]}, "numbers: too large or small"),
        ({"lame_lambda": lame}, "bulk: too small"),
    ):
        words = packed(arrays | changed, header)
        with pytest.raises(ValueError, match=f"^{message}"):
            check_receipt.opened(words, header)
    assert not passes(arrays, header | {"factor": float("inf")})
    assert not passes(arrays, header | {"goal": "u\nPASS: another"})


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
def test_other_types_and_shapes_do_not_pass(order, tmp_path):
    """Each array has its place in the file, so that its shape is what the sizes say."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pressed"](order)), path)
    arrays, header = opened(path)
    words = packed(arrays, header)
    assert passes(arrays, header)
    for changed in changed_words(words):
        with pytest.raises(ValueError, match=r"^receipt: its arrays"):
            check_receipt.opened(changed, header)
    for order in (0, 3 - header["order"], 3):
        with pytest.raises(ValueError, match=r"^receipt: its arrays|^order: "):
            check_receipt.opened(words, header | {"order": order})
    if header["order"] == 1:  # no array of order one has the size S
        with pytest.raises(ValueError, match=r"^sides: not as many"):
            check_receipt.opened(words, header | {"S": header["S"] + 1})
    for sizes in ({"K": header["K"] + 1}, {"S": 0}, {"B": -1}, {"P": 1.5}, {"P": True}):
        with pytest.raises(ValueError, match=r"^receipt: its arrays|^sizes: "):
            check_receipt.opened(words, header | sizes)


def test_forces_that_go_round_do_not_pass(tmp_path):
    """Each cell passes on more than it gets, so that forces end at supports."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    assert passes(arrays, header)
    for forces in tangled(arrays):
        assert not passes(arrays | {"passed": forces}, header)


def test_cells_in_a_ring_do_not_pass(tmp_path):
    """All cells around a vertex pass on their forces to the next one, without a support."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    arrays, header = opened(path)
    cells = arrays["cells"]
    first, second = numbered_sides(cells.T)
    K = len(cells[0])
    outer = first[first == second]
    on_boundary = [np.delete(cells[:, p % K], p // K) for p in outer]
    inside = np.setdiff1d(cells, on_boundary)[0]
    ring = np.flatnonzero((cells == inside).any(axis=0))
    middle = arrays["points"][:, cells[:, ring]].mean(axis=1)
    middle -= arrays["points"][:, [inside]]
    ring = ring[np.arctan2(middle[1], middle[0]).argsort()]
    names = "stress", "body_force", "traction", "pressure"
    nothing = {name: 0 * arrays[name] for name in names}
    for size, other in ((1e-20, {}), (1.0, {}), (1e20, {}), (0.0, nothing)):
        forces = arrays["passed"].copy()
        forces[:, :, ring] = 0.0
        for cell, after in zip(ring, np.roll(ring, 1), strict=True):
            way = np.flatnonzero(~np.isin(cells[:, cell], cells[:, after]))[0]
            forces[:, way, cell] = size
        words = packed(arrays | {"passed": forces} | other, header)
        with pytest.raises(ValueError, match=r"^passed: too little"):
            check_receipt.proved_intervals(words, header)


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
    assert done.stdout.startswith("least energy in (")


@pytest.mark.parametrize(("N", "shapes"), [(2, 1), (3, 3)])
def test_parts_of_parts_do_not_degenerate(N, shapes):
    """Bey (1995): cutting a tetrahedron again and again makes three shapes, of equal volume."""
    simplices = np.random.default_rng(N).normal(size=(N + 1, N, 1))
    whole = abs(np.linalg.det(simplices[1:, :, 0] - simplices[0, :, 0]))
    for level in range(1, 5):
        simplices = check_receipt.subdivided(N, simplices)
        corners = simplices.transpose(2, 0, 1)
        volume = abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
        np.testing.assert_allclose(volume, whole / 2 ** (N * level), rtol=1e-9)
        i, j = np.triu_indices(N + 1, 1)
        edges = np.linalg.norm(corners[:, i] - corners[:, j], axis=2)
        scaled = np.round(np.sort(edges, axis=1) * 2**level, 9)
        assert len(np.unique(scaled, axis=0)) <= shapes


def test_the_checker_is_short():
    """Lines of code, without comments, docstrings and blank lines."""
    parts = Path(check_receipt.__file__).read_text().split('"""')
    lines = [line for part in parts[::2] for line in part.splitlines()]
    code = [line for line in lines if line.strip() and line.strip()[0] != "#"]
    assert len(code) <= 406


def test_a_receipt_of_an_older_format_says_so(tmp_path):
    path = tmp_path / "receipt.npz"
    np.savez(path, header=json.dumps({"format": "ngepc receipt 5"}))
    with pytest.raises(ValueError, match="'ngepc receipt 6' is needed, write"):
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
    ],
)
def test_what_has_no_receipt_is_refused_by_name(data, named, tmp_path):
    with pytest.raises(ValueError, match=named):
        write_receipt(semismooth_newton(plate(**data)), tmp_path / "receipt.npz")


def test_a_receipt_ends_in_npz(tmp_path):
    result = semismooth_newton(CASES["pulled"](1))
    with pytest.raises(ValueError, match="npz"):
        write_receipt(result, tmp_path / "receipt.txt")
