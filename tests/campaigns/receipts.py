"""Receipts of random problems, changed in one number: none that claims too much may pass.

A judge that is independent of the checker decides whether a change falsifies the claim: it checks
supports, gap, signs, symmetry and equilibrium, and computes both energies by a rule of degree 20
instead of bounds.
"""

import json
import math
import tempfile
import time
from copy import copy
from dataclasses import dataclass
from itertools import combinations, islice
from pathlib import Path

import numpy as np
from campaigns.crossings import problem_of, random_draws
from campaigns.intervals import goals_of
from ngsolve import ET, IntegrationRule

from ngepc import error_bound, goal_bound, semismooth_newton, write_receipt
from ngepc.goals import check_receipt
from ngepc.goals.receipt_arrays import NO_OBSTACLE
from ngepc.goals.receipt_file import packed
from ngepc.studies.work import Work

ENERGIES = ("order 1", "order 2", "solid", "order 2, solid")
GOALS = tuple(f"goal, {kind}" for kind in ENERGIES)
KINDS = ENERGIES + GOALS
CHANGES = ("a little", "much", "sign", "zero", "swapped", "claim")
WRONG = 1e-7
"""Part of the largest stress, displacement or interval that the judge calls wrong."""
CHECKS = 3
"""Of so many checks of a receipt the fastest counts."""
MOST = 400
"""No more changes of one receipt are tried."""
GROWTH = np.append(0.0, np.geomspace(1e-3, 1.0, 40))
"""Plastic strains at which the judge looks for a supremum, over the largest one."""
AT_ONCE = 200
"""Suprema are found on so many cells at a time, so that numbers stay in the cache."""
OF_NODES = "points", "u", "z"
"""Arrays of nodes that suprema depend on."""
OF_CELLS = "stress", "tau", "mu", "hardening", "beta", "lame_lambda", "initial", "back"
"""Arrays of cells that suprema depend on."""
HEAD = ("group", "receipts", "changes that falsify", "of these pass", "harmless changes",
        "of these pass ", "check / solve", "check / solve and bound")  # fmt: skip


def bernstein(shares, k):
    """Bernstein's polynomials at barycentric points, (q, k)."""
    count = shares.shape[1]
    if k == 1:
        return np.ones((len(shares), 1))
    if k == count:
        return shares
    mixed = [2 * shares[:, i] * shares[:, j] for i, j in edges_of(count)]
    return np.column_stack([shares**2, *mixed])


def edges_of(count):
    """The vertices at the ends of the edges of a simplex with so many vertices, the last first."""
    return list(combinations(range(count), 2))[::-1]


def between(count):
    """The places of the coefficients of two vertices, (vertices, vertices)."""
    found = np.diag(np.arange(count))
    for number, (i, j) in enumerate(edges_of(count), start=count):
        found[i, j] = found[j, i] = number
    return found


def rule(N, degree=20):
    """Barycentric points and weights that add up to one."""
    shape = {1: ET.SEGM, 2: ET.TRIG, 3: ET.TET}[N]
    found = IntegrationRule(shape, degree if N < 3 else 8)
    points = np.array(found.points)[:, :N]
    weights = np.array(found.weights)
    points = np.column_stack([1 - points.sum(axis=1), points])
    return points, weights / weights.sum()


