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
   A convex function of a field has at most the mean of its values at the coefficients.
4. Rounding.  A number of one K is wrong by at most EPS times the sizes of its terms and the
   condition of K: it takes less than ROUNDINGS operations.  Sums over K are ``math.fsum``.
5. S misses equilibrium by residuals r in K and j on its sides.  For the solution v
   J(v) >= lower bound - |R(u)| - |R(v - u)|,  R(w) = int r . w + int j . w.  Let affine tractions
   T carry forces and torques of r, j along a tree from K to K to supports.  What is left on K does
   no work on rigid motions, and is at most b_K |eps(w)|, b_K = |J|^2 |J^-1| (C_1 |r| + C_2 sum
   (|E|/det J)^(1/2) |j, T|)  with the edges J of K and constants of an equilateral reference.  J is
   m-convex, m = min(2 mu h/(2 mu + h), n B):  with G = J(u) - J(v), b^2 = sum b_K^2/m the last term
   is at most b (2 G)^(1/2).
"""

import itertools
import json
import math
import sys
from types import SimpleNamespace

import numpy as np

ROUNDINGS = 64
EPS = ROUNDINGS * float(np.finfo(float).eps)
FORMAT = "ngepc receipt 1"
ARRAYS = {  # types and shapes: k coefficients on K, t on each of the S sides of the boundary
    float: "points PN, u UN, stress Kknn, lame_lambda K, mu K, hardening K, beta K, "
    "initial K1nn, back K1nn, body_force KN, prescribed StN, traction StN, gap St, pressure St",
    int: "cells Kk, boundary SN",
    bool: "held SN, contact S",
}  # fmt: skip
SIDES = {2: [[1, 2], [0, 2], [0, 1]], 3: [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]}
BETWEEN = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])  # coefficient of two vertices
PAIRS = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])  # and back
CONSTANTS = {2: (1.1, 2.3), 3: (3.0, 9.0)}  # C_1, C_2
LAWS = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}  # N, n
DEEPEST = 6  # how often K is cut for the plastic terms
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


def cuts(N: int, k: int) -> np.ndarray:
    """Coefficients on the parts of a simplex from its own, (parts, k, k)."""
    vertex = np.eye(N + 1)
    corners = (vertex[CHILDREN[N] // 10] + vertex[CHILDREN[N] % 10]) / 2
    if k <= N + 1:
        return corners if k > 1 else np.ones((1, 1, 1))
    polar = np.einsum("pia,pjb,abk->pijk", corners, corners, np.eye(6)[BETWEEN])
    return polar[:, PAIRS[:, 0], PAIRS[:, 1]]


def derivatives(c: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Coefficients of the derivatives, (K, k, ..., N)."""
    affine = c.shape[1] == slopes.shape[1]
    table = np.arange(c.shape[1])[None] if affine else BETWEEN
    return (2 - affine) * np.einsum("kvi...,kij->kv...j", c[:, table], slopes)


def rows(a: np.ndarray) -> np.ndarray:
    """Components of fields in one row, (K, k, components)."""
    return a.reshape(*a.shape[:2], math.prod(a.shape[2:]))


def size(a: np.ndarray) -> np.ndarray:
    """The largest norm of coefficients on each simplex."""
    return np.sqrt(np.einsum("kia,kia->ki", rows(a), rows(a)).max(axis=1))


def inner(a: np.ndarray, b: np.ndarray, N: int) -> np.ndarray:
    """Means of the products of two fields with coefficients (K, k, ...)."""
    k = a.shape[1]
    means = QUADRATIC[N] if k > N + 1 else (1 + np.eye(k)) / (k * (k + 1))
    return np.einsum("kia,kia->k", means @ rows(a), rows(b))


