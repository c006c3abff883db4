"""Check a receipt: python check_receipt.py receipt.npz (numpy alone; proofs: docs/receipts.md).

A body of triangles or tetrahedra K has forces f and tractions g, is held on parts of its boundary
and may touch an obstacle, u . n <= psi.  C multiplies means by B and deviators by 2 mu.  The energy
    J(u) = int phi(eps(u)) - f . u - boundary int g . u  has the density
    phi = min over deviators p of |C (eps - p_0 - p)|^2/(2 C) - k + a : p + h/2 |p|^2 + beta |p|.
For an admissible u let t = C (eps(u) - p_0).  S is in equilibrium with f and g - P n, where P >= 0.
With s = dev t - a, x = dev S - a, the solution v, and the work R of forces that S leaves,
    phi = |t|^2/(2 C) - k + E,  E = -([|s| - beta]_+)^2/(4 mu + 2 h),  R^2 <= 2 b^2 (J(u) - J(v)),
    J(u) - J(v) <= int |S - t|^2/(2 C) + E + ([|x| - beta]_+)^2/(2 h) + int P (psi - u . n) + R.
A factor times Q = int F . v + int G . v + int c P - int (reaction) . V is a goal.  The second layer
of arrays has F, G, c, V, and z, T, q in the places of u, S, P.  With t_z = C eps(z), |q| <= P,
|c - z . n| <= psi - u . n,  y = x + s + dev (T - t_z),  w = x + dev T + h/(2 mu) y, and the number
X of the lemma,  Q <= int F . u + G . u + f . z + g . z - t : eps(z) + int (q + P) (psi - u . n)
    + int |S - t + T - t_z|^2/(4 C) + (X - |y|^2/4)/(2 mu) + R,  also for -Q, -c, -z, -T, -q.
"""

import json
import math
import sys

import numpy as np
from numpy import einsum, ndarray

FORMAT = "ngepc receipt 12"
EPS = 16 * 2.0**-52
LARGEST = 1e20  # number
KORN = {2: 2.7, 3: 6.3}
BASIS = np.zeros((7, 3, 3))  # of tensors: two means, and deviators
BASIS[:4, [0, 1, 2], [0, 1, 2]] = [[1, 1, 0], [1, 1, 1], [1, -1, 0], [1, 1, -2]]
BASIS[[4, 5, 6], [0, 0, 1], [1, 2, 2]] = BASIS[[4, 5, 6], [1, 2, 2], [0, 0, 1]] = 1
BASIS /= np.sqrt((BASIS**2).sum(axis=(1, 2), keepdims=True))
LAWS = {"two-dimensional": [0, 2, 4], "plane strain": [1, 2, 4, 3]}
LAWS["solid"] = [1, 2, 4, 3, 5, 6]
BETWEEN = {(1, n): np.arange(n)[:, None] for n in (3, 4)}  # coefficients of a vertex
PAIRS, MEANS = {}, {}  # the vertices of coefficients of quadratics; means of products
for n in (2, 3, 4):
    i, j = PAIRS[n] = np.hstack([[range(n)] * 2, np.flip(np.triu_indices(n, 1), 1)])
    A = np.eye(n)[i] + np.eye(n)[j]
    BETWEEN[2, n] = (A.T[:, None] * A.T).argmax(axis=2)
    M = 4 * (1 + A @ A.T + np.eye(len(A))) / math.perm(n + 3, 4)
    MEANS[2, n] = MEANS[len(A)] = M
MEANS |= {k: (1 + np.eye(k)) / (k * (k + 1)) for k in (1, 2, 3, 4)}


def need(condition: object, message: str) -> None:
    """Refuse the receipt unless all conditions hold."""
    if condition is not True and not np.all(condition):
        raise ValueError(message)


def most(*terms: object) -> float:
    """No less than the sum of all numbers."""
    x = np.concatenate([np.ravel(term) for term in terms])
    return float(x.sum() + x.size * EPS * np.abs(x).sum() + 1e-60)


def size(a: ndarray, *kept: int) -> ndarray:
    """Norms of all numbers of each cell, the last axis, or of each of the kept ones."""
    axes = list(range(a.ndim))
    return np.sqrt(einsum(a, axes, a, axes, [*kept, axes[-1]]))


def inner(a: ndarray, b: ndarray) -> ndarray:
    """Means of the products of two fields (k, c, K)."""
    if len(a) > 4:
        return einsum("kcK,kcK->K", einsum("kl,lcK->kcK", MEANS[len(a)], a), b)
    return einsum("kcK,kcK->K", a + a.sum(axis=0), b) / (len(a) * (len(a) + 1))


