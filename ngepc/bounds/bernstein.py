"""Bernstein's polynomials of any degree on segments and triangles.

They are nonnegative and add up to one, so that values lie in the convex hull of the coefficients.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import combinations_with_replacement

import numpy as np

from ngepc.bounds.polynomials import SPLIT


@cache
def multi_indices(degree: int, corners: int) -> np.ndarray:
    """The exponents of the polynomials, (functions, corners)."""
    chosen = combinations_with_replacement(range(corners), degree)
    return np.array([np.bincount(c, minlength=corners) for c in chosen])


def basis(shares: np.ndarray, degree: int) -> np.ndarray:
    """The polynomials at points with barycentric coordinates (..., corners), (..., functions)."""
    exponents = multi_indices(degree, shares.shape[-1])
    factorials = np.array([math.factorial(n) for n in range(degree + 1)])
    counts = factorials[degree] / factorials[exponents].prod(axis=1)
    return counts * (shares[..., None, :] ** exponents).prod(axis=-1)


@cache
def nodes(degree: int, corners: int) -> np.ndarray:
    """Barycentric coordinates of as many points as there are polynomials."""
    return multi_indices(degree, corners) / degree


@cache
def from_nodes(degree: int, corners: int) -> np.ndarray:
    """The matrix of the coefficients by the values at the nodes."""
    return np.linalg.inv(basis(nodes(degree, corners), degree))


@cache
def split(degree: int) -> np.ndarray:
    """Coefficients on the four parts of a triangle by those of the triangle, (4, n, n)."""
    places = np.matmul(nodes(degree, 3), SPLIT[3])
    return np.matmul(from_nodes(degree, 3), basis(places, degree))
