"""Check a receipt: an energy, a force or a displacement lies in an interval.  numpy alone.

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
   A convex function of a field has at most the mean of its values at the coefficients.
4. Rounding.  A number of one K is wrong by at most EPS times the sizes of its terms and the
   condition of K: it takes less than ROUNDINGS operations.  Sums over K are ``math.fsum``.
5. S misses equilibrium by residuals r in K and j on its sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Let affine tractions
   T carry forces and torques of r, j along a tree from K to K to supports.  What is left on K does
   no work on rigid motions, and is at most b_K |eps(w)|, b_K = |J|^2 |J^-1| (C_1 |r| + C_2 sum
   (|E|/det J)^(1/2) |j, T|)  with the edges J of K and constants of an equilateral reference.
   J is m-convex, m = min(2 mu h/(2 mu + h), n B):  with G = J(u) - J(v), b^2 = sum b_K^2/m the
   last term is at most b (2 G)^(1/2).
6. A goal is Q = int F . u + int G . u + int c P - int t . V of the solution (u, P, t).  Let z = V
   where the body is held, T a stress in equilibrium with F, G and -q n on the obstacle, L > 0 with
   |q| <= L P, |c - z . n| <= L (psi - u . n), and s = 2 mu (e - p_0) - a.  Then
     Q <= int [F . u + G . u + f . z + g . z - B tr eps(u) tr eps(z) - a : eps(z)]
          + int (m_T - B tr eps(z) + L (m - B tr eps(u)))^2/(4 L B) + int [X(p, w) - p : s]
          + int (q + L P)(psi - u . n) + (b_T + L b) (2 G)^(1/2),
     p = (d_T + L (d - a))/(2 mu),  w = L s/(2 mu) - dev eps(z),  k = L/(2 mu),
     X = sup over t of  p : t + w : N - k t : N,  N = the radial return of t; X is convex.
   Proof: for the solution (v, Y) add  (T, eps(v - u)) = goal's load on v - u,  (Y, eps(z)) = load
   on z,  and subtract  L (Y - S, eps(v - u)).  -Q has the same bound with -z, -T, -q, -c.
"""

import functools
import itertools
import json
import math
import sys
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

ROUNDINGS = 64
EPS = ROUNDINGS * float(np.finfo(float).eps)
FORMAT = "ngepc receipt 2"
ENERGY = [  # types and shapes: k coefficients on K, t on each of the S sides of the boundary
    (float, "points PN, u UN, stress Kknn, lame_lambda K, mu K, hardening K, beta K, initial K1nn, "
            "back K1nn, body_force KN, prescribed StN, traction StN, gap St, pressure St"),
    (int, "cells Kk, boundary SN"),
    (bool, "held SN, contact S"),
]  # fmt: skip
GOAL = [  # z, T, q, F, G, V, c of 6
    (float, "z UN, tau Kknn, goal_pressure St, goal_force KN, goal_traction StN, goal_motion StN, "
            "goal_contact S"),
]  # fmt: skip
SIDES = {2: [[1, 2], [0, 2], [0, 1]], 3: [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]}
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # and back
CONSTANTS = {2: (1.1, 2.3), 3: (3.0, 9.0)}  # C_1, C_2
LAWS = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}  # N, n
DEEPEST = 6  # how often K is cut for the plastic terms
NEWTON = 4  # steps for g in ``highest``
COARSER = 8  # resolution of X over that of the energies
TINY = float(np.finfo(float).tiny)
CHILDREN = {  # parts of K by Bey; 21 is the mean of vertices 2 and 1
    2: np.array([[0, 10, 20], [11, 21, 10], [22, 20, 21], [21, 20, 10]]),
    3: np.array([[0, 10, 20, 30], [10, 11, 21, 31], [20, 21, 22, 32], [30, 31, 32, 33],
                 [10, 20, 30, 31], [10, 20, 21, 31], [20, 30, 31, 32], [20, 21, 31, 32]]),
}  # fmt: skip
QUADRATIC = {  # means of the products of quadratic Bernstein polynomials
    1: np.array([[6, 1, 3], [1, 6, 3], [3, 3, 4]]) / 30,
    2: np.array([[6, 1, 1, 1, 3, 3], [1, 6, 1, 3, 1, 3], [1, 1, 6, 3, 3, 1],
                 [1, 3, 3, 4, 2, 2], [3, 1, 3, 2, 4, 2], [3, 3, 1, 2, 2, 4]]) / 90,
}  # fmt: skip


