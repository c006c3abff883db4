"""Check a receipt: a least energy, and a force or displacement, lie in intervals.  numpy alone.

    python check_receipt.py receipt.npz

A body of triangles or tetrahedra K has forces f and tractions g, is held on parts of its boundary
and may touch an obstacle, u . n <= psi.  With the mean m and the deviator e of eps(u)
    J(u) = int phi(eps(u)) - f . u - boundary int g . u,  B = n lambda + 2 mu,
    phi  = min over p of  B/2 m^2 + mu |e - p_0 - p|^2 - mu |p_0|^2 + a : p + h/2 |p|^2 + beta |p|
is the energy.  C has the modulus B of m, and 2 mu of e.  An admissible u has the trial stress
t = C (eps(u) - p_0); S is a stress in equilibrium with f and g - P n, where P >= 0.  With
s = dev t - a, x = dev S - a, any p, and the solution v
1.  J(u) <= int |t|^2/(2 C) - mu |p_0|^2 + E - f . u - boundary int g . u,
    J(u) - J(v) <= int |S - t|^2/(2 C) + E + ([|x| - beta]_+)^2/(2 h) + int P (psi - u . n) + R,
    E = (mu + h/2) |p|^2 + beta |p| - p : s.
2.  R is the work of forces that S leaves, |R| <= b (2 J(u) - 2 J(v))^(1/2).
3.  A factor times Q = int F . u + int G . u + int c P - int (reaction) . V is a goal.  The second
    layer of arrays has F, G, c, V, and z, T, q in the places of u, S, P.  With t_z = C eps(z),
    |q| <= P, |c - z . n| <= psi - u . n,  y = x + s + dev (T - t_z),  v = x + dev T + h/(2 mu) y
    Q <= int F . u + G . u + f . z + g . z - t : eps(z) + int (q + P) (psi - u . n)
         + int |S - t + T - t_z|^2/(4 C) + (X - |y|^2/4)/(2 mu) + R;
    -Q has the same bound with -c, -z, -T, -q.
Tensors have coordinates in an orthonormal basis, first m; fields have Bernstein coefficients, of
vertices, then of the edges opposite to them.  Proofs are in docs/receipts.md.
"""

import json
import math
import sys
from types import SimpleNamespace as Body

import numpy as np
from numpy import einsum, ndarray

FORMAT = "ngepc receipt 8"
EPS = 16 * 2.0**-52
SMALLEST = 1e-30  # number besides zero
WIDE = 100  # condition of densities and works
KORN = {2: 2.7, 3: 6.3}
LAWS = {"two-dimensional": (2, 2, 3), "plane strain": (2, 3, 4), "solid": (3, 3, 6)}
BASIS = np.zeros((6, 3, 3))  # laws have N, n, and so many of these coordinates
BASIS[[[0], [1], [3]], [0, 1, 2], [0, 1, 2]] = [[1, 1, 1], [1, -1, 0], [1, 1, -2]]
BASIS[[2, 4, 5], [0, 0, 1], [1, 2, 2]] = BASIS[[2, 4, 5], [1, 2, 2], [0, 0, 1]] = 1
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
MEANS = {k: (1 + np.eye(k)) / (k * (k + 1)) for k in (1, 2, 3, 4)}  # of products
MEANS[6] = np.kron([[1, 3], [3, 2]], np.ones((3, 3))) / 90
MEANS[6] += np.kron([[5, -2], [-2, 2]], np.eye(3)) / 90
CURVED = np.array([[6, 1, 3], [1, 6, 3], [3, 3, 4]]) / 30  # on an edge


def need(condition: object, message: str) -> None:
    """Refuse the receipt unless a condition holds."""
    if not condition:
        raise ValueError(message)


def most(*terms: object) -> float:
    """No less than the sum of all numbers."""
    x = np.concatenate([np.ravel(term) for term in terms])
    return float(x.sum() + x.size * EPS * np.abs(x).sum() + SMALLEST**2)


def lengths(a: ndarray) -> ndarray:
    """Norms (k, ...) of the coefficients of fields (k, c, ...)."""
    return np.sqrt(einsum("kc...,kc...->k...", a, a))


def size(a: ndarray) -> ndarray:
    """The largest norm of the coefficients of fields (k, c, ...)."""
    return lengths(a).max(axis=0)