def split(S: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviator of tensors."""
    n = S.shape[-1]
    m = np.trace(S, axis1=-2, axis2=-1) / n
    return m, S - m[..., None, None] * np.eye(n)


def plastic_density(s: np.ndarray, beta: np.ndarray, N: int, p: bool) -> np.ndarray:
    """With x = s outside the ball |s| <= beta: means of beta |x| - s : x + |x|^2/2, or |x|^2/2.

    The first is no less than that of the best x, the second no less than [|s| - beta]_+^2/2.
    """
    length = np.sqrt(np.einsum("kia,kia->ki", s, s))
    over = np.maximum(length - beta[:, None], 0.0)
    x = s * (over / np.where(length > 0, length, 1.0))[..., None]
    if p:
        return inner(x, x / 2 - s, N) + beta * over.mean(axis=1)
    return inner(x, x, N) / 2


def plastic(r: SimpleNamespace, s: np.ndarray, modulus: np.ndarray, p: bool) -> list:
    """Plastic terms of phi (``p``) or phi*: bounds from above, K is cut where that gains."""
    flows = size(s) > r.beta
    i, j = np.triu_indices(r.n)
    s = s[flows][..., i, j] * np.where(i == j, 1.0, math.sqrt(2))
    beta = r.beta[flows]
    weight = (r.volume / modulus)[flows]
    value = weight * plastic_density(s, beta, r.N, p)
    table = cuts(r.N, s.shape[1])
    found = []
    for level in range(DEEPEST):
        s = (np.concatenate(table) @ s).reshape(-1, *s.shape[1:])
        beta = beta.repeat(len(table))
        weight = weight.repeat(len(table)) / len(table)
        parts = weight * plastic_density(s, beta, r.N, p)
        inside = parts.reshape(-1, len(table)).sum(axis=1)
        on = ((value - inside) * len(value) > r.fine) & (level < DEEPEST - 1)
        found.append(np.minimum(value, inside)[~on])
        if not on.any():
            break
        on = on.repeat(len(table))
        s = s[on]
        beta = beta[on]
        weight = weight[on]
        value = parts[on]
    return found


def check_shapes(arrays: dict[str, np.ndarray], N: int, n: int) -> None:
    """Arrays are finite and as ``ARRAYS`` says: a letter is the same number everywhere."""
    k = arrays["cells"].shape[1]
    need(k == N + 1 or (N, k) == (2, 6), "cells: neither order one nor order two")
    sizes = {"1": 1, "N": N, "n": n, "k": k, "t": N if k == N + 1 else N + 1}
    for kind, table in ARRAYS.items():
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
    r.on_sides = r.u[nodes[r.out]]
    r.normal = r.area[r.out]
    r.near = r.wrong[r.out // (N + 1)]
    pressed = r.pressure[..., None] * r.normal[:, None]
    r.load = r.traction * r.measure[r.out, None, None] - pressed


def check_admissible(r: SimpleNamespace) -> None:
    """Displacements meet supports and clear the obstacle; pressures are nonnegative."""
    same = (r.on_sides == r.prescribed) | ~r.held[:, None]
    need(same.all(), "u: not the prescribed displacement")
    need((r.pressure >= 0).all(), "pressure: negative")
    need((r.pressure[~r.contact] == 0).all(), "pressure: where no obstacle is")
    n = r.normal / r.measure[r.out, None]
    room = r.gap - np.einsum("ska,sa->sk", r.on_sides, n)
    room -= r.near[:, None] * np.sqrt((r.on_sides**2).sum(axis=2))
    c = room[r.contact]
    need((c[:, : r.N] >= 0).all(), "u: inside the obstacle at a vertex")
    if c.shape[1] > r.N:
        lowest = -(1 - EPS) * np.sqrt(c[:, 0] * c[:, 1])
        need((c[:, 2] >= lowest).all(), "u: inside the obstacle on a side")


def upper_energy(r: SimpleNamespace) -> float:
    """No less than J(u)."""
    N = r.N
    local = r.u[r.cells]
    change = local - local[:, :1]
    du = derivatives(change, r.slopes)
    eps = np.zeros((*du.shape[:2], r.n, r.n))
    eps[..., :N, :N] = (du + du.swapaxes(2, 3)) / 2
    mean, e = split(eps)
    e = e - r.initial
    s = 2 * r.mu[:, None, None, None] * e - r.back
    density = r.bulk * r.n**2 * inner(mean, mean, N) / 2 + r.mu * inner(e, e, N)
    density -= r.mu * (r.initial**2).sum(axis=(1, 2, 3))
    flow = plastic(r, s, 2 * r.mu + r.hardening, p=True)
    work = (r.body_force * local.mean(axis=1)).sum(axis=1) * r.volume
    done = inner(r.traction, r.on_sides, N - 1) * r.measure[r.out]
    missed = size(change) * r.steep * r.wrong  # of the strain
    strain = size(eps) + missed + size(r.initial) + size(r.back) / r.mu
    stiff = 10 * r.volume * (r.n * r.bulk + 2 * r.mu)
    slack = stiff * strain * (missed + r.wrong * strain)
    force = size(r.body_force[:, None]) * r.volume * r.wrong * size(local)
    pull = size(r.traction) * r.measure[r.out] * r.near * size(r.on_sides)
    terms = [r.volume * density, *flow, -work, -done, slack, force, pull]
    return math.fsum(np.concatenate(terms))


def find_residuals(r: SimpleNamespace) -> None:
    """Residuals of the stress, with what rounding adds, and the reactions t."""
    S = r.stress[..., : r.N, : r.N]
    rest = np.trace(derivatives(S, r.slopes), axis1=-2, axis2=-1)
    large = size(S)
    force = r.body_force[:, None]
    r.inside = size(rest + force) + r.wrong * (3 * large * r.steep + size(force))
    edges = np.arange(r.N + 1, S.shape[1]).reshape(r.N + 1, -1)
    places = np.column_stack([SIDES[r.N], edges])
    area = r.area.reshape(len(S), -1, 1, r.N, 1)
    T = (S[:, places] @ area)[..., 0].reshape(len(r.area), -1, r.N)
    jump = np.zeros((len(r.ends), *T.shape[1:]))
    np.add.at(jump, r.side.ravel(), T)
    outside = r.side.ravel()[r.out]
    missing = jump[outside] - r.load
    r.reaction = np.where(r.held[:, None], missing, 0.0)
    jump[outside] = np.where(r.held[:, None], 0.0, missing)
    unsure = np.zeros(len(jump))
    np.add.at(unsure, r.side, (r.wrong * large)[:, None] * r.areas)
    given = size(r.traction) + r.pressure.max(axis=1)
    unsure[outside] += r.near * r.measure[r.out] * given
    r.unsure = unsure[outside]
    r.jump = size(jump) + unsure


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
    area = r.measure[r.out][row]
    wrenches = np.column_stack([e, *turns]) * area[:, None]
    least = np.linalg.eigvalsh(wrenches.T @ wrenches)[0]
    need(least > 1e-9 * (wrenches**2).sum(), "held: the body can move")
    return total * (1 + 3 * math.sqrt((area**2).sum() / least))


def find_defect(r: SimpleNamespace) -> tuple[float, float]:
    """B and a bound of |R(u)| for the residuals."""
    N = r.N
    outward = r.jump[r.side]
    force = r.inside * r.volume + outward.sum(axis=1)
    of_u = math.fsum(force * size(r.u[r.cells]))
    reach = 2 * float(np.ptp(r.points, axis=0).sum() + np.abs(r.points).max())
    narrow = variance(r.points[r.ends], 1)[r.side]
    pulled = carried(r, force, reach)[r.side] * (1 + reach / np.sqrt(narrow))
    pulled = (outward + pulled) / np.sqrt(r.areas)
    thin = np.sqrt(variance(r.points[r.cells[:, : N + 1]], 0))
    turned = force * (1 + r.length / thin) / np.sqrt(r.volume)
    inner_part = r.inside * np.sqrt(r.volume) + turned
    first, second = CONSTANTS[N]
    outer_part = (np.sqrt(r.areas / r.det[:, None]) * pulled).sum(axis=1)
    b = r.length**2 * r.steep * (first * inner_part + second * outer_part)
    soft = 2 * r.mu * r.hardening / (2 * r.mu + r.hardening)
    m = np.minimum(soft, r.n * r.bulk)
    return 2 * math.sqrt(math.fsum(b**2 / m)), of_u


def lower_energy(r: SimpleNamespace) -> float:
    """The lower bound of 2 for the stress of the file as it is."""
    N = r.N
    m, d = split(r.stress)
    total = d + 2 * r.mu[:, None, None, None] * r.initial
    density = inner(m, m, N) / (2 * r.bulk) + inner(total, total, N) / (4 * r.mu)
    flow = plastic(r, d - r.back, r.hardening, p=False)
    pressed = inner(r.pressure, r.gap, N - 1) * r.measure[r.out]
    moved = inner(r.reaction, r.prescribed, N - 1)
    large = size(r.stress) + 2 * r.mu * size(r.initial) + size(r.back)
    soft = 1 / r.bulk + 1 / r.mu + 1 / r.hardening
    slack = 10 * r.volume * r.wrong * large**2 * soft
    doubt = r.unsure * size(r.prescribed) + 10 * r.near * np.abs(pressed)
    terms = [-r.volume * density, *(-part for part in flow)]
    return math.fsum(np.concatenate([*terms, moved, -pressed, -slack, -doubt]))


def interval(arrays: dict[str, np.ndarray], header: dict) -> tuple[float, float]:
    """What the least energy lies between; ValueError where the arrays are not admissible."""
    need(header["format"] == FORMAT, f"format: {FORMAT!r} is needed")
    N, n = LAWS[header["kinematics"]]
    check_shapes(arrays, N, n)
    r = SimpleNamespace(**arrays, N=N, n=n, fine=float(header["resolution"]))
    r.bulk = r.lame_lambda + 2 * r.mu / n
    for name in ("mu", "beta", "hardening", "bulk"):
        need((getattr(r, name) > 0).all(), f"{name}: not positive")
    r.stress = (r.stress + r.stress.swapaxes(2, 3)) / 2
    r.initial = split(r.initial + r.initial.swapaxes(2, 3))[1] / 2
    r.back = split(r.back + r.back.swapaxes(2, 3))[1] / 2
    prepare(r)
    check_admissible(r)
    upper = upper_energy(r)
    find_residuals(r)
    b, of_u = find_defect(r)
    found = lower_energy(r) - of_u
    root = b + math.sqrt(b**2 + 2 * (upper - found))  # (2 G)^(1/2)
    return found - b * root, upper


def check(path: str) -> dict:
    """The header of a receipt; ValueError and others if it does not show what it claims."""
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header")))
    lower, upper = interval(arrays, header)
    need(header["lower"] <= lower, f"lower: {header['lower']} claimed, {lower} proved")
    need(upper <= header["upper"], f"upper: {header['upper']} claimed, {upper} proved")
    return header


def check_files(arguments: list[str]) -> int:
    """Check files; the status is 0 if all of them show what they claim."""
    status = 0
    for path in arguments:
        try:
            header = check(path)
            text = f"PASS: least energy in [{header['lower']}, {header['upper']}]"
        except Exception as error:  # whatever is wrong with a file, it does not pass
            text = f"FAIL: {error!r}"
            status = 1
        sys.stdout.write(f"{path}: {text}\n")
    return status


if __name__ == "__main__":
    sys.exit(check_files(sys.argv[1:]))