def outside(x: ndarray, V: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """What of the coefficients of a field exceeds a ball, its lengths, and theirs (k, K)."""
    length = size(x, 0)
    larger = np.maximum(length, V)
    return x * (1 - V / larger)[:, None], larger - V, length


def supremum(y: ndarray, w: ndarray, r: ndarray, H: ndarray, beta: ndarray) -> ndarray:
    """Means of X - |y|^2/4 from above, by the lemma with any r >= 0 and D."""
    b, W = H * (1 + H), beta + 2 * H * (beta + (1 + H) * r)
    near, far = beta * y, r * w
    z, reach, length = outside(near + far, 2 * beta**2)
    A = z - far
    n = z.sum(axis=0)
    gained = einsum("kcK,cK->kK", z, n / (size(n) + 1 / LARGEST)) - size(A, 0)
    gained /= np.where(r > 0, r, LARGEST)
    short = np.maximum((r > 0) * W, gained) - gained
    excess, over, _ = outside(w, W)
    spare = b * np.maximum(2 * beta - length.max(axis=0) / beta, 0.0) ** 2 * (r == 0)
    less = (np.maximum(over**2, spare) - spare).mean(axis=0)
    square = np.minimum(inner(excess, excess), less) + (short**2).mean(axis=0)
    upper = np.minimum(np.sqrt(inner(z, z)), reach.mean(axis=0))
    change = inner(A, A - 2 * near) / (2 * beta) ** 2
    return change + upper - r * (W - b * r) + square / (4 * b)


def arrays_in(words: ndarray, header: dict) -> dict:
    """The arrays of a receipt by their names."""
    c = len(LAWS[header["kinematics"]])
    P, K, B = header["sizes"]
    N, L = 3 if c == 6 else 2, 2 if "goal" in header else 1
    k, t = (math.comb(n + header["order"], n) for n in (N, N - 1))
    shapes = {
        "points": (N, P), "cells": (k, K), "other": (N + 1, K), "u": (L, N, P),
        "stress": (L, k, c, K), "law": (4 + 2 * c, K), "body_force": (L, N, K),
        "passed": (N, N + 1, K), "arm": (N, K), "tangent": (2 * L - 2, K), "held": (N, B),
        "traction": (L, N, t, B), "gap": (L, t, B), "pressure": (L, t, B)}  # fmt: skip
    record = np.dtype([(name, float, shape) for name, shape in shapes.items()])
    length = sum(math.prod(shape) for shape in shapes.values())
    need(words.dtype == float and words.shape == (length,), "receipt: other sizes")
    need(words.nbytes == record.itemsize, "receipt: too large")
    need(max(-words.min(), words.max()) < LARGEST, "numbers: too large, or none")
    return {name: words.view(record)[name][0] for name in shapes}


class Body:
    """A body of K simplices: the last axis of arrays, or that of B sides of the boundary."""

    def __init__(self, words: ndarray, header: dict) -> None:
        vars(self).update(arrays_in(words, header), degree=header["order"])
        self.L, self.N, self.K = self.body_force.shape
        self.cells = np.abs(self.cells).astype(int)
        self.other = self.other.astype(int).ravel()
        self.bulk, self.mu, self.hardening, self.beta = self.law[:4]
        need(self.law[:4] > 1 / LARGEST, "law: a modulus is not positive")
        self.soft = 1 / (1 / (2 * self.mu) + 1 / self.hardening)
        self.between = BETWEEN[self.degree, self.N + 1]
        self.on_side = [np.delete(range(len(self.cells)), k) for k in self.between]
        self.measure(BASIS[LAWS[header["kinematics"]], : self.N, : self.N])
        self.displace()
        self.balance()

    def measure(self, matrices: ndarray) -> None:
        """Volumes, and sides by place (number in K, K): areas, normals and what is beyond."""
        N = self.N
        corners = self.points.take(self.cells[: N + 1], axis=1)
        E = corners[:, :N] - corners[:, N:]
        if N == 2:
            cofactors = np.array([[E[1, 1], -E[1, 0]], [-E[0, 1], E[0, 0]]])
        else:
            cofactors = np.cross(E[:, [1, 2, 0]], E[:, [2, 0, 1]], axis=0)
        det = (E[:, 0] * cofactors[:, 0]).sum(axis=0)
        self.length = size(E)
        need(np.abs(det) > 1e-9 * self.length**N + LARGEST**-2, "cells: too flat")
        self.volume = np.abs(det) / math.factorial(N)
        self.steep = size(cofactors) / np.abs(det)
        self.wrong = EPS * (self.length * self.steep) ** (N - 1)
        cofactors *= np.sign(det) / (N - 1)
        self.area = np.append(-cofactors, cofactors.sum(axis=1)[:, None], axis=1)
        self.across = einsum("cxy,yvK->xvcK", matrices, self.area)
        ends = np.concatenate(self.cells[self.on_side], axis=1)
        area = self.area.reshape(self.N, -1)
        places = np.arange(self.other.size)
        need(self.other.take(self.other) == places, "other: not the other side")
        need(ends == ends.take(self.other, axis=1), "other: not the other side")
        self.joined = (area * area.take(self.other, axis=1)).sum(axis=0) < 0
        need(self.joined == (self.other != places), "cells: two overlap at their side")
        self.out = np.flatnonzero(~self.joined)
        self.ends = ends[:, self.out]
        once = set(map(frozenset, self.ends[: self.N].T.tolist()))
        need(len(once) == len(self.out) == self.held.shape[1], "held: not the boundary")
        self.outer = size(area[:, self.out])
        self.normal = area[:, self.out] / self.outer
        across = self.held.all(axis=0) | (np.abs(self.normal) > 0.8)
        self.holds = (self.held != 0) & across

    def displace(self) -> None:
        """Strains, trial stresses and works, and the room at the obstacle."""
        local = self.u.take(self.cells, axis=2)
        change = local - local[:, :, self.N, None]
        strain = einsum("LxvkK,xvcK->LkcK", change[:, :, self.between], self.across)
        self.moduli = np.stack([self.bulk] + [2 * self.mu] * (self.stress.shape[2] - 1))
        self.trial = self.moduli * (-self.degree / self.N / self.volume) * strain
        self.trial[0] -= self.law[5 : 5 + len(self.moduli)]
        self.grad = self.degree**1.5 * self.N * self.steep * size(change)
        u = self.u.take(self.ends, axis=2)
        room = self.gap - einsum("LxtB,xB->LtB", u, self.normal)
        near = 3 * self.wrong.max() * (np.abs(u).sum((0, 1)) + np.abs(self.gap).sum(0))
        least = room[0] - np.abs(room[1:]).sum(axis=0) - near
        least[2 : 6 // self.N] += (1 - EPS) * np.sqrt(np.abs(least[0] * least[1]))
        need(least >= 0, "u: inside the obstacle, or the adjoint wrong there")
        P = self.pressure[0] - np.abs(self.pressure[1:]).sum(axis=0)
        need(P >= 0, "pressure: negative, or too large beside another")
        M = MEANS[(2, self.N) if self.degree == 2 else self.N][..., None] * self.outer
        self.opened = einsum("stB,LsB,tB->LB", M, self.pressure, room[0] + near)
        pulled = einsum("stB,GxsB,HxtB->GHB", M, self.traction, u)
        done = einsum("GxK,HxK->GHK", self.body_force * self.volume, local.mean(axis=2))
        self.work = np.append(done, pulled, axis=-1)

    def balance(self) -> None:
        """Sizes of the forces that S leaves, by components and cells, and all rounding."""
        self.parts = self.stress, self.trial, self.moduli, self.law
        S, t = (np.array([size(a[:, :, 0]), size(a[:, :, 1:])]) for a in self.parts[:2])
        pulls = size(self.traction) + size(self.pressure)
        load = size(S) + self.length * size(self.body_force)
        load += np.bincount(self.out % self.K, pulls, self.K)
        load *= self.length ** (self.N - 1)
        S += 2 * size(self.law[5:])
        most = 4 * self.mu * (S + t)[1] / self.hardening
        self.tangent = np.clip(self.tangent, 0.0, most)
        grad = self.grad * self.moduli[:2]
        w = (S + grad) * (S + t + self.wrong * grad) / np.array([self.bulk, self.soft])
        w = self.volume * w.sum(axis=0) + 2 * self.N * np.abs(self.u).max() * load
        self.rest = 30 * self.L * self.wrong * w
        self.force = np.tile(6 * EPS * load, (self.N, 1))
        for i in range(self.L):
            T = einsum("kcK,xvcK->xvkK", self.stress[i], self.across)
            inside = sum(T[:, v, k] for v, k in enumerate(self.between)) * self.degree
            inside = inside / self.N - (self.body_force[i] * self.volume)[:, None]
            jump = np.dstack([T[:, v, k] for v, k in enumerate(self.on_side)])
            pulled = self.traction[i] - self.pressure[i] * self.normal[:, None]
            jump[..., self.out] -= pulled * self.outer
            jump[..., self.out] *= (self.held == 0)[:, None]
            jump += jump.take(self.other, axis=2)
            jump = np.abs(jump).max(axis=1).reshape(self.N, -1, self.K).sum(axis=1)
            self.force += np.abs(inside).max(axis=1) + jump / 2

    def defect(self) -> float:
        """The number b: |R| <= b (2 J(u) - 2 J(v))^(1/2)."""
        goes = np.abs(self.passed)
        both = np.stack([goes, goes * self.arm[:, None]]).reshape(2, self.N, -1)
        both[..., self.out] *= self.holds
        gets = both.take(self.other, axis=2) * self.joined
        goes, turn = both.reshape(2, *self.passed.shape).sum(axis=2)
        gets, due = gets.reshape(2, *self.passed.shape).sum(axis=2)
        need(goes > (1 + EPS) * (self.force + gets), "passed: too little")
        need(turn > (1 + EPS) * (due + self.length * (self.force + goes)), "arm: short")
        b = 10.9 * KORN[self.N] * turn.sum(axis=0)
        b *= self.steep * self.length ** (self.N + 1) / self.volume**1.5
        return math.sqrt((b**2 / np.minimum(self.soft, self.bulk)).sum())

    def densities(self, cells: slice) -> ndarray:
        """Those of J(u), of what it exceeds J(v) by, and of the ends of a goal, by cells."""
        stress, trial, moduli, law = (part[..., cells] for part in self.parts)
        if self.degree == 2:  # as quadratics
            trial = trial[:, PAIRS[self.N + 1]].mean(axis=1)
        mu, h, beta = law[1:4]
        H = h / (2 * mu)
        back = law[5 + len(moduli) :]
        s = trial[0, :, 1:] - back
        x = stress[0, :, 1:] - back
        p, over, _ = outside(s, beta)
        mean = np.minimum(np.sqrt(inner(p, p)), over.mean(axis=0))
        E = (beta * mean + inner(p, p / 2 - s)) / (2 * mu + h)
        J = inner(trial[0], trial[0] / moduli) / 2 + E - law[4]
        excess = outside(x, beta)[0]
        apart = inner(x, x) - beta * (2 * size(x.mean(axis=0)) - beta)
        missing = stress - trial
        lack = [inner(missing[0], m / moduli) for m in missing]
        rows = [J, lack[0] / 2 + E + np.minimum(inner(excess, excess), apart) / (2 * h)]
        for T, t, m in zip(stress[1:], trial[1:], missing[1:], strict=True):
            even = (lack[0] + inner(m, m / moduli)) / 4
            odd = lack[1] / 2 - inner(trial[0], t / moduli)
            for sign, r in zip((-1, 1), self.tangent[:, cells], strict=True):
                y = x + s + sign * m[:, 1:]
                X = supremum(y, x + sign * T[:, 1:] + H * y, r, H, beta)
                rows.append(X / (2 * mu) + even + sign * odd)
        return np.array(rows)

    def intervals(self, factor: float) -> dict:
        """What the least energy lies between, and a goal if there is one."""
        need(1 / LARGEST < factor < LARGEST, "factor: not positive, or too large")
        b = self.defect()
        blocks = [slice(k, k + 8192) for k in range(0, self.K, 8192)]
        J, gap, *ends = np.concatenate([self.densities(k) for k in blocks], axis=1)
        J = np.append(self.volume * J, -self.work[0, 0])
        gap = most(self.volume * gap, self.opened[0], self.rest)
        lost = b * (b + math.sqrt(b**2 + 2 * gap))
        found = {"lower": -most(-J, gap, self.rest, lost), "upper": most(J, self.rest)}
        for sign, X in zip((-1, 1), ends, strict=False):
            works = sign * (self.work[0, 1] + self.work[1, 0])
            pushes = self.opened[0] + sign * self.opened[1]
            end = most(works, pushes, self.volume * X, 3 * self.rest, lost)
            found["goal lower" if sign < 0 else "goal upper"] = sign * factor * end
        return found


def check(path: str) -> str:
    """What a receipt shows; ValueError and others if it does not."""
    np.empty(4_000_000)  # freed at once; memory that is freed afterwards is used again
    with open(path, "rb") as file, np.lib.npyio.NpzFile(file) as members:
        header = json.loads(str(members["header"]))
        need(header["format"] == FORMAT, f"format: not {FORMAT!r}, write it again")
        members.zip.open("receipt.npy")  # file stands at its first byte
        words = np.lib.format.read_array(file)  # without the checksum, which takes time
    proved = Body(words, header).intervals(float(header.get("factor", 1)))
    for name, value in proved.items():
        need(type(header[name]) in (int, float), f"{name}: no number")
        right = header[name] <= value if "lower" in name else value <= header[name]
        need(right, f"{name}: {header[name]} claimed, {value} proved")
    text = "{sizes[1]} cells, {kinematics}: least energy in ({lower}, {upper})"
    goal = ", {goal!r} in ({goal lower}, {goal upper})" if "goal" in header else ""
    return (text + goal).format_map(header)


if __name__ == "__main__":
    try:
        sys.stdout.write(f"PASS: {check(sys.argv[1])}\n")
    except Exception as error:  # whatever is wrong with a file, it does not pass
        sys.exit(f"FAIL: {error!r}")