def inner(a: ndarray, b: ndarray, M: ndarray | None = None) -> ndarray:
    """Means of the products of two fields (k, c, ...); the second may be constant."""
    M = MEANS[len(a)] if M is None else M
    return einsum("kc...,kc...->...", (M @ a.reshape(len(a), -1)).reshape(a.shape), b)


def outside(x: ndarray, length: ndarray, V: ndarray) -> ndarray:
    """What of the coefficients of a field, of these lengths, exceeds a ball."""
    return x * (np.maximum(length - V, 0.0) / np.maximum(length, V))[:, None]


def norms(x: ndarray, length: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Means of |x| from above and from below, and x along its mean (k, ...)."""
    largest = length.max(axis=0) + SMALLEST
    n = x.mean(axis=0)
    y = einsum("kc...,c...->k...", x, n / (lengths(n[None])[0] + SMALLEST))
    mean = y.mean(axis=0)
    across = inner(x, x) - inner(y[:, None], y[:, None])
    Y = np.maximum(y.min(axis=0), largest / 4)
    sharp = (y >= Y).all(axis=0)
    upper = np.where(sharp, mean + across / (2 * Y), length.mean(axis=0))
    return upper, mean + across / (2 * largest), y


def flow(s: ndarray, beta: ndarray) -> ndarray:
    """E times 2 mu + h from above, with the best p at the coefficients."""
    length = lengths(s)
    x = outside(s, length, beta)
    upper = norms(x, np.maximum(length - beta, 0.0))[0]
    return beta * upper + inner(x, x / 2 - s)


def squared_excess(v: ndarray, length: ndarray, V: ndarray) -> ndarray:
    """Means of ([|v| - V]_+)^2 from above: by |v| - V itself, or by what exceeds the ball."""
    x = outside(v, length, V)
    apart = inner(v, v) - V * (2 * norms(v, length)[1] - V)
    return np.minimum(apart, inner(x, x))


def supremum(y: ndarray, v: ndarray, r: ndarray, H: ndarray, beta: ndarray) -> ndarray:
    """Means of X - |y|^2/4 from above.  With A = beta D, W = V + 2 b r, any r >= 0 and D.

    X <= |y - D|^2/4 + |A + r v| - r (V + b r) + ([|v| - W]_+^2 + [l]_+^2)/(4 b),
    l = W - (|A + r v| - |A|)/r, or 0 where r = 0.
    """
    b = H * (1 + H)
    V = beta * (1 + 2 * H)
    of_v = lengths(v)
    r = np.clip(r, 0.0, np.maximum(of_v.max(axis=0) - V, 0.0) / b)
    W = V + 2 * b * r
    of_y = lengths(y)
    D = outside(y, of_y, 2 * beta)
    of_A = beta * np.maximum(of_y - 2 * beta, 0.0)
    upper, _, along = norms(beta * D + r * v, of_A + r * of_v)
    gained = along - of_A
    short = np.maximum(W - gained / np.where(r > 0, r, 1.0), 0.0) * (r > 0)
    square = squared_excess(v, of_v, W) + inner(short[:, None], short[:, None])
    return inner(D, D - 2 * y) / 4 + upper - r * (V + b * r) + square / (4 * b)


def basis(kinematics: str) -> ndarray:
    """The matrices (c, n, n) of the coordinates of tensors."""
    _, n, c = LAWS[kinematics]
    matrices = BASIS[:c, :n, :n]
    return matrices / np.sqrt((matrices**2).sum(axis=(1, 2), keepdims=True))


def layout(header: dict) -> np.dtype:
    """The arrays of a receipt, in their order."""
    N, _, c = LAWS[header["kinematics"]]
    P, K, B = header["sizes"]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    L = 1 + ("goal" in header)
    k = order * (N + 1)
    t = order + N - 1
    shapes = {
        "points": (N, P), "cells": (k, K), "other": (N + 1, K), "u": (N, L, P),
        "stress": (k, c, L, K), "law": (2 + 2 * c, K), "body_force": (N, L, K),
        "way": (N, K), "passed": (N, K), "tangent": (2 * L - 2, K), "held": (N, B),
        "contact": (B,), "traction": (t, N, L, B), "gap": (t, L, B), "pressure": (t, L, B),
    }  # fmt: skip
    return np.dtype([(name, float, shape) for name, shape in shapes.items()])


def arrays_in(words: ndarray, header: dict) -> dict:
    """The arrays of a receipt by their names."""
    record = layout(header)
    size = sum(record[name].itemsize for name in record.names)
    right = words.dtype == float and words.shape == (size // 8,)
    right = right and size == record.itemsize  # which may overflow
    need(right, "receipt: its arrays have other types or sizes")
    return {name: words.view(record)[name][0] for name in record.names}


def opened(words: ndarray, header: dict) -> Body:
    """The body of a receipt: its arrays, and what follows from them."""
    arrays = arrays_in(words, header)
    for name, values in arrays.items():
        large = np.abs(values)
        usual = ((large > SMALLEST) == (values != 0)) & (large < 1 / SMALLEST)
        need(usual.all(), f"numbers: some of {name} are too large or small, or none")
    for name in "cells", "other", "way":
        whole = arrays[name].astype(int)
        need((whole == arrays[name]).all(), f"{name}: no whole numbers")
        arrays[name] = whole
    r = Body(**arrays)
    r.N, r.K = r.body_force.shape[::2]
    r.degree = header["order"]
    matrices = basis(header["kinematics"])
    lame, r.mu, r.hardening, r.beta = r.law[:4]
    r.initial, r.back = np.split(r.law[4:], 2)
    r.bulk = matrices.shape[1] * lame + 2 * r.mu
    positive = (r.law[1:4] > 0).all() and (r.bulk > 1e-3 * r.mu).all()
    need(positive, "law: a modulus is not positive, or the bulk modulus too small")
    r.H = r.hardening / (2 * r.mu)
    r.least = np.minimum(r.hardening / (1 + r.H), r.bulk)
    measured(r, matrices[:, : r.N, : r.N])
    join(r)
    balance(r)
    displaced(r)
    return r


def measured(r: Body, matrices: ndarray) -> None:
    """Volumes, outward normals, their products with tensors, and sizes of K."""
    N = r.N
    corners = r.points[:, r.cells[: N + 1]]
    E = corners[:, :N] - corners[:, N:]
    if N == 2:
        cofactors = np.array([[E[1, 1], -E[1, 0]], [-E[0, 1], E[0, 0]]])
    else:
        cofactors = np.cross(E[:, [1, 2, 0]], E[:, [2, 0, 1]], axis=0)
    det = (E[:, 0] * cofactors[:, 0]).sum(axis=0)
    r.length = np.sqrt((E**2).sum(axis=(0, 1)))
    need((np.abs(det) > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    r.volume = np.abs(det) / math.factorial(N)
    r.turn = np.sign(det)
    r.area = np.concatenate([-cofactors.swapaxes(0, 1), cofactors.sum(axis=1)[None]])
    r.area *= r.turn / (N - 1)
    r.steep = np.sqrt((r.area[:N] ** 2).sum(axis=(0, 1))) / (N * r.volume)
    across = matrices.reshape(-1, N) @ r.area
    r.across = across.reshape(N + 1, -1, N, r.K)
    r.wrong = EPS * (r.length * r.steep) ** (N - 1)


def join(r: Body) -> None:
    """The sides by place (number in K, K); those of the boundary have no other place."""
    v = r.N + 1
    r.on_side = [[*np.delete(range(v), i), v + i][: len(r.gap)] for i in range(v)]
    r.between = BETWEEN if r.degree == 2 else np.arange(v)[:, None]
    ends = np.concatenate(r.cells[r.on_side], axis=1)
    r.other = r.other.ravel()
    places = np.arange(r.other.size)
    same = (ends == ends.take(r.other, axis=1)).all() and ends.min() >= 0
    need(same and (r.other.take(r.other) == places).all(), "other: not the other side")
    free = r.other == places
    facing = np.outer((-1) ** np.arange(v), r.turn).ravel()
    apart = facing != facing[r.other]
    need((apart | free).all(), "cells: two overlap at their side")
    r.out = np.flatnonzero(free)
    r.ends = ends[:, r.out]
    vertices = np.unique(np.sort(r.ends[: r.N], axis=0), axis=1)
    right = vertices.shape[1] == len(r.out) == len(r.contact)
    need(right, "held: not the sides of the boundary")
    area = r.area[r.out // r.K, :, r.out % r.K].T
    r.outer = lengths(area[None])[0]
    r.normal = area / r.outer
    r.support = np.zeros((r.N, places.size), dtype=bool)
    across = r.held.all(axis=0) | (np.abs(r.normal) > 0.8)
    r.support[:, r.out] = (r.held != 0) & across


def balance(r: Body) -> None:
    """Forces of 2 in K and on its sides by components, with what rounding adds."""
    T = einsum("kcLK,vcxK->vkxLK", r.stress, r.across)
    rows = np.arange(r.N + 1)[:, None]
    inside = r.degree / r.N * T[rows, r.between].sum(axis=0) - r.body_force * r.volume
    jump = np.concatenate(T[rows, r.on_side], axis=-1)
    jump += jump.take(r.other, axis=-1)
    pulled = r.traction - r.pressure[:, None] * r.normal[:, None]
    left = jump[..., r.out] - 2 * pulled * r.outer
    jump[..., r.out] = np.where(r.held[:, None], 0.0, left)
    pulls = (size(r.traction) + np.abs(r.pressure).max(axis=0)).sum(axis=0)
    loads = size(r.stress) + r.length * size(r.body_force[None])
    r.load = loads.sum(axis=0)
    r.load += np.bincount(r.out % r.K, pulls, r.K)
    r.load *= r.length ** (r.N - 1)
    jumps = np.abs(jump).max(axis=0).sum(axis=1).reshape(r.N, -1, r.K).sum(axis=1)
    r.force = np.abs(inside).max(axis=0).sum(axis=1) + jumps / 2 + 6 * EPS * r.load


def displaced(r: Body) -> None:
    """Displacements on K and sides, strains, trial stresses, and what S differs from them."""
    r.local = np.moveaxis(r.u.take(r.cells, axis=2), 2, 0)
    r.outside = np.moveaxis(r.u.take(r.ends, axis=2), 2, 0)
    r.room = r.gap - einsum("txLB,xB->tLB", r.outside, r.normal)
    change = r.local - r.local[r.N]
    slopes = einsum("vkxLK,vcxK->kcLK", change[r.between], r.across)
    r.strain = slopes * (-r.degree / (r.N * r.volume))
    if r.degree == 2:
        middle = (r.strain[[1, 0, 0]] + r.strain[[2, 2, 1]]) / 2
        r.strain = np.concatenate([r.strain, middle])
    r.moduli = np.stack([r.bulk] + [2 * r.mu] * len(r.back))
    r.trial = r.moduli[:, None] * r.strain
    r.trial[:, 1:, 0] -= 2 * r.mu * r.initial
    r.s = r.trial[:, 1:, 0] - r.back
    r.x = r.stress[:, 1:, 0] - r.back
    r.missing = (r.stress - r.trial) / np.sqrt(r.moduli)[:, None]
    slope = r.degree**1.5 * r.N * r.steep * size(change).sum(axis=0)
    mean = size(r.stress[:, :1]).sum(axis=0) + r.bulk * slope
    rest = size(r.stress[:, 1:]).sum(axis=0) + 2 * r.mu * slope
    rest += 2 * r.mu * size(r.initial[None]) + size(r.back[None])
    density = mean**2 / r.bulk + rest**2 * (1 / (2 * r.mu) + 1 / r.hardening)
    moves = np.abs(r.u).max(axis=(0, 2)) * r.N + np.abs(r.gap).max(axis=(0, 2))
    r.moves = moves.sum()
    r.rest = WIDE * r.wrong * (r.volume * density + r.load * r.moves)


def defect(r: Body) -> float:
    """The number (sum b^2/M)^(1/2) of 2, and a little more because of rounding."""
    place = np.ravel_multi_index((r.way, np.arange(r.K)[None]), (r.N + 1, r.K))
    beyond = r.other[place]
    ends = beyond == place
    held = np.take_along_axis(r.support, place, axis=1)
    need(held[ends].all(), "way: it ends where nothing holds the body")
    after = beyond % r.K + r.K * np.arange(r.N)[:, None]
    gets = np.bincount(after.ravel(), np.where(ends, 0.0, r.passed).ravel(), after.size)
    gets = (1 + EPS) * (r.force + gets.reshape(after.shape))
    need(((r.passed > 0) & (gets < r.passed)).all(), "passed: too little")
    reach = math.dist(r.points.min(axis=1), r.points.max(axis=1))
    b = 12 * KORN[r.N] * reach * r.passed.sum(axis=0)
    b *= r.steep * r.length ** (r.N + 1) / r.volume**1.5
    return 1.001 * math.sqrt((b**2 / r.least).sum())


def obstacle(r: Body) -> None:
    """P +- q is not negative, neither is psi - u . n +- (c - z . n), and P = q = 0 elsewhere."""
    need(not r.pressure[..., r.contact == 0].any(), "pressure: where no obstacle is")
    for sign in (-1, 1):
        P = r.pressure[:, 0] + sign * r.pressure[:, 1:].sum(axis=1)
        need((P >= 0).all(), "pressure: negative, or that of the adjoint too large")
        room = r.room[:, 0] + sign * r.room[:, 1:].sum(axis=1)
        c = room[:, r.contact != 0] - r.wrong.max() * r.moves
        right = (c[: r.N] >= 0).all()
        right = right and (c[r.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all()
        need(right, "u: inside the obstacle, or the adjoint wrong there")


def on_sides(r: Body, a: ndarray, b: ndarray) -> ndarray:
    """Integrals of the products of fields on the sides of the boundary."""
    return r.outer * inner(a, b, CURVED if r.degree == 2 else None)


def work(r: Body, g: int, h: int) -> ndarray:
    """What the loads of layer g do with the displacement of layer h."""
    done = r.volume * inner(r.local[:, :, h], r.body_force[None, :, g])
    return np.append(done, on_sides(r, r.traction[:, :, g], r.outside[:, :, h]))


def energy_interval(r: Body) -> tuple[float, float]:
    """1, 2: what the least energy lies between."""
    obstacle(r)
    b = defect(r)
    trial = r.trial[:, :, 0]
    missing = r.missing[:, :, 0]
    E = flow(r.s, r.beta) / (2 * r.mu + r.hardening)
    J = inner(trial, trial / r.moduli) / 2 - r.mu * (r.initial**2).sum(axis=0)
    J = np.append(r.volume * (J + E), -work(r, 0, 0))
    excess = squared_excess(r.x, lengths(r.x), r.beta) / (2 * r.hardening)
    gap = inner(missing, missing) / 2 + E + excess
    r.opening = on_sides(r, r.pressure[:, :1], r.room[:, :1])
    gap = most(r.volume * gap, r.opening, r.rest)
    r.missed = b * (b + math.sqrt(b**2 + 2 * gap))
    return -most(-J, gap, r.rest, r.missed), most(J, r.rest)


def plastic(r: Body, sign: int) -> tuple[ndarray, ndarray]:
    """y and v of 3."""
    p = r.x + sign * r.stress[:, 1:, 1]
    y = p + (r.s - sign * r.trial[:, 1:, 1])
    return y, p + r.H * y


def goal_interval(r: Body, factor: float) -> tuple[float, float]:
    """3: what a goal lies between."""
    need(SMALLEST < factor < 1 / SMALLEST, "factor: not positive, or too large")
    own = r.volume * inner(r.trial[:, :, 0], r.strain[:, :, 1])
    opened = on_sides(r, r.pressure[:, 1:], r.room[:, :1])
    centre = np.concatenate([work(r, 1, 0), work(r, 0, 1), opened, -own])
    ends = []
    for sign, hint in zip((-1, 1), r.tangent, strict=True):
        missing = r.missing[:, :, 0] + sign * r.missing[:, :, 1]
        X = supremum(*plastic(r, sign), hint, r.H, r.beta)
        X = r.volume * (inner(missing, missing) / 4 + X / (2 * r.mu))
        ends.append(factor * most(sign * centre, X, r.opening, r.rest, r.missed))
    return -ends[0], ends[1]


def proved_intervals(words: ndarray, header: dict) -> dict:
    """What a receipt proves; ValueError where it is not admissible."""
    r = opened(words, header)
    ends = energy_interval(r)
    if "goal" in header:
        ends += goal_interval(r, float(header["factor"]))
    names = "lower", "upper", "goal lower", "goal upper"
    return dict(zip(names, ends, strict=False))


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        need(header["format"] == FORMAT, f"format: not {FORMAT!r}, write it again")
        proved = proved_intervals(file["receipt"], header)
    for name, value in proved.items():
        need(type(header[name]) in (int, float), f"{name}: no number")
        right = header[name] <= value if "lower" in name else value <= header[name]
        need(right, f"{name}: {header[name]} claimed, {value} proved")
    text = "{sizes[1]} cells, {kinematics}: least energy in ({lower}, {upper})"
    if "goal" in header:
        text += ", {goal!r} in ({goal lower}, {goal upper})"
    return text.format_map(header)


if __name__ == "__main__":
    try:
        sys.stdout.write(f"PASS: {check(sys.argv[1])}\n")
    except Exception as error:  # whatever is wrong with a file, it does not pass
        sys.exit(f"FAIL: {error!r}")
