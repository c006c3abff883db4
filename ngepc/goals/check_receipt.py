"""Check a receipt: a least energy, and a force or displacement, lie in intervals.  numpy alone.

    python check_receipt.py receipt.npz

A body of triangles or tetrahedra K has forces f and tractions g, is held on parts of its boundary
and may touch an obstacle, u . n <= psi.  With the mean m and the deviator e of eps(u)
    J(u) = int phi(eps(u)) - f . u - boundary int g . u
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
         + int |S - t + T - t_z|^2/(4 C) + (X - |y|^2/4)/(2 mu) + R,
    and -Q has the same bound with -c, -z, -T, -q.
Tensors have coordinates in an orthonormal basis, first m; fields have Bernstein coefficients, of
vertices, then of the edges opposite to them.  Proofs are in docs/receipts.md.
"""

import json
import math
import sys

import numpy as np
from numpy import einsum, ndarray

FORMAT = "ngepc receipt 9"
EPS = 16 * 2.0**-52
LARGEST = 1e20  # number
KORN = {2: 2.7, 3: 6.3}
BASIS = np.zeros((7, 3, 3))  # of tensors: two means, and deviators
BASIS[:4, [0, 1, 2], [0, 1, 2]] = [[1, 1, 0], [1, 1, 1], [1, -1, 0], [1, 1, -2]]
BASIS[[4, 5, 6], [0, 0, 1], [1, 2, 2]] = BASIS[[4, 5, 6], [1, 2, 2], [0, 0, 1]] = 1
BASIS /= np.sqrt((BASIS**2).sum(axis=(1, 2), keepdims=True))
LAWS = {"two-dimensional": [0, 2, 4], "plane strain": [1, 2, 4, 3]}
LAWS["solid"] = [1, 2, 4, 3, 5, 6]
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
    return float(x.sum() + x.size * EPS * np.abs(x).sum() + 1e-60)


def lengths(a: ndarray) -> ndarray:
    """Norms (k, K) of the coefficients of fields (k, c, K)."""
    return np.sqrt(einsum("kcK,kcK->kK", a, a))


def size(a: ndarray) -> ndarray:
    """Norms of all numbers of each cell, the last axis."""
    return lengths(a.reshape(1, -1, a.shape[-1]))[0]


def inner(a: ndarray, b: ndarray, M: ndarray | None = None) -> ndarray:
    """Means of the products of two fields (k, c, ...)."""
    M = MEANS[len(a)] if M is None else M
    return einsum("kc...,kc...->...", (M @ a.reshape(len(a), -1)).reshape(a.shape), b)


def outside(x: ndarray, V: ndarray) -> tuple[ndarray, ndarray]:
    """What of the coefficients of a field exceeds a ball, and its lengths."""
    length = lengths(x)
    over = np.maximum(length - V, 0.0)
    return x * (over / np.maximum(length, V))[:, None], over


