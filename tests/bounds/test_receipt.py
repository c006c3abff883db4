"""Receipts: files that prove intervals of energies and goals to somebody who has numpy only."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns.receipts import Judge, falsifies, opened, passes, tampered
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
from ngepc.bounds import check_receipt
from ngepc.bounds.bound import bound_data_of, bound_of
from ngepc.geometries import block
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
CHECKER = Path(check_receipt.__file__)
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
    header = check_receipt.check(tmp_path / "receipt.npz")
    assert (header["lower"], header["upper"]) == (lower, upper)
    assert upper - lower == pytest.approx(bound.total, rel=0.15 if order == 2 else 0.05)
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
    header = check_receipt.check(path)
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
    assert upper - lower > 0.9 * width


def test_a_goal_in_space_has_a_receipt(tmp_path):
    path = tmp_path / "receipt.npz"
    found = goal_bound(semismooth_newton(CUBE), "work")
    lower, upper = write_receipt(found, path)
    assert upper - lower == pytest.approx(found.width, rel=0.2)
    assert passes(*opened(path))


def test_the_supremum_of_the_checker_is_one():
    """No less than the integrand at random trial stresses, and close to the best of them."""
    random = np.random.default_rng(4)
    p = random.normal(size=(60, 1, 3))
    w = p + 0.3 * random.normal(size=p.shape)
    k = 10 ** random.uniform(-1, 1, 60)
    h = 10 ** random.uniform(-2, 0, 60)
    beta = 10 ** random.uniform(-1, 1, 60)
    law = np.column_stack([k, 2 + h, h, beta, np.ones(60)])
    bound, smooth = check_receipt.highest(np.concatenate([p, w], axis=2), law)
    y = p + w
    quadratic = (y**2).sum(axis=2) / (4 * k[:, None])
    np.testing.assert_allclose(bound[smooth], quadratic[smooth], rtol=1e-12)

    g = np.append(0.0, np.geomspace(1e-4, 1e4, 4000))[:, None, None, None]
    M, h, beta, k = (v[:, None, None] for v in (2 + h, h, beta, k))
    v = (beta + M * g) * p + (beta + h * g) * w
    length = np.sqrt((v**2).sum(axis=-1))
    outside = length - ((k * (beta + M * g)) * (beta + h * g))[..., 0]
    inside = y * np.minimum(1 / (2 * k), beta / np.sqrt((y**2).sum(axis=2))[..., None])
    inside = (y * inside).sum(axis=2) - k[..., 0] * (inside**2).sum(axis=2)
    best = np.maximum(outside.max(axis=0), inside)
    assert (bound >= best * (1 - 1e-12)).all()
    assert np.median(bound / best) < 1.001
    assert (bound / best).max() < 1.2


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
    for name in ("z", "tau", "goal_pressure", "goal_force", "goal_contact"):
        values = arrays[name].copy()
        place = np.unravel_index(np.abs(values).argmax(), values.shape)
        values[place] += 0.1 * (np.abs(values).max() or 1.0)
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


def changed_types(arrays):
    """Arrays that mean the same to a reader, and something else to numpy."""
    held = arrays["held"].astype(int)
    moved = arrays["u"] + 0.1 * np.ptp(arrays["u"])
    yield "held", arrays | {"held": held, "u": moved}
    yield "contact", arrays | {"contact": arrays["contact"].astype(int)}
    yield "cells", arrays | {"cells": arrays["cells"].astype(np.uint64)}
    yield "u", arrays | {"u": arrays["u"].astype(np.float32)}
    yield "stress", arrays | {"stress": arrays["stress"] + 0j}
    yield "traction", arrays | {"traction": arrays["traction"][:, :1]}
    yield "mu", arrays | {"mu": arrays["mu"][:1]}
    yield "pressure", arrays | {"pressure": arrays["pressure"][0]}


@pytest.mark.parametrize("order", [1, 2])
def test_other_types_and_shapes_do_not_pass(order, tmp_path):
    """~1 is -2, which numpy takes as true: held sides of integers would not be checked."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pressed"](order)), path)
    arrays, header = opened(path)
    assert passes(arrays, header)
    for name, other in changed_types(arrays):
        with pytest.raises(ValueError, match=f"^{name}: "):
            check_receipt.proved_intervals(other, header)


def test_stress_and_sides_have_one_order(tmp_path):
    """Tractions at vertices alone do not show jumps in the middle of sides."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pressed"](2)), path)
    arrays, header = opened(path)
    arrays["cells"] = arrays["cells"][:, :3]
    for name in ("prescribed", "traction", "gap", "pressure"):
        arrays[name] = arrays[name][:, :2]
    with pytest.raises(ValueError, match=r"^stress: "):
        check_receipt.proved_intervals(arrays, header)


def test_the_checker_needs_numpy_alone(tmp_path):
    """A copy of the file in an empty folder, Python without site packages but numpy's."""
    path = tmp_path / "receipt.npz"
    write_receipt(semismooth_newton(CASES["pulled"](1)), path)
    alone = tmp_path / "check_receipt.py"
    alone.write_text(CHECKER.read_text())
    code = (
        "import sys; sys.modules['ngepc'] = sys.modules['ngsolve'] = None; "
        "sys.modules['scipy'] = None; import check_receipt; "
        f"sys.exit(check_receipt.check_files([{str(path)!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "PASS" in done.stdout


@pytest.mark.parametrize(("N", "shapes"), [(2, 1), (3, 3)])
def test_parts_of_parts_do_not_degenerate(N, shapes):
    """Bey (1995): cutting a tetrahedron again and again makes three shapes, of equal volume."""
    simplices = np.random.default_rng(N).normal(size=(1, N + 1, N))
    whole = abs(np.linalg.det(simplices[0, 1:] - simplices[0, 0]))
    table = np.concatenate(check_receipt.cuts(N, N + 1))
    for level in range(1, 5):
        simplices = (table @ simplices).reshape(-1, N + 1, N)
        volume = abs(np.linalg.det(simplices[:, 1:] - simplices[:, :1]))
        np.testing.assert_allclose(volume, whole / 2 ** (N * level), rtol=1e-9)
        i, j = np.triu_indices(N + 1, 1)
        edges = np.linalg.norm(simplices[:, i] - simplices[:, j], axis=2)
        scaled = np.round(np.sort(edges, axis=1) * 2**level, 9)
        assert len(np.unique(scaled, axis=0)) <= shapes


def test_the_checker_is_short():
    """Lines of code, without comments, docstrings and blank lines."""
    text = CHECKER.read_text()
    parts = text.split('"""')
    lines = [line for part in parts[::2] for line in part.splitlines()]
    code = [line for line in lines if line.strip() and line.strip()[0] != "#"]
    assert len(code) <= 465


def test_a_damaged_file_fails(tmp_path):
    path = tmp_path / "receipt.npz"
    path.write_bytes(b"no receipt")
    assert check_receipt.check_files([str(path)]) == 1
    np.savez(path, header=json.dumps({"format": "another"}))
    assert check_receipt.check_files([str(path)]) == 1


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