class Judge:
    """The claims of a receipt, checked by quadrature instead of bounds.

    ``before`` is the judge of a receipt that differs in few cells: integrals of the others are
    taken from it.
    """

    def __init__(self, arrays, header, before=None):
        self.a = arrays = by_cells(by_layers(arrays, header), header)
        self.header = header
        self.before = before
        self.N = arrays["points"].shape[1]
        self.n = arrays["stress"].shape[-1]
        corners = arrays["cells"][:, : self.N + 1]
        x = arrays["points"][corners]
        J = (x[:, 1:] - x[:, :1]).swapaxes(1, 2)
        self.volume = np.abs(np.linalg.det(J)) / math.factorial(self.N)
        inverse = np.linalg.inv(J)
        self.slopes = np.concatenate(
            [-inverse.sum(axis=1, keepdims=True), inverse], axis=1
        )

    @property
    def falsified(self):
        """Whether the file claims more than it proves."""
        return self._inadmissible() or self._energies_are_wrong()

    def _sides(self):
        """Sides by their ascending vertices -> (cell, opposite vertex) of one cell or two."""
        return sides_of(self.a["cells"][:, : self.N + 1])

    def _inadmissible(self):
        a = self.a
        if any(not np.isfinite(v).all() for v in a.values()):
            return True
        if min(self.volume.min(), a["mu"].min(), a["beta"].min()) <= 0:
            return True
        if a["hardening"].min() <= 0:
            return True
        sides = self._sides()
        rows = [tuple(row) for row in a["boundary"].tolist()]
        outer = {key for key, found in sides.items() if len(found) == 1}
        if set(rows) != outer or len(set(rows)) != len(rows) or self._torn(sides):
            return True
        loads = a["stress"], a["body_force"], a["traction"], a["pressure"]
        large = WRONG * np.abs(a["stress"]).max()
        self.reaction = self._reaction(*loads, sides, rows, large)
        if self.reaction is None or self._not_supported(sides, rows):
            return True
        if "goal" not in self.header:
            return False
        loads = a["tau"], a["goal_force"], a["goal_traction"], a["goal_pressure"]
        # the stress of the adjoint may be zero but for rounding
        large = max(self.header["factor"] * large, WRONG * np.abs(a["tau"]).max())
        if self._reaction(*loads, sides, rows, large) is None:
            return True
        return self._not_conditioned(sides, rows)

    def _torn(self, sides):
        """Whether two cells have different nodes on the side between them."""
        return any(
            len({tuple(self._nodes(cell, key)) for cell, _ in at}) > 1
            for key, at in sides.items()
        )

    def _places(self, cell, key, coefficients):
        """The places of the coefficients of a side with ascending vertices in those of a cell."""
        corners = self.a["cells"][cell, : self.N + 1].tolist()
        places = [corners.index(v) for v in key]
        if coefficients == len(corners):
            return places
        table = between(len(corners))
        ends = edges_of(len(key))
        return places + [int(table[places[i], places[j]]) for i, j in ends]

    def _nodes(self, cell, key):
        """The nodes of a side."""
        nodes = self.a["cells"][cell]
        return nodes[self._places(cell, key, len(nodes))].tolist()

    def _tractions(self, S, cell, k, key):
        """S n times the size of a side at its coefficients, by ascending vertices."""
        places = self._places(cell, key, S.shape[1])
        area = -self.N * self.volume[cell] * self.slopes[cell, k]
        return S[cell, places] @ area, area

    def _reaction(self, S, force, traction, P, sides, rows, large):
        """What supports do to a body with this stress; None if it is ``large`` out of balance."""
        a = self.a
        S = (S + S.swapaxes(2, 3))[..., : self.N, : self.N] / 2
        table = np.arange(self.N + 1)[None]
        degree = 1
        if S.shape[1] > self.N + 1:
            table = between(self.N + 1)
            degree = 2
        div = degree * np.einsum("kviab,kib->kva", S[:, table], self.slopes)
        size = self.volume ** (1 / self.N)
        rest = np.abs(div + force[:, None]).max(axis=(1, 2))
        if (rest * size).max() > large:
            return None
        for key, found in sides.items():
            if len(found) == 2:
                first, area = self._tractions(S, *found[0], key)
                second, _ = self._tractions(S, *found[1], key)
                if np.abs(first + second).max() > large * np.linalg.norm(area):
                    return None
        reaction = np.zeros_like(traction)
        for row, key in enumerate(rows):
            T, area = self._tractions(S, *sides[key][0], key)
            size = np.linalg.norm(area)
            load = traction[row] * size - np.outer(P[row], area)
            held = a["held"][row] != 0
            if np.abs(T - load)[:, ~held].max(initial=0.0) > large * size:
                return None
            reaction[row] = np.where(held, T - load, 0.0)
        return reaction

    def _on_side(self, values, sides, key):
        """Coefficients of a displacement on a side, and its outer normal times its size."""
        cell, k = sides[key][0]
        area = -self.N * self.volume[cell] * self.slopes[cell, k]
        return values[self._nodes(cell, key)], area

    def _not_supported(self, sides, rows):
        a = self.a
        large = WRONG * np.abs(a["u"]).max()
        self.moved = np.zeros_like(a["traction"])
        self.measure = np.zeros(len(rows))
        if (a["pressure"] < 0).any():
            return True
        shares = rule(self.N - 1)[0]
        self.room = np.zeros_like(a["gap"])
        for row, key in enumerate(rows):
            u, area = self._on_side(a["u"], sides, key)
            self.moved[row] = u
            self.measure[row] = np.linalg.norm(area)
            room = self.room[row] = a["gap"][row] - u @ area / self.measure[row]
            least = (bernstein(shares, len(room)) @ room).min()
            if min(least, *room[: self.N]) < -large:
                return True
        return False

    def _not_conditioned(self, sides, rows):
        """Whether the conditions on the obstacle fail."""
        a = self.a
        factor = self.header["factor"]
        if not factor > 0:
            return True
        large = WRONG * max(np.abs(a["z"]).max(), np.abs(a["goal_contact"]).max())
        most = factor * a["pressure"]
        if (np.abs(a["goal_pressure"]) > most + WRONG * most.max()).any():
            return True
        self.moved_z = np.zeros_like(a["traction"])
        shares = rule(self.N - 1)[0]
        for row, key in enumerate(rows):
            z, area = self._on_side(a["z"], sides, key)
            self.moved_z[row] = z
            missed = np.abs(
                bernstein(shares, len(z))
                @ (a["goal_contact"][row] - z @ area / self.measure[row])
            )
            room = bernstein(shares, len(z)) @ self.room[row]
            if (missed > factor * room + large).any():
                return True
        return False

    def _energies_are_wrong(self):
        width = self.header["upper"] - self.header["lower"]
        upper, lower = self.energies()
        wrong = not (
            upper <= self.header["upper"] + 1e-3 * width
            and self.header["lower"] - 1e-3 * width <= lower
        )
        if wrong or "goal" not in self.header:
            return wrong
        lower, upper = self.goal()
        width = self.header["goal upper"] - self.header["goal lower"]
        return not (
            upper <= self.header["goal upper"] + 1e-3 * width
            and self.header["goal lower"] - 1e-3 * width <= lower
        )

    def _strains(self, u, shares):
        """Strains of a displacement at points of all cells, (K, q, n, n)."""
        local = u[self.a["cells"]]
        N = self.N
        du = np.einsum("kia,kib->kab", local[:, : N + 1], self.slopes)[:, None]
        if local.shape[1] > N + 1:
            table = between(N + 1)
            du = 2 * np.einsum("kvia,kib->kvab", local[:, table], self.slopes)
        eps = np.zeros((*du.shape[:2], self.n, self.n))
        eps[..., :N, :N] = (du + du.swapaxes(2, 3)) / 2
        return np.einsum("qi,kiab->kqab", bernstein(shares, eps.shape[1]), eps)

    def _work(self, force, traction, u, moved):
        """The work of loads, by rules."""
        a = self.a
        shares, weights = rule(self.N)
        local = u[a["cells"]]
        at = np.einsum("qi,kia->kqa", bernstein(shares, local.shape[1]), local)
        done = self.volume @ (np.einsum("kqa,ka->kq", at, force) @ weights)
        shares, weights = rule(self.N - 1)
        at = bernstein(shares, traction.shape[1])
        pulled = ((at @ traction) * (at @ moved)).sum(axis=2)
        return float(done + self.measure @ (pulled @ weights))

    def _stress(self, e):
        """The law of the step for strains (K, q, n, n)."""
        a = self.a
        mu, h, beta = (a[k][:, None, None, None] for k in ("mu", "hardening", "beta"))
        B = a["lame_lambda"][:, None, None, None] + 2 * mu / self.n
        p_0 = deviator(symmetric(a["initial"]))
        back = deviator(symmetric(a["back"]))
        trial = 2 * mu * (deviator(e) - p_0) - back
        size = np.sqrt((trial**2).sum(axis=(2, 3), keepdims=True))
        over = np.maximum(size - beta, 0.0) / np.where(size > 0, size, 1.0)
        volume = np.trace(e - symmetric(a["initial"]), axis1=2, axis2=3)
        volume = volume[..., None, None]
        kept = trial * (1 - 2 * mu / (2 * mu + h) * over)
        return B * volume * np.eye(self.n) + kept + back, trial

    def goal(self):
        """The interval of the goal by the theorem as it is on the page; suprema by trial."""
        a = self.a
        factor = self.header["factor"]
        own, *highest = self.volume @ self._densities().T
        centre = self._work(a["goal_force"], a["goal_traction"], a["u"], self.moved)
        centre += self._work(a["body_force"], a["traction"], a["z"], self.moved_z)
        centre -= own
        side_shares, side_weights = rule(self.N - 1)
        on = bernstein(side_shares, a["gap"].shape[1]).T
        room = (self.room @ on) * self.measure[:, None]
        centre += ((a["goal_pressure"] @ on) * room @ side_weights).sum()
        opened = factor * ((a["pressure"] @ on) * room @ side_weights).sum()
        ends = []
        for sign, largest in zip((-1, 1), highest, strict=True):
            ends.append(float(centre + sign * (largest + opened)))
        return ends

    def _densities(self):
        """Means over cells of s : eps(z), and of the largest integrands of both ends, (3, K)."""
        if self.before is None:
            found = np.empty((3, len(self.volume)))
            cells = np.arange(len(self.volume))
        else:
            found = self.before.densities.copy()
            cells = np.flatnonzero(self._changed())
        for first in range(0, len(cells), AT_ONCE):
            some = cells[first : first + AT_ONCE]
            found[:, some] = self._part(some)._means()
        self.densities = found
        return found

    def _changed(self):
        """The cells in which something differs from ``before``, (K,); the factor is in all."""
        other = self.before.a
        different = (self.a["cells"] != other["cells"]).any(axis=1)
        different |= self.header["factor"] != self.before.header["factor"]
        for name in OF_NODES:
            moved = (self.a[name] != other[name]).any(axis=1)
            different |= moved[self.a["cells"]].any(axis=1)
        for name in OF_CELLS:
            rows = (self.a[name] != other[name]).reshape(len(different), -1)
            different |= rows.any(axis=1)
        return different

    def _part(self, cells):
        """The judge of some of the cells."""
        part = copy(self)
        part.a = self.a | {name: self.a[name][cells] for name in ("cells", *OF_CELLS)}
        part.slopes = self.slopes[cells]
        return part

    def _means(self):
        """Those of ``_densities``, of all cells at once."""
        a = self.a
        shares, weights = rule(self.N, 4)
        strain = self._strains(a["u"], shares)
        of_z = self._strains(a["z"], shares)
        at = bernstein(shares, a["stress"].shape[1])
        sigma = np.einsum("qi,kiab->kqab", at, symmetric(a["stress"]))
        tau = np.einsum("qi,kiab->kqab", at, symmetric(a["tau"]))
        own, trial = self._stress(strain)
        rows = [(own * of_z).sum(axis=(2, 3))]
        for sign in (-1, 1):
            loads = sign * of_z, sign * tau, sigma
            rows.append(self._highest((strain, own, trial), *loads))
        return np.stack(rows) @ weights

    def _highest(self, state, of_z, tau, sigma):
        """The largest integrand among strains on the curve that contains the best one."""
        a = self.a
        factor = self.header["factor"]
        strain, own, trial = state
        mu, h, beta = (a[k][:, None, None, None] for k in ("mu", "hardening", "beta"))
        B = a["lame_lambda"][:, None] + 2 * a["mu"][:, None] / self.n
        back = deviator(symmetric(a["back"]))
        p = (deviator(tau) + factor * (deviator(sigma) - back)) / (2 * mu)
        w = factor / (2 * mu) * trial - deviator(of_z)
        volume = np.trace(tau + factor * (sigma - own), axis1=2, axis2=3) / self.n
        volume -= B * np.trace(of_z, axis1=2, axis2=3)
        volume = (volume / (2 * factor * B) / self.n)[..., None, None] * np.eye(self.n)

        def value(t):
            """The integrand for a trial stress."""
            e = volume + (t - trial) / (2 * mu)
            change = self._stress(strain + e)[0] - own
            inner = tau * e - of_z * change - factor * e * (own + change - sigma)
            return inner.sum(axis=(2, 3))

        def norm(t):
            return np.maximum(np.sqrt((t**2).sum(axis=(2, 3), keepdims=True)), 1e-300)

        y = (p + w) * mu / factor
        best = value(y * np.minimum(1.0, beta / norm(y)))
        M = 2 * mu + h
        largest = (M * norm(p) + h * norm(w)) * mu / (factor * M * h)
        for part in GROWTH:
            g = part * largest
            v = (beta + M * g) * p + (beta + h * g) * w
            best = np.maximum(best, value((beta + M * g) * v / norm(v)))
        return best

    def energies(self):
        """J(u) and the dual energy of the stress, by rules."""
        a = self.a
        N = self.N
        n = self.n
        shares, weights = rule(N)
        local = a["u"][a["cells"]]
        du = np.einsum("kia,kib->kab", local[:, : N + 1], self.slopes)[:, None]
        if local.shape[1] > N + 1:
            table = between(N + 1)
            du = 2 * np.einsum("kvia,kib->kvab", local[:, table], self.slopes)
        eps = np.zeros((*du.shape[:2], n, n))
        eps[..., :N, :N] = (du + du.swapaxes(2, 3)) / 2
        eps = np.einsum("qi,kiab->kqab", bernstein(shares, eps.shape[1]), eps)
        S = np.einsum(
            "qi,kiab->kqab", bernstein(shares, a["stress"].shape[1]), a["stress"]
        )
        S = (S + S.swapaxes(2, 3)) / 2
        mu, h, beta = (a[k][:, None] for k in ("mu", "hardening", "beta"))
        B = a["lame_lambda"][:, None] + 2 * mu / n

        def deviator(T):
            m = np.trace(T, axis1=2, axis2=3) / n
            return m, T - m[..., None, None] * np.eye(n)

        def square(T):
            return (T**2).sum(axis=(2, 3))

        m, e = deviator(eps)
        m_0, p_0 = deviator(symmetric(a["initial"]))
        back = deviator((a["back"] + a["back"].swapaxes(2, 3)) / 2)[1]
        e = e - p_0
        s = 2 * mu[..., None, None] * e - back
        over = np.maximum(np.sqrt(square(s)) - beta, 0.0)
        phi = B * (n * (m - m_0)) ** 2 / 2 + mu * square(e) - a["stored"][:, None]
        phi -= over**2 / (2 * (2 * mu + h))
        p, d = deviator(S)
        over = np.maximum(np.sqrt(square(d - back)) - beta, 0.0)
        dual = p**2 / (2 * B) + n * p * m_0 + a["stored"][:, None]
        dual += square(d + 2 * mu[..., None, None] * p_0) / (4 * mu) - mu * square(p_0)
        dual += over**2 / (2 * h)
        u = np.einsum("qi,kia->kqa", bernstein(shares, local.shape[1]), local)
        phi -= np.einsum("kqa,ka->kq", u, a["body_force"])
        upper = self.volume @ (phi @ weights)
        lower = -self.volume @ (dual @ weights)
        shares, weights = rule(N - 1)
        at = bernstein(shares, a["traction"].shape[1])
        u, g, U, t = (
            at @ v for v in (self.moved, a["traction"], self.moved, self.reaction)
        )
        upper -= self.measure @ ((u * g).sum(axis=2) @ weights)
        lower += ((t * U).sum(axis=2) @ weights).sum()
        pressed = (a["pressure"] @ at.T) * (a["gap"] @ at.T)
        return float(upper), float(lower - self.measure @ (pressed @ weights))


