"""Receipts of bodies with a uniform stress: their energies and goals are known as fractions.

Each term of rounding that an interval can show has bodies on which the rest is not enough: needles
for the densities, far motions across the loads for the works.  What equilibrium misses by rounding
changes energies by products of two errors, and no interval can show it: forces are compared.
"""

import math
from fractions import Fraction

import numpy as np
import pytest

from ngepc.goals import check_receipt
from ngepc.goals.receipt_arrays import NO_OBSTACLE
from ngepc.goals.receipt_file import basis, packed, proved_intervals, with_hints


class Rectangle:
    """An elastic rectangle of n x n squares, held at x = 0, with numbers that are exact.

    ``scales`` are exponents of two of size, thickness, strain and moduli.  ``u`` = A x and the
    adjoint ``z`` = C x have the stresses ``S`` and ``T``, and the loads that belong to them.
    """

    def __init__(self, random, n=3, scales=(0, 0, 0, 0)):
        size, thin, strain, moduli = (Fraction(2) ** int(s) for s in scales)
        self.size = size * np.array([Fraction(1), thin], dtype=object)
        A, C = (strain * fractions(random, (2, 2), 8) for _ in range(2))
        self.law = moduli * (1 + abs(fractions(random, 4, 8)))
        self.law[3] = 2**20 * strain * moduli
        points = np.array([(i, j) for i in range(n + 1) for j in range(n + 1)])
        self.points = points * self.size
        self.inside = (points > 0).all(axis=1) & (points < n).all(axis=1)
        self.cells, self.other = triangles(n)
        self.area = n**2 * np.prod(self.size)
        self.strained(A, C)

    def strained(self, A, C, shift=0):
        """Displacements A x + ``shift`` and C x, and what belongs to them."""
        self.values = [self.points @ A.T + shift, self.points @ C.T]
        self.stresses = [self.stress(G) for G in (A, C)]
        self.energy = (self.stresses[0] * A).sum() / 2 * self.area
        self.goal = Fraction(0)
        self.loads()

    def is_held(self, ends):
        """Whether the side between two nodes is held."""
        return not self.points[ends, 0].any()

    def stress(self, G):
        """Hooke's law in two dimensions."""
        return self.law[1] * (G + G.T) + self.law[0] * np.trace(G) * np.eye(
            2, dtype=int
        )

    def loads(self):
        """Tractions and supports of the boundary; the exact energy and goal."""
        places = np.flatnonzero(self.other.ravel() == np.arange(self.other.size))
        self.held = np.zeros((2, len(places)), dtype=bool)
        self.tractions = np.zeros((2, 2, 2, len(places)), dtype=object)
        for number, place in enumerate(places):
            side, cell = divmod(place, self.cells.shape[1])
            ends = np.delete(self.cells[:, cell], side)
            along = self.points[ends[1]] - self.points[ends[0]]
            normal = np.array([along[1], -along[0]])
            normal *= np.sign(
                normal @ (self.points[ends[0]] - self.points[self.cells[side, cell]])
            )
            u, z = (values[ends].mean(axis=0) for values in self.values)
            pulls = [S @ normal for S in self.stresses]
            if self.is_held(ends):
                self.held[:, number] = True
                self.goal -= pulls[0] @ z
                continue
            self.energy -= pulls[0] @ u
            self.goal += pulls[1] @ u
            for layer, pull in enumerate(pulls):
                traction = pull / np.abs(along).sum()
                self.tractions[layer, :, :, number] = traction[:, None]

    def file(self, factor=0.5):
        """Arrays and header of a receipt, without hints; the factor is a power of two."""
        P, K, B = len(self.points), self.cells.shape[1], self.held.shape[1]
        law = self.law.copy()
        law[0] = 2 * (self.law[0] + self.law[1])
        matrices = basis("two-dimensional")
        stress = np.einsum(
            "cij,lij->cl", matrices, np.array(self.stresses, dtype=float)
        )
        arrays = {
            "points": self.points.T, "cells": self.cells, "other": self.other,
            "u": np.stack([values.T for values in self.values]),
            "stress": np.tile(stress.T[:, None, :, None], (1, 3, 1, K)),
            "law": np.append(law, [0] * 6)[:, None].repeat(K, axis=1),
            "body_force": np.zeros((2, 2, K)), "passed": np.zeros((2, 3, K)),
            "arm": np.zeros((2, K)), "tangent": np.zeros((2, K)),
            "held": self.held, "traction": self.tractions,
            "gap": np.zeros((2, 2, B)), "pressure": np.zeros((2, 2, B)),
        }  # fmt: skip
        arrays = {name: values.astype(float) for name, values in arrays.items()}
        for name in ("u", "stress", "traction"):
            arrays[name][1] /= factor
        arrays["gap"][0] = NO_OBSTACLE
        header = {"kinematics": "two-dimensional", "order": 1, "goal": "Q"}
        header["factor"] = factor
        return arrays, header | {"sizes": [P, K, B]}

    def proved(self, arrays, header):
        """What the checker proves with good hints."""
        words = with_hints(packed(arrays), header)
        return proved_intervals(words, header)

    def is_inside(self, proved):
        """Whether intervals have the exact numbers."""
        energy = proved["lower"] <= self.energy <= proved["upper"]
        return energy and proved["goal lower"] <= self.goal <= proved["goal upper"]


