"""Check a receipt: a least energy, and a force or displacement, lie in intervals.  numpy alone.

    python check_receipt.py receipt.npz

Forces f and tractions g act on a body of triangles or tetrahedra K, which is held on parts of its
boundary (u_i = U_i) and may touch an obstacle (u . n <= psi).  With e = dev eps, B = lambda + 2mu/n

    J(u) = int phi(eps(u)) - f . u - boundary int g . u,
    phi  = min over p of  B/2 (tr eps)^2 + mu |e - p_0 - p|^2 - mu |p_0|^2
                          + a : p + h/2 |p|^2 + beta |p|.

Proofs are in docs/receipts.md.
1. Every admissible u, with every p, gives an upper bound of the least energy.
2. Every stress S with  div S + f = 0,  S n = g - P n,  P >= 0  gives a lower bound,
    - int phi*(S) + int t . U - int P psi,     t = S n + P n - g  where the body is held,
    phi* = m^2/(2 B) + |d + 2 mu p_0|^2/(4 mu) + ([|d - a| - beta]_+)^2/(2 h),  S = m I + d.
   S is polynomial on parts of K: the centre takes the place of vertex a in part a.
3. Fields have Bernstein coefficients, those of the vertices, then of the edges opposite to them.
   A convex function of a field has at most the mean of its values at the coefficients.  A vector x
   with parts y along a direction and z across it has  |x| >= y + |z|^2/(2 max |x|)  and, for any
   Y > 0,  |x| <= y + (|z|^2 + ([Y - y]_+)^2)/(2 Y).  F(q) = |A + q v| - V q - b q^2 has for q >= 0
   at most  F(r) + ([|v| - V - 2 b r]_+)^2/(4 b)  if r = 0 or  |A + r v| - |A| >= r (V + 2 b r).
4. Rounding.  A number of one K takes less than 32 operations, so that it is wrong by at most EPS
   times the sizes of its terms and the condition of K, and by UNDERFLOW, since numbers of the file
   are zero or between 1e-30 and 1e30.  ``wrong`` is EPS times the largest condition.
5. S misses equilibrium by forces r in the parts and j on their sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Affine tractions T
   pass on forces and torques from K to K in proportion to ``passed``, until they reach supports:
   each K passes on more than it gets, and no more than ``passed``.  What is left on a part does no
   work on rigid motions, and is, with edges J of the part and distances x from the centre, at most
     b |eps(w)|,  b = |x|^2 |J^-1| (C_1 |r| + C_2 sum |j, T|/(det J)^(1/2)).
   J is m-convex, m = min(2 mu h/(2 mu + h), n B):  with G = J(u) - J(v) and the root b of all
   b^2/m  the last term is at most  b (2 G)^(1/2).
6. A goal is Q = int F . u + int G . u + int c P - int t . V of the solution (u, P, t).  The second
   layer of the arrays has F, G, V, c in the places of f, g, U, psi, and a displacement z = V where
   the body is held, a stress T and q in the places of u, S, P.  With L > 0,  |q| <= L P,
   |c - z . n| <= L (psi - u . n),  s = 2 mu (e - p_0) - a
     Q <= int [F . u + G . u + f . z + g . z - B tr eps(u) tr eps(z) - a : eps(z)]
          + int (m_T - B tr eps(z) + L (m - B tr eps(u)))^2/(4 L B) + int [X - p : s]
          + int (q + L P)(psi - u . n) + (b_T + L b) (2 G)^(1/2),
     p = (d_T + L (d - a))/(2 mu),  y = p + L s/(2 mu) - dev eps(z),  k = L/(2 mu),
   and -Q the same with -z, -T, -q, -c.  With H = h/(2 mu) and any D, X is at most
   |y - D|^2/(4 k)  and the largest F of 3,
     A = beta D,  v = p + H y,  V = k beta (1 + 2 H),  b = k H (1 + H).
"""

import json
import math
import sys
from itertools import combinations
from types import SimpleNamespace as Body

