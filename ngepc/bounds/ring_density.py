"""The conjugate density on bodies of revolution, and its integral from above.

Stresses are y/r with polynomials y.  The elastic part of r phi* is a quadratic form of y over r,
see ``ring_integrals``.  The plastic part F(|s|) is convex in s = S/r.  Hence r F(|S|/r) is convex
in S and r together, and on a part, with the n Bernstein coefficients S_i and r_i,

    int r F(|S|/r)  <=  area/n sum_i r_i F(|S_i|/r_i).

With linear hardening F is [|s| - beta]_+^2 / (2 h).  If q is a polynomial whose coefficients are
the nearest points of balls with the radii beta r_i, then r [|s| - beta]_+^2 <= |S - q|^2/r.
Where S varies little, a Taylor polynomial below |S| gives a sharper bound from

    r [|s| - beta]_+^2  <=  |S|^2/r - 2 beta |S| + beta^2 r.
"""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np

from ngepc.bounds.conjugate import Conjugate
from ngepc.bounds.flow_potentials import flow_potential
from ngepc.bounds.polynomials import (
    NARROW,
    SPLIT,
    portions,
    root_from_below,
    triangle_rule,
    worth_keeping,
)
from ngepc.bounds.ring_integrals import OverRadius, inverse_from_above
from ngepc.discretisation.law import Law
from ngepc.linalg.bernstein import bernstein_values, from_lattice, lattice_points

LEVELS = 4
"""How often a triangle is cut at most."""
WORTH = 0.01
"""Triangles are cut until the rest exceeds a rule by this fraction of the bound."""
TERMS = 8
"""m of the polynomial above 1/r."""