ADJOINT = {
    "u": "z",
    "stress": "tau",
    "body_force": "goal_force",
    "traction": "goal_traction",
    "gap": "goal_contact",
    "pressure": "goal_pressure",
}
"""Names of the second layer of the arrays."""


def by_layers(arrays, header):
    """The arrays of a file without layers: those of the adjoint, times the factor, by name."""
    found = dict(arrays)
    for name, second in ADJOINT.items():
        found[name] = arrays[name][0]
        if len(arrays[name]) > 1:
            found[second] = header["factor"] * arrays[name][1]
    return found


def by_cells(arrays, header):
    """The arrays of a file with cells, nodes or sides first, and tensors as matrices."""
    N, n = {"two-dimensional": (2, 2), "plane strain": (2, 3), "solid": (3, 3)}[
        header["kinematics"]
    ]
    found = {name: np.moveaxis(values, -1, 0) for name, values in arrays.items()}
    law = found.pop("law")
    for column, name in enumerate(("bulk", "mu", "hardening", "beta")):
        found[name] = law[:, column]
    found["lame_lambda"] = (found.pop("bulk") - 2 * found["mu"]) / n
    found["stored"] = law[:, 4]
    swelling, start, back = np.split(law[:, 5:], [1, law.shape[1] // 2 - 2], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        start = np.hstack([swelling / law[:, :1], start / (2 * law[:, 1:2])])
    back = np.hstack([np.zeros((len(back), 1)), back])
    for name, values in (("initial", start), ("back", back)):
        found[name] = tensors(values, N, n)[:, None]
    for name in {"stress", "tau"} & set(found):
        found[name] = tensors(found[name], N, n)
    for name in {"traction", "goal_traction"} & set(found):
        found[name] = found[name].swapaxes(1, 2)
    sides = sides_of(found["cells"][:, : N + 1])
    free = [
        (k, cell, key) for key, at in sides.items() if len(at) == 1 for cell, k in at
    ]
    found["boundary"] = np.array([key for _, _, key in sorted(free)])
    found["held"] = found["held"] != 0
    return found


def tensors(x, N, n):
    """Symmetric matrices (..., n, n) from their coordinates in an orthonormal basis."""
    T = np.zeros((*x.shape[:-1], n, n))
    for i in range(n):
        T[..., i, i] = x[..., 0] / math.sqrt(n)
    difference = x[..., 1] / math.sqrt(2)
    T[..., 0, 0] += difference
    T[..., 1, 1] -= difference
    if n == 3:
        third = x[..., 3] / math.sqrt(6)
        T[..., 0, 0] += third
        T[..., 1, 1] += third
        T[..., 2, 2] -= 2 * third
    for place, (i, j) in zip((2, 4, 5), combinations(range(N), 2), strict=False):
        T[..., i, j] = T[..., j, i] = x[..., place] / math.sqrt(2)
    return T


def sides_of(cells):
    """Sides by their ascending vertices -> [(cell, opposite vertex), ...]."""
    seen = {}
    for number, row in enumerate(cells.tolist()):
        for k in range(len(row)):
            key = tuple(sorted(row[:k] + row[k + 1 :]))
            seen.setdefault(key, []).append((number, k))
    return seen


def symmetric(T):
    """The symmetric parts of tensors."""
    return (T + T.swapaxes(2, 3)) / 2


def deviator(T):
    """The deviators of tensors."""
    n = T.shape[-1]
    return T - np.trace(T, axis1=2, axis2=3)[..., None, None] / n * np.eye(n)


def falsifies(arrays, header, before=None):
    """Whether a receipt claims more than it proves; an invalid mesh proves nothing."""
    try:
        return Judge(arrays, header, before).falsified
    except (np.linalg.LinAlgError, IndexError, ZeroDivisionError, ValueError):
        return True


def changed(arrays, header, random):
    """A copy of a receipt with one number changed, and what was done."""
    arrays = {name: values.copy() for name, values in arrays.items()}
    header = dict(header)
    what = str(random.choice(CHANGES))
    if what == "claim":
        goal = "goal " if "goal" in header and random.random() < 0.5 else ""
        name = goal + str(random.choice(["lower", "upper"]))
        width = header[goal + "upper"] - header[goal + "lower"]
        header[name] += float(random.normal()) * width * 10 ** random.uniform(-2, 2)
        return arrays, header, f"claim {name}"
    name = str(random.choice([name for name in arrays if arrays[name].size]))
    values = arrays[name]
    place = tuple(int(random.integers(size)) for size in values.shape)
    near = values[np.abs(values) < NO_OBSTACLE]
    scale = float(np.abs(near).max(initial=0.0)) or 1.0
    old = values[place]
    if values.dtype.kind in "biu":
        values[place] = (
            random.choice(values.ravel()) if old.dtype.kind != "b" else not old
        )
        return arrays, header, f"{name} swapped"
    part = (
        10 ** random.uniform(-6, -3)
        if what == "a little"
        else 10 ** random.uniform(-2, 2)
    )
    values[place] = {
        "sign": -old,
        "zero": 0.0,
        "swapped": values.ravel()[random.integers(values.size)],
    }.get(what, old + part * scale * random.choice([-1, 1]))
    return arrays, header, f"{name} {what}"


def passes(arrays, header):
    """Whether the checker accepts it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "changed.npz"
        np.savez(path, header=json.dumps(header), receipt=packed(arrays))
        try:
            check_receipt.check(str(path))
        except Exception:  # whatever is wrong with a file, it does not pass
            return False
        return True


def seconds_of_check(path):
    """CPU seconds in which a receipt is checked."""
    start = time.process_time()
    check_receipt.check(str(path))
    return time.process_time() - start


def median_and_largest(values):
    """The median of numbers, in brackets the largest."""
    return f"{np.median(values):.2f} ({max(values):.2f})"


def opened(path):
    """Arrays by name, and header of a receipt."""
    with np.load(path) as file:
        header = json.loads(str(file["header"]))
        words = file["receipt"]
    arrays = check_receipt.arrays_in(words, header)
    integers = {name: arrays[name].astype(int) for name in ("cells", "other")}
    return arrays | integers, header


def tampered(path, random, wanted):
    """Changes of a receipt until so many falsify a claim: (what, falsifies, passes)."""
    arrays, header = opened(path)
    before = Judge(arrays, header)
    if before.falsified:
        before = None
    found = []
    for _ in range(MOST):
        if sum(wrong for _, wrong, _ in found) >= wanted:
            break
        other, claims, what = changed(arrays, header, random)
        same = claims == header
        if same and all(np.array_equal(other[k], arrays[k]) for k in arrays):
            continue
        found.append((what, falsifies(other, claims, before), passes(other, claims)))
    return found


@dataclass(eq=False)
class Receipts(Work):
    """The campaign: ``count`` receipts, each changed until ``each`` changes falsify a claim.

    Parameters
    ----------
    count, each, seed
        How many receipts of each kind, changes, and the seed of their sequence.
    """

    count: int = 10
    each: int = 20
    seed: int = 1

    name, title = "receipts", "Receipts that are changed in one number"
    columns = " | ".join(
        [" = {group}", *(f"{head.strip()} = {{{head}}}" for head in HEAD[1:])]
    )

    def cells(self):
        """The receipts by kind and number."""
        numbers = range(1, self.count + 1)
        return [
            {"seed": self.seed, "kind": kind, "number": number, "each": self.each}
            for kind in KINDS
            for number in numbers
        ]

    def solve(self, seed, kind, number, each):
        """The verdicts on the changes of one receipt."""
        body = kind.removeprefix("goal, ")
        draw = next(islice(random_draws(seed, body), number - 1, None))
        start = time.process_time()
        result = semismooth_newton(problem_of(draw, body))
        solved = time.process_time() - start
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "receipt.npz"
            try:
                if kind in GOALS:
                    goals = goals_of(result.problem, draw)
                    name = sorted(goals)[number % len(goals)]
                    result = goal_bound(result, goals[name])
                else:
                    error_bound(result)
                bounded = time.process_time() - start
                write_receipt(result, path)
            except (ValueError, RuntimeError) as error:
                return {"refused": str(error)}
            checked = min(seconds_of_check(path) for _ in range(CHECKS))
            wrong = falsifies(*opened(path))
            failure = "the judge refuses the receipt" if wrong else ""
            random = np.random.default_rng([seed, number])
            found = tampered(path, random, each)
        wrong = [row for row in found if row[1]]
        harmless = [row for row in found if not row[1]]
        return {
            "refused": "",
            "failure": failure,
            "wrong": len(wrong),
            "passed": [what for what, _, passed in wrong if passed],
            "harmless": len(harmless),
            "harmless_passed": sum(passed for _, _, passed in harmless),
            "of_solve": checked / solved,
            "of_both": checked / bounded,
        }

    def line(self, record):
        """One line about a receipt."""
        if record["refused"]:
            return f"{record['kind']} {record['number']}: refused, {record['refused']}"
        return (
            f"{record['kind']} {record['number']}: {record['wrong']} changes, "
            f"{len(record['passed'])} pass {record['passed']} {record['failure']}"
        )

    def table_rows(self, records):
        """A row for each kind."""
        rows = []
        for kind in KINDS:
            group = [r for r in records if r["kind"] == kind and not r["refused"]]
            if not group:
                continue
            values = [
                kind,
                len(group),
                sum(r["wrong"] for r in group),
                sum(len(r["passed"]) for r in group),
                sum(r["harmless"] for r in group),
                sum(r["harmless_passed"] for r in group),
                median_and_largest([r["of_solve"] for r in group]),
                median_and_largest([r["of_both"] for r in group]),
            ]
            rows.append(dict(zip(HEAD, values, strict=True)))
        return rows

    def notes(self, records):
        """What was drawn, what was refused, and the failures."""
        refused = [r for r in records if r["refused"]]
        lines = [
            "Random problems of `tests/campaigns/random_problems.py`; one number of mesh, data, "
            "displacement, stress, pressure or claim is changed. An independent program without "
            "bounds decides whether this falsifies the claim. Receipts of goals also have an "
            "adjoint pair and claim an interval of a force or displacement. Harmless changes, "
            "such as a yield stress where nothing yields, leave the claim true. CPU times of "
            "checks are medians, in brackets the largest.",
            f"{len(refused)} problems have no receipt.",
        ]
        lines += [f"- {r['kind']} {r['number']}: {r['refused']}" for r in refused]
        lines += [
            f"- {r['kind']} {r['number']}: {r['passed']} {r['failure']}"
            for r in records
            if not r["refused"] and (r["passed"] or r["failure"])
        ]
        return lines
