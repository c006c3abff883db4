"""Receipts of order two in the plane and in space: energies and goals are known as fractions.

Products of two quadratics are integrated by the integrals of monomials, and the nodes on edges
have the numbers of docs/receipts.md: nothing of the checker is in the numbers it has to enclose.
"""

import functools
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from ngepc.goals.receipt_arrays import NO_OBSTACLE
from ngepc.goals.receipt_file import basis, packed, proved_intervals, with_hints

KINEMATICS = {2: "two-dimensional", 3: "solid"}
CUBES = {2: (2, 2), 3: (2, 1, 1)}
EDGES = {2: [(0, 1)], 3: [(1, 2), (0, 2), (0, 1)]}
EDGES[4] = [(2, 3), (1, 3), (1, 2), (0, 3), (0, 2), (0, 1)]


def fractions(random, shape, largest):
    """Random whole numbers."""
    numbers = random.integers(-largest, largest + 1, shape)
    return np.vectorize(Fraction, otypes=[object])(numbers)


def determinant(M):
    """By the first row."""
    if len(M) == 1:
        return M[0, 0]
    minors = [determinant(np.delete(M[1:], j, axis=1)) for j in range(len(M))]
    return sum((-1) ** j * M[0, j] * minor for j, minor in enumerate(minors))


def slopes(E, W):
    """The X with E X = W, by Cramer's rule."""
    X = np.empty_like(W)
    for i, j in np.ndindex(W.shape):
        replaced = E.copy()
        replaced[:, i] = W[:, j]
        X[i, j] = determinant(replaced) / determinant(E)
    return X


def pairs(n):
    """The vertices of each coefficient of a quadratic on a simplex with n vertices."""
    return [(i, i) for i in range(n)] + EDGES[n]


@functools.cache
def means(n):
    """Of products of Bernstein polynomials: monomials of barycentric coordinates."""
    terms = [np.eye(n, dtype=int)[list(pair)].sum(axis=0) for pair in pairs(n)]
    table = np.empty((len(terms), len(terms)), dtype=object)
    for row, column in np.ndindex(table.shape):
        powers = (terms[row] + terms[column]).tolist()
        mean = Fraction(math.factorial(n - 1), math.factorial(n + 3))
        times = (1 + (row >= n)) * (1 + (column >= n))
        table[row, column] = times * mean * math.prod(map(math.factorial, powers))
    return table


def mean_product(n, x, y):
    """The mean of the product of two fields on a simplex with n vertices."""
    x, y = (np.array(a).reshape(len(pairs(n)), -1) for a in (x, y))
    return ((means(n) @ x) * y).sum()


