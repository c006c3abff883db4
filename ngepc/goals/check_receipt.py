"""Check a receipt: a least energy, and a force or displacement, lie in intervals.  numpy alone.

    python check_receipt.py receipt.npz

A body of triangles or tetrahedra K has forces f and tractions g, is held on parts of its boundary
(u_i = U_i) and may touch an obstacle (u . n <= psi).  With eps = (m, e), B = n lambda + 2 mu

    J(u) = int phi(eps(u)) - f . u - boundary int g . u,
    phi  = min over p of  B/2 m^2 + mu |e - p_0 - p|^2 - mu |p_0|^2 + a : p + h/2 |p|^2 + beta |p|.

Tensors have coordinates in an orthonormal basis, first m = tr eps/n^(1/2); fields have Bernstein
coefficients of the vertices, then of the edges opposite to them.  Proofs are in docs/receipts.md.
1. Every admissible u, with every p, gives an upper bound of the least energy.  Every stress (S, d)
   in equilibrium with f and g - P n, P >= 0, and with t where the body is held, gives a lower one,
    - int S^2/(2 B) + |d + 2 mu p_0|^2/(4 mu) + ([|d - a| - beta]_+)^2/(2 h) - t . U + P psi.
2. Equilibrium is missed by forces r in K and j on its sides, of work R.  With the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|.  Each K passes on its forces, or their components, by
   one side, until they reach supports.  What is left does no work on rigid motions, and
    |R(w)| <= sum b |eps(w)|,  b = |E|^2 |E^-1| (C_1 |r| + C_2 sum |j, T|/(det E)^(1/2)),
   with edges E of K and tractions T.  J is M-convex, M = min(2 mu h/(2 mu + h), B).
3. A goal is Q = int F . u + int G . u + int c P - int t . V of the solution.  A second layer of the
   arrays has F, G, V, c in the places of f, g, U, psi, and a displacement z = V where the body is
   held, a stress (T, d_T) and q in the places of u, (S, d), P.  With L > 0,  |q| <= L P,
   |c - z . n| <= L (psi - u . n),  s = 2 mu (e - p_0) - a,  k = L/(2 mu),  H = h/(2 mu)
    Q <= int [F . u + G . u + f . z + g . z - B m(u) m(z) - a : e(z)] + int (q + L P)(psi - u . n)
         + int (T - B m(z) + L (S - B m(u)))^2/(4 L B) + int [X - p : s] + (b_T + L b) G^(1/2),
    p = (d_T + L (d - a))/(2 mu),  y = p + k s - e(z),  G = 2 (J(u) - J(v)),
   and -Q the same with -z, -T, -q, -c.  For any D and r >= 0, with A = beta D, v = p + H y,
   V = k beta (1 + 2 H), b = k H (1 + H)
    X <= |y - D|^2/(4 k) + |A + r v| - r (V + b r) + ([|v| - V - 2 b r]_+^2 + [l]_+^2)/(4 b),
    l = V + 2 b r - (|A + r v| - |A|)/r,  or 0 where r = 0.
"""

import json
import math
import sys
from types import SimpleNamespace as Body

import numpy as np
from numpy import einsum, ndarray

FORMAT = "ngepc receipt 7"
EPS = 16 * 2.0**-52
SMALLEST = 1e-30  # number besides zero
WIDE = 100  # condition of densities
CONSTANTS = {2: (1.1, 4.0), 3: (3.0, 16.0)}  # C_1, C_2
BASIS = np.zeros((6, 3, 3))  # matrices of the coordinates
BASIS[:3, [0, 1, 2], [0, 1, 2]] = [[1, 1, 1], [1, -1, 0], [1, 1, -2]]
BASIS[[3, 4, 5], [0, 0, 1], [1, 2, 2]] = BASIS[[3, 4, 5], [1, 2, 2], [0, 0, 1]] = 1
LAWS = {  # N, n, coordinates
    "two-dimensional": (2, 2, [0, 1, 3]),
    "plane strain": (2, 3, [0, 1, 2, 3]),
    "solid": (3, 3, [0, 1, 2, 3, 4, 5]),
}
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
    Y = np.maximum(y.min(axis=0), largest / 8)
    sharp = (y >= Y).all(axis=0)
    upper = np.where(sharp, mean + across / (2 * Y), length.mean(axis=0))
    return upper, mean + across / (2 * largest), y