def norms(x: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Means of |x| from above and from below, and x along its mean (k, K)."""
    length = lengths(x)
    largest = length.max(axis=0) + 1 / LARGEST
    n = x.mean(axis=0)
    along = einsum("kcK,cK->kK", x, n / (size(n) + 1 / LARGEST))
    mean = along.mean(axis=0)
    across = inner(x, x) - inner(along[:, None], along[:, None])
    least = np.maximum(along.min(axis=0), largest / 4)
    sharp = (along >= least).all(axis=0)
    upper = np.where(sharp, mean + across / (2 * least), length.mean(axis=0))
    return upper, mean + across / (2 * largest), along


def squared_excess(v: ndarray, V: ndarray) -> ndarray:
    """Means of ([|v| - V]_+)^2 from above: by |v| - V itself, or by what exceeds the ball."""
    x, _ = outside(v, V)
    apart = inner(v, v) - V * (2 * norms(v)[1] - V)
    return np.minimum(apart, inner(x, x))


def supremum(y: ndarray, v: ndarray, r: ndarray, H: ndarray, beta: ndarray) -> ndarray:
    """Means of X - |y|^2/4 from above.  With A = beta D, W = V + 2 b r, any r >= 0 and D.

    X <= |y - D|^2/4 + |A + r v| - r (V + b r) + ([|v| - W]_+^2 + [l]_+^2)/(4 b),
    l = W - (|A + r v| - |A|)/r, or 0 where r = 0.
    """
    b = H * (1 + H)
    V = beta * (1 + 2 * H)
    r = np.clip(r, 0.0, np.maximum(lengths(v).max(axis=0) - V, 0.0) / b)
    W = V + 2 * b * r
    D, over = outside(y, 2 * beta)
    upper, _, along = norms(beta * D + r * v)
    gained = (along - beta * over) / np.where(r > 0, r, 1.0)
    short = np.where(r > 0, np.maximum(W - gained, 0.0), 0.0)[:, None]
    square = squared_excess(v, W) + inner(short, short)
    return inner(D, D - 2 * y) / 4 + upper - r * (V + b * r) + square / (4 * b)


def arrays_in(words: ndarray, header: dict) -> dict:
    """The arrays of a receipt by their names."""
    c = len(LAWS[header["kinematics"]])
    P, K, B = header["sizes"]
    N = 3 if c == 6 else 2
    L = 2 if "goal" in header else 1
    order = header["order"]
    need(order in (1, 2) and N + order < 5, "order: neither one nor two")
    k = order * (N + 1)
    t = order + N - 1
    shapes = {
        "points": (N, P), "cells": (k, K), "other": (N + 1, K), "u": (N, L, P),
        "stress": (k, c, L, K), "law": (2 + 2 * c, K), "body_force": (N, L, K),
        "passed": (N, N + 1, K), "tangent": (2 * L - 2, K), "held": (N, B),
        "contact": (B,), "traction": (t, N, L, B), "gap": (t, L, B), "pressure": (t, L, B),
    }  # fmt: skip
    record = np.dtype([(name, float, shape) for name, shape in shapes.items()])
    length = sum(math.prod(shape) for shape in shapes.values())
    right = words.dtype == float and words.shape == (length,)
    right = right and record.itemsize == 8 * length  # which may overflow
    need(right, "receipt: its arrays have other types or sizes")
    need(max(-words.min(), words.max()) < LARGEST, "numbers: too large, or none")
    return {name: words.view(record)[name][0] for name in shapes}


class Body:
    """A body of K simplices: the last axis of arrays, or that of B sides of the boundary."""

    def __init__(self, words: ndarray, header: dict) -> None:
        vars(self).update(arrays_in(words, header))
        self.N, self.L, self.K = self.body_force.shape
        self.degree = header["order"]
        self.cells = self.cells.astype(int)
        self.other = self.other.astype(int).ravel()
        need((self.law[:4] > 1 / LARGEST).all(), "law: a modulus is not positive")
        self.bulk, self.mu, self.hardening, self.beta = self.law[:4]
        self.initial, self.back = np.split(self.law[4:], 2)
        self.soft = 1 / (1 / (2 * self.mu) + 1 / self.hardening)
        v = np.arange(self.N + 1)
        self.between = BETWEEN if self.degree == 2 else v[:, None]
        self.on_side = [[*v[v != i], i + len(v)][: len(self.gap)] for i in v]
        self.measure(BASIS[LAWS[header["kinematics"]], : self.N, : self.N])
        self.join()
        self.balance()
        self.displace()

    def measure(self, matrices: ndarray) -> None:
        """Volumes, outward normals times areas of sides, and their products with tensors."""
        N = self.N
        corners = self.points.take(self.cells[: N + 1], axis=1)
        E = corners[:, :N] - corners[:, N:]
        if N == 2:
            cofactors = np.array([[E[1, 1], -E[1, 0]], [-E[0, 1], E[0, 0]]])
        else:
            cofactors = np.cross(E[:, [1, 2, 0]], E[:, [2, 0, 1]], axis=0)
        det = (E[:, 0] * cofactors[:, 0]).sum(axis=0)
        self.length = size(E)
        flat = np.abs(det) <= 1e-9 * self.length**N + LARGEST**-2
        need(not flat.any(), "cells: a cell is too flat")
        self.volume = np.abs(det) / math.factorial(N)
        self.steep = size(cofactors) / np.abs(det)
        self.wrong = EPS * (self.length * self.steep) ** (N - 1)
        last = cofactors.sum(axis=1, keepdims=True)
        self.area = np.concatenate([-cofactors, last], axis=1) * np.sign(det) / (N - 1)
        self.across = einsum("cxy,yvK->vcxK", matrices, self.area)

    def join(self) -> None:
        """Sides by place (number in K, K); those of the boundary have no other place."""
        ends = np.concatenate(self.cells[self.on_side], axis=1)
        area = self.area.reshape(self.N, -1)
        places = np.arange(self.other.size)
        joined = self.other != places
        right = (ends == ends.take(self.other, axis=1)).all()
        right = right and (self.other.take(self.other) == places).all()
        need(right, "other: not the other side")
        apart = (area * area.take(self.other, axis=1)).sum(axis=0) < 0
        need((apart == joined).all(), "cells: two overlap at their side")
        self.out = np.flatnonzero(~joined)
        self.ends = ends[:, self.out]
        vertices = np.unique(np.sort(self.ends[: self.N], axis=0), axis=1)
        right = vertices.shape[1] == len(self.out) == len(self.contact)
        need(right and vertices.min() >= 0, "held: not the sides of the boundary")
        self.outer = size(area[:, self.out])
        self.normal = area[:, self.out] / self.outer
        across = self.held.all(axis=0) | (np.abs(self.normal) > 0.8)
        self.holds = (self.held != 0) & across

    def balance(self) -> None:
        """Forces of 2 in K and on its sides by components, with what rounding adds."""
        inside = -self.body_force * self.volume
        sides = []
        for v, across in enumerate(self.across):
            T = einsum("kcLK,cxK->kxLK", self.stress, across)
            inside = inside + self.degree / self.N * T[self.between[v]]
            sides.append(T[self.on_side[v]])
        jump = np.concatenate(sides, axis=-1)
        pulled = self.traction - self.pressure[:, None] * self.normal[:, None]
        left = jump[..., self.out] - pulled * self.outer
        jump[..., self.out] = np.where(self.held[:, None], 0.0, left)
        jump += jump.take(self.other, axis=-1)
        jump = np.abs(jump).max(axis=0).sum(axis=1).reshape(self.N, -1, self.K)
        pulls = size(self.traction) + size(self.pressure)
        load = np.bincount(self.out % self.K, pulls, self.K)
        load += size(self.stress) + self.length * size(self.body_force)
        self.load = load * self.length ** (self.N - 1)
        self.force = np.abs(inside).max(axis=0).sum(axis=1) + jump.sum(axis=1) / 2
        self.force += 9 * EPS * self.load

    def displace(self) -> None:
        """Strains, trial stresses and works, the room at the obstacle, and rounding of all."""
        local = np.moveaxis(self.u.take(self.cells, axis=2), 2, 0)
        change = local - local[self.N]
        strain = einsum("vkxLK,vcxK->kcLK", change[self.between], self.across)
        strain *= -self.degree / (self.N * self.volume)
        if self.degree == 2:
            middle = (strain[[1, 0, 0]] + strain[[2, 2, 1]]) / 2
            strain = np.concatenate([strain, middle])
        self.moduli = np.stack([self.bulk] + [2 * self.mu] * len(self.back))
        self.trial = self.moduli[:, None] * strain
        self.trial[:, 1:, 0] -= 2 * self.mu * self.initial
        done = einsum("xGK,xHK->GHK", self.body_force, local.mean(axis=0))
        u = np.moveaxis(self.u.take(self.ends, axis=2), 2, 0)
        M = CURVED if self.degree == 2 else None
        pulled = inner(self.traction[:, :, :, None], u[:, :, None], M)
        self.work = np.append(self.volume * done, self.outer * pulled, axis=-1)
        self.room = self.gap - einsum("txLB,xB->tLB", u, self.normal)
        self.near = (self.N * np.abs(u).max(axis=1) + np.abs(self.gap)).sum(axis=1)
        opened = inner(self.pressure[:, None], self.room[:, None, :1], M)
        self.opened = self.outer * opened
        slope = self.degree**1.5 * self.N * self.steep * size(change)
        rest = size(self.stress[:, 1:]) + size(self.back)
        rest += 2 * self.mu * (slope + size(self.initial))
        mean = size(self.stress[:, 0]) + self.bulk * slope
        density = self.volume * (mean**2 / self.bulk + rest**2 / self.soft)
        self.moves = 2 * (self.N * np.abs(self.u).max() + np.abs(self.gap).max())
        self.rest = 30 * self.L * self.wrong * (density + self.load * self.moves)

    def defect(self) -> float:
        """The number b of 2."""
        passed = self.passed.reshape(self.N, -1)
        right = (passed >= 0).all() and not passed[:, self.out][~self.holds].any()
        need(right, "passed: negative, or to where nothing holds the body")
        gets = passed.take(self.other, axis=1)
        gets[:, self.out] = 0
        gets = gets.reshape(self.passed.shape).sum(axis=1)
        total = self.passed.sum(axis=1)
        need((total > (1 + EPS) * (self.force + gets)).all(), "passed: too little")
        reach = math.dist(self.points.min(axis=1), self.points.max(axis=1))
        b = 12.1 * KORN[self.N] * reach * total.sum(axis=0)
        b *= self.steep * self.length ** (self.N + 1) / self.volume**1.5
        return math.sqrt((b**2 / np.minimum(self.soft, self.bulk)).sum())

    def obstacle(self) -> None:
        """|q| <= P, and |c - z . n| <= psi - u . n; P = q = 0 where no obstacle is."""
        P = self.pressure[:, 0] - np.abs(self.pressure[:, 1:]).sum(axis=1)
        right = (P >= 0).all() and not self.pressure[..., self.contact == 0].any()
        need(right, "pressure: negative, or too large beside another")
        c = self.room[:, 0] - np.abs(self.room[:, 1:]).sum(axis=1)
        c = (c - self.wrong.max() * self.near)[:, self.contact != 0]
        right = (c[: self.N] >= 0).all()
        right = right and (c[self.N :] >= -(1 - EPS) * np.sqrt(c[0] * c[1])).all()
        need(right, "u: inside the obstacle, or the adjoint wrong there")

    def densities(self) -> tuple[ndarray, ndarray, dict]:
        """1: those of J(u), and of what it exceeds J(v) by; 3: those of both ends of a goal."""
        t = self.trial[:, :, 0]
        s = t[:, 1:] - self.back
        x = self.stress[:, 1:, 0] - self.back
        p, _ = outside(s, self.beta)
        E = self.beta * norms(p)[0] + inner(p, p / 2 - s)
        E /= 2 * self.mu + self.hardening
        J = inner(t, t / self.moduli) / 2 - self.mu * (self.initial**2).sum(axis=0) + E
        excess = squared_excess(x, self.beta)
        missing = self.stress - self.trial
        square = inner(missing[:, :, 0], missing[:, :, 0] / self.moduli)
        gap = square / 2 + E + excess / (2 * self.hardening)
        H = self.hardening / (2 * self.mu)
        ends = {}
        for sign, hint in zip((-1, 1), self.tangent, strict=False):
            p = x + sign * self.stress[:, 1:, 1]
            y = p + s - sign * self.trial[:, 1:, 1]
            X = supremum(y, p + H * y, hint, H, self.beta) / (2 * self.mu)
            both = missing[:, :, 0] + sign * missing[:, :, 1]
            own = inner(t, self.trial[:, :, 1] / self.moduli)
            ends[sign] = X + inner(both, both / self.moduli) / 4 - sign * own
        return J, gap, ends

    def intervals(self, factor: float) -> dict:
        """What the least energy lies between, and a goal if there is one."""
        need(1 / LARGEST < factor < LARGEST, "factor: not positive, or too large")
        self.obstacle()
        b = self.defect()
        J, gap, ends = self.densities()
        J = np.append(self.volume * J, -self.work[0, 0])
        gap = most(self.volume * gap, self.opened[0], self.rest)
        missed = b * (b + math.sqrt(b**2 + 2 * gap))
        proved = {"lower": -most(-J, gap, self.rest, missed)}
        proved["upper"] = most(J, self.rest)
        for sign, X in ends.items():
            works = sign * (self.work[0, 1] + self.work[1, 0])
            pushes = self.opened[0] + sign * self.opened[1]
            end = most(works, pushes, self.volume * X, 3 * self.rest, missed)
            proved["goal lower" if sign < 0 else "goal upper"] = sign * factor * end
        return proved


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    with open(path, "rb") as words, np.lib.npyio.NpzFile(words) as file:
        header = json.loads(str(file["header"]))
        need(header["format"] == FORMAT, f"format: not {FORMAT!r}, write it again")
        proved = Body(file["receipt"], header).intervals(float(header.get("factor", 1)))
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
