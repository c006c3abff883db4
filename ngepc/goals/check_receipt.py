"""Check a receipt: a least energy, and a force or displacement, lie in intervals.  numpy alone.

    python check_receipt.py receipt.npz

Forces f and tractions g act on a body of triangles or tetrahedra K, which is held on parts of its
boundary (u_i = U_i) and may touch an obstacle (u . n <= psi).  With e = dev eps, B = lambda + 2mu/n

    J(u) = int phi(eps(u)) - f . u - boundary int g . u,
    phi  = min over p of  B/2 (tr eps)^2 + mu |e - p_0 - p|^2 - mu |p_0|^2
                          + a : p + h/2 |p|^2 + beta |p|.

1. Every admissible u, with every p, gives an upper bound of the least energy.
2. Every stress S with  div S + f = 0,  S n = g - P n,  P >= 0  gives a lower bound,
    - int phi*(S) + int t . U - int P psi,     t = S n + P n - g  where the body is held,
    phi* = m^2/(2 B) + |d + 2 mu p_0|^2/(4 mu) + ([|d - a| - beta]_+)^2/(2 h),  S = m I + d.
   S is polynomial on parts of K: the centre takes the place of vertex a in part a.
3. Fields have Bernstein coefficients, those of the vertices, then of the edges opposite to them.
   A convex function of a field has at most the mean of its values at the coefficients.  A vector
   with parts y along a direction, z across it:  y + |z|^2/(2 max |x|) <= |x| <= y + |z|^2/(2 y),
   the latter for y > 0.  F(q) = |A + q v| - V q - b q^2 has for q >= 0, and any r >= 0, at most
     F(r) + ([|v| - V - 2 b r]_+)^2/(4 b)   if  |A + r v| - |A| >= r (V + 2 b r):
   for q > r as |A + q v| <= |A + r v| + (q - r) |v|, and for q < r as norms are convex,
   F(q) <= (1 - q/r) F(0) + q/r F(r) + b q (r - q), and F(0) <= F(r) - b r^2.
4. Rounding.  A number of one K is wrong by at most EPS times the sizes of its terms and the
   condition of K: it takes less than 64 operations, and so do the numbers that ``summed`` adds.
   Numbers of the file are zero or between 1e-30 and 1e30, so that underflow is below UNDERFLOW.
5. S misses equilibrium by residuals r in the parts and j on their sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Affine tractions T
   pass on the forces and torques of r, j: from part to part, and from K by its side ``way``, at
   most ``passed``, until a support is reached.  What is left on a part does no work on rigid
   motions, and is at most  b |eps(w)|,  b = |x|^2 |J^-1| (C_1 |r| + C_2 sum |j, T|/(det J)^(1/2)),
   with edges J, distances x from the centre, constants of a reference simplex, and forces j, T.
   J is m-convex, m = min(2 mu h/(2 mu + h), n B):  with G = J(u) - J(v) and the root b of all
   b^2/m  the last term is at most  b (2 G)^(1/2).
6. A goal is Q = int F . u + int G . u + int c P - int t . V of the solution (u, P, t).  The second
   layer of the arrays has F, G, V, c in the places of f, g, U, psi, and a displacement z = V where
   the body is held, a stress T and q in the places of u, S, P.  With L > 0,  |q| <= L P,
   |c - z . n| <= L (psi - u . n),  s = 2 mu (e - p_0) - a
     Q <= int [F . u + G . u + f . z + g . z - B tr eps(u) tr eps(z) - a : eps(z)]
          + int (m_T - B tr eps(z) + L (m - B tr eps(u)))^2/(4 L B) + int [X - p : s]
          + int (q + L P)(psi - u . n) + (b_T + L b) (2 G)^(1/2),
     p = (d_T + L (d - a))/(2 mu),  w = L s/(2 mu) - dev eps(z),  k = L/(2 mu),
     X = sup over t of  p : t + w : N - k t : N,  N = the radial return of t.
   Proof: for the solution (v, Y) add  (T, eps(v - u)) = goal's load on v - u,  (Y, eps(z)) = load
   on z,  and subtract  L (Y - S, eps(v - u)).  -Q has the same bound with -z, -T, -q, -c.
7. With H = h/(2 mu), t - N = q x of size q, N = beta x + H q x, or q = 0, |N| <= beta.  For any D
     (p + w) : N - k |N|^2 <= |p + w - D + 2 H k q x|^2/(4 k) + (D - 2 H k q x) : N,
   so that X is at most  |p + w - D|^2/(4 k)  and the largest F of 3 with
     A = beta D,  v = p + H (p + w),  V = k beta (1 + 2 H),  b = k H (1 + H).
"""