@cache
def rule_for(degree: int, power: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points for a power of |S|^2 and for |S|^2/r, Bernstein's polynomials there, and weights."""
    places, weights = triangle_rule(max(2 * power * degree, 2 * degree + TERMS))
    return places, bernstein_values(degree, places), weights


@cache
def affine_coefficients(degree: int) -> np.ndarray:
    """Bernstein coefficients of an affine function by its values at the vertices, (n, 3)."""
    return from_lattice(2, degree) @ lattice_points(2, degree)


@cache
def on_quarters(degree: int) -> np.ndarray:
    """Coefficients on the four parts of a triangle by those on all of it, (4, n, n)."""
    places = np.matmul(lattice_points(2, degree), SPLIT[3])
    return np.matmul(from_lattice(2, degree), bernstein_values(degree, places))


class RingConjugate(Conjugate):
    """phi* of stresses with the coordinates (mean, deviator): each component has an equation.

    ``degree`` is that of y.
    """

    def __init__(self, law: Law, degree: int) -> None:
        super().__init__(law)
        self.whole = True
        self.offset = np.zeros(len(self.bulk))
        self.degree = degree

    def ring_integrals(
        self, y: np.ndarray, radii: np.ndarray, area: np.ndarray, estimate: float
    ) -> np.ndarray:
        """Upper bounds of int 2 pi r phi* over triangles.

        ``y`` (cells, n, 4) are Bernstein coefficients, ``radii`` (cells, 3) and ``area`` (cells,)
        those of the triangles; ``estimate`` is about the error bound.
        """
        R = radii @ affine_coefficients(self.degree).T
        whole = y.copy()
        initial = self.two_mu[:, None] * self.initial[:, 0]
        whole[..., 1:] += R[..., None] * initial[:, None]
        base = partial(bernstein_values, self.degree)
        result = OverRadius(base, self._form, self.degree, whole, radii, area).bound()
        S = y[..., 1:] - R[..., None] * self.back
        cell = np.flatnonzero(
            (np.linalg.norm(S, axis=2) > self.beta[:, None] * R).any(axis=1)
        )
        pieces = (S[cell], radii[cell], area[cell], cell)
        plastic = self._plastic_integrals(*pieces, WORTH * estimate)
        return math.pi * (result + 2 * plastic)

    def _form(self, y: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Twice the elastic part of phi* for stresses y (n, q, 4) of some triangles."""
        square = np.einsum("nqd,nqd->nq", y[..., 1:], y[..., 1:])
        return y[..., 0] ** 2 / self.bulk[cell, None] + square / self.two_mu[cell, None]

    def _plastic_integrals(
        self,
        S: np.ndarray,
        radii: np.ndarray,
        area: np.ndarray,
        cell: np.ndarray,
        allowed: float,
    ) -> np.ndarray:
        """Upper bounds of the integrals of r F over triangles; ``cell`` are their numbers."""
        result = np.zeros(len(self.bulk))
        allowed = allowed / (2 * math.pi)
        for level in range(LEVELS + 1):
            bound, rule = self._on_parts(S, radii, cell)
            gain = area * (bound - rule)
            kept = worth_keeping(gain, allowed) | (level == LEVELS)
            found = (area * bound)[kept]
            result += np.bincount(cell[kept], found, minlength=len(result))
            allowed -= float(gain[kept].sum())
            if kept.all():
                break
            S = np.matmul(on_quarters(self.degree), S[~kept][:, None]).reshape(
                -1, *S.shape[1:]
            )
            radii = np.matmul(SPLIT[3], radii[~kept][:, None, :, None]).reshape(-1, 3)
            area = np.repeat(area[~kept] / 4, 4)
            cell = np.repeat(cell[~kept], 4)
        return result

    def _on_parts(
        self, S: np.ndarray, radii: np.ndarray, cell: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean of r F over parts from above, and by a rule."""
        R = radii @ affine_coefficients(self.degree).T
        bound = self._potential(S, R, cell).mean(axis=1)
        places, weights = triangle_rule(2 * self.degree)
        values = np.matmul(bernstein_values(self.degree, places), S)
        rule = self._potential(values, radii @ places.T, cell) @ weights
        if self.resistance.is_constant:
            squares = self._squares(S, R, radii, self.beta[cell])
            bound = np.minimum(bound, squares / (2 * self.hardening[cell]))
        return bound, np.minimum(rule, bound)

    def _potential(self, S: np.ndarray, r: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """r F(|S|/r), zero for r = 0, for S (parts, q, d) and r (parts, q)."""
        columns = self.resistance.of(cell).of(np.s_[:, None])
        h = self.hardening[cell, None]
        size = np.linalg.norm(S, axis=2)
        size = np.divide(size, r, out=np.zeros_like(size), where=r > 0)
        return r * flow_potential(columns, h, size, columns.gained_at(size, h))

    def _squares(
        self, S: np.ndarray, R: np.ndarray, radii: np.ndarray, beta: np.ndarray
    ) -> np.ndarray:
        """Means of r [|s| - beta]_+^2 over parts that do not touch the axis, inf for others."""
        result = np.full(len(S), np.inf)
        away = np.flatnonzero(radii.min(axis=1) > 0)
        for some in portions(len(away)):
            own = away[some]
            result[own] = squares_above(
                S[own], R[own], radii[own], beta[own], self.degree
            )
        return result


def squares_above(
    S: np.ndarray, R: np.ndarray, radii: np.ndarray, beta: np.ndarray, degree: int
) -> np.ndarray:
    """Means of r [|S|/r - beta]_+^2 from above, from coefficients S (n, k, d) and R (n, k)."""
    size = np.linalg.norm(S, axis=2)
    inside = np.minimum(beta[:, None] * R / np.maximum(size, np.finfo(float).tiny), 1.0)
    beyond = (1 - inside)[..., None] * S
    result = mean_over_radius(beyond, radii, degree)
    mean = S.mean(axis=1)
    varies = np.linalg.norm(S - mean[:, None], axis=2).max(axis=1)
    least = np.maximum(np.linalg.norm(mean, axis=1) - varies, 0.0)
    for power in (2, 4):
        result = np.minimum(result, by_taylor(S, radii, beta, least, degree, power))
    return result


def mean_over_radius(S: np.ndarray, radii: np.ndarray, degree: int) -> np.ndarray:
    """Means of |S|^2/r from above."""
    places, base, weights = rule_for(degree, 1)
    values = np.matmul(base, S)
    square = np.einsum("nqd,nqd->nq", values, values)
    return (square * inverse_from_above(radii @ places.T, radii, TERMS)) @ weights


def by_taylor(
    S: np.ndarray,
    radii: np.ndarray,
    beta: np.ndarray,
    least: np.ndarray,
    degree: int,
    power: int,
) -> np.ndarray:
    """Means of |S|^2/r - 2 beta |S| + beta^2 r from above, inf where that is not sharp.

    |S| is at least ``least`` (n,); ``power`` is the degree of the Taylor polynomial in |S|^2.
    """
    places, base, weights = rule_for(degree, power)
    values = np.matmul(base, S)
    square = np.einsum("nqd,nqd->nq", values, values)
    r = radii @ places.T
    c = np.maximum(square @ weights, np.finfo(float).tiny)[:, None]
    share = least[:, None] ** 2 / c
    size = np.sqrt(c) * root_from_below(square / c - 1, share, power)
    b = beta[:, None]
    over = square * inverse_from_above(r, radii, TERMS)
    found = (over - 2 * b * size + b**2 * r) @ weights
    return np.where(share[:, 0] >= NARROW, found, np.inf)
