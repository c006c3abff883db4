"""Check a receipt: the least energy of a body lies in an interval.  numpy alone.

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
   with parts y > 0 along a direction, z across it:  y + |z|^2/(2 |x|) <= |x| <= y + |z|^2/(2 y).
4. Rounding.  A number of one K is wrong by at most EPS times the sizes of its terms and the
   condition of K: it takes less than 64 operations, and so do the numbers that ``summed`` adds.
5. S misses equilibrium by residuals r in the parts and j on their sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Affine tractions T
   pass on the forces and torques of r, j: from part to part, and from K by its side ``way``, at
   most ``passed``, until a support is reached.  What is left on a part does no work on rigid
   motions, and is at most  b |eps(w)|,  b = |x|^2 |J^-1| (C_1 |r| + C_2 sum |j, T|/(det J)^(1/2)),
   with edges J, distances x from the centre, constants of a reference simplex, and forces j, T.
   J is m-convex, m = min(2 mu h/(2 mu + h), n B):  with G = J(u) - J(v) and the root b of all
   b^2/m  the last term is at most  b (2 G)^(1/2).
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
FORMAT = "ngepc receipt 4"
TABLE = (  # names, types, shapes: K cells of v vertices, P points, S sides, B of the boundary
    "points f8 NP, u f8 NU, stress f8 kcvK, lame_lambda f8 K, mu f8 K, hardening f8 K, "
    "beta f8 K, initial f8 cK, back f8 cK, body_force f8 NK, passed f8 S, "
    "prescribed f8 tNB, traction f8 tNB, gap f8 tB, pressure f8 tB, "
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
    x = np.concatenate(parts)
    x = np.append(x, np.zeros(-x.size % 32)).reshape(32, -1)
    return math.fsum(x.sum(axis=0).tolist()) + EPS * float(np.abs(x).sum())


def size(a: ndarray) -> ndarray:
    """The largest norm of the coefficients of fields (k, c, ...)."""
    return np.sqrt((a**2).sum(axis=1).max(axis=0))


def inner(a: ndarray, b: ndarray, N: int) -> ndarray:
    """Means of the products of two fields with coefficients (k, c, K)."""
    if len(a) > N + 1:
        return einsum("kcK,kcK->K", einsum("kj,jcK->kcK", QUADRATIC[N], a), b)
    a = (a + a.sum(axis=0)) / (len(a) * (len(a) + 1))
    return einsum("kcK,kcK->K", a, b)


def split(r: Body, S: ndarray) -> tuple[ndarray, ndarray]:
    """Mean (k, 1, K) and deviator of tensors, in coordinates with the same products."""
    mean = S[:, : r.n].sum(axis=1, keepdims=True) / r.n
    diagonal = einsum("dc,kcK->kdK", DEVIATORS[: r.n - 1, : r.n], S[:, : r.n])
    return mean, np.concatenate([diagonal, math.sqrt(2) * S[:, r.n :]], axis=1)


def subdivided(N: int, s: ndarray) -> ndarray:
    """Coefficients (k, c, 2^N K) on the parts of simplices."""
    T = np.eye(N + 1)[[CHILDREN[N] // 10, CHILDREN[N] % 10]].mean(axis=0)
    if len(s) > N + 1:
        T = einsum("pia,pjb,abk->pijk", T, T, np.eye(6)[BETWEEN])
        T = T[:, [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
    return einsum("pij,jcK->icpK", T, s).reshape(*s.shape[:2], -1)


def plastic_terms(N: int, s: ndarray, beta: ndarray, p: bool, cuts: int) -> ndarray:
    """Means of ``flow`` on K, which are cut where |s| - beta varies much, so often at most."""
    length = np.sqrt(einsum("kcK,kcK->kK", s, s))
    most = length.max(axis=0) - beta
    small = (2 * (length.min(axis=0) - beta) <= most) & (cuts > 0)
    found = np.zeros(beta.shape)
    on = np.flatnonzero((most > 0) & ~small)
    found[on] = flow(N, s.take(on, axis=2), length.take(on, axis=1), beta[on], p)
    on = np.flatnonzero((most > 0) & small)
    if len(on):
        parts = subdivided(N, s.take(on, axis=2))
        parts = plastic_terms(N, parts, np.tile(beta[on], 2**N), p, cuts - 1)
        found[on] = parts.reshape(2**N, -1).mean(axis=0)
    return found


def flow(N: int, s: ndarray, length: ndarray, beta: ndarray, p: bool) -> ndarray:
    """Plastic terms of phi (``p``) times 2 mu + h, or of phi* times h, by 3.

    With x = s outside the ball |s| <= beta they are beta |x| - s : x + |x|^2/2, or |x|^2/2: the
    first is no less than that of the best x, the second no less than [|s| - beta]_+^2/2.  Also
    (|s| - beta)^2 = |s|^2 - 2 beta |s| + beta^2.
    """
    over = np.maximum(length - beta, 0.0)
    x = s * (over / np.maximum(length, beta))[:, None]
    field = x if p else s
    n = field.mean(axis=0)
    n /= np.maximum(np.sqrt((n**2).sum(axis=0)), 1e-300)
    y = einsum("kcK,cK->kK", field, n)[:, None]
    least = y.min(axis=(0, 1)) if p else length.max(axis=0)
    clear = least > length.max(axis=0) / 8
    square = inner(field, field, N)
    norm = (square - inner(y, y, N)) / (2 * np.where(clear, least, 1.0))
    norm += y.mean(axis=(0, 1))
    if p:
        norm = np.minimum(np.where(clear, norm, np.inf), over.mean(axis=0))
        return beta * norm + inner(x, x / 2 - s, N)
    return np.minimum(square - 2 * beta * norm + beta**2, inner(x, x, N)) / 2


def unpacked(record: ndarray, table: str, sizes: dict) -> dict:
    """The arrays of a record; numbers are zero or of sizes that neither over- nor underflow."""
    rows = [row.split() for row in table.split(", ")]
    rows = [(name, kind, [sizes[s] for s in letters]) for name, kind, letters in rows]
    need((record.dtype, record.shape) == (np.dtype(rows), ()), "arrays: wrong types")
    arrays = {name: record[name] for name in record.dtype.names}
    for name, values in arrays.items():
        large = np.abs(values)
        usual = (large == 0) | ((large > SMALLEST) & (large < 1 / SMALLEST))
        need(usual.all(), f"{name}: too large or too small, or no number")
    return arrays


def opened(file: dict, header: dict) -> Body:
    """The arrays of a receipt, and what follows from them."""
    need(header["format"] == FORMAT, f"format: {FORMAT!r} is needed")
    record = file["receipt"]
    N, n = LAWS[header["kinematics"]]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    sizes = {"N": N, "n": n, "2": 2, "v": N + 1, "c": n + N * (N - 1) // 2}
    sizes |= {"k": 6 if order == 2 else N + 1, "t": 3 if order == 2 else N}
    for letter, name in zip("PKSB", ("points", "mu", "sides", "gap"), strict=True):
        sizes[letter] = record[name].shape[-1]
    sizes["U"] = sizes["P"] + (order - 1) * sizes["S"]
    need(all(sizes.values()), "sizes: not positive")
    r = Body(**sizes, **unpacked(record, TABLE, sizes), degree=order)
    r.held = r.held != 0
    r.contact = r.contact != 0
    r.bulk = r.lame_lambda + 2 * r.mu / r.n
    for name in ("mu", "beta", "hardening"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    need((r.bulk > 1e-3 * r.mu).all(), "bulk: too small, or not positive")
    r.entries = np.diag(np.arange(N))  # their places among the components of a tensor
    for c, (i, j) in enumerate(combinations(range(N), 2)):
        r.entries[i, j] = r.entries[j, i] = n + c
    r.between = BETWEEN if order == 2 else np.arange(r.v)[None]  # for gradients
    r.on_side = [[*row, r.v + i][: r.t] for i, row in enumerate(SIDES[r.N])]
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
    away = corners - corners.mean(axis=1, keepdims=True)
    r.length = np.sqrt((away**2).sum(axis=(0, 1)))
    J = corners[:, 1:] - corners[:, :1]
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
    r.ends = ends[:, r.out]
    r.nodes = np.concatenate([r.cells, r.P + r.side][: r.degree])
    r.side_nodes = np.concatenate([r.ends, r.P + r.out[None]][: r.degree])
    place = r.sides[0, r.out]
    r.outer = r.areas.ravel()[place]
    r.normal = r.area.swapaxes(0, 1).reshape(N, -1)[:, place] / r.outer
    r.near = r.wrong[place % r.K]


def room(r: Body, u: ndarray, motion: ndarray, gap: ndarray) -> ndarray:
    """gap - u . n, with what rounding may change, of a displacement with the right supports."""
    u = u[:, r.side_nodes].swapaxes(0, 1)
    need(((u == motion) | ~r.held).all(), "u, z: not the prescribed displacement")
    return gap - (u * r.normal).sum(axis=1) - r.near * np.sqrt((u**2).sum(axis=1))


def need_positive(r: Body, c: ndarray, message: str) -> None:
    """Coefficients of functions that are nonnegative on the sides with an obstacle."""
    c = c[:, r.contact]
    need((c[: r.N] >= 0).all(), message)
    need((c[r.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all(), message)


def strains(r: Body, u: ndarray) -> tuple[ndarray, ...]:
    """Trace and deviator of eps(u), no less than its size, and what rounding misses of it."""
    change = (u[:, r.nodes] - u[:, r.nodes[:1]]).swapaxes(0, 1)
    du = r.degree * einsum("kiaK,ibK->kabK", change[r.between], r.slopes)
    eps = np.zeros((len(du), r.c, r.K))
    eps[:, r.entries] = (du + du.swapaxes(1, 2)) / 2
    missed = size(change) * r.steep * r.wrong
    mean, e = split(r, eps)
    return r.n * mean, e, size(e) + 2 * size(mean) + missed, missed


def work(r: Body, force: ndarray, traction: ndarray, u: ndarray) -> ndarray:
    """int force . u + boundary int traction . u by parts, and what rounding may change."""
    local = u[:, r.nodes].swapaxes(0, 1)
    outside = u[:, r.side_nodes].swapaxes(0, 1)
    done = r.volume * (force * local.mean(axis=0)).sum(axis=0)
    pulled = r.outer * inner(traction, outside, r.N - 1)
    unsure = r.volume * r.wrong * size(force[None]) * size(local)
    near = r.outer * r.near * size(traction) * size(outside)
    return np.array([np.concatenate([done, pulled]), np.concatenate([unsure, near])])


def upper_energy(r: Body) -> float:
    """No less than J(u)."""
    r.trace, e, r.strain, r.missed = strains(r, r.u)
    e = e - r.initial
    r.trial = 2 * r.mu * e - r.back
    density = r.bulk / 2 * inner(r.trace, r.trace, r.N) + r.mu * inner(e, e, r.N)
    density -= r.mu * (r.initial**2).sum(axis=0)
    plastic = plastic_terms(r.N, r.trial, r.beta, p=True, cuts=r.degree)
    density += plastic / (2 * r.mu + r.hardening)
    r.strain = r.strain + size(r.initial[None]) + size(r.back[None]) / r.mu
    r.stiff = r.n * r.bulk + 2 * r.mu
    density += 10 * r.stiff * r.strain * (r.missed + r.wrong * r.strain)
    done, unsure = work(r, r.body_force, r.traction, r.u)
    return summed(r.volume * density, unsure - done)


def balance(r: Body, S: ndarray, force: ndarray, traction: ndarray, P: ndarray) -> Body:
    """Residuals of a stress, with what rounding adds, and the reactions t."""
    N = r.N
    largest = size(S).max(axis=0)
    large = EPS * 2 * largest * r.length ** (N - 1)
    T = einsum("kxbaK,ibaK->ikxaK", S[:, r.entries], r.part_area)  # of part a, side i
    rest = r.degree * sum(T[i, r.between[:, i]] for i in range(N + 1)) / N
    inside = size(rest - (force * r.volume / (N + 1))[:, None])
    inside += 2 * large + EPS * size(force[None]) * r.length**N
    jumps = np.zeros((N + 1, r.K))
    for a, b in combinations(range(N + 1), 2):
        of_b = {a: b, N + 1 + b: N + 1 + a}  # places in part a -> in part b
        other = [of_b.get(i, i) for i in r.on_side[b]]
        jump = T[b, r.on_side[b], :, a] + T[a, other, :, b]
        jumps[[a, b]] += size(jump) + large
    T = np.concatenate([T[a, r.on_side[a], :, a] for a in range(N + 1)], axis=2)
    jump = T.take(r.sides[0], axis=2) + T.take(r.sides[1], axis=2)
    missing = jump[..., r.out] / 2 - (traction - P[:, None] * r.normal) * r.outer
    jump[..., r.out] = np.where(r.held, 0.0, missing)
    unsure = np.tile(large, N + 1)[r.sides].sum(axis=0)
    unsure[r.out] += r.near * r.outer * (size(traction) + np.abs(P).max(axis=0))
    jumps += (size(jump) + unsure)[r.side]
    found = Body(size=largest, inside=inside, jumps=jumps, unsure=unsure[r.out])
    found.force = (inside + jumps).sum(axis=0)
    found.reaction = np.where(r.held, missing, 0.0)
    return found


def rolled(r: Body, force: float, reach: float) -> float:
    """What supports of single components carry, all of them, of forces with a sum of sizes."""
    component, row = np.nonzero(r.held)
    m = (r.points[:, r.ends[:, row]].mean(axis=1) - r.points[:, :1]) / reach
    e = np.eye(r.N)[:, component]
    turns = [m[i] * e[j] - m[j] * e[i] for i, j in combinations(range(r.N), 2)]
    area = r.outer[row]
    wrenches = np.concatenate([e, turns]) * area
    least = np.linalg.eigvalsh(wrenches @ wrenches.T)[0]
    need(least > 1e-9 * (wrenches**2).sum(), "held: the body can move")
    return 3 * force * math.sqrt((area**2).sum() / least)


def defect(r: Body, rest: Body, passed: ndarray) -> float:
    """The number b of 5.  As forces ``passed`` grow from K to K, every chain of them ends."""
    N = r.N
    going = np.flatnonzero(r.way >= 0)
    side = r.side[r.way[going], going]
    free = r.out[~r.held.all(axis=0)]
    need(not np.isin(side, free).any(), "way: it ends where the body is free")
    need((np.bincount(side) < 2).all(), "way: two K have the same")
    whole = len(going) == r.K - 1 and not np.isin(side, r.out).any()
    need(whole or len(going) == r.K, "way: the body is in two pieces")
    force = (1 + EPS) * (rest.force + passed[r.side].sum(axis=0))
    grows = (2 * passed[side] >= force[going]).all() and (passed[side] > 0).all()
    need(grows and (passed >= 0).all(), "passed: too little")
    reach = float(np.ptp(r.points, axis=1).sum())
    more = rolled(r, summed(rest.force), reach) if whole else 0.0
    lever = 4 * reach * r.length ** (N - 2)
    T = (passed[r.side] + more) * (1 + lever / r.areas)
    T += N * (force + more) * (1 + lever * r.length / (0.9 * r.volume))
    steep = np.sqrt(r.steep**2 + (N + 1) * (r.slopes**2).sum(axis=1))
    C = CONSTANTS[N]
    b = C[0] * math.sqrt(math.factorial(N)) * rest.inside + C[1] * (rest.jumps + T)
    b *= r.length**2 * steep * np.sqrt((N + 1) / r.det)
    m = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.n * r.bulk)
    return 2 * math.sqrt(summed((b**2).sum(axis=0) / m))


def lower_energy(r: Body, rest: Body) -> float:
    """The lower bound of 2 for the stress of the file as it is, where K are its parts."""
    law = [2 * r.bulk, 4 * r.mu, r.hardening, r.beta]
    twice_bulk, four_mu, h, beta = np.tile(law, r.v)
    r.m, d = split(r, r.stress.reshape(r.k, r.c, -1))
    r.shifted = d - np.tile(r.back, r.v)
    total = r.shifted + np.tile(r.back + 2 * r.mu * r.initial, r.v)
    density = inner(r.m, r.m, r.N) / twice_bulk + inner(total, total, r.N) / four_mu
    density += plastic_terms(r.N, r.shifted, beta, p=False, cuts=r.degree) / h
    pressed = inner(r.pressure[:, None], r.gap[:, None], r.N - 1) * r.outer
    moved = inner(rest.reaction, r.prescribed, r.N - 1)
    r.large = 3 * rest.size + 2 * r.mu * size(r.initial[None]) + size(r.back[None])
    r.soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    rounding = r.volume * 10 * r.wrong * r.large**2 * r.soft
    large = r.outer * size(r.pressure[:, None]) * size(r.gap[:, None])
    doubt = rest.unsure * size(r.prescribed) + 10 * r.near * large
    inside = density.reshape(-1, r.K).mean(axis=0) * r.volume
    return -summed(inside, rounding, pressed - moved + doubt)


def energies(r: Body) -> tuple[float, float]:
    """An interval of the least energy; ValueError where the receipt is not admissible."""
    need((r.pressure >= 0).all(), "pressure: negative")
    need((r.pressure[:, ~r.contact] == 0).all(), "pressure: where no obstacle is")
    r.room = room(r, r.u, r.prescribed, r.gap)
    need_positive(r, r.room, "u: inside the obstacle")
    upper = upper_energy(r)
    rest = balance(r, r.stress, r.body_force, r.traction, r.pressure)
    of_u = summed(rest.force * size(r.u[:, r.nodes].swapaxes(0, 1)))
    found = lower_energy(r, rest) - of_u
    r.b = defect(r, rest, r.passed)
    r.root = r.b + math.sqrt(r.b**2 + 2 * (upper - found))  # (2 G)^(1/2)
    return found - r.b * r.root, upper


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        lower, upper = energies(opened(file, header))
    claim = header["lower"], header["upper"]
    right = claim[0] <= lower and upper <= claim[1]
    need(right, f"least energy: {claim} claimed, {(lower, upper)} proved")
    return f"least energy in {claim}"


if __name__ == "__main__":
    for path in sys.argv[1:]:
        sys.stdout.write(f"{path}: {check(path)}\n")
