"""The map from the unit square or cube to quadrilaterals and hexahedra.

Positions are linear in each reference coordinate.  Polynomials of a degree in each coordinate have
as coefficients those of products of Bernstein polynomials.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np

SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
CORNERS = {
    2: np.array(SQUARE),
    3: np.array([(*corner, z) for z in (0, 1) for corner in SQUARE]),
}
"""Reference coordinates of the corners, in their order."""

ITERATIONS = 20
"""Newton steps for the reference coordinates of a point."""
CENTRE = 0.5
"""All reference coordinates of the centre."""


def factors_of(places: np.ndarray) -> np.ndarray:
    """The factors of the functions of the corners, one for each direction, (places, 2^N, N)."""
    corners = CORNERS[places.shape[1]]
    x = places[:, None]
    return np.where(corners, x, 1 - x)


def corner_functions(places: np.ndarray) -> np.ndarray:
    """The functions of the corners at reference coordinates (places, N), (places, 2^N)."""
    return factors_of(places).prod(axis=2)


def corner_slopes(places: np.ndarray) -> np.ndarray:
    """Their derivatives by the reference coordinates, (places, 2^N, N)."""
    N = places.shape[1]
    factors = factors_of(places)
    signs = 2.0 * CORNERS[N] - 1
    slopes = np.empty(factors.shape)
    for axis in range(N):
        others = [k for k in range(N) if k != axis]
        slopes[..., axis] = signs[:, axis] * factors[..., others].prod(axis=2)
    return slopes


def places_of(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Reference coordinates (n, N) of points (n, N) in elements with corners (n, 2^N, N).

    Newton's method from the centre.
    """
    place = np.full(points.shape, CENTRE)
    for _ in range(ITERATIONS):
        there = np.einsum("nk,nki->ni", corner_functions(place), corners)
        F = np.einsum("nkj,nki->nij", corner_slopes(place), corners)
        missed = (points - there)[..., None]
        place = place + np.linalg.solve(F, missed)[..., 0]
    return place


@cache
def bernstein_lattice(N: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """A lattice in the unit square or cube, and the matrix to Bernstein coefficients from values.

    For polynomials of a degree in each coordinate.
    """
    along = np.arange(degree + 1) / max(degree, 1)
    grid = np.meshgrid(*N * [along], indexing="ij")
    lattice = np.stack(grid, axis=-1).reshape(-1, N)
    return lattice, np.linalg.inv(bernstein_functions(lattice, degree))


def bernstein_functions(places: np.ndarray, degree: int) -> np.ndarray:
    """Products of the Bernstein polynomials of all coordinates, (places, (degree + 1)^N)."""
    k = np.arange(degree + 1)
    binomial = np.array([comb(degree, i) for i in k.tolist()])
    x = places[..., None]
    along = binomial * x**k * (1 - x) ** (degree - k)
    result = np.ones((len(places), 1))
    for axis in range(places.shape[1]):
        result = (result[:, :, None] * along[:, axis, None]).reshape(len(places), -1)
    return result
