"""What the checker of receipts says about a stress that is out of equilibrium."""

import math

import numpy as np
import pytest
from campaigns.receipts import Judge, bernstein, opened, rule
from ngsolve import x, y

from ngepc import Material, Problem, semismooth_newton, write_receipt
from ngepc.geometries import block
from ngepc.goals import check_receipt
from ngepc.goals.check_receipt import KORN
from ngepc.goals.receipt_file import basis_coordinates, packed, with_hints

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)
CLAMPED = {"traction": {"contact": (0.5, -8.0 - x)}, "body_force": (0.0, -2.0)}
ROLLING = {
    "clamped": None,
    "prescribed": {"left": (0.0, None), "clamped": (None, 0.0)},
    "traction": {"right": (6.0 + y, 1.0)},
}
CUBE = {"traction": {"contact": (0.0, 1.0, -7.0)}}
CASES = {
    "clamped": (2, 1, CLAMPED),
    "clamped, order 2": (2, 2, CLAMPED),
    "rolling": (2, 1, ROLLING),
    "rolling, order 2": (2, 2, ROLLING),
    "cube": (3, 1, CUBE),
}


def out_of_balance(name, path, noise=1e-3):
    """A body whose stress misses equilibrium by a part of its size, and what passes its sides."""
    N, order, data = CASES[name]
    mesh = block.mesh(0.4 if N == 2 else 0.6, (1.0, 0.7, 0.8)[:N])
    problem = Problem(mesh, MATERIAL, order=order, **data)
    write_receipt(semismooth_newton(problem), path)
    arrays, header = opened(path)
    stress = arrays["stress"].copy()
    random = np.random.default_rng(3)
    stress += noise * np.abs(stress).max() * random.normal(size=stress.shape)
    words = with_hints(packed(arrays | {"stress": stress}), header)
    found = check_receipt.arrays_in(words, header)
    return arrays | {name: found[name] for name in ("stress", "passed")}, header


def plain_defect(r):
    """The number b of the lemma on the page, cell by cell, with determinants and inverses."""
    N = r.N
    reach = np.linalg.norm(np.ptp(r.points, axis=1))
    total = 0.0
    for K in range(r.K):
        corners = r.points[:, r.cells[: N + 1, K]].T
        edges = corners[:-1] - corners[-1]
        length = np.linalg.norm(edges)
        det = abs(np.linalg.det(edges))
        mu, h = r.mu[K], r.hardening[K]
        modulus = min(2 * mu * h / (2 * mu + h), r.bulk[K])
        volume = det / math.factorial(N)
        lever = 5 * reach * length ** (N - 1) / volume
        tractions = 2 * (1 + lever) * r.passed[:, :, K].sum()
        b = (r.force[:, K].sum() + tractions) / math.sqrt(volume)
        b *= KORN[N] * length**2 * np.linalg.norm(np.linalg.inv(edges))
        total += b**2 / modulus
    return math.sqrt(total)


@pytest.mark.parametrize("name", list(CASES))
def test_the_defect_cell_by_cell(name, tmp_path):
    """No less than the lemma says, and not much more: 12 lengths in place of 10 and 3."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    assert 1.0 <= r.defect() / plain_defect(r) <= 1.2 * 1.009


def admissible(arrays, header, random):
    """Displacements that vanish on supports: random at nodes, or a motion that fades out."""
    points = arrays["points"]
    N = len(points)
    rough = random.normal(size=points.shape)
    smooth = random.normal(size=(N, N)) @ points + random.normal(size=(N, 1))
    r = check_receipt.Body(packed(arrays), header)
    for w in (rough, smooth):
        for row, nodes in enumerate(r.ends.T):
            w[np.ix_(r.held[:, row] != 0, nodes)] = 0.0
        yield w


@pytest.mark.parametrize("name", list(CASES))
def test_forces_are_bounded_where_they_pass(name, tmp_path):
    """What passes a cell is its own force and all that others pass to it, cell by cell."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    for sides, force in zip(r.passed, r.force, strict=True):
        way, passed = sides.argmax(axis=0), sides.sum(axis=0)
        own = force.copy()
        for start in range(r.K):
            K, steps = start, 0
            while (other := r.other[way[K] * r.K + K]) != way[K] * r.K + K:
                K, steps = other % r.K, steps + 1
                own[K] += force[start]
                assert steps < r.K
        assert (passed > own).all()
        assert (passed < 1.2 * own).all()


@pytest.mark.parametrize("name", list(CASES))
def test_what_is_out_of_balance_does_no_more_work_than_the_defect_says(name, tmp_path):
    """Virtual work, without any residual: |int S : eps(w) - loads on w| <= b |eps(w)|_m."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    b = r.defect()
    random = np.random.default_rng(1)
    for _ in range(20):
        for w in admissible(arrays, header, random):
            missed, norm = virtual_work(arrays, header, w)
            assert 1e-8 * norm < abs(missed) <= b * norm


@pytest.mark.parametrize("name", list(CASES))
def test_forces_that_split_and_go_round_are_bounded(name, tmp_path):
    """Random parts of them pass all sides, also back: these numbers give a bound, too."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    random = np.random.default_rng(2)
    passed = np.array([round_about(r, i, random) for i in range(r.N)])
    words = packed(arrays | {"passed": passed})
    split = check_receipt.Body(words, header)
    b = split.defect()
    for w in admissible(arrays, header, random):
        missed, norm = virtual_work(arrays, header, w)
        assert abs(missed) <= b * norm
    total = passed.sum(axis=1)
    less = passed.copy()
    less[0, :, total[0].argmin()] *= 1 - 1e-9
    with pytest.raises(ValueError, match=r"^passed: too little"):
        check_receipt.Body(packed(arrays | {"passed": less}), header).defect()


