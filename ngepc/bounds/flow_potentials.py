"""The potential of plastic flow F of a hardening law, and bounds of its integrals.

    F(r) = max over g >= 0 of  r g - h/2 g^2 - int_0^g beta

is convex and nondecreasing, F'(r) the g of the maximum, and F infinite for r that the law never
reaches.  On the parts of a cell r is the size of a polynomial s with Bernstein coefficients
(n, k, d).
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.polynomials import (
    RULE,
    TRIANGLES,
    WEIGHTS,
    beyond,
    exceeding,
    excess_integrals,
    square_integrals,
)
from ngepc.discretisation.resistance import Resistance


def flow_potential(
    resistance: Resistance, modulus: np.ndarray, size: np.ndarray, gained: np.ndarray
) -> np.ndarray:
    """size g - modulus/2 g^2 - int_0^g beta at its maximum g = ``gained``, inf for infinite g."""
    finite = np.isfinite(gained)
    g = np.where(finite, gained, 0.0)
    over = np.maximum(size - resistance.beta, 0.0)
    found = over * g - modulus / 2 * g**2 - resistance.hardened(g)
    return np.where(finite, found, np.inf)


def potential_at(
    resistance: Resistance, hardening: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """F(size), for sizes of any shape that broadcasts with the law."""
    gained = resistance.gained_at(size, hardening)
    return flow_potential(resistance, hardening, size, gained)


def most_potential(
    resistance: Resistance, modulus: np.ndarray, s: np.ndarray, volume: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """An upper bound of int F(|s|) over parts, by convexity alone, and a quadrature rule.

    F(|s|) is convex in s, so that the mean of its values at the coefficients bounds its mean.
    A second bound: the largest and the smallest |s| bound the g of the maximum.  Between these
    beta(g) >= beta(g_0) + slope (g - g_0) for g >= g_0, with slope = min beta': F is at most
    that of linear hardening with this slope and another yield bound.

    ``s`` (n, k, d) are Bernstein coefficients; the sizes ``volume`` have shape (n,).
    """
    sizes = np.linalg.norm(s, axis=2)
    columns = resistance.of(np.s_[:, None])
    at_coefficients = potential_at(columns, modulus[:, None], sizes)
    most = resistance.gained_at(sizes.max(axis=1), modulus)
    finite = np.isfinite(most)
    most = np.where(finite, most, 0.0)
    linear = _linear_above(resistance, modulus, s, volume, most)
    bound = np.minimum(linear, volume * at_coefficients.mean(axis=1))
    bound = np.where(finite, bound, np.inf)
    at_rule = np.linalg.norm(np.matmul(RULE[s.shape[1]], s), axis=2)
    estimate = potential_at(columns, modulus[:, None], at_rule)
    estimate = estimate @ WEIGHTS[s.shape[1]]
    return bound, np.minimum(volume * estimate, bound)


def _linear_above(
    resistance: Resistance,
    modulus: np.ndarray,
    s: np.ndarray,
    volume: np.ndarray,
    most: np.ndarray,
) -> np.ndarray:
    """The second bound of ``most_potential``, inf where that hardening has no modulus > 0.

    ``most`` is the g of the largest |s|.
    """
    middle = s.mean(axis=1)
    spread = np.linalg.norm(s - middle[:, None], axis=2).max(axis=1)
    least = np.maximum(np.linalg.norm(middle, axis=1) - spread, 0.0)
    fewest = np.minimum(resistance.gained_at(least, modulus), most)

    g = (fewest + most) / 2
    slope = resistance.slopes(fewest, most)[0]
    stiff = modulus + slope
    beta = resistance.bound(g) - slope * g
    given = resistance.bound(g) * g - slope * g**2 / 2 - resistance.energy(g)
    squares = square_integrals(beyond(s, beta), volume)
    if s.shape[1] in TRIANGLES:
        squares = np.minimum(squares, excess_integrals(s, beta, volume))
    hard = np.where(stiff > 0, stiff, 1.0)
    return np.where(stiff > 0, volume * given + squares / (2 * hard), np.inf)


def least_potential(
    resistance: Resistance, modulus: np.ndarray, s: np.ndarray, area: np.ndarray
) -> np.ndarray:
    """A lower bound of int G(|s|) over triangles, where G is F with this modulus in place of h.

    G is convex: its mean is at least its value at the mean of s.  Where |s| > beta everywhere, G is
    at least that of the linear hardening of ``linear_below``.

    ``s`` (n, k, d) are vertex values of affine functions; ``area``, the sizes, has shape (n,).
    """
    middle = s.mean(axis=1)
    size = np.linalg.norm(middle, axis=1)
    spread = np.linalg.norm(s - middle[:, None], axis=2).max(axis=1)
    least = np.maximum(size - spread, 0.0)
    most = np.linalg.norm(s, axis=2).max(axis=1)
    g = resistance.gained_at(size, modulus)
    at_mean = area * flow_potential(resistance, modulus, size, g)
    usable, beta, stiff, given = linear_below(resistance, modulus, g, least, most)
    linear = area * given + exceeding(s, beta, area) / (2 * stiff)
    return np.where(usable, np.maximum(linear, at_mean), at_mean)


def linear_below(
    resistance: Resistance,
    modulus: np.ndarray,
    g: np.ndarray,
    least: np.ndarray,
    most: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Linear hardening whose G is nowhere above that of a law for |s| between two values.

    It has the bound of the law at ``g``, and the largest slope of beta between the two values.
    Returns where there is one, with |s| > beta everywhere, its beta, its modulus, and the constant
    that is added to its G.
    """
    fewest = resistance.gained_at(least, modulus)
    slope = resistance.slopes(fewest, resistance.gained_at(most, modulus))[1]
    usable = np.isfinite(slope) & (fewest > 0)
    slope = np.where(usable, slope, 0.0)
    beta = resistance.bound(g) - slope * g
    usable &= (beta >= 0) & (beta <= least)
    beta = np.where(usable, beta, resistance.beta)
    given = resistance.bound(g) * g - slope * g**2 / 2 - resistance.energy(g)
    return usable, beta, modulus + slope, given