import json
import math
import sys
from itertools import combinations
from types import SimpleNamespace as Body

import numpy as np
from numpy import einsum, ndarray

EPS = 64 * 2.0**-52
SMALLEST = 1e-30  # number besides zero
UNDERFLOW = 1e-80
WIDE = 1000  # products of conditions of what numbers of 7 are divided by
FORMAT = "ngepc receipt 5"
TABLE = (  # K cells of v vertices, P points, S sides, B of the boundary, L layers
    "points f8 NP, u f8 NLU, stress f8 kcLvK, lame_lambda f8 K, mu f8 K, hardening f8 K, "
    "beta f8 K, initial f8 cK, back f8 cK, body_force f8 NLK, passed f8 LS, "
    "prescribed f8 tNLB, traction f8 tNLB, gap f8 tLB, pressure f8 tLB, "
    "cells i8 vK, sides i8 2S, way i8 K, held i8 NB, contact i8 B"
)
LAWS = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}  # N, n
CONSTANTS = {2: (1.1, 4.0), 3: (3.0, 16.0)}  # C_1, C_2
DEVIATORS = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
SIDES = {2: [[1, 2], [0, 2], [0, 1]], 3: [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]}
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
# fmt: off
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


def summed(*parts: ndarray) -> float:
    """No less than the sum of all numbers."""
    x = np.concatenate([part.ravel() for part in parts])
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
    """Means of the products of two fields with coefficients (k, c, ...)."""
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


