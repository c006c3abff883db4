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
    "cube, order 2": (3, 2, CUBE),
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
    return arrays | {name: found[name] for name in ("stress", "passed", "arm")}, header


def plain_defect(r):
    """The number b of the lemma on the page, cell by cell, with determinants and inverses."""
    N = r.N
    total = 0.0
    for K in range(r.K):
        corners = r.points[:, r.cells[: N + 1, K]].T
        edges = corners[:-1] - corners[-1]
        length = np.linalg.norm(edges)
        det = abs(np.linalg.det(edges))
        mu, h = r.mu[K], r.hardening[K]
        modulus = min(2 * mu * h / (2 * mu + h), r.bulk[K])
        volume = det / math.factorial(N)
        lever = 5 * r.arm[:, K] * length ** (N - 1) / volume
        tractions = 2 * (1 + lever) @ r.passed[:, :, K].sum(axis=1)
        b = (r.force[:, K].sum() + tractions) / math.sqrt(volume)
        b *= KORN[N] * length**2 * np.linalg.norm(np.linalg.inv(edges))
        total += b**2 / modulus
    return math.sqrt(total)


@pytest.mark.parametrize("name", list(CASES))
def test_the_defect_cell_by_cell(name, tmp_path):
    """No less than the lemma says, and not much more: 10.75 arms in place of 10 and 3 forces."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    assert 1.0 <= r.defect() / plain_defect(r) <= 1.075 * 1.015


def test_a_stress_out_of_equilibrium_costs_what_the_lemma_says(tmp_path):
    """Of d, the distance in energy, d^2 <= 2 (gap + b d) is known: energies lose b d."""
    arrays, header = out_of_balance("clamped", tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    b = r.defect()
    gap = r.volume @ r.densities(slice(None))[1] + r.opened[0].sum()
    d = max(np.roots([1.0, -2 * b, -2 * gap]))
    assert b**2 > 0.01 * gap  # far more than rounding
    found = r.intervals(1.0)
    assert found["upper"] - found["lower"] == pytest.approx(gap + b * d, rel=1e-9)


def refined_to(corner, levels):
    """A plate with cells that become smaller towards a corner."""
    mesh = block.mesh(0.5, (1.0, 0.4))
    for _ in range(levels):
        points = np.array([v.point for v in mesh.vertices])
        nearest = np.abs(points - corner).sum(axis=1).argmin()
        for element in mesh.Elements():
            there = nearest in [v.nr for v in element.vertices]
            mesh.SetRefinementFlag(element, there)
        mesh.Refine()
    return mesh


def test_the_defect_does_not_grow_with_smaller_cells(tmp_path):
    """Forces of small cells act near them: with the size of the body as arm it grows 59 times."""
    found = []
    for levels in (10, 16):
        mesh = refined_to((1.0, 0.0), levels)
        problem = Problem(mesh, MATERIAL, traction={"right": (0.0, -1.0)}, order=1)
        write_receipt(semismooth_newton(problem), tmp_path / "receipt.npz")
        arrays, header = opened(tmp_path / "receipt.npz")
        found.append(check_receipt.Body(packed(arrays), header).defect())
    assert found[1] < 1.3 * found[0]


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


def ways(r, component):
    """Parts of its forces that a cell passes to others, (to, from), by their proportions."""
    inside = np.setdiff1d(np.arange(r.other.size), r.out)
    parts = r.passed[component] / r.passed[component].sum(axis=0)
    A = np.zeros((r.K, r.K))
    np.add.at(A, (r.other[inside] % r.K, inside % r.K), parts.ravel()[inside])
    return A, parts


@pytest.mark.parametrize("name", list(CASES))
def test_forces_are_bounded_where_they_pass(name, tmp_path):
    """What passes a cell is its own force and all that others pass to it, cell by cell."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    for component, force in enumerate(r.force):
        A, _ = ways(r, component)
        passed = r.passed[component].sum(axis=0)
        exact = np.linalg.solve(np.eye(r.K) - A, force)
        assert (passed > exact).all()
        assert (passed < 1.2 * exact).all()


@pytest.mark.parametrize("name", list(CASES))
def test_arms_are_no_less_than_the_ways_of_forces(name, tmp_path):
    """Moments about the centre of each side of all that passes it, from where it began."""
    arrays, header = out_of_balance(name, tmp_path / "receipt.npz")
    r = check_receipt.Body(packed(arrays), header)
    corners = r.points[:, r.cells[: r.N + 1]]
    centres = (corners.sum(axis=1)[:, None] - corners) / r.N
    for component, force in enumerate(r.force):
        A, parts = ways(r, component)
        started = np.linalg.inv(np.eye(r.K) - A) * force
        moment = r.arm[component] * r.passed[component]
        for side in range(r.N + 1):
            away = centres[:, side, :, None, None] - corners[:, None]
            away = np.sqrt((away**2).sum(axis=0)).max(axis=1)
            exact = parts[side] * (started * away).sum(axis=1)
            assert (exact <= moment[side]).all()


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
    found = [round_about(r, i, random) for i in range(r.N)]
    passed, arm = map(np.array, zip(*found, strict=True))
    words = packed(arrays | {"passed": passed, "arm": arm})
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
    short = arm.copy()
    short[0, arm[0].argmin()] *= 1 - 1e-9
    words = packed(arrays | {"passed": passed, "arm": short})
    with pytest.raises(ValueError, match=r"^arm: short"):
        check_receipt.Body(words, header).defect()


def round_about(r, component, random):
    """Forces of a component that pass the sides of cells, (N + 1, K), in random parts; arms."""
    free = np.ones(r.other.size, dtype=bool)
    free[r.out] = r.holds[component]
    parts = random.random((r.N + 1, r.K)) * free.reshape(r.N + 1, r.K)
    parts /= parts.sum(axis=0)
    A = np.zeros((r.K, r.K))
    place = np.setdiff1d(np.arange(r.other.size), r.out)
    np.add.at(A, (r.other[place] % r.K, place % r.K), parts.ravel()[place])
    grows = 1 + 2 * check_receipt.EPS
    ways = np.eye(r.K) - grows * A
    own = r.force[component]
    total = np.linalg.solve(ways, grows * own) * (1 + 1e-12)
    moment = np.linalg.solve(ways, grows * r.length * (own + total)) * (1 + 1e-12)
    return parts * total, moment / total


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


@pytest.mark.parametrize(
    ("angle", "holds"), [(30.0, True), (36.0, True), (37.5, False)]
)
def test_rollers_hold_across_their_side_only(angle, holds, tmp_path):
    """A force on a slanted roller may have a part that the roller does not hold."""
    path = tmp_path / "receipt.npz"
    problem = Problem(block.mesh(0.5, (1.0, 0.7)), MATERIAL, order=1, **ROLLING)
    write_receipt(semismooth_newton(problem), path)
    arrays, header = opened(path)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned = np.array([[c, -s], [s, c]]) @ arrays["points"]
    r = check_receipt.Body(packed(arrays | {"points": turned}), header)
    assert arrays["held"].any()
    np.testing.assert_array_equal(r.holds, (arrays["held"] != 0) & holds)