class Box:
    """A box of simplices, held at the bottom of its last axis and on rollers at x = 0.

    ``u`` and the adjoint ``z`` are quadratic and not zero where they are held; to ``u`` a
    displacement is added that is affine on each cell, whose strain is an initial one.  A body
    that yields has affine ones and plastic strains of the sizes 10 k.
    """

    def __init__(self, random, N, yields=False):
        self.N = N
        self.simplices(random)
        self.law = 1 + abs(fractions(random, 4, 8))
        self.law[3] *= 1 if yields else 2**40
        self.A, self.b = fractions(random, (2, N, N), 4), fractions(random, (2, N), 3)
        q = fractions(random, (2, N, N, N), 0 if yields else 1)
        self.q = q + q.swapaxes(2, 3)
        hat = fractions(random, self.points.shape, 3)
        self.nodes = [self.points[[i, j]] for i, j in self.ends]
        self.u, self.z = (
            np.array([self.value(layer, *ends) for ends in self.nodes])
            for layer in (0, 1)
        )
        self.u += [hat[[i, j]].sum(axis=0) / 2 for i, j in self.ends]
        self.sizes = fractions(random, len(self.cells), 2 if yields else 0)
        self.stored = fractions(random, len(self.cells), 5)
        self.energy = self.goal = Fraction(0)
        self.inside(hat)
        self.boundary()

    def simplices(self, random):
        """Cubes cut along their diagonals; vertices have moved along the box, in any order."""
        cubes = np.array(CUBES[self.N])
        self.grid = np.array(list(itertools.product(*(range(n + 1) for n in cubes))))
        self.cubes = cubes
        number = {tuple(place): i for i, place in enumerate(self.grid)}
        paths = itertools.permutations(np.eye(self.N, dtype=int))
        paths = [np.cumsum([0 * path[0], *path], axis=0) for path in paths]
        starts = itertools.product(*map(range, cubes))
        cells = [[number[tuple(v)] for v in s + p] for s in starts for p in paths]
        label = random.permutation(len(self.grid))
        vertices = [sorted(cell, key=label.__getitem__) for cell in cells]
        moved = fractions(random, self.grid.shape, 3) / 16
        moved *= (self.grid > 0) & (self.grid < cubes)
        self.points = (self.grid + moved) * (1 + abs(fractions(random, self.N, 3)))
        edges = {
            pair for v in vertices for pair in itertools.combinations(sorted(v), 2)
        }
        self.ends = [(i, i) for i in range(len(self.grid))] + sorted(edges)
        self.node = {ends: i for i, ends in enumerate(self.ends)}
        self.cells = [self.nodes_of(np.array(cell)) for cell in vertices]

    def nodes_of(self, vertices):
        """Nodes of a simplex: its vertices, and those on its edges."""
        ends = [tuple(sorted(vertices[list(pair)])) for pair in pairs(len(vertices))]
        return np.array([self.node[pair] for pair in ends])

    def value(self, layer, x, y):
        """The coefficient of ``u`` or ``z`` between two points."""
        square = np.einsum("aij,i,j->a", self.q[layer], x, y)
        return square + self.A[layer] @ (x + y) / 2 + self.b[layer]

    def strain(self, layer, x):
        """At a point."""
        G = 2 * self.q[layer] @ x + self.A[layer]
        return (G + G.T) / 2

    def hooke(self, e):
        """The stress of an elastic strain."""
        trace = np.trace(e) * np.eye(self.N, dtype=int)
        return 2 * self.law[1] * e + self.law[0] * trace

    def inside(self, hat):
        """Stresses and laws of cells, and what is inside of the energy and the goal."""
        N = self.N
        f = [-self.divergence(layer) for layer in (0, 1)]
        self.body_force = np.array(f)
        self.stress, self.initial, self.back = [], [], []
        for cell, k, stored in zip(self.cells, self.sizes, self.stored, strict=True):
            corners = self.points[cell[: N + 1]]
            E, W = (a[1:] - a[0] for a in (corners, hat[cell[: N + 1]]))
            G = slopes(E, W)
            volume = abs(determinant(E)) / math.factorial(N)
            middles = [corners[[i, j]].sum(axis=0) / 2 for i, j in pairs(N + 1)]
            e = [[self.strain(layer, x) for x in middles] for layer in (0, 1)]
            S = [[self.hooke(at) for at in own] for own in e]
            direction = np.zeros((N, N), dtype=object)
            direction[:2, :2] = [[1, 7], [7, -1]]
            p = k * direction
            flow = self.law[2] * k + self.law[3] * int(np.sign(k)) / 10
            back = S[0][0] - flow * direction
            back = back - np.trace(back) * np.eye(N, dtype=int) / Fraction(N)
            self.stress.append(S)
            self.initial.append(self.hooke((G + G.T) / 2 - p))
            self.back.append(back)
            plastic = (
                (back * p).sum() + 50 * self.law[2] * k**2 + 10 * self.law[3] * abs(k)
            )
            density = mean_product(N + 1, S[0], e[0]) / 2 - stored + plastic
            one = [1] * len(cell)
            u = [mean_product(N + 1, one, self.u[cell, x]) for x in range(N)]
            self.energy += volume * (density - f[0] @ u)
            self.goal += volume * (f[1] @ u)

    def divergence(self, layer):
        """Of the stress, which is affine."""
        zero, *axes = np.vstack([np.zeros((1, self.N)), np.eye(self.N)]).astype(int)
        S = [self.hooke(self.strain(layer, x)) for x in (zero, *axes)]
        return sum(S[i + 1][:, i] - S[0][:, i] for i in range(self.N))

    def boundary(self):
        """Sides, their supports and tractions, and what loads and reactions do."""
        N, K = self.N, len(self.cells)
        self.other = np.arange((N + 1) * K)
        found = {}
        for place in range((N + 1) * K):
            ends = tuple(np.sort(np.delete(self.cells[place % K][: N + 1], place // K)))
            before = found.setdefault(ends, place)
            self.other[[place, before]] = before, place
        self.out = np.flatnonzero(self.other == np.arange(self.other.size))
        self.held = np.zeros((N, len(self.out)), dtype=bool)
        self.traction = np.zeros((2, N, len(pairs(N)), len(self.out)), dtype=object)
        for row in range(len(self.out)):
            side, axis, sign, area = self.side(row)
            bottom, roller = sign < 0 and axis == N - 1, sign < 0 and axis == 0
            x = [(self.nodes[node][0] + self.nodes[node][1]) / 2 for node in side]
            S = [[self.hooke(self.strain(layer, at)) for at in x] for layer in (0, 1)]
            pulls = sign * np.array(S)[:, :, axis]
            for i in range(N):
                if bottom or (roller and i == 0):
                    self.held[i, row] = True
                    self.goal -= area * mean_product(N, pulls[0, :, i], self.z[side, i])
                    continue
                self.traction[:, i, :, row] = pulls[:, :, i]
                self.energy -= area * mean_product(N, pulls[0, :, i], self.u[side, i])
                self.goal += area * mean_product(N, pulls[1, :, i], self.u[side, i])

    def side(self, row):
        """Nodes of a side of the boundary, the axis and sign of its normal, and its area."""
        place, K = self.out[row], len(self.cells)
        ends = np.delete(self.cells[place % K][: self.N + 1], place // K)
        on = [(self.grid[ends] == end).all(axis=0) for end in (0, self.cubes)]
        axis = int(np.flatnonzero(on[0] | on[1])[0])
        along = np.delete(self.points[ends[1:]] - self.points[ends[0]], axis, axis=1)
        area = abs(determinant(along)) / math.factorial(self.N - 1)
        return self.nodes_of(ends), axis, 1 if on[1][axis] else -1, area

    def file(self, factor):
        """Arrays and header of a receipt, without hints; the factor is a power of two."""
        N, P, K, B = self.N, len(self.ends), len(self.cells), len(self.out)
        matrices = basis(KINEMATICS[N])
        stress = np.einsum(
            "cij,Klkij->lkcK", matrices, np.array(self.stress, dtype=object)
        )
        moduli = [N * self.law[0] + 2 * self.law[1], *self.law[1:]]
        moduli = np.array(moduli)[:, None].repeat(K, axis=1)
        initial = np.einsum("cij,Kij->cK", matrices, np.array(self.initial))
        back = np.einsum("cij,Kij->cK", matrices, np.array(self.back))[1:]
        t = len(pairs(N))
        arrays = {
            "points": np.array(self.nodes).mean(axis=1).T, "cells": np.array(self.cells).T,
            "other": self.other.reshape(N + 1, K), "u": np.stack([self.u.T, self.z.T]),
            "stress": stress, "law": np.vstack([moduli, self.stored, initial, back]),
            "body_force": self.body_force[:, :, None].repeat(K, axis=2),
            "passed": np.zeros((N, N + 1, K)), "arm": np.zeros((N, K)),
            "tangent": np.zeros((2, K)), "held": self.held, "traction": self.traction,
            "gap": np.zeros((2, t, B)), "pressure": np.zeros((2, t, B)),
        }  # fmt: skip
        arrays = {name: values.astype(float) for name, values in arrays.items()}
        for name in ("u", "stress", "traction", "body_force"):
            arrays[name][1] /= factor
        arrays["gap"][0] = NO_OBSTACLE
        header = {
            "kinematics": KINEMATICS[N],
            "order": 2,
            "goal": "Q",
            "factor": factor,
        }
        return arrays, header | {"sizes": [P, K, B]}

    def touch(self, random, arrays, factor, part):
        """An obstacle at the top, with quadratic pressures and ``part`` of them for the adjoint."""
        N = self.N
        self.pushed = 0
        for row in range(len(self.out)):
            side, axis, sign, area = self.side(row)
            if axis != N - 1 or sign < 0:
                continue
            P = 1 + abs(fractions(random, len(side), 8))
            u, z = self.u[side, axis], self.z[side, axis]
            worked = area * mean_product(N, P, u)
            self.pushed += area * mean_product(N, P, [1] * len(side))
            self.energy -= worked
            self.goal += part * worked + area * mean_product(N, P, z)
            arrays["gap"][:, :, row] = [u, z / Fraction(factor)]
            arrays["pressure"][:, :, row] = [P, part * P / Fraction(factor)]
            arrays["traction"][:, axis, :, row] += arrays["pressure"][:, :, row]

    def is_inside(self, proved):
        """Whether intervals have the exact numbers."""
        energy = proved["lower"] <= self.energy <= proved["upper"]
        return energy and proved["goal lower"] <= self.goal <= proved["goal upper"]

    def free(self):
        """The components of nodes that no support holds, as an array like u."""
        free = np.ones((self.N, len(self.ends)), dtype=bool)
        for row, held in enumerate(self.held.T):
            free[np.ix_(held, self.side(row)[0])] = False
        return free


def proved(arrays, header):
    """What the checker proves with good hints."""
    return proved_intervals(with_hints(packed(arrays), header), header)


def middle(found):
    """Of the interval of the goal."""
    return (found["goal lower"] + found["goal upper"]) / 2


def width(found, name=""):
    """Of the interval of the energy, or of the ``goal``."""
    return found[f"{name}upper"] - found[f"{name}lower"]


@pytest.mark.parametrize("yields", [False, True])
@pytest.mark.parametrize("N", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_an_exact_pair_proves_its_numbers(seed, N, yields):
    """Displacements and stresses of the solution: intervals have nothing but rounding."""
    body = Box(np.random.default_rng(seed), N, yields)
    for factor in (1.0, 8.0):
        found = proved(*body.file(factor))
        assert body.is_inside(found)
        assert width(found) < 1e-5 * abs(body.energy)
        if not yields:  # where the stress of the adjoint is that of its strain
            assert width(found, "goal ") < 1e-5 * factor * abs(body.energy)


@pytest.mark.parametrize("N", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_an_elastic_body_away_from_its_solution(seed, N):
    """J(u) - J(v) is half a square, all of the width; with exact adjoints goals are halfway."""
    random = np.random.default_rng(seed)
    body = Box(random, N)
    for factor in (0.5, 4.0):
        arrays, header = body.file(factor)
        arrays["u"][0] += 10 * random.normal(size=arrays["u"][0].shape) * body.free()
        found = proved(arrays, header)
        assert body.is_inside(found)
        error = found["upper"] - float(body.energy)
        assert width(found) <= error * (1 + 1e-3)
        assert width(found, "goal ") <= factor * error * (1 + 1e-3)
        assert abs(middle(found) - float(body.goal)) <= 1e-3 * factor * error


@pytest.mark.parametrize("yields", [False, True])
@pytest.mark.parametrize("N", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_wrong_pairs_prove_nothing_false(seed, N, yields):
    """Displacements, adjoints and stresses that are all wrong by a random size."""
    random = np.random.default_rng(seed)
    body = Box(random, N, yields)
    for size in 10.0 ** random.uniform(-8, 1, 3):
        arrays, header = body.file(2.0 ** random.integers(-3, 9))
        arrays["u"] += size * random.normal(size=arrays["u"].shape) * body.free()
        arrays["stress"] *= 1 + size * random.normal(size=arrays["stress"].shape)
        assert body.is_inside(proved(arrays, header))


@pytest.mark.parametrize(("part", "factor"), [(-1, 1.0), (0.75, 1.0), (3, 4.0)])
@pytest.mark.parametrize("N", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_body_that_keeps_away_from_a_curved_obstacle(seed, N, part, factor):
    """J(u) - J(v) is half a square and the work of pressures, which goals have once more."""
    random = np.random.default_rng(seed)
    body = Box(random, N)
    arrays, header = body.file(factor)
    body.touch(random, arrays, factor, Fraction(part))
    height = arrays["points"][-1]
    for distance in (4.0, 0.25):
        away = arrays["u"].copy()
        away[0, -1] -= distance * height
        found = proved(arrays | {"u": away}, header)
        assert body.is_inside(found)
        error = found["upper"] - float(body.energy)
        assert width(found) <= error * (1 + 1e-2)
        error += distance * height.max() * float(body.pushed)
        assert width(found, "goal ") <= factor * error * (1 + 1e-2)
        assert abs(middle(found) - float(body.goal)) <= 1e-3 * factor * error