class Needles(Rectangle):
    """A parallelogram of needles, held on its whole boundary: elastic, or plastic everywhere.

    Nodes have long coordinates, so that products of their differences are rounded, and strains are
    small differences of them.  The strain of the adjoint has the direction of that of the body.
    """

    EDGES = np.array([[55, 89], [89, 144]], dtype=object)

    def __init__(self, random, plastic, n=2):
        grid = np.array([(i, j) for i in range(n + 1) for j in range(n + 1)])
        moved = fractions(random, grid.shape, 2**6)
        self.points = grid @ self.EDGES * 2**24 + moved
        self.inside = (grid > 0).all(axis=1) & (grid < n).all(axis=1)
        self.cells, self.other = triangles(n)
        corners = self.points[self.cells]
        E = corners[1:] - corners[:1]
        det = E[0, :, 0] * E[1, :, 1] - E[0, :, 1] * E[1, :, 0]
        self.area = abs(det).sum() / 2
        self.law = 1 + abs(fractions(random, 4, 8))
        size = 10 * Fraction(int(random.integers(1, 4)))
        self.law[3] = 2**20 if not plastic else 2 * self.law[1] * size / 4
        e = size / 10 * np.array([[1, 7], [7, -1]], dtype=object)
        e = e.T if random.random() < 0.5 else e[::-1] * [[1], [-1]]
        mean = fractions(random, 2, 5)
        one = np.eye(2, dtype=int)
        self.strain = e + mean[0] * one
        self.strained(self.strain, e / 2 + mean[1] * one)
        if plastic:
            self.yielding(e, size)

    def is_held(self, ends):
        """All sides are."""
        return True

    def yielding(self, e, size):
        """Stress, energy and goal where a strain with this deviator, and its size, yields."""
        mu, h, beta = self.law[1:]
        over = 2 * mu * size - beta
        lost = 2 * mu / (2 * mu + h)
        self.stresses[0] = self.stresses[0] - lost * over / size * e
        self.stresses[1] = self.stresses[1] - lost * mu * e  # that of its strain e/2
        self.energy -= over**2 / (2 * (2 * mu + h)) * self.area
        self.goal += lost * over / size * (e * e).sum() / 2 * self.area


class Squares(Needles):
    """The same of halves of near squares, whose condition adds no room to what rounding may do."""

    EDGES = np.array([[1, 0], [0, 1]], dtype=object)


def fractions(random, shape, largest):
    """Random whole numbers."""
    numbers = random.integers(-largest, largest + 1, shape)
    return np.vectorize(Fraction, otypes=[object])(numbers)


