"""Polynomials on simplices by their Bernstein coefficients.

With barycentric coordinates l and multi-indices a of sum k the polynomials of degree k are
sum_a c_a B_a, B_a = k! / a! l^a.  The B_a are not negative and add up to one: |sum_a c_a B_a| is
nowhere above sum_a |c_a| B_a, and a polynomial with coefficients <= 0 is <= 0.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product

import numpy as np


@cache
def multi_indices(N: int, degree: int) -> np.ndarray:
    """The multi-indices of sum ``degree`` for simplices with N + 1 vertices, (n, N + 1)."""
    parts = product(range(degree + 1), repeat=N + 1)
    return np.array([part for part in parts if sum(part) == degree])


@cache
def chains(N: int, degree: int) -> np.ndarray:
    """Each multi-index a as a list that contains vertex i a_i times, (n, degree)."""
    numbers = np.arange(N + 1)
    return np.array([np.repeat(numbers, a) for a in multi_indices(N, degree)])


@cache
def raised(N: int, degree: int) -> np.ndarray:
    """The position of a + e_i among the multi-indices of degree + 1, (n, N + 1)."""
    above = {tuple(a): place for place, a in enumerate(multi_indices(N, degree + 1))}
    steps = np.eye(N + 1, dtype=int)
    below = multi_indices(N, degree)
    return np.array([[above[tuple(a + step)] for step in steps] for a in below])


def bernstein_values(degree: int, points: np.ndarray) -> np.ndarray:
    """The polynomials B_a at barycentric points (..., N + 1), shape (..., n)."""
    indices = multi_indices(points.shape[-1] - 1, degree)
    factorials = np.array([math.factorial(j) for j in range(degree + 1)])
    weights = math.factorial(degree) / factorials[indices].prod(axis=1)
    return weights * (points[..., None, :] ** indices).prod(axis=-1)


@cache
def lattice_points(N: int, degree: int) -> np.ndarray:
    """Barycentric points a/k, as many as there are polynomials of degree k, (n, N + 1)."""
    return multi_indices(N, degree) / max(degree, 1)


@cache
def from_lattice(N: int, degree: int) -> np.ndarray:
    """The coefficients of a polynomial by its values at the points of the lattice, (n, n)."""
    return np.linalg.inv(bernstein_values(degree, lattice_points(N, degree)))


def integral(N: int, degree: int) -> float:
    """The integral of each B_a over the volume of the simplex."""
    return 1 / math.comb(degree + N, N)


@cache
def times_hats(N: int, degree: int) -> np.ndarray:
    """Integrals of B_a l_j over the volume of the simplex, (n, N + 1)."""
    shares = (multi_indices(N, degree) + 1) / (degree + 1)
    return shares * integral(N, degree + 1)


@cache
def parts_of(N: int, degree: int, cuts: int) -> np.ndarray:
    """Coefficients of a polynomial on the parts of a simplex from those on all of it, (m, n).

    Each edge is cut into ``cuts`` equal parts.  The parts of the simplex have the same volume, so
    that the mean of all coefficients is the mean of the polynomial.
    """
    parts = []
    for corners in _parts(N, cuts):
        own = bernstein_values(degree, lattice_points(N, degree) @ corners)
        parts.append(from_lattice(N, degree) @ own)
    return np.concatenate(parts)


@cache
def distinct_parts(N: int, degree: int, cuts: int) -> tuple[np.ndarray, np.ndarray]:
    """The rows of ``parts_of`` without repetitions, and their shares of all rows.

    Neighbouring parts have coefficients in common.
    """
    rows, counts = np.unique(parts_of(N, degree, cuts), axis=0, return_counts=True)
    return rows, counts / counts.sum()


def _parts(N: int, cuts: int) -> list[np.ndarray]:
    """Barycentric corners of the equal simplices in a simplex; ``cuts`` is 2^k in space."""
    steps = np.eye(N + 1)
    if N == 3:
        result = [steps]
        for _ in range(int(math.log2(cuts))):
            result = [half @ part for part in result for half in _eighths()]
        return result
    result = [(a + steps) / cuts for a in multi_indices(N, cuts - 1)]
    if N == 1 or cuts == 1:
        return result
    return result + [(a + 1 - steps) / cuts for a in multi_indices(2, cuts - 2)]


def _eighths() -> list[np.ndarray]:
    """Barycentric corners of eight equal parts of a tetrahedron.

    Four at its corners, and four of the octahedron between them, around one of its diagonals.
    """
    steps = np.eye(4)
    corners = [(step + steps) / 2 for step in steps]
    ring = [(0, 1), (0, 2), (2, 3), (1, 3)]
    middles = [(steps[i] + steps[j]) / 2 for i, j in ring]
    diagonal = [(steps[0] + steps[3]) / 2, (steps[1] + steps[2]) / 2]
    around = [[middles[k - 1], middles[k]] for k in range(4)]
    return corners + [np.array(diagonal + pair) for pair in around]