def subdivided(N: int, s: ndarray) -> ndarray:
    """Coefficients (k, c, 2^N K) on the parts of simplices."""
    T = np.eye(N + 1)[[CHILDREN[N] // 10, CHILDREN[N] % 10]].mean(axis=0)
    if len(s) > N + 1:
        T = einsum("pia,pjb,abk->pijk", T, T, np.eye(6)[BETWEEN])
        T = T[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return einsum("pij,jcK->icpK", T, s).reshape(*s.shape[:2], -1)


def along(x: ndarray, n: ndarray) -> ndarray:
    """Fields along a direction, (k, 1, ...)."""
    return einsum("kc...,c...->k...", x, n)[:, None]


def across(length: ndarray, y: ndarray) -> ndarray:
    """No less than the size of what ``along`` leaves, y, of fields of a length."""
    return np.sqrt((length**2 - (1 - EPS) * y[:, 0] ** 2).max(axis=0))


def mean_direction(x: ndarray) -> ndarray:
    """The direction of the mean of a field."""
    n = x.sum(axis=0)
    return n / np.maximum(np.sqrt(einsum("c...,c...->...", n, n)), SMALLEST)


def outside_ball(x: ndarray, most: ndarray) -> ndarray:
    """What exceeds a ball, coefficient by coefficient."""
    length = lengths(x)
    return x * (np.maximum(length - most, 0.0) / np.maximum(length, most))[:, None]


def norm(N: int, x: ndarray) -> ndarray:
    """Means of |x| from above, by 3."""
    y = along(x, mean_direction(x))
    least = y.min(axis=(0, 1))
    length = lengths(x)
    clear = least > length.max(axis=0) / 8
    across = inner(x, x, N) - inner(y, y, N)
    found = y.mean(axis=(0, 1)) + across / (2 * np.where(clear, least, 1.0))
    return np.minimum(np.where(clear, found, np.inf), length.mean(axis=0))


def means(N: int, density: object, x: ndarray, law: ndarray, cuts: int) -> ndarray:
    """Means of a density on K, which are cut where it is uneven, so often at most."""
    found, uneven = density(N, x, law)
    on = np.flatnonzero(uneven)
    if cuts and len(on):
        parts = np.tile(law.take(on, axis=1), 2**N)
        parts = means(N, density, subdivided(N, x.take(on, axis=2)), parts, cuts - 1)
        found[on] = parts.reshape(2**N, -1).mean(axis=0)
    return found


def squared_excess(N: int, v: ndarray, v_n: ndarray, V: ndarray) -> ndarray:
    """Means of ([|v| - V]_+)^2 from above: by |v| - V itself, or what exceeds the ball.

    ``v_n`` is the field along any direction.
    """
    square = inner(v, v, N)
    length = lengths(v)
    longest = np.maximum(length.max(axis=0), SMALLEST)
    least = v_n.mean(axis=(0, 1)) + (square - inner(v_n, v_n, N)) / (2 * longest)
    found = square - 2 * V * least + V**2
    on = np.flatnonzero(length.min(axis=0) < V)
    x = outside_ball(v.take(on, axis=2), V[on])
    found[on] = np.minimum(found[on], inner(x, x, N))
    return found


def yielding(s: ndarray, beta: ndarray) -> ndarray:
    """Where |s| - beta varies much."""
    over = lengths(s) - beta
    most = over.max(axis=0)
    return (most > 0) & (2 * over.min(axis=0) <= most)


def flow(N: int, s: ndarray, law: ndarray) -> tuple[ndarray, ndarray]:
    """Plastic terms of phi times 2 mu + h, with the best p at the coefficients."""
    beta = law[0]
    x = outside_ball(s, beta)
    return beta * norm(N, x) + inner(x, x / 2 - s, N), yielding(s, beta)


def conjugate(N: int, s: ndarray, law: ndarray) -> tuple[ndarray, ndarray]:
    """Plastic terms of phi* times h."""
    return squared_excess(N, s, along(s, mean_direction(s)), law[0]) / 2, yielding(
        s, law[0]
    )


def goal_supremum(N: int, x: ndarray, law: ndarray) -> tuple[ndarray, ndarray]:
    """X of 6 by 7 for coefficients of p + w and v; r is the best number for which 3 is sure."""
    y, v = np.split(x, 2, axis=1)
    k, H, beta = law
    V = k * beta * (1 + 2 * H)
    b = k * H * (1 + H)
    D = outside_ball(y, 2 * k * beta)
    A = beta * D
    n = mean_direction(v)
    v_n = along(v, n)
    A_n = along(A, n)
    least = A_n.min(axis=(0, 1))
    turned = across(lengths(A), A_n) / np.maximum(least, SMALLEST)
    length = lengths(v)
    slope = v_n.min(axis=(0, 1)) - turned * across(length, v_n)
    slope = np.where(least < 0, 0.0, slope / np.sqrt(1 + turned**2))
    twice = np.maximum(slope - V, 0.0)
    r = twice / (2 * b)
    found = norm(N, A + r * v) - r * (V + b * r)
    found += squared_excess(N, v, v_n, V + twice) / (4 * b) + inner(y - D, y - D, N) / (
        4 * k
    )
    most = length.max(axis=0) - V
    return found, (most > 0) & (1.5 * twice <= most)


def record_type(header: dict) -> tuple[dict, np.dtype]:
    """The sizes of a receipt, and its arrays in the order of the table."""
    N, n = LAWS[header["kinematics"]]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    sizes = {letter: header[letter] for letter in "PKSB"}
    need(all(type(s) is int and s > 0 for s in sizes.values()), "sizes: not positive")
    sizes |= {"N": N, "n": n, "v": N + 1, "c": n + N * (N - 1) // 2, "2": 2}
    sizes |= {"k": 6 if order == 2 else N + 1, "t": 3 if order == 2 else N}
    sizes["L"] = 2 if "goal" in header else 1
    sizes["U"] = sizes["P"] + (order - 1) * sizes["S"]
    rows = [row.split() for row in TABLE.split(", ")]
    rows = [(name, kind, [sizes[s] for s in shape]) for name, kind, shape in rows]
    return sizes, np.dtype(rows)


def opened(words: ndarray, header: dict) -> Body:
    """The arrays of a receipt, and what follows from them."""
    sizes, kind = record_type(header)
    right = words.dtype == np.int64 and words.shape == (kind.itemsize // 8,)
    need(right, "receipt: its arrays have other types or sizes")
    record = words.view(kind)[0]
    arrays = {name: record[name] for name in kind.names}
    r = Body(**sizes, **arrays, degree=header["order"])
    large = np.abs(words.view(float)[: kind.fields["cells"][1] // 8])
    usual = np.count_nonzero(large > SMALLEST) == np.count_nonzero(large)
    usual &= large.max() < 1 / SMALLEST
    need(usual, "numbers: too large or small, or no numbers")
    N, n = r.N, r.n
    r.cuts = r.degree if r.L == 1 else 0  # a goal needs the energy for rounding only
    r.held = r.held != 0
    r.contact = r.contact != 0
    r.bulk = r.lame_lambda + 2 * r.mu / n
    for name in ("mu", "beta", "hardening"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    need((r.bulk > 1e-3 * r.mu).all(), "bulk: too small, or not positive")
    r.entries = np.diag(np.arange(N))  # their places among the components of a tensor
    for c, (i, j) in enumerate(combinations(range(N), 2)):
        r.entries[i, j] = r.entries[j, i] = n + c
    r.between = BETWEEN if r.degree == 2 else np.arange(r.v)[None]  # for gradients
    r.on_side = [[*row, r.v + i][: r.t] for i, row in enumerate(SIDES[N])]
    r.initial = split(r, r.initial[None])[1][0]
    r.back = split(r, r.back[None])[1][0]
    measured(r)
    join(r)
    return r


def measured(r: Body) -> None:
    """Volumes, slopes of barycentric coordinates of K and its parts, outward normals."""
    N = r.N
    need((r.cells >= 0).all() and (r.cells < r.P).all(), "cells: no such point")
    need((np.diff(r.cells, axis=0) > 0).all(), "cells: vertices are not ascending")
    corners = r.points[:, r.cells]
    corners = corners - corners[:, :1]
    away = corners - corners.mean(axis=1, keepdims=True)
    r.length = np.sqrt((away**2).sum(axis=(0, 1)))
    J = corners[:, 1:]
    if N == 2:
        cofactors = np.array([[J[1, 1], -J[1, 0]], [-J[0, 1], J[0, 0]]])
    else:
        cofactors = np.cross(J[:, [1, 2, 0]], J[:, [2, 0, 1]], axis=0)
    det = (J[:, 0] * cofactors[:, 0]).sum(axis=0)
    r.det = np.abs(det)
    need((r.det > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    r.volume = r.det / math.factorial(N)
    r.area = np.concatenate([cofactors.sum(axis=1)[None], -cofactors.swapaxes(0, 1)])
    r.area *= np.sign(det) / (N - 1)
    r.areas = np.sqrt((r.area**2).sum(axis=1))
    r.slopes = -r.area / (N * r.volume)
    r.steep = np.sqrt((r.slopes**2).sum(axis=(0, 1)))
    r.wrong = EPS * (3 * r.length * r.steep) ** (N - 1)
    r.part_area = (r.area[:, :, None] - r.area.swapaxes(0, 1)) / (N + 1)
    r.part_area += np.eye(N + 1)[:, None, :, None] * r.area[:, :, None]


def join(r: Body) -> None:
    """Sides have two places (side of K, K), equal ones on the boundary; coefficients of K."""
    N = r.N
    r.out = np.flatnonzero(r.sides[0] == r.sides[1])
    r.side = np.full(r.areas.size, -1)
    r.side[r.sides] = np.arange(r.S)
    once = r.side.size == 2 * r.S - r.B and len(r.out) == r.B
    need(once and (r.sides >= 0).all() and (r.side >= 0).all(), "sides: not those of K")
    r.side = r.side.reshape(r.areas.shape)
    corners = r.cells[SIDES[N]].swapaxes(0, 1).reshape(N, -1)
    ends = corners[:, r.sides[0]]
    need((ends == corners[:, r.sides[1]]).all(), "sides: two K have different ones")
    number = r.P ** np.arange(N)[::-1] @ ends
    need(r.P**N < 2**63 and (np.diff(number) > 0).all(), "sides: not ascending")
    area = r.area.swapaxes(0, 1).reshape(N, -1)
    opposite = (area[:, r.sides[0]] * area[:, r.sides[1]]).sum(axis=0) < 0
    opposite[r.out] = True
    need(opposite.all(), "cells: two overlap at their side")
    r.ends = ends[:, r.out]
    r.nodes = np.concatenate([r.cells, r.P + r.side][: r.degree])
    r.side_nodes = np.concatenate([r.ends, r.P + r.out[None]][: r.degree])
    place = r.sides[0, r.out]
    r.outer = r.areas.ravel()[place]
    r.normal = area[:, None, place] / r.outer
    r.near = r.wrong[place % r.K]


def displaced(r: Body) -> None:
    """Values of u and z on K and sides, strains, their sizes, and what rounding misses of them."""
    r.local = np.moveaxis(r.u[..., r.nodes], 2, 0)
    r.outside = np.moveaxis(r.u[..., r.side_nodes], 2, 0)
    right = (r.outside == r.prescribed) | ~r.held[:, None]
    need(right.all(), "u: not the prescribed displacement")
    r.room = r.gap - (r.outside * r.normal).sum(axis=1)
    r.unsure_room = r.near * np.sqrt((r.outside**2).sum(axis=1))
    change = r.local - r.local[:1]
    du = r.degree * einsum("kiaLK,ibK->kabLK", change[r.between], r.slopes)
    eps = np.zeros((len(du), r.c, r.L, r.K))
    eps[:, r.entries] = (du + du.swapaxes(1, 2)) / 2
    mean, r.strain = split(r, eps)
    r.trace = r.n * mean
    r.missed = size(change) * r.steep * r.wrong
    r.strained = size(r.strain) + 2 * size(mean) + r.missed


def work(r: Body, g: int, h: int) -> ndarray:
    """What the loads of layer g do with the displacement h by parts, and what rounding changes."""
    force, u = r.body_force[:, g], r.local[:, :, h]
    traction, outside = r.traction[:, :, g], r.outside[:, :, h]
    done = r.volume * (force * u.mean(axis=0)).sum(axis=0)
    pulled = r.outer * inner(traction, outside, r.N - 1)
    unsure = r.volume * r.wrong * size(force[None]) * size(u)
    near = r.outer * r.near * size(traction) * size(outside)
    return np.array([np.concatenate([done, pulled]), np.concatenate([unsure, near])])


def upper_energy(r: Body) -> float:
    """No less than J(u)."""
    e = r.strain[:, :, 0] - r.initial
    trace = r.trace[:, :, 0]
    r.trial = 2 * r.mu * e - r.back
    density = r.bulk / 2 * inner(trace, trace, r.N) + r.mu * inner(e, e, r.N)
    density -= r.mu * (r.initial**2).sum(axis=0)
    plastic = means(r.N, flow, r.trial, r.beta[None], r.cuts)
    density += plastic / (2 * r.mu + r.hardening)
    r.strained[0] += size(r.initial[None]) + size(r.back[None]) / r.mu
    r.stiff = r.n * r.bulk + 2 * r.mu
    density += 10 * r.stiff * r.strained[0] * (r.missed[0] + r.wrong * r.strained[0])
    done, unsure = work(r, 0, 0)
    return summed(r.volume * density, unsure - done)


def balance(r: Body) -> None:
    """Residuals of the stresses, with what rounding adds, and the reactions t."""
    N = r.N
    r.stressed = size(r.stress).max(axis=1)
    large = EPS * 2 * r.stressed * r.length ** (N - 1)
    S = r.stress[:, r.entries]
    T = einsum("kxyLaK,iyaK->ikxLaK", S, r.part_area)  # on side i of part a
    inside = r.degree * sum(T[i, r.between[:, i]] for i in range(N + 1)) / N
    inside -= (r.body_force * r.volume / (N + 1))[:, :, None]
    forced = EPS * size(r.body_force[None]) * r.length**N
    r.inside = size(inside) + (2 * large + forced)[:, None]
    r.jumps = np.zeros((r.L, N + 1, r.K))
    for a, b in combinations(range(N + 1), 2):
        of_b = {a: b, N + 1 + b: N + 1 + a}  # places in part a -> in part b
        other = [of_b.get(i, i) for i in r.on_side[b]]
        jump = T[b, r.on_side[b], :, :, a] + T[a, other, :, :, b]
        r.jumps[:, [a, b]] += (size(jump) + large)[:, None]
    T = np.concatenate([T[a, r.on_side[a], :, :, a] for a in range(N + 1)], axis=-1)
    jump = T.take(r.sides[0], axis=-1) + T.take(r.sides[1], axis=-1)
    pulled = r.traction - r.pressure[:, None] * r.normal
    missing = jump[..., r.out] / 2 - pulled * r.outer
    jump[..., r.out] = np.where(r.held[:, None], 0.0, missing)
    unsure = np.tile(large, N + 1)[:, r.sides].sum(axis=1)
    sizes = size(r.traction) + np.abs(r.pressure).max(axis=0)
    unsure[:, r.out] += r.near * r.outer * sizes
    r.jumps += (size(jump) + unsure)[:, r.side]
    r.force = (r.inside + r.jumps).sum(axis=1)
    r.reaction = np.where(r.held[:, None], missing, 0.0)
    r.unsure = unsure[:, r.out]


def rolled(r: Body, reach: float) -> float:
    """What supports of single components carry at most, all of them, of a unit force."""
    component, row = np.nonzero(r.held)
    m = (r.points - r.points[:, :1])[:, r.ends[:, row]].mean(axis=1) / reach
    e = np.eye(r.N)[:, component]
    turns = [m[i] * e[j] - m[j] * e[i] for i, j in combinations(range(r.N), 2)]
    area = r.outer[row]
    wrenches = np.concatenate([e, turns]) * area
    least = np.linalg.eigvalsh(wrenches @ wrenches.T)[0]
    need(least > 1e-9 * (wrenches**2).sum(), "held: the body can move")
    return 3 * math.sqrt((area**2).sum() / least)


def defects(r: Body) -> list[float]:
    """The numbers b of 5.  As forces ``passed`` grow from K to K, every chain of them ends."""
    N = r.N
    going = np.flatnonzero(r.way >= 0)
    side = r.side[r.way[going], going]
    free = r.out[~r.held.all(axis=0)]
    need(not np.isin(side, free).any(), "way: it ends where the body is free")
    need((np.bincount(side) < 2).all(), "way: two K have the same")
    whole = len(going) == r.K - 1 and not np.isin(side, r.out).any()
    need(whole or len(going) == r.K, "way: the body is in two pieces")
    passed = r.passed[:, r.side]
    force = (1 + EPS) * (r.force + passed.sum(axis=1))
    going_on = r.passed[:, side]
    grows = (2 * going_on >= force[:, going]).all() and (going_on > 0).all()
    need(grows and (r.passed >= 0).all(), "passed: too little")
    reach = float(np.ptp(r.points, axis=1).sum())
    total = np.array([summed(force) for force in r.force])[:, None, None]
    more = rolled(r, reach) * total if whole else 0.0
    lever = 4 * reach * r.length ** (N - 2)
    T = (passed + more) * (1 + lever / r.areas)
    T += N * (force[:, None] + more) * (1 + lever * r.length / (0.9 * r.volume))
    steep = np.sqrt(r.steep**2 + (N + 1) * (r.slopes**2).sum(axis=1))
    C = CONSTANTS[N]
    b = C[0] * math.sqrt(math.factorial(N)) * r.inside + C[1] * (r.jumps + T)
    b *= r.length**2 * steep * np.sqrt((N + 1) / r.det)
    m = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.n * r.bulk)
    return [2 * math.sqrt(summed((b**2).sum(axis=0) / m)) for b in b]


def lower_energy(r: Body) -> float:
    """The lower bound of 2 for the stress of the file as it is."""
    r.m, r.d = split(r, r.stress)
    m, d = r.m[:, :, 0], r.d[:, :, 0]
    r.shifted = d - r.back[:, None]
    total = d + (2 * r.mu * r.initial)[:, None]
    density = inner(m, m, r.N) / (2 * r.bulk) + inner(total, total, r.N) / (4 * r.mu)
    shifted = r.shifted.reshape(r.k, -1, r.v * r.K)
    plastic = means(r.N, conjugate, shifted, np.tile(r.beta, r.v)[None], r.cuts)
    density += plastic.reshape(r.v, -1) / r.hardening
    P, psi = r.pressure[:, None, 0], r.gap[:, None, 0]
    moved = inner(r.reaction[:, :, 0], r.prescribed[:, :, 0], r.N - 1)
    pressed = r.outer * inner(P, psi, r.N - 1)
    r.large = 3 * r.stressed[0] + 2 * r.mu * size(r.initial[None]) + size(r.back[None])
    r.soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    rounding = r.volume * 10 * r.wrong * r.large**2 * r.soft
    doubt = r.unsure[0] * size(r.prescribed[:, :, 0])
    doubt += 10 * r.near * r.outer * size(P) * size(psi)
    inside = density.mean(axis=0) * r.volume
    return -summed(inside, rounding, pressed - moved + doubt)


def need_positive(r: Body, c: ndarray, message: str) -> None:
    """Coefficients of functions that are nonnegative on the sides with an obstacle."""
    c = c[:, r.contact]
    need((c[: r.N] >= 0).all(), message)
    need((c[r.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all(), message)


def energies(r: Body) -> tuple[float, float]:
    """An interval of the least energy; ValueError where the receipt is not admissible."""
    need((r.pressure[:, 0] >= 0).all(), "pressure: negative")
    need((r.pressure[:, 0, ~r.contact] == 0).all(), "pressure: where no obstacle is")
    displaced(r)
    need_positive(r, r.room[:, 0] - r.unsure_room[:, 0], "u: inside the obstacle")
    upper = upper_energy(r)
    balance(r)
    r.b = defects(r)
    of_u = summed(r.force[0] * size(r.local[:, :, 0]))
    found = lower_energy(r) - of_u
    r.root = r.b[0] + math.sqrt(r.b[0] ** 2 + 2 * (upper - found))  # (2 G)^(1/2)
    return found - r.b[0] * r.root, upper


def on_parts(r: Body, c: ndarray) -> ndarray:
    """Fields on K (1 or N + 1, c, K) as fields (1 or k, c, parts of K, K)."""
    if len(c) == 1:
        return c[:, :, None]
    parts = np.repeat(c[:, :, None], r.v, axis=2)
    own = np.arange(r.v)
    parts[own, :, own] = c.mean(axis=0)
    middle = (parts[[1, 0, 0]] + parts[[2, 2, 1]]) / 2
    return np.concatenate([parts, middle])


def need_adjoint(r: Body, L: float) -> None:
    """The conditions of 6 on the obstacle."""
    need(SMALLEST < L < 1 / SMALLEST, "factor: not positive, too large or too small")
    P, q = r.pressure.swapaxes(0, 1)
    small = np.abs(q) <= (1 - EPS) * L * P
    need(small.all(), "pressure: that of the adjoint is too large")
    room, spare = r.room.swapaxes(0, 1)
    unsure, unsure_spare = r.unsure_room.swapaxes(0, 1)
    for sign in (-1.0, 1.0):
        most = (1 - EPS) * L * (room - unsure) + sign * spare - unsure_spare
        need_positive(r, most, "u: the adjoint is wrong at the obstacle")


def suprema(r: Body, L: float) -> ndarray:
    """The integrals over the parts of K in 6, for -Q and Q."""
    fields = r.trial, r.strain[:, :, 1], r.trace[:, :, 1], r.trace[:, :, 0]
    trial, e, trace, own_trace = (on_parts(r, c)[:, :, None] for c in fields)
    signs = np.array([-1.0, 1.0])[:, None, None]
    m = L * (r.m[:, :, :1] - r.bulk * own_trace)
    m = m + signs * (r.m[:, :, 1:] - r.bulk * trace)
    p = (signs * r.d[:, :, 1:] + L * r.shifted[:, :, None]) / (2 * r.mu)
    H = r.hardening / (2 * r.mu)
    k = L / (2 * r.mu)
    y = p + k * trial - signs * e
    x = np.concatenate([y, p + H * y], axis=1).reshape(r.k, -1, 2 * r.v * r.K)
    law = np.tile([k, H, r.beta], 2 * r.v)
    found = means(r.N, goal_supremum, x, law, 1).reshape(2, r.v, -1)
    found += inner(m, m, r.N) / (4 * L * r.bulk) - inner(p, trial, r.N)
    return r.volume / r.v * found


def goal_interval(r: Body, L: float) -> tuple[float, float]:
    """6: what a goal lies between."""
    N = r.N
    need_adjoint(r, L)
    P, q = r.pressure.swapaxes(0, 1)[:, :, None]
    room = r.room[:, :1]
    opened = r.outer * inner(q, room, N - 1)
    opening = r.outer * inner(L * P, room, N - 1)
    far = size(r.gap[:, :1]) + size(r.outside[:, :, 0])
    near = 10 * r.near * r.outer * (size(q) + L * size(P)) * far
    own = r.bulk * inner(r.trace[:, :, 0], r.trace[:, :, 1], N)
    own += (r.back * r.strain[:, :, 1].mean(axis=0)).sum(axis=0)
    done, gained = work(r, 1, 0), work(r, 0, 1)
    centre = np.concatenate([done[0], gained[0], -r.volume * own, opened])
    strained = r.strained[1] + L * r.strained[0]
    large = L * r.large + r.stiff * strained + 3 * r.stressed[1]
    wrong = r.wrong * large + r.stiff * (r.missed[1] + L * r.missed[0])
    slack = WIDE * r.volume * r.soft / L * large * wrong
    doubt = np.array((r.b[1] + L * r.b[0]) * r.root)
    always = [opening, slack, near, done[1], gained[1], doubt]
    lower, upper = suprema(r, L)
    return -summed(-centre, *always, lower), summed(centre, *always, upper)


def proved_intervals(words: ndarray, header: dict) -> dict:
    """What a receipt proves; ValueError where it is not admissible."""
    r = opened(words, header)
    proved = dict(zip(("lower", "upper"), energies(r), strict=True))
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
    text = f"least energy in ({header['lower']}, {header['upper']})"
    if "goal" not in header:
        return text
    name = header["goal"]
    need(type(name) is str and name.isprintable(), "goal: no name")
    return f"{text}, {name} in ({header['goal lower']}, {header['goal upper']})"


def check_files(paths: list[str]) -> int:
    """Check files; the status is 0 if all of them show what they claim."""
    status = 0
    for path in paths:
        try:
            text = f"PASS: {check(path)}"
        except Exception as error:  # whatever is wrong with a file, it does not pass
            known = isinstance(error, ValueError)
            text = f"FAIL: {error if known else repr(error)}"
            status = 1
        sys.stdout.write(f"{path}: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(check_files(sys.argv[1:]))