def squared_excess(v: ndarray, length: ndarray, V: ndarray) -> ndarray:
    """Means of ([|v| - V]_+)^2 from above: by |v| - V itself, or by what exceeds the ball."""
    x = outside(v, length, V)
    apart = inner(v, v) - V * (2 * norms(v, length)[1] - V)
    return np.minimum(apart, inner(x, x))


def flow(s: ndarray, beta: ndarray) -> ndarray:
    """Plastic terms of phi times 2 mu + h from above, with the best p at the coefficients."""
    length = lengths(s)
    x = outside(s, length, beta)
    upper = norms(x, np.maximum(length - beta, 0.0))[0]
    return beta * upper + inner(x, x / 2 - s)


def supremum(y: ndarray, v: ndarray, r: ndarray, law: tuple) -> ndarray:
    """Means of X from above."""
    k, H, beta = law
    b = k * H * (1 + H)
    V = k * beta * (1 + 2 * H)
    of_y, of_v = lengths(y), lengths(v)
    r = np.clip(r, 0.0, of_v.max(axis=0) / b)
    W = V + 2 * b * r
    D = outside(y, of_y, 2 * k * beta)
    of_A = beta * np.maximum(of_y - 2 * k * beta, 0.0)
    upper, _, along = norms(beta * D + r * v, of_A + r * of_v)
    short = np.where(r > 0, W - (along - of_A) / np.maximum(r, SMALLEST), 0.0)
    short = np.maximum(short, 0.0)[:, None]
    square = squared_excess(v, of_v, W) + inner(short, short)
    return inner(y - D, y - D) / (4 * k) + upper - r * (V + b * r) + square / (4 * b)


def layout(header: dict) -> np.dtype:
    """The arrays of a receipt, in their order."""
    N, _, coordinates = LAWS[header["kinematics"]]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    P, K, B, W = sizes = [header[letter] for letter in "PKBW"]
    right = all(type(number) is int and number > 0 for number in sizes)
    need(right and W in (1, N), "sizes: not positive")
    L, c, v, t = 1 + ("goal" in header), len(coordinates), N + 1, N + order - 1
    shapes = {
        "points": (N, P), "cells": (v * order, K), "other": (v, K), "u": (N, L, P),
        "stress": (v * order, c, L, K), "law": (2 + 2 * c, K), "body_force": (N, L, K),
        "way": (W, K), "passed": (W, L, K), "tangent": (2 * L - 2, K), "held": (N, B),
        "contact": (B,), "traction": (t, N, L, B), "gap": (t, L, B), "pressure": (t, L, B),
    }  # fmt: skip
    return np.dtype([(name, float, shape) for name, shape in shapes.items()])


