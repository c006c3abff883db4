"""What the checker of receipts says about a stress that is out of equilibrium."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns.receipts import Judge, bernstein, opened, rule
from ngsolve import x, y

from ngepc import Material, Problem, semismooth_newton, write_receipt
from ngepc.geometries import block
from ngepc.goals import check_receipt
from ngepc.goals.receipt_file import numbered_sides, packed, passed, ways

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
    arrays = arrays | {"stress": stress}
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    held = arrays["held"].all(axis=0)
    places = numbered_sides(arrays["cells"].T)
    way, levels = ways(arrays["cells"].T, places, held)
    forces = passed(r.force[0], way, places, levels)
    return arrays | {"passed": forces[None]}, header


def plain_defect(r):
    """The number b, with loops over cells, their parts and their sides."""
    N = r.N
    first, second = check_receipt.CONSTANTS[N]
    reach = sum(max(axis) - min(axis) for axis in r.points.tolist())
    flow = r.passed[0]
    supports = 0.0
    if not flow.ravel()[r.place].any():
        supports = 2 * check_receipt.rolled(r, reach) * r.force[0].sum()
    total = 0.0
    for K in range(r.K):
        corners = r.points[:, r.cells[:, K]].T
        centre = corners.mean(axis=0)
        length = np.linalg.norm(corners - centre)
        volume = abs(np.linalg.det(corners[1:] - corners[0])) / math.factorial(N)
        gets = r.force[0, K]
        for i in range(N + 1):
            for other in np.argwhere(r.side == r.side[i, K]).tolist():
                gets += flow[tuple(other)] * (other != [i, K])
        passes = max(gets, sum(flow[:, K])) + supports
        mu, h = r.mu[K], r.hardening[K]
        modulus = min(2 * mu * h / (2 * mu + h), r.n * r.bulk[K])
        for a in range(N + 1):
            edges = np.delete(corners, a, axis=0) - centre
            det = abs(np.linalg.det(edges))
            lever = 5 * reach * length ** (N - 1) / volume
            forces = (N + 2) * passes * (1 + lever)
            norm = r.inside[0, a, K] / math.sqrt(det / math.factorial(N))
            b = first * norm + second * (r.jumps[0, a, K] + forces) / math.sqrt(det)
            b *= length**2 * np.linalg.norm(np.linalg.inv(edges))
            total += b**2 / modulus
    return 2 * math.sqrt(total)


@pytest.mark.parametrize("name", list(CASES))
def test_the_defect_cell_by_cell(name, tmp_path):
    """By loops, determinants and inverses of the parts of cells."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    assert check_receipt.defects(r)[0] == pytest.approx(plain_defect(r), rel=1e-9)


def admissible(arrays, header, random):
    """Displacements that vanish on supports: random at nodes, or a motion that fades out."""
    u = arrays["u"]
    points = arrays["points"]
    N = len(points)
    rough = random.normal(size=u[:, 0].shape)
    smooth = np.zeros_like(rough)
    matrix = random.normal(size=(N, N))
    smooth[:, : points.shape[1]] = matrix @ points + random.normal(size=(N, 1))
    r = check_receipt.opened(packed(arrays, header), header)
    if header["order"] == 2:
        first = numbered_sides(arrays["cells"].T)[0]
        cell = first % r.K
        ends = arrays["cells"].T[cell]
        keep = np.arange(N + 1) != (first // r.K)[:, None]
        ends = ends[keep].reshape(-1, N)
        smooth[:, points.shape[1] :] = smooth[:, ends].mean(axis=2)
    for w in (rough, smooth):
        for row, nodes in enumerate(r.side_nodes.T):
            w[np.ix_(r.held[:, row], nodes)] = 0.0
        yield w


@pytest.mark.parametrize("name", list(CASES))
def test_what_is_out_of_balance_does_no_more_work_than_the_defect_says(name, tmp_path):
    """Virtual work, without any residual: |int S : eps(w) - loads on w| <= b |eps(w)|_m."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    b = check_receipt.defects(r)[0] / 2
    random = np.random.default_rng(1)
    for _ in range(20):
        for w in admissible(arrays, header, random):
            missed, norm = virtual_work(arrays, header, w)
            assert 1e-8 * norm < abs(missed) <= b * norm


def virtual_work(arrays, header, w):
    """int S : eps(w) less the work of the loads, and the norm of eps(w), by quadrature."""
    judge = Judge(arrays | {"u": w[:, None]}, header)
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

    corners = arrays["points"][:, arrays["cells"]]
    centre = corners.mean(axis=1)
    values = np.zeros_like(arrays["stress"])
    expected = np.zeros((3, centre.shape[1]))
    area = np.abs(np.linalg.det((corners[:, 1:] - corners[:, :1]).T)) / 2
    for a in range(3):
        part = corners.copy()
        part[:, a] = centre
        at = [part[:, i] for i in range(3)]
        if order == 2:
            at += [(part[:, i] + part[:, j]) / 2 for i, j in ((1, 2), (0, 2), (0, 1))]
        found = np.stack([stress(point) for point in at])
        for place, (i, j) in enumerate(((1, 2), (0, 2), (0, 1)) if order == 2 else ()):
            found[3 + place] = 2 * found[3 + place] - (found[i] + found[j]) / 2
        values[:, [0, 1, 3], 0, a] = found
        missed = [divergence(point) + arrays["body_force"][:, 0] for point in at[:3]]
        sizes = [np.sqrt((vector**2).sum(axis=0)) for vector in missed]
        expected[a] = np.max(sizes, axis=0) * area / 3
    arrays = arrays | {"stress": values}
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    np.testing.assert_allclose(r.inside[0], expected, rtol=1e-9)
    between = ~np.isin(r.side, r.out)
    assert r.jumps[0][between].max() < 1e-11 * np.abs(values).max()


@pytest.mark.parametrize("name", ["clamped", "clamped, order 2", "cube"])
def test_forces_may_split(name, tmp_path):
    """Cells pass on what they get by several sides: the same statement of the defect."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    free = np.zeros(r.v * r.K, dtype=bool)
    free[r.place] = ~r.held.all(axis=0)
    share = np.where(free, 0.0, 1.0).reshape(r.v, r.K)
    share *= np.random.default_rng(4).uniform(0.5, 1.0, share.shape)
    share += 20.0 * (arrays["passed"][0] > 0)
    share /= share.sum(axis=0)
    flow = np.zeros((1, r.v, r.K))
    for _ in range(3000):
        into = np.zeros(r.v * r.K)
        into[r.sides] = flow.reshape(-1)[r.sides[::-1]]
        into[r.place] = 0.0
        gets = r.force[0] + into.reshape(r.v, r.K).sum(axis=0)
        flow = 1.0001 * (gets * share)[None]
    arrays = arrays | {"passed": flow}
    r = check_receipt.opened(packed(arrays, header), header)
    check_receipt.balance(r)
    assert ((flow[0] > 0).sum(axis=0) > 1).mean() > 0.5
    b = check_receipt.defects(r)[0] / 2
    random = np.random.default_rng(1)
    for w in admissible(arrays, header, random):
        missed, norm = virtual_work(arrays, header, w)
        assert abs(missed) <= b * norm
    with pytest.raises(ValueError, match=r"^passed: too little"):
        check_receipt.defects(SimpleNamespace(**vars(r) | {"passed": 0.999 * flow}))