def triangles(n):
    """Vertices of the triangles of n x n squares, and the places of their sides."""
    corners = [(i * (n + 1) + j) for i in range(n) for j in range(n)]
    halves = [(0, n + 1, n + 2), (0, 1, n + 2)]
    cells = np.array([[c + k for k in half] for c in corners for half in halves]).T
    K = cells.shape[1]
    other = np.arange(3 * K)
    found = {}
    for place in other.copy():
        ends = tuple(np.delete(cells[:, place % K], place // K))
        before = found.setdefault(ends, place)
        other[[place, before]] = before, place
    return cells, other.reshape(3, K)


@pytest.mark.parametrize("seed", range(20))
def test_rounding_is_enclosed(seed):
    """Bodies of all sizes, thin ones, stiff ones: intervals have nothing but rounding."""
    random = np.random.default_rng(seed)
    size, strain, moduli = random.integers(-25, 25, 3)
    scales = size, -random.integers(0, 12), strain, moduli
    body = Rectangle(random, scales=scales)
    proved = body.proved(*body.file())
    assert body.is_inside(proved)
    unit = Rectangle(random)
    proved = unit.proved(*unit.file())
    assert unit.is_inside(proved)
    assert proved["upper"] - proved["lower"] < 1e-6 * max(abs(unit.energy), 1)


@pytest.mark.parametrize("seed", range(20))
def test_a_stress_that_misses_equilibrium_proves_nothing_false(seed):
    """That of any displacement: nothing but what equilibrium misses is between the bounds."""
    random = np.random.default_rng(seed)
    body = Rectangle(random)
    arrays, header = body.file(2.0 ** random.integers(-3, 4))
    inner = arrays["u"][:, :, body.inside]
    arrays["u"][:, :, body.inside] += random.normal(size=inner.shape)
    trial = check_receipt.Body(packed(arrays), header).trial
    arrays["stress"][:] = trial
    assert body.is_inside(body.proved(arrays, header))


@pytest.mark.parametrize("plastic", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_energies_is_enclosed(seed, plastic):
    """Needles, whose strains are differences of long products; sums are exact enough."""
    body = Needles(np.random.default_rng(seed), plastic)
    assert body.is_inside(body.proved(*body.file(2.0**10)))


@pytest.mark.parametrize("end", ["goal lower", "goal upper"])
@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_goals_is_enclosed(seed, end):
    """Without any stress equilibrium is exact, and the adjoint -u or u makes one end exact."""
    body = Needles(np.random.default_rng(seed), False)
    sign = 1 if end == "goal lower" else -1
    body.strained(body.strain, sign * body.strain)
    arrays, header = body.file(1.0)
    arrays["stress"][:] = 0
    assert body.is_inside(body.proved(arrays, header))


@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_tangents_is_enclosed(seed):
    """Any tangent proves the same of strains in one line; the larger, the more it is rounded."""
    body = Squares(np.random.default_rng(seed), True)
    arrays, header = body.file(1.0)
    words = with_hints(packed(arrays), header)
    check_receipt.arrays_in(words, header)["tangent"][:] = 1e19
    assert body.is_inside(proved_intervals(words, header))


@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_back_stresses_is_enclosed(seed):
    """Nothing moves but plastic strains, from a back stress that is far larger than the stress."""
    random = np.random.default_rng(seed)
    body = Squares(random, False)
    body.strained(np.zeros((2, 2), dtype=object), np.zeros((2, 2), dtype=object))
    body.law[2:] = 2**20 * body.law[2], 1 + abs(fractions(random, 1, 2**10)[0])
    mu, h, beta = body.law[1:]
    size = Fraction(int(random.integers(2**19, 2**20)))
    over = 5 * size - beta
    body.energy = -(over**2) / (4 * mu + 2 * h) * body.area
    arrays, header = body.file(1.0)
    back = np.array([3.0, 4.0])[:, None] * float(size)
    arrays["law"][-2:] = back
    arrays["stress"][0, :, 1:] = back * float(2 * mu * over / (2 * mu + h) / (5 * size))
    assert body.is_inside(body.proved(arrays, header))


class Held(Rectangle):
    """A rectangle that is held on its whole boundary, so that loads do no work."""

    def is_held(self, ends):
        """All sides are."""
        return True


@pytest.mark.parametrize("end", ["energy", "goal"])
@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_rotations_is_enclosed(seed, end):
    """Displacements are turned by far more than strained: nothing changes but rounding."""
    random = np.random.default_rng(seed)
    body = Held(random)
    A, C = (fractions(random, (2, 2), 8) for _ in range(2))
    size = 2 * int(random.integers(2**28, 2**32)) + 1
    turn = size * np.array([[0, -1], [1, 0]], dtype=object)
    body.strained(A + turn, C if end == "energy" else A + turn)
    proved = body.proved(*body.file())
    assert body.is_inside(proved)
    assert proved["upper"] - proved["lower"] < 10 * abs(body.energy)  # not 1e8


@pytest.mark.parametrize("seed", range(20))
def test_rounding_of_works_is_enclosed(seed):
    """A far motion across the tractions, whose works are small differences of long products."""
    random = np.random.default_rng(seed)
    body = Rectangle(random)
    a, b = fractions(random, 2, 2**9) * 2 + 1
    body.law[:2] = 0, 2
    C = fractions(random, (2, 2), 8)
    far = np.array([a, b]) * (int(random.integers(2**40, 2**41)) * 2 + 1)
    body.strained(np.array([[b * b, -a * b], [-a * b, a * a]]), C, far)
    body.law[3] = 2**60
    proved = body.proved(*body.file())
    assert body.is_inside(proved)


def root_of(x):
    """The root of a fraction to 200 digits of base two."""
    shift = 2 * (200 + x.denominator.bit_length())
    return Fraction(math.isqrt((x.numerator << shift) // x.denominator), 1) / (
        1 << shift // 2
    )


def exact_forces(arrays, held):
    """Sizes of the components of all forces on cells, of uniform stresses without body forces."""
    half = 1 / root_of(Fraction(2))
    basis = np.array([np.eye(2), [[1, 0], [0, -1]], [[0, 1], [1, 0]]], dtype=int) * half
    exact = np.vectorize(Fraction, otypes=[object])
    points, stress = exact(arrays["points"]).T, exact(arrays["stress"][0])
    cells, other = arrays["cells"].astype(int), arrays["other"].astype(int).ravel()
    K = cells.shape[1]
    normals, tractions = {}, {}
    for place in range(3 * K):
        side, cell = divmod(place, K)
        i, j = np.delete(np.arange(3), side)
        along = points[cells[j, cell]] - points[cells[i, cell]]
        normal = np.array([along[1], -along[0]])
        if normal @ (points[cells[i, cell]] - points[cells[side, cell]]) < 0:
            normal = -normal
        normals[place] = normal
        S = [np.tensordot(stress[k, :, cell], basis, 1) for k in (i, j)]
        tractions[place] = np.array([T @ normal for T in S])
    forces = np.zeros((2, K), dtype=object)
    out = np.flatnonzero(other == np.arange(3 * K)).tolist()
    for place, T in tractions.items():
        if place in out:
            row = out.index(place)
            normal = normals[place]
            size = root_of(normal @ normal)
            P = exact(arrays["pressure"][0, :, row])
            g = exact(arrays["traction"][0, :, :, row]).T
            jump = 2 * (T - g * size + P[:, None] * normal)
            jump[:, held[:, row] != 0] = 0
        else:
            jump = T + tractions[other[place]]
        forces[:, place % K] += abs(jump).max(axis=0) / 2
    for cell in range(K):
        inside = sum(
            np.tensordot(stress[k, :, cell], basis, 1) @ normals[k * K + cell]
            for k in range(3)
        )
        forces[:, cell] += abs(inside) / 2
    return forces


@pytest.mark.parametrize("deviators", [1.0, 0.0])
@pytest.mark.parametrize("seed", range(5))
def test_rounding_of_forces_is_enclosed(seed, deviators):
    """Stresses that differ by rounding, with tractions and pressures that nearly cancel."""
    random = np.random.default_rng(seed)
    body = Needles(random, False)
    arrays, header = body.file()
    energy = {"kinematics": "two-dimensional", "order": 1, "sizes": header["sizes"]}
    for name in ("u", "stress", "body_force", "traction", "gap", "pressure"):
        arrays[name] = arrays[name][:1].copy()
    arrays["tangent"] = arrays["tangent"][:0]
    noise = random.integers(-2, 3, arrays["stress"].shape) * 2.0**-52
    arrays["stress"] = random.normal() * arrays["stress"] * (1 + noise)
    arrays["stress"][:, :, 1:] *= deviators
    arrays["held"] = arrays["held"] * (random.random(arrays["held"].shape) < 0.3)
    r = check_receipt.Body(packed(arrays), energy)
    cell = r.out % r.K
    S = np.einsum("cij,cB->ijB", basis("two-dimensional"), r.stress[0, 0][:, cell])
    large = 2.0 ** (20 * (seed % 2))
    pressure = large * np.abs(S).max() * random.random(r.pressure.shape[-1])
    pulls = np.einsum("ijB,jB->iB", S, r.normal) + pressure * r.normal
    arrays["pressure"][:] = pressure
    arrays["traction"][:] = pulls[:, None]
    r = check_receipt.Body(packed(arrays), energy)
    exact = exact_forces(arrays, arrays["held"])
    assert (exact <= r.force * (1 + check_receipt.EPS)).all()


@pytest.mark.parametrize("seed", range(5))
def test_rounding_hides_no_penetration(seed):
    """Rooms that are zero or positive as computed, and negative in fact; sides are slanted."""
    random = np.random.default_rng(seed)
    body = Needles(random, False)
    arrays, header = body.file()
    r = check_receipt.Body(packed(arrays), header)
    outside = r.u.take(r.ends, axis=2)
    arrays["gap"][:] = np.einsum("LxtB,xB->LtB", outside, r.normal)
    arrays["gap"][1] = 0  # an adjoint that does not move
    arrays["u"][1] = 0
    with pytest.raises(ValueError, match=r"^u: inside the obstacle"):
        check_receipt.Body(packed(arrays), header)
    arrays["gap"][0] += 12 * r.wrong.max() * np.abs(r.u).max()
    check_receipt.Body(packed(arrays), header)


def test_a_sum_of_forces_that_is_just_reached_is_too_little():
    """Sums of what a cell gets are rounded; by more than that each cell passes on."""
    body = Rectangle(np.random.default_rng(1))
    arrays, header = body.file()
    words = with_hints(packed(arrays), header)
    arrays = check_receipt.arrays_in(words, header)
    r = check_receipt.Body(words, header)
    going = r.passed[0].ravel().nonzero()[0]
    first = np.setdiff1d(np.arange(r.K), r.other[going] % r.K)[0]
    side = r.passed[:, :, first].argmax(axis=1)
    for size, enough in ((1.0, False), (1 + 2.0**-52, False), (1 + 2.0**-46, True)):
        arrays["passed"][[0, 1], side, first] = r.force[:, first] * size
        r.passed = arrays["passed"]
        if enough:
            r.defect()
        else:
            with pytest.raises(ValueError, match=r"^passed: too little"):
                r.defect()


@pytest.mark.parametrize("seed", range(20))
def test_no_displacement_or_stress_proves_something_false(seed):
    """Whatever nobody prescribes is changed, and factor and hints of the suprema."""
    random = np.random.default_rng(seed)
    body = Rectangle(random)
    for number in range(10):
        arrays, header = body.file(2.0 ** random.integers(-10, 11))
        size = 10.0 ** random.uniform(-16, 2)
        other = {name: arrays[name].copy() for name in ("u", "stress")}
        other["u"][:, :, body.inside] += size * random.normal(
            size=(2, 2, body.inside.sum())
        )
        shape = other["stress"].shape if number % 2 else (2, 1, 1, 1)
        other["stress"] *= 1 + size * random.normal(size=shape)
        assert body.is_inside(body.proved(arrays | other, header))


@pytest.mark.parametrize("scales", [(7, 0, 0, 0), (0, 0, 30, 0), (0, 0, 0, 20)])
def test_rounding_has_the_units_of_an_energy(scales):
    """In units that are powers of two all numbers are the same ones."""
    rest = []
    for own in ((0, 0, 0, 0), scales):
        arrays, header = Rectangle(np.random.default_rng(1), scales=own).file()
        rest.append(check_receipt.Body(packed(arrays), header).rest)
    size, _, strain, moduli = scales
    scale = 2.0 ** (2 * size + 2 * strain + moduli)
    np.testing.assert_allclose(rest[1], scale * rest[0], rtol=1e-12)


class Touching(Rectangle):
    """The same with an obstacle at the side x = L, which the solution touches with a pressure P.

    The adjoint does not move there along the normal, and has the pressure q = ``part`` P.
    """

    def __init__(self, random, part):
        self.part = part
        super().__init__(random)
        A, C = fractions(random, (2, 2, 2), 8)
        C[0] = 0
        self.P = abs(self.stress(A)[0, 0]) + 1
        self.strained(A, C)
        length, height = self.size * 3
        pushed = A[0, 0] * length * height + A[0, 1] * height**2 / 2
        self.energy -= self.P * pushed
        self.goal += self.part * self.P * pushed

    def touching(self, factor, distance):
        """Arrays and header; the body keeps ``distance`` times x from where it is."""
        arrays, header = self.file(factor)
        r = check_receipt.Body(packed(arrays), header)
        right = (r.normal[0] > 0.5) & (r.held[0] == 0)
        u = np.einsum("xtB,xB->tB", r.u[0].take(r.ends, axis=1), r.normal)
        arrays["gap"][0] = np.where(right, u, arrays["gap"][0])
        arrays["u"][0, 0] -= distance * arrays["points"][0]
        P = float(self.P)
        pressures = np.array([P, float(self.part) * P / factor])
        arrays["pressure"] = pressures[:, None, None] * right * np.ones((2, 2, 1))
        arrays["traction"][:, 0] += arrays["pressure"]
        return arrays, header


@pytest.mark.parametrize("part", [-1, -0.75, 0.75, 1])
@pytest.mark.parametrize("seed", range(3))
def test_a_body_that_keeps_away_from_its_obstacle(seed, part):
    """J(u) - J(v) is half a square and P times the distance: nothing can be left out."""
    body = Touching(np.random.default_rng(seed), Fraction(part))
    for factor, distance in ((1.0, 2.0**-8), (2.0, 2.0**-8), (1.0, 2.0**-12)):
        found = body.proved(*body.touching(factor, distance))
        assert body.is_inside(found)
        error = found["upper"] - float(body.energy)
        assert found["upper"] - found["lower"] <= error * (1 + 1e-3)


def missed_equilibrium(r):
    """Least b with |R(w)| <= b (int M |eps(w)|^2)^(1/2) for the w of the mesh, of both layers."""
    P = r.points.shape[1]
    M = np.minimum(r.soft, r.bulk)
    matrices = basis("two-dimensional")
    R, A = np.zeros((2, 2 * P)), np.zeros((2 * P, 2 * P))
    for cell, vertices in enumerate(r.cells.T):
        frame = np.vstack([np.ones(3), r.points[:, vertices]])
        slopes = np.linalg.inv(frame)[:, 1:]
        area = abs(np.linalg.det(frame)) / 2
        strains = np.einsum("cij,vj->cvi", matrices, slopes).reshape(3, 6)
        rows = (2 * vertices[:, None] + [0, 1]).ravel()
        A[np.ix_(rows, rows)] += M[cell] * area * strains.T @ strains
        R[:, rows] += area * r.stress[..., cell].mean(axis=1) @ strains
    for side, ends in enumerate(r.ends.T):
        pull = r.outer[side] / 2 * r.traction[:, :, 0, side]
        for end in ends:
            R[:, [2 * end, 2 * end + 1]] -= pull
    held = r.ends[:, r.held.all(axis=0)]
    free = np.setdiff1d(np.arange(2 * P), [2 * held, 2 * held + 1])
    solved = np.linalg.solve(A[np.ix_(free, free)], R[:, free].T)
    return np.sqrt(np.einsum("lf,fl->l", R[:, free], solved))


@pytest.mark.parametrize("seed", range(10))
def test_what_equilibrium_misses_is_bounded(seed):
    """Two triangles that hand on all forces: the bound is about 1e5 times what their own w find."""
    random = np.random.default_rng(seed)
    body = Rectangle(random, n=1, scales=(3, 0, -4, 2))
    arrays, header = body.file()
    arrays["stress"] += random.normal(size=arrays["stress"].shape)
    words = with_hints(packed(arrays), header)
    r = check_receipt.Body(words, header)
    bound = r.defect()
    missed = missed_equilibrium(r).sum()
    assert 5e-6 * bound <= missed <= bound
