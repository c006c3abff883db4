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
3. Fields have Bernstein coefficients, those of the vertices, then of the edges opposite to them.
   A convex function of a field has at most the mean of its values at the coefficients.  A vector
   with parts y > 0 along a direction, z across it:  y + |z|^2/(2 |x|) <= |x| <= y + |z|^2/(2 y).
4. Rounding.  A number of one K is wrong by at most EPS times the sizes of its terms and the
   condition of K: it takes less than 64 operations.  Sums over K are ``math.fsum``.
5. S misses equilibrium by residuals r in K and j on its sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Affine tractions T
   pass on the forces and torques of r, j: from K by the side ``way``, at most ``carried``, until a
   support is reached.  What is left on K does no work on rigid motions, and is at most
   b_K |eps(w)|, b_K = |J|^2 |J^-1| (C_1 |r| + C_2 sum (|E|/det J)^(1/2) |j, T|)  with the edges J
   of K and constants of a reference K.  J is m-convex, m = min(2 mu h/(2 mu + h), n B):  with
   G = J(u) - J(v), b^2 = sum b_K^2/m  the last term is at most b (2 G)^(1/2).
"""

import json
import math
import sys
from collections.abc import Callable, Mapping
from itertools import combinations
from types import SimpleNamespace as Body

import numpy as np
from numpy import einsum, ndarray

EPS = 64 * 2.0**-52
SMALLEST = 1e-30  # number besides zero
FORMAT = "ngepc receipt 3"
NUMBERS = (  # the last letter is the fastest: K cells, P points, B sides of the boundary
    "points NP, u NU, stress kcK, lame_lambda K, mu K, hardening K, beta K, initial cK, back cK, "
    "body_force NK, carried K, prescribed tNB, traction tNB, gap tB, pressure tB"
)
INDICES = "cells vK, sides 2S, way K, held NB, contact B"
LAWS = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}  # N, n
CONSTANTS = {2: (1.1, 4.0), 3: (3.0, 16.0)}  # C_1, C_2
DEVIATORS = np.array([[1, -1, 0], [1, 1, -2]]) / np.sqrt([[2], [6]])
SIDES = {2: [[1, 2], [0, 2], [0, 1]], 3: [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]}
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
QUADRATIC = {  # means of the products of quadratic Bernstein polynomials
    1: np.array([[6, 1, 3], [1, 6, 3], [3, 3, 4]]) / 30,
    2: np.array([[6, 1, 1, 1, 3, 3], [1, 6, 1, 3, 1, 3], [1, 1, 6, 3, 3, 1],
                 [1, 3, 3, 4, 2, 2], [3, 1, 3, 2, 4, 2], [3, 3, 1, 2, 2, 4]]) / 90,
}  # fmt: skip


PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # and back
CHILDREN = {  # parts of K by Bey; 21 is the mean of vertices 2 and 1
    2: np.array([[0, 10, 20], [11, 21, 10], [22, 20, 21], [21, 20, 10]]),
    3: np.array([[0, 10, 20, 30], [10, 11, 21, 31], [20, 21, 22, 32], [30, 31, 32, 33],
                 [10, 20, 30, 31], [10, 20, 21, 31], [20, 30, 31, 32], [20, 21, 31, 32]]),
}  # fmt: skip


def need(condition: object, message: str) -> None:
    """Refuse the receipt unless a condition holds."""
    if not condition:
        raise ValueError(message)


def unpacked(values: ndarray, table: str, sizes: dict) -> dict[str, ndarray]:
    """Arrays with names and shapes of a table, one after the other in ``values``."""
    shapes = [[sizes[letter] for letter in row.split()[1]] for row in table.split(", ")]
    stops = np.cumsum([math.prod(shape) for shape in shapes])
    need(values.shape == (stops[-1],), "numbers: more or less than the sizes say")
    parts = np.split(values, stops[:-1])
    names = [row.split()[0] for row in table.split(", ")]
    return {n: v.reshape(s) for n, v, s in zip(names, parts, shapes, strict=True)}


def summed(*parts: ndarray) -> float:
    """The sum of all numbers, correctly rounded."""
    return math.fsum(np.concatenate(parts).tolist())


def size(a: ndarray) -> ndarray:
    """The largest norm of coefficients (k, c, K) on each K."""
    return np.sqrt(einsum("kcK,kcK->kK", a, a).max(axis=0))


def inner(a: ndarray, b: ndarray, N: int) -> ndarray:
    """Means of the products of two fields with coefficients (k, c, K)."""
    if len(a) > N + 1:
        return einsum("kcK,kcK->K", einsum("kj,jcK->kcK", QUADRATIC[N], a), b)
    a = (a + a.sum(axis=0)) / (len(a) * (len(a) + 1))
    return einsum("kcK,kcK->K", a, b)


def slopes_of(c: ndarray, slopes: ndarray) -> ndarray:
    """Coefficients (k, ..., N, K) of the gradients of fields (k, ..., K)."""
    vertices = len(slopes)
    table = BETWEEN if len(c) > vertices else np.arange(vertices)[None]
    parts = [c[table[:, i], ..., None, :] * slopes[i] for i in range(vertices)]
    return sum(parts) * (2 if len(c) > vertices else 1)


def split(r: Body, S: ndarray) -> tuple[ndarray, ndarray]:
    """Mean (k, 1, K) and deviator of tensors, in coordinates with the same products."""
    mean = S[:, : r.n].sum(axis=1, keepdims=True) / r.n
    diagonal = einsum("dc,kcK->kdK", DEVIATORS[: r.n - 1, : r.n], S[:, : r.n])
    return mean, np.concatenate([diagonal, math.sqrt(2) * S[:, r.n :]], axis=1)


def parted(N: int, x: ndarray, law: ndarray) -> tuple[ndarray, ndarray]:
    """Coefficients on the parts of K; ``law`` ends with the volume."""
    table = np.eye(N + 1)[[CHILDREN[N] // 10, CHILDREN[N] % 10]].mean(axis=0)
    if len(x) > N + 1:
        table = einsum("pia,pjb,abk->pijk", table, table, np.eye(6)[BETWEEN])
        table = table[:, PAIRS[:, 0], PAIRS[:, 1]]
    x = einsum("pij,jcK->icpK", table, x).reshape(*x.shape[:2], -1)
    law = np.tile(law, len(table))
    law[-1] /= len(table)
    return x, law


def above(r: Body, density: Callable, x: ndarray, law: ndarray) -> ndarray:
    """Integrals of a function from above; the file says which K, and which parts, are cut."""
    found = []
    while x.shape[2]:
        on = r.cut[: x.shape[2]]
        need(on.shape == (x.shape[2],), "cut: too short")
        r.cut = r.cut[x.shape[2] :]
        found.append(law[-1, ~on] * density(r.N, x[..., ~on], law[:, ~on]))
        x, law = parted(r.N, x[..., on], law[:, on])
    return np.concatenate(found)


def flow(N: int, s: ndarray, law: ndarray, p: bool = True) -> ndarray:
    """Plastic terms of phi (``p``) times 2 mu + h, or of phi* times h, by 3.

    With x = s outside the ball |s| <= beta they are beta |x| - s : x + |x|^2/2, or |x|^2/2: the
    first is no less than that of the best x, the second no less than [|s| - beta]_+^2/2.  Also
    (|s| - beta)^2 = |s|^2 - 2 beta |s| + beta^2.
    """
    beta = law[0]
    length = np.sqrt(einsum("kcK,kcK->kK", s, s))
    over = np.maximum(length - beta, 0.0)
    x = s * (over / np.maximum(length, beta))[:, None]
    field = x if p else s
    n = field.mean(axis=0)
    n /= np.maximum(np.sqrt((n**2).sum(axis=0)), 1e-300)
    y = einsum("kcK,cK->kK", field, n)[:, None]
    least = y.min(axis=(0, 1)) if p else length.max(axis=0)
    clear = least > length.max(axis=0) / 8
    square = inner(field, field, N)
    across = (square - inner(y, y, N)) / (2 * np.where(clear, least, 1.0))
    norm = y.mean(axis=(0, 1)) + across
    if p:
        norm = np.minimum(np.where(clear, norm, np.inf), over.mean(axis=0))
        return beta * norm + inner(x, x / 2 - s, N)
    return np.minimum(square - 2 * beta * norm + beta**2, inner(x, x, N)) / 2


def need_numbers(name: str, values: ndarray) -> None:
    """Numbers of 64 bits, zero or of sizes whose products neither overflow nor underflow."""
    need(values.dtype == float and np.isfinite(values).all(), f"{name}: not finite")
    sizes = np.abs(values[values != 0])
    usual = ((sizes > SMALLEST) & (sizes < 1 / SMALLEST)).all()
    need(usual, f"{name}: too large or too small")


def sizes_of(header: dict) -> dict[str, int]:
    """What the letters of the tables say."""
    need(header["format"] == FORMAT, f"format: {FORMAT!r} is needed")
    N, n = LAWS[header["kinematics"]]
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    sizes = {letter: header["sizes"][letter] for letter in "PKSB"}
    need(all(type(v) is int and v > 0 for v in sizes.values()), "sizes: not positive")
    sizes |= {"N": N, "2": 2, "v": N + 1, "c": n + N * (N - 1) // 2}
    sizes |= {"k": 6 if order == 2 else N + 1, "t": 3 if order == 2 else N}
    sizes["U"] = sizes["P"] + (order - 1) * sizes["S"]
    return sizes | {"n": n}


def opened(file: Mapping[str, ndarray], header: dict) -> Body:
    """The arrays of a receipt with types and shapes of the tables, and what follows from them."""
    sizes = sizes_of(header)
    numbers, indices, cut = file["numbers"], file["indices"], file["cut"]
    need(cut.dtype == bool, "cut: of a wrong type")
    need_numbers("numbers", numbers)
    need(indices.dtype == int and (indices >= -1).all(), "indices: of a wrong type")
    arrays = unpacked(numbers, NUMBERS, sizes) | unpacked(indices, INDICES, sizes)
    r = Body(**arrays, **sizes, cut=cut)
    r.held, r.contact = r.held != 0, r.contact != 0
    r.bulk = r.lame_lambda + 2 * r.mu / r.n
    for name in ("mu", "beta", "hardening"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    need((r.bulk > 1e-3 * r.mu).all(), "bulk: too small, or not positive")
    r.voigt = np.diag(np.arange(r.N))
    for c, (i, j) in enumerate(combinations(range(r.N), 2)):
        r.voigt[i, j] = r.voigt[j, i] = r.n + c
    r.initial = split(r, r.initial[None])[1][0]
    r.back = split(r, r.back[None])[1][0]
    measured(r)
    join(r)
    return r


def measured(r: Body) -> None:
    """Volumes, slopes of barycentric coordinates, and areas with outward normals."""
    N = r.N
    need((r.cells[0] >= 0).all() and (r.cells < r.P).all(), "cells: no such point")
    need((np.diff(r.cells, axis=0) > 0).all(), "cells: vertices are not ascending")
    corners = r.points[:, r.cells]
    J = corners[:, 1:] - corners[:, :1]
    r.length = np.sqrt((J**2).sum(axis=(0, 1)))
    if N == 2:
        cofactors = np.array([[J[1, 1], -J[1, 0]], [-J[0, 1], J[0, 0]]])
    else:
        cofactors = np.cross(J[:, [1, 2, 0]], J[:, [2, 0, 1]], axis=0)
    det = (J[:, 0] * cofactors[:, 0]).sum(axis=0)
    r.det = np.abs(det)
    need((r.det > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    inverse = (cofactors / det).swapaxes(0, 1)
    r.steep = np.sqrt((inverse**2).sum(axis=(0, 1)))
    r.wrong = EPS * (r.length * r.steep) ** (N - 1)
    r.slopes = np.concatenate([-inverse.sum(axis=0, keepdims=True), inverse])
    r.volume = r.det / math.factorial(N)
    r.area = -N * r.volume * r.slopes
    r.areas = np.sqrt((r.area**2).sum(axis=1))


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
    quadratic = r.U > r.P
    r.nodes = np.concatenate([r.cells, r.P + r.side][: 1 + quadratic])
    r.side_nodes = np.concatenate([r.ends, r.P + r.out[None]][: 1 + quadratic])
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
    least = -(1 - EPS) * np.sqrt(c[0] * c[1])
    need((c[r.N :] >= least).all(), message)


def strains(r: Body, u: ndarray) -> tuple[ndarray, ...]:
    """Trace and deviator of eps(u), no less than its size, and what rounding misses of it."""
    change = u[:, r.nodes].swapaxes(0, 1)
    change = change - change[:1]
    du = slopes_of(change, r.slopes)
    eps = np.zeros((len(du), r.c, r.K))
    for i, j in np.ndindex(r.N, r.N):
        eps[:, r.voigt[i, j]] += du[:, i, j] / (1 if i == j else 2)
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


def upper_energy(r: Body, above: Callable) -> float:
    """No less than J(u)."""
    r.trace, e, r.strain, r.missed = strains(r, r.u)
    e = e - r.initial
    r.trial = 2 * r.mu * e - r.back
    density = r.bulk / 2 * inner(r.trace, r.trace, r.N) + r.mu * inner(e, e, r.N)
    density -= r.mu * (r.initial**2).sum(axis=0)
    law = np.array([r.beta, r.volume / (2 * r.mu + r.hardening)])
    flows = above(r, flow, r.trial, law)
    r.strain = r.strain + size(r.initial[None]) + size(r.back[None]) / r.mu
    r.stiff = r.n * r.bulk + 2 * r.mu
    density += 10 * r.stiff * r.strain * (r.missed + r.wrong * r.strain)
    done, unsure = work(r, r.body_force, r.traction, r.u)
    return summed(r.volume * density, flows, unsure - done)


def balance(r: Body, S: ndarray, force: ndarray, traction: ndarray, P: ndarray) -> Body:
    """Residuals of a stress, with what rounding adds, and the reactions t."""
    N = r.N
    full = S[:, r.voigt]
    rest = einsum("kabbK->kaK", slopes_of(full, r.slopes)) + force
    large = 2 * size(S)
    inside = size(rest) + r.wrong * (3 * large * r.steep + size(force[None]))
    edges = np.arange(N + 1, len(S)).reshape(-1, N + 1)
    places = np.concatenate([np.transpose(SIDES[N]), edges])
    T = sum(full[places, :, b].swapaxes(1, 2) * r.area[:, b] for b in range(N))
    T = T.reshape(len(places), N, -1)
    jump = T[..., r.sides[0]] + T[..., r.sides[1]]
    missing = jump[..., r.out] / 2 - (traction - P[:, None] * r.normal) * r.outer
    jump[..., r.out] = np.where(r.held, 0.0, missing)
    unsure = (r.wrong * large * r.areas).ravel()[r.sides].sum(axis=0)
    unsure[r.out] += r.near * r.outer * (size(traction) + np.abs(P).max(axis=0))
    outward = (size(jump) + unsure)[r.side]
    found = Body(inside=inside, outward=outward, unsure=unsure[r.out])
    found.force = inside * r.volume + outward.sum(axis=0)
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


def defect(r: Body, rest: Body, carried: ndarray) -> float:
    """The number b of 5.  As ``carried`` grows from K to K, every chain of them ends."""
    reach = float(np.ptp(r.points, axis=1).sum())
    going = np.flatnonzero(r.way >= 0)
    need((r.way <= r.N).all() and len(going) >= r.K - 1, "way: a part is not held")
    place = r.way[going] * r.K + going
    side = r.side.ravel()[place]
    beyond = r.sides[:, side].sum(axis=0) - place
    last = beyond == place
    free = r.out[~r.held.all(axis=0)]
    need(not np.isin(side[last], free).any(), "way: it ends where the body is free")
    need(len(going) == r.K or not last.any(), "way: the body is in two pieces")
    gets = np.bincount(beyond[~last] % r.K, carried[going[~last]], r.K)
    least = np.maximum((rest.force + gets) * (1 + EPS), 0.0)
    need((carried >= least).all(), "carried: too little")
    passed = np.zeros(r.S)
    passed[side] = carried[going]
    if len(going) < r.K:
        passed += rolled(r, summed(rest.force), reach)
    lever = 1 + 4 * reach * r.length ** (r.N - 2) / r.areas
    pulled = (rest.outward + passed[r.side] * lever) / np.sqrt(r.areas)
    first, second = CONSTANTS[r.N]
    b = second * (np.sqrt(r.areas / r.det) * pulled).sum(axis=0)
    b = r.length**2 * r.steep * (b + first * rest.inside * np.sqrt(r.volume))
    m = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.n * r.bulk)
    return 2 * math.sqrt(summed(b**2 / m))


def lower_energy(r: Body, rest: Body, above: Callable) -> float:
    """The lower bound of 2 for the stress of the file as it is."""
    r.m, d = split(r, r.stress)
    r.shifted = d - r.back
    total = d + 2 * r.mu * r.initial
    density = inner(r.m, r.m, r.N) / (2 * r.bulk) + inner(total, total, r.N) / (
        4 * r.mu
    )
    law = np.array([r.beta, r.volume / r.hardening])
    flows = above(r, lambda *at: flow(*at, p=False), r.shifted, law)
    pressed = inner(r.pressure[:, None], r.gap[:, None], r.N - 1) * r.outer
    moved = inner(rest.reaction, r.prescribed, r.N - 1)
    r.large = 3 * size(r.stress) + 2 * r.mu * size(r.initial[None]) + size(r.back[None])
    r.soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    density += 10 * r.wrong * r.large**2 * r.soft
    large = r.outer * size(r.pressure[:, None]) * size(r.gap[:, None])
    doubt = rest.unsure * size(r.prescribed) + 10 * r.near * large
    return -summed(r.volume * density, flows, pressed - moved + doubt)


def energies(r: Body, above: Callable = above) -> tuple[float, float]:
    """An interval of the least energy; ValueError where the receipt is not admissible."""
    need((r.pressure >= 0).all(), "pressure: negative")
    need((r.pressure[:, ~r.contact] == 0).all(), "pressure: where no obstacle is")
    r.room = room(r, r.u, r.prescribed, r.gap)
    need_positive(r, r.room, "u: inside the obstacle")
    upper = upper_energy(r, above)
    rest = balance(r, r.stress, r.body_force, r.traction, r.pressure)
    of_u = summed(rest.force * size(r.u[:, r.nodes].swapaxes(0, 1)))
    found = lower_energy(r, rest, above) - of_u
    r.b = defect(r, rest, r.carried)
    r.root = r.b + math.sqrt(r.b**2 + 2 * (upper - found))  # (2 G)^(1/2)
    return found - r.b * r.root, upper


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with np.load(path, allow_pickle=False) as file:
        header = json.loads(str(file["header"]))
        lower, upper = energies(opened(file, header))
    claimed = header["lower"], header["upper"]
    right = claimed[0] <= lower and upper <= claimed[1]
    need(right, f"least energy: {claimed} claimed, {(lower, upper)} proved")
    return f"least energy in {claimed}"


if __name__ == "__main__":
    for path in sys.argv[1:]:
        sys.stdout.write(f"{path}: {check(path)}\n")