import numpy as np
from numpy import einsum, ndarray

EPS = 16 * 2.0**-52
SMALLEST = 1e-30  # number besides zero
UNDERFLOW = 1e-80
AT_ONCE = 8192  # simplices, to save time
WIDE = 40  # condition of densities
FORMAT = "ngepc receipt 6"
TABLE = (  # K cells of v vertices, P points, S sides, B of the boundary, L layers
    "cells vK, points NP, u NLU, stress kcLvK, lame_lambda K, mu K, hardening K, beta K, "
    "initial cK, back cK, body_force NLK, passed LvK, held NB, contact B, "
    "prescribed tNLB, traction tNLB, gap tLB, pressure tLB"
)
LAWS = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}  # N, n
CONSTANTS = {2: (1.1, 4.0), 3: (3.0, 16.0)}  # C_1, C_2
DEVIATORS = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
SIDES = {2: [[1, 2], [0, 2], [0, 1]], 3: [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]}
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
# fmt: off
# Places of the entries of a tensor among its components
ENTRIES = {2: np.array([[0, -1], [-1, 1]]), 3: np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])}
# Parts of a simplex by Bey; 21 is the mean of vertices 2 and 1
CHILDREN = {2: np.array([[0, 10, 20], [11, 21, 10], [22, 20, 21], [21, 20, 10]]),
            3: np.array([[0, 10, 20, 30], [10, 11, 21, 31], [20, 21, 22, 32], [30, 31, 32, 33],
                         [10, 20, 30, 31], [10, 20, 21, 31], [20, 30, 31, 32], [20, 21, 31, 32]])}
# Means of the products of quadratic Bernstein polynomials
QUADRATIC = {1: np.array([[6, 1, 3], [1, 6, 3], [3, 3, 4]]) / 30,
             2: np.array([[6, 1, 1, 1, 3, 3], [1, 6, 1, 3, 1, 3], [1, 1, 6, 3, 3, 1],
                          [1, 3, 3, 4, 2, 2], [3, 1, 3, 2, 4, 2], [3, 3, 1, 2, 2, 4]]) / 90}
# fmt: on


def need(condition: object, message: str) -> None:
    """Refuse the receipt unless a condition holds."""
    if not condition:
        raise ValueError(message)


def most(*terms: object) -> float:
    """No less than the sum of all numbers."""
    x = np.concatenate([np.ravel(term) for term in terms])
    x = np.append(x, np.zeros(-x.size % 32)).reshape(32, -1)
    rounding = EPS * float(np.abs(x).sum()) + UNDERFLOW
    return math.fsum(x.sum(axis=0).tolist()) + rounding


def lengths(a: ndarray) -> ndarray:
    """Norms (k, ...) of the coefficients of fields (k, c, ...)."""
    return np.sqrt(einsum("kc...,kc...->k...", a, a))


def size(a: ndarray) -> ndarray:
    """The largest norm of the coefficients of fields (k, c, ...)."""
    return lengths(a).max(axis=0)


def inner(a: ndarray, b: ndarray, N: int) -> ndarray:
    """Means of the products of two fields (k, c, ...) on simplices; the second may be constant."""
    if len(a) > N + 1:
        a = einsum("kj,jc...->kc...", QUADRATIC[N], a)
        return einsum("kc...,kc...->...", a, b)
    together = einsum("c...,c...->...", a.sum(axis=0), b.sum(axis=0)) / len(b)
    return (together + einsum("kc...,kc...->...", a, b) / len(a)) / (len(a) + 1)


def split(r: Body, S: ndarray) -> tuple[ndarray, ndarray]:
    """Mean (k, 1, ...) and deviator of tensors, in coordinates with the same products."""
    mean = S[:, : r.n].sum(axis=1, keepdims=True) / r.n
    diagonal = einsum("dc,kc...->kd...", DEVIATORS[: r.n - 1, : r.n], S[:, : r.n])
    return mean, np.concatenate([diagonal, math.sqrt(2) * S[:, r.n :]], axis=1)