def need(condition: object, message: str) -> None:
    """Refuse the receipt unless a condition holds."""
    if not condition:
        raise ValueError(message)


@functools.cache
def cuts(N: int, k: int) -> np.ndarray:
    """Coefficients on the parts of a simplex from its own, (parts, k, k)."""
    corners = np.eye(N + 1)[[CHILDREN[N] // 10, CHILDREN[N] % 10]].mean(axis=0)
    if k == N + 1:
        return corners
    polar = np.einsum("pia,pjb,abk->pijk", corners, corners, np.eye(6)[BETWEEN])
    return polar[:, PAIRS[:, 0], PAIRS[:, 1]]


def elevated_to(c: np.ndarray, k: int) -> np.ndarray:
    """k coefficients of fields that are constant, affine, or have k coefficients."""
    if c.shape[1] == 1:
        return np.repeat(c, k, axis=1)
    edges = (
        (c[:, PAIRS[3:k, 0]] + c[:, PAIRS[3:k, 1]]) / 2 if c.shape[1] < k else c[:, :0]
    )
    return np.concatenate([c, edges], axis=1)


def derivatives(c: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Coefficients of the derivatives, (K, k, ..., N)."""
    affine = c.shape[1] == slopes.shape[1]
    table = np.arange(c.shape[1])[None] if affine else BETWEEN
    return (2 - affine) * np.einsum("kvi...,kij->kv...j", c[:, table], slopes)


def dots_at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products at the coefficients, (K, k)."""
    return np.einsum("kia,kia->ki", a, b)


def size(a: np.ndarray) -> np.ndarray:
    """The largest norm of coefficients on each simplex."""
    a = a.reshape(len(a), a.shape[1], -1)
    return np.sqrt(dots_at(a, a).max(axis=1))


def inner(a: np.ndarray, b: np.ndarray, N: int) -> np.ndarray:
    """Means of the products of two fields with coefficients (K, k, .)."""
    k = a.shape[1]
    table = QUADRATIC[N] if k > N + 1 else (1 + np.eye(k)) / (k * (k + 1))
    return dots_at(table @ a, b).sum(axis=1)


@functools.cache
def tensor_basis(n: int) -> np.ndarray:
    """From the entries of tensors: mean, and deviator in an orthonormal basis."""
    E = np.eye(n * n).reshape(-1, n, n)
    mean = np.trace(E, axis1=1, axis2=2) / n
    i, j = np.triu_indices(n)
    deviator = ((E + E.swapaxes(1, 2)) / 2)[:, i, j] - mean[:, None] * (i == j)
    return np.column_stack([mean, deviator * np.where(i == j, 1.0, math.sqrt(2))])


def split(S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (., 1) and deviator of tensors, of their symmetric parts."""
    parts = S.reshape(*S.shape[:-2], -1) @ tensor_basis(S.shape[-1])
    return parts[..., :1], parts[..., 1:]


def above(
    r: SimpleNamespace, density: Callable, x: np.ndarray, law: np.ndarray, fine: float
) -> np.ndarray:
    """Integrals of a convex function of fields x from above; K is cut where that gains.

    ``density`` bounds the means of the function from coefficients and a row of ``law`` each, which
    ends with the volume.
    """
    value = law[:, -1] * density(x, law)
    table = cuts(r.N, x.shape[1])
    found = []
    for _ in range(DEEPEST - 1):
        if not len(value):
            break
        x = (np.concatenate(table) @ x).reshape(-1, *x.shape[1:])
        law = law.repeat(len(table), axis=0)
        law[:, -1] /= len(table)
        parts = law[:, -1] * density(x, law)
        inside = parts.reshape(-1, len(table)).sum(axis=1)
        on = (value - inside) * len(value) > fine
        found.append(np.minimum(value, inside)[~on])
        on = on.repeat(len(table))
        x = x[on]
        law = law[on]
        value = parts[on]
    return np.concatenate([*found, value])


def plastic(
    r: SimpleNamespace, s: np.ndarray, modulus: np.ndarray, p: bool
) -> np.ndarray:
    """Plastic terms of phi (``p``) or phi*.

    With x = s outside the ball |s| <= beta: means of beta |x| - s : x + |x|^2/2, or |x|^2/2.  The
    first is no less than that of the best x, the second no less than [|s| - beta]_+^2/2.
    """

    def density(s: np.ndarray, law: np.ndarray) -> np.ndarray:
        length = np.sqrt(dots_at(s, s))
        over = np.maximum(length - law[:, :1], 0.0)
        x = s * (over / np.where(length > 0, length, 1.0))[..., None]
        if p:
            return inner(x, x / 2 - s, r.N) + law[:, 0] * over.mean(axis=1)
        return inner(x, x, r.N) / 2

    flows = size(s) > r.beta
    law = np.column_stack([r.beta, r.volume / modulus])
    return above(r, density, s[flows], law[flows], r.fine)


def highest(x: np.ndarray, law: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """No less than X(p, w) of 6 at the coefficients x = (p, w), and where it is |p + w|^2/(4 k).

    Where |t| <= beta it is sup y : t - k |t|^2, y = p + w.  Beyond, with a plastic strain g > 0, t
    and N have sizes beta + M g, beta + h g, M = 2 mu + h, and the direction of v = beta y + g y',
    y' = M p + h w: X = sup of F = |v| - k (beta + M g)(beta + h g), F'(0) <= |y'| - k beta (M + h).
    (i) |v| <= (beta + M g)|p| + (beta + h g)|w|.  (ii) |v|'' = D/|v|^3 with a constant D: where
    y : y' >= 0 it is largest at 0.  If c = 2 k M h - |v|''(0) > 0, F <= F(g) + F'(g)^2/(2 c).
    """
    p, w = np.split(x, 2, axis=2)
    of_p, both, of_w = dots_at(p, p), dots_at(p, w), dots_at(w, w)
    k, M, h, beta = (np.broadcast_to(law[:, [c]], both.shape) for c in range(4))
    length = np.sqrt(np.maximum(of_p + 2 * both + of_w, 0.0))
    steep = np.sqrt(np.maximum(M**2 * of_p + 2 * M * h * both + h**2 * of_w, 0.0))
    inside = length <= 2 * k * beta
    best = np.where(inside, length**2 / (4 * k), beta * (length - k * beta))
    flows = steep > k * beta * (M + h)
    values = k, M, h, beta, length, steep, of_p, both, of_w
    k, M, h, beta, length, steep, of_p, both, of_w = (value[flows] for value in values)
    bend = 2 * k * M * h
    loss = k * beta * (M + h)
    start = beta * length
    along = beta * (M * of_p + (M + h) * both + h * of_w)

    def norm(g: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(start**2 + 2 * g * along + (g * steep) ** 2, TINY))

    apart = np.sqrt(of_p) + np.sqrt(of_w)
    rise = np.maximum(M * np.sqrt(of_p) + h * np.sqrt(of_w) - loss, 0.0)
    coarse = beta * apart + rise**2 / (2 * bend)
    D = np.maximum((start * steep) ** 2 - along**2, 0.0)
    g = rise / bend
    for _ in range(NEWTON):
        v = norm(g)
        d = (along + g * steep**2) / v - loss - bend * g
        g = np.maximum(g + d / np.maximum(bend - D / v**3, bend / 4), g / 2)
    v = norm(g)
    d = (along + g * steep**2) / v - loss - bend * g
    least = norm(g / 2)
    concave = bend - D / least**3
    right = (
        v
        - loss * g
        - bend * g**2 / 2
        + d**2 / (2 * np.where(concave > 0, concave, np.inf))
    )
    rise = (least - start) / np.maximum(g / 2, TINY) - loss
    best_g = np.clip(rise / bend, 0.0, g / 2)
    left = start + rise * best_g - bend * best_g**2 / 2
    fine = np.where((along >= 0) & (concave > 0), np.maximum(left, right), np.inf)
    coarse = np.minimum(coarse, fine) - k * beta**2
    best[flows] = np.maximum(best[flows], coarse)
    return best, inside & ~flows


def check_shapes(arrays: dict, N: int, n: int, goal: bool) -> None:
    """Arrays are finite and as tables say: a letter is the same number everywhere."""
    k = arrays["cells"].shape[1]
    need(k == N + 1 or (N, k) == (2, 6), "cells: neither order one nor order two")
    sizes = {"1": 1, "N": N, "n": n, "k": k, "t": N if k == N + 1 else N + 1}
    for kind, table in (*ENERGY, *GOAL * goal):
        for name, letters in map(str.split, table.split(", ")):
            values = arrays[name]
            fits = values.dtype == kind and values.ndim == len(letters)
            shape = tuple(map(sizes.setdefault, letters, values.shape))
            need(fits and values.shape == shape, f"{name}: wrong type or shape")
            need(np.isfinite(values).all(), f"{name}: not finite")


def prepare(r: SimpleNamespace) -> None:
    """Volumes, slopes of barycentric coordinates, and the sides of the simplices."""
    N = r.N
    corner = r.cells[:, : N + 1]
    need((np.diff(corner, axis=1) > 0).all(), "cells: vertices are not ascending")
    J = r.points[corner[:, 1:]] - r.points[corner[:, :1]]
    r.det = np.abs(np.linalg.det(J))
    r.length = np.sqrt((J**2).sum(axis=(1, 2)))
    need((r.det > 1e-9 * r.length**N).all(), "cells: a cell is too flat")
    inverse = np.linalg.inv(J).transpose(0, 2, 1)
    r.slopes = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
    r.steep = np.sqrt((inverse**2).sum(axis=(1, 2)))
    r.wrong = EPS * r.length * r.steep
    r.volume = r.det / math.factorial(N)
    r.area = (-N * r.volume[:, None, None] * r.slopes).reshape(-1, N)  # outward
    r.measure = np.sqrt((r.area**2).sum(axis=1))
    nodes = corner[:, SIDES[N]].reshape(-1, N)
    number = nodes @ len(r.points) ** np.arange(N)[::-1]
    _, r.first, side, count = np.unique(number, True, True, True)
    need(count.max() <= 2, "cells: a side belongs to three cells")
    r.ends = nodes[r.first]
    r.side = side.reshape(-1, N + 1)
    r.areas = r.measure.reshape(r.side.shape)
    r.out = r.first[count == 1]  # sides of the boundary, by cell
    same = np.array_equal(r.boundary, r.ends[count == 1])
    need(same, "boundary: the sides of a single cell, in ascending order, are needed")
    nodes = np.column_stack([nodes, r.cells[:, N + 1 :].reshape(len(nodes), -1)])
    need((nodes[r.first][side.ravel()] == nodes).all(), "u: not continuous")
    r.side_nodes = nodes[r.out]
    r.outer = r.measure[r.out]
    r.normal = r.area[r.out] / r.outer[:, None]
    r.near = r.wrong[r.out // (N + 1)]


def check_supports(
    r: SimpleNamespace, u: np.ndarray, motion: np.ndarray, name: str
) -> None:
    """Displacements have the values of supports."""
    same = (u[r.side_nodes] == motion) | ~r.held[:, None]
    need(same.all(), f"{name}: not the prescribed displacement")


def along_normals(r: SimpleNamespace, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u . n on the boundary, and what rounding may change in it."""
    u = u[r.side_nodes]
    return np.einsum("ska,sa->sk", u, r.normal), r.near[:, None] * np.sqrt(
        dots_at(u, u)
    )


def need_positive(r: SimpleNamespace, c: np.ndarray, message: str) -> None:
    """Coefficients of functions that are nonnegative on the sides with an obstacle."""
    c = c[r.contact]
    need((c[:, : r.N] >= 0).all(), message)
    if c.shape[1] > r.N:
        lowest = -(1 - EPS) * np.sqrt(c[:, 0] * c[:, 1])
        need((c[:, 2] >= lowest).all(), message)


def check_admissible(r: SimpleNamespace) -> None:
    """Displacements meet supports and clear the obstacle; pressures are nonnegative."""
    check_supports(r, r.u, r.prescribed, "u")
    need((r.pressure >= 0).all(), "pressure: negative")
    need((r.pressure[~r.contact] == 0).all(), "pressure: where no obstacle is")
    moved, unsure = along_normals(r, r.u)
    r.room = r.gap - moved - unsure
    need_positive(r, r.room, "u: inside the obstacle")


def strains(r: SimpleNamespace, u: np.ndarray) -> tuple[np.ndarray, ...]:
    """Trace and deviator of eps(u), no less than its size, and what rounding misses of it."""
    change = u[r.cells]
    change -= change[:, :1].copy()
    du = derivatives(change, r.slopes)
    eps = np.zeros((*du.shape[:2], r.n, r.n))
    eps[..., : r.N, : r.N] = (du + du.swapaxes(2, 3)) / 2
    missed = size(change) * r.steep * r.wrong
    mean, e = split(elevated_to(eps, r.stress.shape[1]))
    return r.n * mean, e, size(eps) + missed, missed


def work(
    r: SimpleNamespace, force: np.ndarray, traction: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """int force . u + boundary int traction . u by parts, and what rounding may change."""
    local = u[r.cells]
    at_sides = u[r.side_nodes]
    done = (force * local.mean(axis=1)).sum(axis=1) * r.volume
    pulled = inner(traction, at_sides, r.N - 1) * r.outer
    inside = size(force[:, None]) * r.volume * r.wrong * size(local)
    outside = size(traction) * r.outer * r.near * size(at_sides)
    return np.concatenate([done, pulled]), np.concatenate([inside, outside])


def upper_energy(r: SimpleNamespace) -> float:
    """No less than J(u)."""
    r.trace, e, r.strain, r.missed = strains(r, r.u)
    e = e - r.initial
    r.trial = 2 * r.mu[:, None, None] * e - r.back
    density = r.bulk * inner(r.trace, r.trace, r.N) / 2 + r.mu * inner(e, e, r.N)
    density -= r.mu * size(r.initial) ** 2
    flow = plastic(r, r.trial, 2 * r.mu + r.hardening, p=True)
    done, unsure = work(r, r.body_force, r.traction, r.u)
    r.strain += size(r.initial) + size(r.back) / r.mu
    r.stiff = r.n * r.bulk + 2 * r.mu
    slack = 10 * r.volume * r.stiff * r.strain * (r.missed + r.wrong * r.strain)
    return math.fsum(np.concatenate([r.volume * density, flow, -done, slack, unsure]))


def balance(
    r: SimpleNamespace,
    S: np.ndarray,
    force: np.ndarray,
    traction: np.ndarray,
    P: np.ndarray,
) -> SimpleNamespace:
    """Residuals of a stress, with what rounding adds, and the reactions t."""
    S = S[..., : r.N, : r.N]
    rest = np.trace(derivatives(S, r.slopes), axis1=-2, axis2=-1)
    large = size(S)
    force = force[:, None]
    inside = size(rest + force) + r.wrong * (3 * large * r.steep + size(force))
    edges = np.arange(r.N + 1, S.shape[1]).reshape(r.N + 1, -1)
    places = np.column_stack([SIDES[r.N], edges])
    area = r.area.reshape(len(S), -1, 1, r.N, 1)
    T = (S[:, places] @ area)[..., 0].reshape(len(r.area), -1, r.N)
    jump = np.zeros((len(r.ends), *T.shape[1:]))
    np.add.at(jump, r.side.ravel(), T)
    outside = r.side.ravel()[r.out]
    load = (traction - P[..., None] * r.normal[:, None]) * r.outer[:, None, None]
    missing = jump[outside] - load
    held = r.held[:, None]
    jump[outside] = np.where(held, 0.0, missing)
    unsure = np.zeros(len(jump))
    np.add.at(unsure, r.side, (r.wrong * large)[:, None] * r.areas)
    unsure[outside] += r.near * r.outer * (size(traction) + np.abs(P).max(axis=1))
    reaction = np.where(held, missing, 0.0)
    return SimpleNamespace(
        inside=inside,
        jump=size(jump) + unsure,
        unsure=unsure[outside],
        reaction=reaction,
    )


def variance(x: np.ndarray, index: int) -> np.ndarray:
    """A principal variance of simplices (., corners, N): mean squares along that axis."""
    x = x - x.mean(axis=1, keepdims=True)
    corners = x.shape[1]
    covariance = np.einsum("kai,kaj->kij", x, x) / (corners * (corners + 1))
    return np.linalg.eigvalsh(covariance)[:, index]


def carried(r: SimpleNamespace, force: np.ndarray, reach: float) -> np.ndarray:
    """No less than what each side carries of the forces of K, on a tree to the supports."""
    sides = r.side.shape[1]
    last = np.zeros(len(r.ends), dtype=int)
    last[r.side.ravel()] = np.arange(r.side.size)
    other = (r.first + last)[r.side] - np.arange(r.side.size).reshape(r.side.shape)
    fixed = np.unique(r.out[r.held.all(axis=1)] // sides)
    levels = [fixed if len(fixed) else np.zeros(1, dtype=int)]
    through = np.full(len(force), -1)
    through[levels[0]] = 0
    while len(levels[-1]):
        beyond = other[levels[-1]].ravel()
        beyond = beyond[through[beyond // sides] < 0]
        cell, place = np.unique(beyond // sides, return_index=True)
        through[cell] = beyond[place]
        levels.append(cell)
    need((through >= 0).all(), "cells: a part of the body is not held")
    total = force.copy()
    carries = np.zeros(len(r.ends))
    for cell in levels[:0:-1]:
        carries[r.side.ravel()[through[cell]]] = total[cell]
        np.add.at(total, other.ravel()[through[cell]] // sides, total[cell])
    return carries if len(fixed) else carries + rolled(r, math.fsum(force), reach)


def rolled(r: SimpleNamespace, total: float, reach: float) -> float:
    """What supports of single components carry, all of them, where forces add up to a total."""
    row, component = np.nonzero(r.held)
    m = r.points[r.boundary].mean(axis=1)[row] / reach
    e = np.eye(r.N)[component]
    pairs = itertools.combinations(range(r.N), 2)
    turns = [m[:, i] * e[:, j] - m[:, j] * e[:, i] for i, j in pairs]
    area = r.outer[row]
    wrenches = np.column_stack([e, *turns]) * area[:, None]
    least = np.linalg.eigvalsh(wrenches.T @ wrenches)[0]
    need(least > 1e-9 * (wrenches**2).sum(), "held: the body can move")
    return total * (1 + 3 * math.sqrt((area**2).sum() / least))


def defect(r: SimpleNamespace, rest: SimpleNamespace) -> tuple[float, float]:
    """b and a bound of |R(u)| for the residuals."""
    N = r.N
    outward = rest.jump[r.side]
    force = rest.inside * r.volume + outward.sum(axis=1)
    of_u = math.fsum(force * size(r.u[r.cells]))
    reach = 2 * float(np.ptp(r.points, axis=0).sum() + np.abs(r.points).max())
    narrow = variance(r.points[r.ends], 1)[r.side]
    pulled = carried(r, force, reach)[r.side] * (1 + reach / np.sqrt(narrow))
    pulled = (outward + pulled) / np.sqrt(r.areas)
    thin = np.sqrt(variance(r.points[r.cells[:, : N + 1]], 0))
    turned = force * (1 + r.length / thin) / np.sqrt(r.volume)
    inner_part = rest.inside * np.sqrt(r.volume) + turned
    first, second = CONSTANTS[N]
    outer_part = (np.sqrt(r.areas / r.det[:, None]) * pulled).sum(axis=1)
    b = r.length**2 * r.steep * (first * inner_part + second * outer_part)
    soft = 2 * r.mu * r.hardening / (2 * r.mu + r.hardening)
    m = np.minimum(soft, r.n * r.bulk)
    return 2 * math.sqrt(math.fsum(b**2 / m)), of_u


def lower_energy(r: SimpleNamespace, rest: SimpleNamespace) -> float:
    """The lower bound of 2 for the stress of the file as it is."""
    N = r.N
    m, d = split(r.stress)
    r.m, r.shifted = m, d - r.back
    total = d + 2 * r.mu[:, None, None] * r.initial
    density = inner(m, m, N) / (2 * r.bulk) + inner(total, total, N) / (4 * r.mu)
    flow = plastic(r, r.shifted, r.hardening, p=False)
    pressed = inner(r.pressure[..., None], r.gap[..., None], N - 1) * r.outer
    moved = inner(rest.reaction, r.prescribed, N - 1)
    r.large = size(r.stress) + 2 * r.mu * size(r.initial) + size(r.back)
    r.soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    slack = 10 * r.volume * r.wrong * r.large**2 * r.soft
    doubt = rest.unsure * size(r.prescribed) + 10 * r.near * np.abs(pressed)
    terms = [r.volume * density, flow, -moved, pressed, slack, doubt]
    return -math.fsum(np.concatenate(terms))


def check_adjoint(r: SimpleNamespace, factor: float) -> None:
    """The conditions of 6."""
    need(factor > 0, "factor: not positive")
    check_supports(r, r.z, r.goal_motion, "z")
    moved, unsure = along_normals(r, r.z)
    most = factor * (1 - EPS) * r.room - unsure
    for wanted in (r.goal_contact[:, None] - moved, moved - r.goal_contact[:, None]):
        need_positive(r, most - wanted, "z: wrong at the obstacle")
    small = np.abs(r.goal_pressure) <= (1 - EPS) * factor * r.pressure
    need(small.all(), "goal_pressure: larger than the factor times the pressure")


def suprema(
    r: SimpleNamespace, p: np.ndarray, w: np.ndarray, factor: float
) -> np.ndarray:
    """The integrals of X(p, w) - p : s from above, by parts."""
    k = factor / (2 * r.mu)
    law = np.column_stack([k, 2 * r.mu + r.hardening, r.hardening, r.beta, r.volume])
    x = np.concatenate([p, w], axis=2)
    smooth = highest(x, law)[1].all(axis=1)
    quadratic = r.volume * inner(p + w, p + w, r.N) / (4 * k)
    fine = COARSER * factor * r.fine
    rough = above(
        r, lambda *at: highest(*at)[0].mean(axis=1), x[~smooth], law[~smooth], fine
    )
    return np.concatenate(
        [quadratic[smooth], rough, -r.volume * inner(p, r.trial, r.N)]
    )


def goal_interval(
    r: SimpleNamespace, factor: float, misses: float, root: float
) -> tuple:
    """6: what a goal lies between, for the b of S, ``misses``, and (2 G)^(1/2), ``root``."""
    N = r.N
    q = r.goal_pressure
    rest = balance(r, r.tau, r.goal_force, r.goal_traction, q)
    doubt = (defect(r, rest)[0] + factor * misses) * root
    trace, e, strain, missed = strains(r, r.z)
    m, d = split(r.tau)
    done, unsure_done = work(r, r.goal_force, r.goal_traction, r.u)
    gained, unsure_gained = work(r, r.body_force, r.traction, r.z)
    back = elevated_to(r.back, e.shape[1])
    own = r.volume * (r.bulk * inner(r.trace, trace, N) + inner(back, e, N))
    room = r.room[..., None]
    opened = inner(q[..., None], room, N - 1) * r.outer
    centre = np.concatenate([done, gained, -own, opened])
    opening = inner(factor * r.pressure[..., None], room, N - 1) * r.outer
    large = size(r.tau) + factor * r.large + r.stiff * (strain + factor * r.strain)
    wrong = r.wrong * large + r.stiff * (missed + factor * r.missed)
    slack = 10 * r.volume * r.soft / factor * large * wrong
    near = 10 * r.near * (np.abs(opening) + r.outer * size(q[..., None]) * size(room))
    always = [opening, slack, near, unsure_done, unsure_gained, [doubt]]

    bulk, two_mu = r.bulk[:, None, None], 2 * r.mu[:, None, None]
    ends = []
    for sign in (-1.0, 1.0):
        mean = sign * (m - bulk * trace) + factor * (r.m - bulk * r.trace)
        squares = r.volume * inner(mean, mean, N) / (4 * factor * r.bulk)
        p = (sign * d + factor * r.shifted) / two_mu
        w = factor / two_mu * r.trial - sign * e
        parts = [sign * centre, *always, squares, suprema(r, p, w, factor)]
        ends.append(sign * math.fsum(np.concatenate(parts)))
    return tuple(ends)


def proved_intervals(arrays: dict[str, np.ndarray], header: dict) -> dict[str, float]:
    """What the arrays prove; ValueError where they are not admissible."""
    need(header["format"] == FORMAT, f"format: {FORMAT!r} is needed")
    N, n = LAWS[header["kinematics"]]
    check_shapes(arrays, N, n, "goal" in header)
    r = SimpleNamespace(**arrays, N=N, n=n, fine=float(header["resolution"]))
    r.bulk = r.lame_lambda + 2 * r.mu / n
    for name in ("mu", "beta", "hardening", "bulk"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    r.stress = (r.stress + r.stress.swapaxes(2, 3)) / 2
    r.initial = split(r.initial)[1]
    r.back = split(r.back)[1]
    prepare(r)
    check_admissible(r)
    upper = upper_energy(r)
    rest = balance(r, r.stress, r.body_force, r.traction, r.pressure)
    b, of_u = defect(r, rest)
    found = lower_energy(r, rest) - of_u
    root = b + math.sqrt(b**2 + 2 * (upper - found))  # (2 G)^(1/2)
    proved = {"lower": found - b * root, "upper": upper}
    if "goal" in header:
        r.tau = (r.tau + r.tau.swapaxes(2, 3)) / 2
        factor = float(header["factor"])
        check_adjoint(r, factor)
        ends = goal_interval(r, factor, b, root)
        proved["goal lower"], proved["goal upper"] = ends
    return proved


def check(path: str) -> dict:
    """The header of a receipt; ValueError and others if it does not show what it claims."""
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header")))
    for name, value in proved_intervals(arrays, header).items():
        proved = header[name] <= value if "lower" in name else value <= header[name]
        need(proved, f"{name}: {header[name]} claimed, {value} proved")
    return header


def check_files(arguments: list[str]) -> int:
    """Check files; the status is 0 if all of them show what they claim."""
    status = 0
    for path in arguments:
        try:
            header = check(path)
            text = f"PASS: least energy in [{header['lower']}, {header['upper']}]"
            if "goal" in header:
                text += f", {header['goal']} in [{header['goal lower']}, {header['goal upper']}]"
        except Exception as error:  # whatever is wrong with a file, it does not pass
            known = isinstance(error, ValueError)
            text = f"FAIL: {error if known else repr(error)}"
            status = 1
        sys.stdout.write(f"{path}: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(check_files(sys.argv[1:]))