def round_about(r, component, random):
    """Forces of a component that pass the sides of cells, (N + 1, K), in random parts."""
    free = np.ones(r.other.size, dtype=bool)
    free[r.out] = r.holds[component]
    parts = random.random((r.N + 1, r.K)) * free.reshape(r.N + 1, r.K)
    parts /= parts.sum(axis=0)
    A = np.zeros((r.K, r.K))
    place = np.setdiff1d(np.arange(r.other.size), r.out)
    np.add.at(A, (r.other[place] % r.K, place % r.K), parts.ravel()[place])
    grows = 1 + 2 * check_receipt.EPS
    total = np.linalg.solve(np.eye(r.K) - grows * A, grows * r.force[component])
    return parts * total * (1 + 1e-12)


def virtual_work(arrays, header, w):
    """int S : eps(w) less the work of the loads, and the norm of eps(w), by quadrature."""
    judge = Judge(arrays | {"u": w[None]}, header)
    a = judge.a
    sides = judge._sides()
    rows = [tuple(row) for row in a["boundary"].tolist()]
    moved = np.zeros_like(a["traction"])
    judge.measure = np.zeros(len(rows))
    for row, key in enumerate(rows):
        moved[row], area = judge._on_side(a["u"], sides, key)
        judge.measure[row] = np.linalg.norm(area)
    shares, weights = rule(judge.N, 6)
    strain = judge._strains(a["u"], shares)
    at = bernstein(shares, a["stress"].shape[1])
    stress = np.einsum("qi,kiab->kqab", at, a["stress"])
    inside = judge.volume @ ((strain * stress).sum(axis=(2, 3)) @ weights)
    loads = judge._work(a["body_force"], a["traction"], a["u"], moved)
    mu, h = a["mu"], a["hardening"]
    bulk = a["lame_lambda"] + 2 * mu / judge.n
    modulus = np.minimum(2 * mu * h / (2 * mu + h), judge.n * bulk)
    square = (strain**2).sum(axis=(2, 3)) @ weights
    return inside - loads, math.sqrt((modulus * judge.volume) @ square)


@pytest.mark.parametrize("order", [1, 2])
def test_residuals_of_a_polynomial_stress(order, tmp_path):
    """Its divergence, known by differentiation, times the volumes of the parts of the cells."""
    name = "clamped" if order == 1 else "clamped, order 2"
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz", noise=0.0)
    random = np.random.default_rng(order)
    slope = random.normal(size=(3, 2))
    curved = random.normal(size=(3, 2, 2)) * (order == 2)
    curved = curved + curved.swapaxes(1, 2)

    def stress(at):
        """Components xx, yy, xy at points (2, ...)."""
        linear = np.einsum("ca,a...->c...", slope, at)
        return linear + np.einsum("cab,a...,b...->c...", curved, at, at)

    def divergence(at):
        """Of the stress, (2, ...)."""
        d = slope[(...,) + (None,) * (at.ndim - 1)] + 2 * np.einsum(
            "cab,b...->ca...", curved, at
        )
        return np.stack([d[0, 0] + d[2, 1], d[2, 0] + d[1, 1]])

    corners = arrays["points"][:, arrays["cells"][:3].astype(int)]
    area = np.abs(np.linalg.det((corners[:, 1:] - corners[:, :1]).T)) / 2
    at = [corners[:, i] for i in range(3)]
    if order == 2:
        at += [(corners[:, i] + corners[:, j]) / 2 for i, j in ((1, 2), (0, 2), (0, 1))]
    found = np.stack([stress(point) for point in at])
    for place, (i, j) in enumerate(((1, 2), (0, 2), (0, 1)) if order == 2 else ()):
        found[3 + place] = 2 * found[3 + place] - (found[i] + found[j]) / 2
    tensors = np.zeros((*found.shape[::2], 3, 3))
    tensors[..., [0, 1, 0, 1], [0, 1, 1, 0]] = found[:, [0, 1, 2, 2]].swapaxes(1, 2)
    coordinates = basis_coordinates(tensors, header["kinematics"])
    values = np.moveaxis(coordinates, 2, 1)[None]
    missed = [divergence(point) + arrays["body_force"][0] for point in at[:3]]
    expected = np.abs(missed).max(axis=0) * area
    r = check_receipt.Body(packed(arrays | {"stress": values}), header)
    within = (r.other.reshape(3, -1) != np.arange(r.other.size).reshape(3, -1)).all(
        axis=0
    )
    assert within.sum() > 3  # the stress has no jumps: all forces are of the divergence
    np.testing.assert_allclose(r.force[:, within], expected[:, within], rtol=1e-9)