def along(x: ndarray, n: ndarray) -> ndarray:
    """Fields along the direction of vectors (c, ...), (k, 1, ...)."""
    n = n / np.maximum(lengths(n[None])[0], SMALLEST)
    return einsum("kc...,c...->k...", x, n)[:, None]


def outside_ball(x: ndarray, length: ndarray, V: ndarray) -> ndarray:
    """What of a field exceeds a ball, coefficient by coefficient of a length."""
    return x * (np.maximum(length - V, 0.0) / np.maximum(length, V))[:, None]


def norm(N: int, x: ndarray, length: ndarray) -> ndarray:
    """Means of |x| from above, by 3; coefficients have this length at most."""
    y = along(x, x.mean(axis=0))
    Y = np.maximum(y.min(axis=(0, 1)), length.max(axis=0) / 8) + SMALLEST
    square = inner(x, x, N) - inner(y, y, N)
    square += (np.maximum(Y - y, 0.0) ** 2).mean(axis=(0, 1))
    return np.minimum(y.mean(axis=(0, 1)) + square / (2 * Y), length.mean(axis=0))


def squared_excess(N: int, v: ndarray, V: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Means of ([|v| - V]_+)^2 from above: by |v| - V itself, or what exceeds the ball."""
    length = lengths(v)
    y = along(v, v.mean(axis=0))
    square = inner(v, v, N)
    longest = length.max(axis=0) + SMALLEST
    mean = y.mean(axis=(0, 1)) + (square - inner(y, y, N)) / (2 * longest)
    found = square - 2 * V * mean + V**2
    least = length.min(axis=0) - V
    on = np.flatnonzero(least < 0)
    x = outside_ball(v.take(on, axis=2), length.take(on, axis=1), V[on])
    found[on] = np.minimum(found[on], inner(x, x, N))
    return found, least, longest - V


def flow(N: int, s: ndarray, beta: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Plastic terms of phi times 2 mu + h with the best p at the coefficients."""
    length = lengths(s)
    x = outside_ball(s, length, beta)
    found = beta * norm(N, x, np.maximum(length - beta, 0.0))
    found += inner(x, x / 2 - s, N)
    return found, length.min(axis=0) - beta, length.max(axis=0) - beta


def supremum(
    N: int, x: ndarray, V: ndarray, k: ndarray, H: ndarray, beta: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """X of 6 for the coefficients of y and v, with the largest r for which 3 is sure at all."""
    y, v = np.split(x, 2, axis=1)
    b = k * H * (1 + H)
    of_y, of_v = lengths(y), lengths(v)
    D = outside_ball(y, of_y, 2 * k * beta)
    of_A = beta * np.maximum(of_y - 2 * k * beta, 0.0)
    first = np.maximum(of_v.mean(axis=0) - V, SMALLEST) / (2 * b)
    n = beta * D.mean(axis=0) + first * v.mean(axis=0)
    turned = (of_A - beta * along(D, n)[:, 0]).max(axis=0)
    slope = along(v, n).min(axis=(0, 1)) - V
    root = slope**2 - 8 * b * turned
    r = np.maximum(slope + np.sqrt(np.maximum(root, 0.0)), 0.0) / (4 * b)
    r[root < 0] = 0.0
    found = norm(N, beta * D + r * v, of_A + r * of_v) - r * (V + b * r)
    found += squared_excess(N, v, V + 2 * b * r)[0] / (4 * b)
    found += inner(y - D, y - D, N) / (4 * k)
    return found, 2 * b * r, of_v.max(axis=0) - V


def subdivided(N: int, s: ndarray) -> ndarray:
    """Coefficients (k, c, 2^N K) on the parts of simplices."""
    T = np.eye(N + 1)[[CHILDREN[N] // 10, CHILDREN[N] % 10]].mean(axis=0)
    if len(s) > N + 1:
        T = einsum("pia,pjb,abk->pijk", T, T, np.eye(6)[BETWEEN])
        T = T[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return einsum("pij,jcK->icpK", T, s).reshape(*s.shape[:2], -1)


def means(N: int, density: object, x: ndarray, law: ndarray, cuts: int) -> ndarray:
    """Means of a density on simplices; those where it is uneven are cut, so often at most."""
    if x.shape[-1] > AT_ONCE:
        rows = [slice(i, i + AT_ONCE) for i in range(0, x.shape[-1], AT_ONCE)]
        parts = [means(N, density, x[..., i], law[:, i], cuts) for i in rows]
        return np.concatenate(parts)
    found, least, largest = density(N, x, *law)
    on = np.flatnonzero((largest > 0) & (1.5 * least <= largest))
    if cuts and len(on):
        parts = np.tile(law.take(on, axis=1), 2**N)
        parts = means(N, density, subdivided(N, x.take(on, axis=2)), parts, cuts - 1)
        found[on] = parts.reshape(2**N, -1).mean(axis=0)
    return found


def shapes_of(header: dict) -> tuple[dict, dict]:
    """The sizes of a receipt, and the shapes of its arrays in their order."""
    N, n = LAWS[header["kinematics"]]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    sizes = {letter: header[letter] for letter in "PKSB"}
    need(all(type(s) is int and s > 0 for s in sizes.values()), "sizes: not positive")
    sizes |= {"N": N, "n": n, "v": N + 1, "c": n + N * (N - 1) // 2, "degree": order}
    sizes |= {"k": 6 if order == 2 else N + 1, "t": 3 if order == 2 else N}
    sizes |= {"L": 1 + ("goal" in header), "U": sizes["P"] + (order - 1) * sizes["S"]}
    rows = [row.split() for row in TABLE.split(", ")]
    return sizes, {name: [sizes[s] for s in shape] for name, shape in rows}


def arrays_in(words: ndarray, header: dict) -> dict:
    """The sizes and arrays of a receipt."""
    found, shapes = shapes_of(header)
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()])
    right = words.dtype == float and words.shape == (ends[-1],)
    need(right, "receipt: its arrays have other types or sizes")
    for name, part in zip(shapes, np.split(words, ends[:-1]), strict=True):
        found[name] = part.reshape(shapes[name])
    return found


def opened(words: ndarray, header: dict) -> Body:
    """The arrays of a receipt, and what follows from them."""
    r = Body(**arrays_in(words, header))
    large = np.abs(words)
    usual = np.count_nonzero(large > SMALLEST) == np.count_nonzero(large)
    need(usual and large.max() < 1 / SMALLEST, "numbers: too large or small, or none")
    r.held = r.held != 0
    r.contact = r.contact != 0
    r.bulk = r.lame_lambda + 2 * r.mu / r.n
    for name in ("mu", "beta", "hardening"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    need((r.bulk > 1e-3 * r.mu).all(), "bulk: too small, or not positive")
    r.between = BETWEEN if r.degree == 2 else np.arange(r.v)[None]  # for gradients
    r.on_side = [[*row, r.v + i][: r.t] for i, row in enumerate(SIDES[r.N])]
    r.initial = split(r, r.initial[None, :, None])[1][0]
    r.back = split(r, r.back[None, :, None])[1][0]
    measured(r)
    join(r)
    return r


def measured(r: Body) -> None:
    """Volumes, slopes of barycentric coordinates of K, outward normals of K and its parts."""
    N = r.N
    cells = r.cells.astype(int)
    right = (cells == r.cells).all() and cells[0].min() >= 0 and cells[-1].max() < r.P
    need(right and (np.diff(cells, axis=0) > 0).all(), "cells: not ascending points")
    r.cells = cells
    corners = r.points[:, cells] - r.points[:, cells[:1]]
    away = corners - corners.mean(axis=1, keepdims=True)
    r.length = np.sqrt((away**2).sum(axis=(0, 1)))
    J = corners[:, 1:]
    if N == 2:
        cofactors = np.array([[J[1, 1], -J[1, 0]], [-J[0, 1], J[0, 0]]])
    else:
        cofactors = np.cross(J[:, [1, 2, 0]], J[:, [2, 0, 1]], axis=0)
    det = (J[:, 0] * cofactors[:, 0]).sum(axis=0)
    need((np.abs(det) > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    r.volume = np.abs(det) / math.factorial(N)
    r.area = np.concatenate([cofactors.sum(axis=1)[None], -cofactors.swapaxes(0, 1)])
    r.area *= np.sign(det) / (N - 1)
    r.slopes = -r.area / (N * r.volume)
    r.steep = np.sqrt((r.slopes**2).sum(axis=(0, 1)))
    r.wrong = EPS * float((3 * r.length * r.steep).max()) ** (N - 1)
    r.part_area = (r.area[:, :, None] - r.area.swapaxes(0, 1)) / (N + 1)
    r.part_area += np.eye(N + 1)[:, None, :, None] * r.area[:, :, None]


def join(r: Body) -> None:
    """The sides by their vertices, with two places (side of K, K), equal on the boundary."""
    N = r.N
    need(r.P**N < 2**63, "sizes: too large")
    ends = r.cells[SIDES[N]].swapaxes(0, 1).reshape(N, -1)
    number = r.P ** np.arange(N)[::-1] @ ends
    order = number.argsort(kind="stable")
    first = np.diff(number[order], prepend=-1) > 0
    last = np.append(first[1:], True)
    need((first | last).all(), "sides: three cells at one")
    r.sides = np.array([order[first], order[last]])
    r.out = np.flatnonzero(r.sides[0] == r.sides[1])
    counts = r.sides.shape[1], len(r.out)
    need(counts == (r.S, r.B), "sides: not as many as cells have")
    r.side = np.empty((r.v, r.K), dtype=int)
    r.side.ravel()[order] = np.cumsum(first) - 1
    area = r.area.swapaxes(0, 1).reshape(N, -1)
    opposite = (area[:, r.sides[0]] * area[:, r.sides[1]]).sum(axis=0) < 0
    opposite[r.out] = True
    need(opposite.all(), "cells: two overlap at their side")
    r.place = r.sides[0, r.out]
    r.ends = ends[:, r.place]
    r.nodes = np.concatenate([r.cells, r.P + r.side][: r.degree])
    r.side_nodes = np.concatenate([r.ends, r.P + r.out[None]][: r.degree])
    r.outer = np.sqrt((area[:, r.place] ** 2).sum(axis=0))
    r.normal = area[:, None, r.place] / r.outer


def on_parts(r: Body, c: ndarray) -> ndarray:
    """Fields on K (k, ..., K) on its parts (k, ..., v, K), quadratic unless constant."""
    if len(c) == 1:
        return c[..., None, :]
    parts = np.repeat(c[..., None, :], r.v, axis=-2)
    own = np.arange(r.v)
    parts[own, ..., own, :] = c.mean(axis=0)
    return np.concatenate([parts, (parts[[1, 0, 0]] + parts[[2, 2, 1]]) / 2])


def displaced(r: Body) -> None:
    """Values of u and z on K and sides, strains on the parts of K, and sizes."""
    r.local = np.moveaxis(r.u[..., r.nodes], 2, 0)
    r.outside = np.moveaxis(r.u[..., r.side_nodes], 2, 0)
    right = (r.outside == r.prescribed) | ~r.held[:, None]
    need(right.all(), "u: not the prescribed displacement")
    r.room = r.gap - (r.outside * r.normal).sum(axis=1)
    r.moves = np.abs(r.u).max(axis=(0, 2)) * r.N + np.abs(r.gap).max(axis=(0, 2))
    change = r.local - r.local[:1]
    du = r.degree * einsum("kiaLK,ibK->kabLK", change[r.between], r.slopes)
    eps = np.zeros((len(du), r.c, r.L, r.K))
    eps[:, ENTRIES[r.N]] = (du + du.swapaxes(1, 2)) / 2
    mean, r.strain = split(r, on_parts(r, eps))
    r.trace = r.n * mean
    r.m, r.d = split(r, r.stress)
    r.trial = 2 * r.mu * (r.strain[:, :, 0] - r.initial) - r.back
    r.shifted = r.d[:, :, 0] - r.back
    r.large = r.degree * r.N * (r.n * r.bulk + 2 * r.mu) * r.steep * size(change)
    r.large += size(r.stress).max(axis=1)
    r.large[0] += 2 * r.mu * size(r.initial)[0] + size(r.back)[0]


def need_positive(r: Body, c: ndarray, message: str) -> None:
    """Coefficients of functions that are nonnegative on the sides with an obstacle."""
    c = c[:, r.contact]
    need((c[: r.N] >= 0).all(), message)
    need((c[r.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all(), message)


def balance(r: Body) -> None:
    """Forces of 5 on the parts and on their sides, with what rounding adds, and the reactions t."""
    N = r.N
    area = EPS * r.length ** (N - 1)
    sizes = size(r.stress).max(axis=1) + r.length * size(r.body_force[None])
    T = einsum(
        "kxyLaK,iyaK->ikxLaK", r.stress[:, ENTRIES[N]], r.part_area
    )  # side i of part a
    inside = r.degree * sum(T[i, r.between[:, i]] for i in range(N + 1)) / N
    inside -= (r.body_force * r.volume / (N + 1))[:, :, None]
    r.inside = size(inside) + (area * sizes)[:, None]
    r.jumps = np.repeat((N + 1) * (area * sizes)[:, None], N + 1, axis=1)
    for a, b in combinations(range(N + 1), 2):
        of_b = {a: b, N + 1 + b: N + 1 + a}  # places in part a -> in part b
        other = [of_b.get(i, i) for i in r.on_side[b]]
        jump = T[b, r.on_side[b], :, :, a] + T[a, other, :, :, b]
        r.jumps[:, [a, b]] += size(jump)[:, None] / 2  # one half acts on each part
    T = np.concatenate([T[a, r.on_side[a], :, :, a] for a in range(N + 1)], axis=-1)
    jump = T.take(r.sides[0], axis=-1) + T.take(r.sides[1], axis=-1)
    pulled = r.traction - r.pressure[:, None] * r.normal
    left = jump[..., r.out] / 2 - pulled * r.outer
    jump[..., r.out] = np.where(r.held[:, None], 0.0, 2 * left)
    r.reaction = np.where(r.held[:, None], left, 0.0)
    jumps = size(jump) / 2
    pulls = size(r.traction) + np.abs(r.pressure).max(axis=0)
    jumps[:, r.out] += area[r.place % r.K] * pulls
    r.jumps += jumps[:, r.side]
    r.force = (r.inside + r.jumps).sum(axis=1)


def rolled(r: Body, reach: float) -> float:
    """What supports of single components carry at most, all of them, of a unit force."""
    component, row = np.nonzero(r.held)
    m = (r.points - r.points[:, :1])[:, r.ends[:, row]].mean(axis=1) / reach
    e = np.eye(r.N)[:, component]
    turns = [m[i] * e[j] - m[j] * e[i] for i, j in combinations(range(r.N), 2)]
    wrenches = np.concatenate([e, turns]) * r.outer[row]
    least = np.linalg.eigvalsh(wrenches @ wrenches.T)[0]
    need(least > 1e-9 * (wrenches**2).sum(), "held: the body can move")
    return 3 * math.sqrt((r.outer[row] ** 2).sum() / least)


def defects(r: Body) -> list[float]:
    """The numbers b of 5; where no side is held in all components all forces go to the first K."""
    N = r.N
    passed = r.passed.reshape(r.L, -1)
    ends = passed[:, r.place]
    free = ends[:, ~r.held.all(axis=0)]
    need((passed >= 0).all() and not free.any(), "passed: where the body is free")
    gets = np.empty_like(passed)
    gets[:, r.sides] = passed[:, r.sides[::-1]]
    gets[:, r.place] = 0.0
    gets = r.force + gets.reshape(r.passed.shape).sum(axis=1)
    out = r.passed.sum(axis=1)
    rolls = not ends.any()
    need(((1 + EPS) * gets < out)[:, rolls:].all(), "passed: too little")
    reach = float(np.ptp(r.points, axis=1).sum())
    through = np.maximum(gets, out)
    if rolls:
        through += rolled(r, reach) * 2 * r.force.sum(axis=1, keepdims=True)
    T = (N + 2) * (1 + 5 * reach * r.length ** (N - 1) / r.volume) * through
    steep = np.sqrt(r.steep**2 + (N + 1) * (r.slopes**2).sum(axis=1))
    C = CONSTANTS[N]
    b = C[0] * math.sqrt(math.factorial(N)) * r.inside + C[1] * (r.jumps + T[:, None])
    b *= r.length**2 * steep * np.sqrt((N + 1) / (math.factorial(N) * r.volume))
    m = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.n * r.bulk)
    return (2 * np.sqrt((b**2 / m).sum(axis=(1, 2)))).tolist()


def work(r: Body, g: int, h: int) -> ndarray:
    """What the loads of layer g do with the displacement of layer h, by parts."""
    done = r.volume * inner(r.local[:, :, h], r.body_force[None, :, g], r.N)
    pulled = inner(r.traction[:, :, g], r.outside[:, :, h], r.N - 1)
    return np.concatenate([done, r.outer * pulled])


def doubt(r: Body, g: int, h: int) -> float:
    """What rounding changes of this work, of that of pressures and supports, and of R(u)."""
    return 5 * r.wrong / EPS * float(r.force[g].sum() * r.moves[h])


def unsure(r: Body, large: ndarray) -> ndarray:
    """What rounding changes of energies on K with stresses of a size."""
    soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    return WIDE * r.wrong * r.volume * soft * large**2


def densities(r: Body, cuts: int) -> tuple[ndarray, ndarray]:
    """Means of phi*(S) and phi(eps(u)) on K from above."""
    N = r.N
    e = r.strain[:, :, 0] - r.initial
    m, d, trace = r.m[:, :, 0], r.d[:, :, 0] + 2 * r.mu * r.initial, r.trace[:, :, 0]
    upper = r.bulk / 2 * inner(trace, trace, N) + r.mu * inner(e, e, N)
    upper -= r.mu * (r.initial**2).sum(axis=0)
    lower = inner(m, m, N) / (2 * r.bulk) + inner(d, d, N) / (4 * r.mu)
    for found, density, s, h in (
        (upper, flow, r.trial, 2 * r.mu + r.hardening),
        (lower, squared_excess, r.shifted, 2 * r.hardening),
    ):
        beta = np.tile(r.beta, s.shape[2])[None]
        plastic = means(N, density, s.reshape(*s.shape[:2], -1), beta, cuts)
        found += plastic.reshape(found.shape) / h
    return lower.mean(axis=0), upper.mean(axis=0)


def energy_interval(r: Body) -> tuple[float, float]:
    """An interval of the least energy; ValueError where the receipt is not admissible."""
    need((r.pressure[:, 0] >= 0).all(), "pressure: negative")
    need((r.pressure[:, 0, ~r.contact] == 0).all(), "pressure: where no obstacle is")
    displaced(r)
    need_positive(r, r.room[:, 0] - r.wrong * r.moves[0], "u: inside the obstacle")
    balance(r)
    r.b = defects(r)
    cuts = r.degree if r.L == 1 else 0  # a goal needs the energy for rounding only
    lower, upper = (r.volume * density for density in densities(r, cuts))
    rest = unsure(r, r.large[0]), doubt(r, 0, 0)
    pressed = r.outer * inner(r.pressure[:, None, 0], r.gap[:, None, 0], r.N - 1)
    moved = inner(r.reaction[:, :, 0], r.prescribed[:, :, 0], r.N - 1)
    lower = -most(lower, pressed, -moved, *rest)
    upper = most(upper, -work(r, 0, 0), *rest)
    r.root = r.b[0] + math.sqrt(r.b[0] ** 2 + 2 * (upper - lower))  # (2 G)^(1/2)
    return lower - r.b[0] * r.root, upper


def suprema(r: Body, L: float) -> ndarray:
    """The integrals over the parts of K in 6, for -Q and Q."""
    fields = r.trial, r.strain[:, :, 1], r.trace[:, :, 1], r.trace[:, :, 0]
    trial, e, trace, own_trace = (field[:, :, None] for field in fields)
    signs = np.array([-1.0, 1.0])[:, None, None]
    m = L * (r.m[:, :, :1] - r.bulk * own_trace)
    m = m + signs * (r.m[:, :, 1:] - r.bulk * trace)
    p = (signs * r.d[:, :, 1:] + L * r.shifted[:, :, None]) / (2 * r.mu)
    H = r.hardening / (2 * r.mu)
    k = L / (2 * r.mu)
    y = p + k * trial - signs * e
    x = np.concatenate([y, p + H * y], axis=1).reshape(r.k, -1, 2 * r.v * r.K)
    law = np.tile([k * r.beta * (1 + 2 * H), k, H, r.beta], 2 * r.v)
    found = means(r.N, supremum, x, law, 1).reshape(2, r.v, -1)
    found += inner(m, m, r.N) / (4 * L * r.bulk) - inner(p, trial, r.N)
    return r.volume * found.mean(axis=1)


def goal_interval(r: Body, L: float) -> tuple[float, float]:
    """6: what a goal lies between."""
    need(SMALLEST < L < 1 / SMALLEST, "factor: not positive, too large or too small")
    P, q = r.pressure.swapaxes(0, 1)
    small = np.abs(q) <= (1 - EPS) * L * P
    need(small.all(), "pressure: that of the adjoint is too large")
    room, spare = r.room.swapaxes(0, 1)
    missed = r.wrong * (L * r.moves[0] + r.moves[1])
    for sign in (-1.0, 1.0):
        least = (1 - EPS) * L * room + sign * spare - missed
        need_positive(r, least, "u: the adjoint is wrong at the obstacle")
    opened, opening = (
        r.outer * inner(x[:, None], room[:, None], r.N - 1) for x in (q, L * P)
    )
    own = r.bulk * inner(r.trace[:, :, 0], r.trace[:, :, 1], r.N)
    own += (r.back * r.strain[:, :, 1].mean(axis=0)).sum(axis=0)
    own = r.volume * own.mean(axis=0)
    centre = np.concatenate([work(r, 1, 0), work(r, 0, 1), opened, -own])
    always = [opening, unsure(r, r.large[1] + L * r.large[0]) / L]
    always += [doubt(r, 1, 0), doubt(r, 0, 1), L * doubt(r, 0, 0)]
    always.append((r.b[1] + L * r.b[0]) * r.root)
    lower, upper = suprema(r, L)
    return -most(-centre, lower, *always), most(centre, upper, *always)


def proved_intervals(words: ndarray, header: dict) -> dict:
    """What a receipt proves; ValueError where it is not admissible."""
    r = opened(words, header)
    proved = dict(zip(("lower", "upper"), energy_interval(r), strict=True))
    if "goal" in header:
        ends = goal_interval(r, float(header["factor"]))
        proved |= zip(("goal lower", "goal upper"), ends, strict=True)
    return proved


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        right = header["format"] == FORMAT
        need(right, f"format: {FORMAT!r} is needed, write the receipt again")
        proved = proved_intervals(file["receipt"], header)
    for name, value in proved.items():
        right = header[name] <= value if "lower" in name else value <= header[name]
        need(right, f"{name}: {header[name]} claimed, {value} proved")
    name = header.get("goal", "")
    need(type(name) is str and name.isprintable(), "goal: no name")
    text = f"least energy in ({header['lower']}, {header['upper']})"
    goal = (
        f", {name} in ({header['goal lower']}, {header['goal upper']})" if name else ""
    )
    return text + goal


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
