"""Receipts of rectangles with a uniform stress: their energies and goals are known as fractions."""

from fractions import Fraction

import numpy as np
import pytest

from ngepc.goals import check_receipt
from ngepc.goals.receipt_file import packed, with_hints, without_tiny


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
        inside = (points > 0).all(axis=1) & (points < n).all(axis=1)
        self.inside = inside
        self.cells, self.other = triangles(n)
        self.values = [self.points @ G.T for G in (A, C)]
        self.stresses = [self.stress(G) for G in (A, C)]
        self.energy = (self.stresses[0] * A).sum() / 2 * n**2 * np.prod(self.size)
        self.goal = Fraction(0)
        self.loads()

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
            if not self.points[ends, 0].any():
                self.held[:, number] = True
                self.goal -= pulls[0] @ z
                continue
            self.energy -= pulls[0] @ u
            self.goal += pulls[1] @ u
            for layer, pull in enumerate(pulls):
                self.tractions[:, :, layer, number] = pull / np.abs(along).sum()

    def file(self, factor=0.5):
        """Arrays and header of a receipt, without hints; the factor is a power of two."""
        P, K, B = len(self.points), self.cells.shape[1], self.held.shape[1]
        basis = check_receipt.basis("two-dimensional")
        stress = np.einsum("cij,lij->cl", basis, np.array(self.stresses, dtype=float))
        arrays = {
            "points": self.points.T, "cells": self.cells, "other": self.other,
            "u": np.stack([values.T for values in self.values], axis=1),
            "stress": np.tile(stress[None, :, :, None], (3, 1, 1, K)),
            "law": np.append(self.law, [0] * 4)[:, None].repeat(K, axis=1),
            "body_force": np.zeros((2, 2, K)), "way": np.zeros((2, K)),
            "passed": np.zeros((2, K)), "tangent": np.zeros((2, K)),
            "held": self.held, "contact": np.zeros(B), "traction": self.tractions,
            "gap": np.zeros((2, 2, B)), "pressure": np.zeros((2, 2, B)),
        }  # fmt: skip
        arrays = {name: values.astype(float) for name, values in arrays.items()}
        for name in ("u", "stress", "traction"):
            np.moveaxis(arrays[name], -2, 0)[1] /= factor
        header = {"kinematics": "two-dimensional", "order": 1, "goal": "Q"}
        header["factor"] = factor
        return arrays, header | {"sizes": [P, K, B]}

    def proved(self, arrays, header):
        """What the checker proves with good hints."""
        arrays = {name: without_tiny(values) for name, values in arrays.items()}
        words = with_hints(packed(arrays, header), header)
        return check_receipt.proved_intervals(words, header)

    def is_inside(self, proved):
        """Whether intervals have the exact numbers."""
        energy = proved["lower"] <= self.energy <= proved["upper"]
        return energy and proved["goal lower"] <= self.goal <= proved["goal upper"]


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
        shape = other["stress"].shape if number % 2 else (2, 1)
        other["stress"] *= 1 + size * random.normal(size=shape)
        assert body.is_inside(body.proved(arrays | other, header))


def missed_equilibrium(r):
    """Least b with |R(w)| <= b (int M |eps(w)|^2)^(1/2) for the w of the mesh, of both layers."""
    P = r.points.shape[1]
    M = np.minimum(2 * r.mu * r.hardening / (2 * r.mu + r.hardening), r.bulk)
    basis = check_receipt.basis("two-dimensional")
    R, A = np.zeros((2, 2 * P)), np.zeros((2 * P, 2 * P))
    for cell, vertices in enumerate(r.cells.T):
        frame = np.vstack([np.ones(3), r.points[:, vertices]])
        slopes = np.linalg.inv(frame)[:, 1:]
        area = abs(np.linalg.det(frame)) / 2
        strains = np.einsum("cij,vj->cvi", basis, slopes).reshape(3, 6)
        rows = (2 * vertices[:, None] + [0, 1]).ravel()
        A[np.ix_(rows, rows)] += M[cell] * area * strains.T @ strains
        R[:, rows] += area * r.stress[..., cell].mean(axis=0).T @ strains
    for side, ends in enumerate(r.ends.T):
        pull = r.outer[side] / 2 * r.traction[0, :, :, side]
        for end in ends:
            R[:, [2 * end, 2 * end + 1]] -= pull.T
    held = r.ends[:, r.held.all(axis=0)]
    free = np.setdiff1d(np.arange(2 * P), [2 * held, 2 * held + 1])
    solved = np.linalg.solve(A[np.ix_(free, free)], R[:, free].T)
    return np.sqrt(np.einsum("lf,fl->l", R[:, free], solved))


@pytest.mark.parametrize("seed", range(10))
def test_what_equilibrium_misses_is_bounded(seed):
    """Two triangles that hand on all forces: the bound is 1e4 times what their own w find."""
    random = np.random.default_rng(seed)
    body = Rectangle(random, n=1, scales=(3, 0, -4, 2))
    arrays, header = body.file()
    arrays["stress"] += random.normal(size=arrays["stress"].shape)
    words = with_hints(packed(arrays, header), header)
    r = check_receipt.opened(words, header)
    bound = check_receipt.defect(r)
    missed = missed_equilibrium(r).sum()
    assert 1e-5 * bound <= missed <= bound