def arrays_in(words: ndarray, header: dict) -> dict:
    """The arrays of a receipt by their names."""
    record = layout(header)
    right = words.dtype == float and words.shape == (record.itemsize // 8,)
    need(right, "receipt: its arrays have other types or sizes")
    return {name: words.view(record)[name][0] for name in record.names}


def opened(words: ndarray, header: dict) -> Body:
    """The arrays of a receipt, and what follows from them."""
    r = Body(**arrays_in(words, header))
    large = np.abs(words)
    usual = np.count_nonzero(large > SMALLEST) == np.count_nonzero(large)
    need(usual and large.max() < 1 / SMALLEST, "numbers: too large or small, or none")
    r.N, n, _ = LAWS[header["kinematics"]]
    r.v, r.L, r.K, r.degree = r.N + 1, r.u.shape[1], header["K"], header["order"]
    r.between = BETWEEN if r.degree == 2 else np.arange(r.v)[:, None]
    places = r.cells, r.other, r.way
    whole = all((a == np.trunc(a)).all() for a in places)
    need(whole, "cells, other, way: no whole numbers")
    r.cells, r.other, r.way = (a.astype(int) for a in places)
    r.held, r.contact = r.held != 0, r.contact != 0
    lame, r.mu, r.hardening, r.beta = r.law[:4]
    r.initial, r.back = np.split(r.law[4:], 2)
    r.bulk = n * lame + 2 * r.mu
    positive = (r.law[1:4] > 0).all() and (r.bulk > 1e-3 * r.mu).all()
    need(positive, "law: a modulus is not positive, or the bulk modulus too small")
    measured(r, basis(header["kinematics"])[:, : r.N, : r.N])
    join(r)
    return r


def basis(kinematics: str) -> ndarray:
    """The matrices (c, n, n) of the coordinates of tensors."""
    _, n, coordinates = LAWS[kinematics]
    matrices = BASIS[coordinates, :n, :n]
    return matrices / np.sqrt((matrices**2).sum(axis=(1, 2), keepdims=True))


def measured(r: Body, matrices: ndarray) -> None:
    """Volumes, outward normals, their products with tensors, and sizes of K."""
    N = r.N
    corners = r.points[:, r.cells[: r.v]]
    E = corners[:, :N] - corners[:, N:]
    if N == 2:
        cofactors = np.array([[E[1, 1], -E[1, 0]], [-E[0, 1], E[0, 0]]])
    else:
        cofactors = np.cross(E[:, [1, 2, 0]], E[:, [2, 0, 1]], axis=0)
    det = (E[:, 0] * cofactors[:, 0]).sum(axis=0)
    r.length = np.sqrt((E**2).sum(axis=(0, 1)))
    need((np.abs(det) > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    r.volume = np.abs(det) / math.factorial(N)
    r.area = np.concatenate([-cofactors.swapaxes(0, 1), cofactors.sum(axis=1)[None]])
    r.area *= np.sign(det) / (N - 1)
    r.steep = np.sqrt((r.area[:N] ** 2).sum(axis=(0, 1))) / (N * r.volume)
    r.across = [einsum("cxy,yK->cxK", matrices, area) for area in r.area]
    r.wrong = EPS * (r.length * r.steep) ** (N - 1)


def join(r: Body) -> None:
    """The sides by place (number in K, K); those of the boundary have no other place."""
    t, B = r.gap.shape[::2]
    r.on_side = [[*np.delete(range(r.v), i), r.v + i][:t] for i in range(r.v)]
    ends = np.concatenate([r.cells[rows] for rows in r.on_side], axis=1)
    r.other = r.other.ravel()
    places = np.arange(r.other.size)
    joined = (ends == ends[:, r.other]).all() and (r.other[r.other] == places).all()
    need(joined and ends.min() >= 0, "other: not the other side")
    area = np.concatenate(list(r.area), axis=1)
    apart = einsum("aP,aP->P", area, area.take(r.other, axis=1)) < 0
    need((apart | (r.other == places)).all(), "cells: two overlap at their side")
    r.out = np.flatnonzero(r.other == places)
    r.ends = ends[:, r.out]
    vertices = np.unique(np.sort(r.ends[: r.N], axis=0), axis=1)
    need(vertices.shape[1] == len(r.out) == B, "held: not the sides of the boundary")
    r.outer = np.sqrt((area[:, r.out] ** 2).sum(axis=0))
    r.normal = area[:, r.out] / r.outer
    across = r.held & (np.abs(r.normal) > 0.8) & (len(r.way) == r.N)
    r.support = np.zeros((len(r.way), places.size), dtype=bool)
    r.support[:, r.out] = (r.held.all(axis=0) | across)[: len(r.way)]


def displaced(r: Body) -> None:
    """Values of u and z on K and sides, strains, and sizes."""
    r.local = np.array([r.u.take(nodes, axis=2) for nodes in r.cells])
    r.outside = np.array([r.u.take(nodes, axis=2) for nodes in r.ends])
    r.room = r.gap - einsum("taLB,aB->tLB", r.outside, r.normal)
    r.moves = np.abs(r.u).max(axis=(0, 2)) * r.N + np.abs(r.gap).max(axis=(0, 2))
    change = r.local - r.local[r.N]
    pairs = zip(r.between, r.across, strict=True)
    slopes = [einsum("kxLK,cxK->kcLK", change[rows], across) for rows, across in pairs]
    r.strain = sum(slopes) * (-r.degree / (r.N * r.volume))
    if r.degree == 2:
        middle = (r.strain[[1, 0, 0]] + r.strain[[2, 2, 1]]) / 2
        r.strain = np.concatenate([r.strain, middle])
    r.trial = 2 * r.mu * (r.strain[:, 1:, 0] - r.initial) - r.back
    r.shifted = r.stress[:, 1:, 0] - r.back
    r.large = r.degree * r.N * (r.bulk + 2 * r.mu) * r.steep * size(change)
    r.large += size(r.stress)
    r.large[0] += 2 * r.mu * lengths(r.initial[None])[0] + lengths(r.back[None])[0]


def balance(r: Body) -> None:
    """Forces of 2 in K and on its sides, with what rounding adds, and the reactions t."""
    T = [einsum("kcLK,cxK->kxLK", r.stress, across) for across in r.across]
    inside = sum(row[rows] for row, rows in zip(T, r.between, strict=True))
    inside = r.degree / r.N * inside - r.body_force * r.volume
    pairs = zip(T, r.on_side, strict=True)
    jump = np.concatenate([row[rows] for row, rows in pairs], axis=-1)
    jump += jump.take(r.other, axis=-1)
    pulled = r.traction - r.pressure[:, None] * r.normal[:, None]
    left = jump[..., r.out] / 2 - pulled * r.outer
    jump[..., r.out] = np.where(r.held[:, None], 0.0, 2 * left)
    r.reaction = np.where(r.held[:, None], left, 0.0)
    sizes = size(r.stress) + r.length * size(r.body_force[None])
    rounding = 2 * EPS * r.length ** (r.N - 1) * sizes
    jumps = size(jump) / 2
    pulls = size(r.traction) + np.abs(r.pressure).max(axis=0)
    jumps[:, r.out] += 2 * EPS * r.outer * pulls
    r.inside = size(inside) + rounding
    r.jumps = jumps.reshape(r.L, r.v, r.K).sum(axis=1) + (r.v + 1) * rounding
    r.force = r.inside + r.jumps
    r.doubt = 5 / EPS * r.wrong.max() * np.outer(r.force.sum(axis=1), r.moves)


def defects(r: Body) -> list[float]:
    """The numbers (sum b^2/M)^(1/2) of 2, twice because of rounding."""
    need(((r.way >= 0) & (r.way < r.v)).all(), "way: not a side of its cell")
    need((r.passed > 0).all(), "passed: not positive")
    for side, flows, support in zip(r.way, r.passed, r.support, strict=True):
        place = side * r.K + np.arange(r.K)
        beyond = r.other[place]
        ends = beyond == place
        need(support[place[ends]].all(), "way: it ends where nothing holds the body")
        after = np.where(ends, r.K, beyond % r.K)
        for force, passed in zip(r.force, flows, strict=True):
            gets = force + np.bincount(after, passed, r.K + 1)[:-1]
            need(((1 + EPS) * gets < passed).all(), "passed: too little")
    reach = math.dist(r.points.min(axis=1), r.points.max(axis=1))
    lever = 1 + 5 * reach * r.length ** (r.N - 1) / r.volume
    tractions = r.jumps + 2 * lever * r.passed.sum(axis=0)
    (C, D), parts = CONSTANTS[r.N], math.factorial(r.N)
    b = C * math.sqrt(parts) * r.inside + D * tractions
    b *= r.length**2 * r.steep / np.sqrt(parts * r.volume)
    M = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.bulk)
    return (2 * np.sqrt((b**2 / M).sum(axis=1))).tolist()


def need_positive(r: Body, c: ndarray, message: str) -> None:
    """Coefficients of functions that are nonnegative on the sides with an obstacle."""
    c = c[:, r.contact]
    need((c[: r.N] >= 0).all(), message)
    need((c[r.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all(), message)


def on_sides(r: Body, a: ndarray, b: ndarray) -> ndarray:
    """Integrals of the products of fields on the sides of the boundary."""
    return r.outer * inner(a, b, CURVED if r.degree == 2 else None)


def work(r: Body, g: int, h: int) -> ndarray:
    """What the loads of layer g do with the displacement of layer h."""
    done = r.volume * inner(r.local[:, :, h], r.body_force[None, :, g])
    return np.append(done, on_sides(r, r.traction[:, :, g], r.outside[:, :, h]))


def unsure(r: Body, large: ndarray) -> ndarray:
    """What rounding changes of energies on K with stresses of a size."""
    soft = 3 / r.bulk + 1 / r.mu + 1 / r.hardening
    return WIDE * r.wrong * r.volume * soft * large**2


def energy_interval(r: Body) -> tuple[float, float]:
    """An interval of the least energy; ValueError where the receipt is not admissible."""
    P = r.pressure[:, 0]
    right = (P >= 0).all() and not P[:, ~r.contact].any()
    need(right, "pressure: negative, or where no obstacle is")
    displaced(r)
    room = r.room[:, 0] - r.wrong.max() * r.moves[0]
    need_positive(r, room, "u: inside the obstacle")
    balance(r)
    r.b = defects(r)
    m, S = r.strain[:, :1, 0], r.stress[:, :1, 0]
    e = r.strain[:, 1:, 0] - r.initial
    d = r.stress[:, 1:, 0] + 2 * r.mu * r.initial
    upper = r.bulk / 2 * inner(m, m) + r.mu * (inner(e, e) - (r.initial**2).sum(axis=0))
    upper += flow(r.trial, r.beta) / (2 * r.mu + r.hardening)
    lower = inner(S, S) / (2 * r.bulk) + inner(d, d) / (4 * r.mu)
    lower += squared_excess(r.shifted, lengths(r.shifted), r.beta) / (2 * r.hardening)
    rest = unsure(r, r.large[0]), r.doubt[0, 0]
    pressed = on_sides(r, r.pressure[:, :1], r.gap[:, :1])
    moved = on_sides(r, r.reaction[:, :, 0] / r.outer, r.outside[:, :, 0])
    low = -most(r.volume * lower, pressed, -moved, *rest)
    high = most(r.volume * upper, -work(r, 0, 0), *rest)
    r.root = r.b[0] + math.sqrt(r.b[0] ** 2 + 2 * (high - low))
    return low - r.b[0] * r.root, high


def integrand(r: Body, L: float, sign: int) -> tuple:
    """y, v, the law of a supremum, and the rest of what is under the integrals of 3."""
    m = r.stress[:, :1] - r.bulk * r.strain[:, :1]
    m = sign * m[:, :, 1] + L * m[:, :, 0]
    two_mu = 2 * r.mu
    p = (sign * r.stress[:, 1:, 1] + L * r.shifted) / two_mu
    k, H = L / two_mu, r.hardening / two_mu
    y = p + k * r.trial - sign * r.strain[:, 1:, 1]
    rest = inner(m, m) / (4 * L * r.bulk) - inner(p, r.trial)
    return y, p + H * y, (k, H, r.beta), rest


def suprema(r: Body, L: float, sign: int, tangent: ndarray) -> ndarray:
    """The integrals over K of the third line of 3."""
    y, v, law, rest = integrand(r, L, sign)
    return r.volume * (supremum(y, v, tangent, law) + rest)


def goal_interval(r: Body, L: float) -> tuple[float, float]:
    """3: what a goal lies between."""
    need(SMALLEST < L < 1 / SMALLEST, "factor: not positive, too large or too small")
    P, q = r.pressure.swapaxes(0, 1)
    need((np.abs(q) <= (1 - EPS) * L * P).all(), "pressure: the adjoint has too much")
    room, spare = r.room.swapaxes(0, 1)
    missed = r.wrong.max() * (L * r.moves[0] + r.moves[1])
    for sign in (-1, 1):
        least = (1 - EPS) * L * room + sign * spare - missed
        need_positive(r, least, "u: the adjoint is wrong at the obstacle")
    opened, opening = (on_sides(r, x[:, None], room[:, None]) for x in (q, L * P))
    own = r.bulk * inner(r.strain[:, :1, 0], r.strain[:, :1, 1])
    own += (r.back * r.strain[:, 1:, 1].mean(axis=0)).sum(axis=0)
    centre = np.concatenate([work(r, 1, 0), work(r, 0, 1), opened, -r.volume * own])
    always = [opening, unsure(r, r.large[1] + L * r.large[0]) / L]
    always += [r.doubt[1, 0], r.doubt[0, 1], L * r.doubt[0, 0]]
    always.append((r.b[1] + L * r.b[0]) * r.root)
    lower, upper = (suprema(r, L, *of) for of in zip((-1, 1), r.tangent, strict=True))
    return -most(-centre, lower, *always), most(centre, upper, *always)


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
        right = header[name] <= value if "lower" in name else value <= header[name]
        need(right, f"{name}: {header[name]} claimed, {value} proved")
    text = "{K} cells, {kinematics}: least energy in ({lower}, {upper})"
    if "goal" in header:
        text += ", {goal!r} in ({goal lower}, {goal upper})"
    return text.format_map(header)


def check_files(paths: list[str]) -> int:
    """Check files; the status is 0 if all of them show what they claim."""
    status = 0
    for path in paths:
        try:
            text = f"PASS: {check(path)}"
        except Exception as error:  # whatever is wrong with a file, it does not pass
            text = f"FAIL: {error if isinstance(error, ValueError) else repr(error)}"
            status = 1
        sys.stdout.write(f"{path}: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(check_files(sys.argv[1:]))
