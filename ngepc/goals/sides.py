"""The supremum of a goal on the cells, for both signs and every lambda.

With the letters of ``supremum``, and sigma = +1 or -1 for the upper and the lower bound,

    q/(2 mu_2) = sigma T + lambda S,   T = dev tau/(2 mu_2),  S = (sigma^ - dev alpha_0)/(2 mu_2),
    w = lambda s/(2 mu_2) - sigma eps(z),

and the supremum over the mean strain is that of sigma A + lambda B,

    (sigma A + lambda B)^2/(4 lambda K),   A = tau_m - K tr eps(z),  B = sigma^_m - K tr eps_h.

So all of the supremum but Phi is known for every lambda from five integrals over each cell.  Where
|q/(2 mu_2)| and |w| are at most lambda beta/(2 mu_2), nothing yields, and Phi is a square, too:

    2 mu_2 |sigma G + lambda R|^2/(4 lambda),   G = T - eps(z),  R = S + s/(2 mu_2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ngepc.bounds.polynomials import portions
from ngepc.bounds.simplices import of_cells
from ngepc.discretisation.resistance import Resistance
from ngepc.goals.cutting import potential_integrals
from ngepc.goals.pieces import (
    MEANS,
    RULE,
    WEIGHTS,
    applied,
    largest_of,
    mean_products,
    mean_squares,
    pieces_last,
    products,
)
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_ellipsoids import EllipsoidLaw
from ngepc.goals.supremum_of_laws import NonlinearLaw

AnyLaw = ScaledLaw | NonlinearLaw | EllipsoidLaw
"""What Phi depends on, by the kind of law."""

MANY = 0.3
"""Cells where nothing yields are treated by themselves if they are more than this part."""


def largest_sizes(values: np.ndarray) -> np.ndarray:
    """No less than the sizes of vectors on each cell, (n,), from coefficients (n, k, d)."""
    found = np.empty(len(values))
    for cells in portions(len(values)):
        part = pieces_last(values[cells])
        found[cells] = np.sqrt(largest_of(products(part, part)))
    return found


@dataclass(frozen=True, eq=False)
class LawOnCells:
    """The numbers of the law on cells, (cells,); ``resistance`` is that of a nonlinear one.

    ``form`` (cells, d, d) is that of Hill's ellipsoid, None for von Mises.
    """

    two_mu: np.ndarray
    hardening: np.ndarray
    beta: np.ndarray
    resistance: Resistance | None = None
    form: np.ndarray | None = None

    def of(self, chosen: slice | np.ndarray) -> LawOnCells:
        """Those of some of the cells."""
        own = None if self.resistance is None else self.resistance.of(chosen)
        form = None if self.form is None else self.form[chosen]
        numbers = (self.two_mu, self.hardening, self.beta)
        return LawOnCells(*(values[chosen] for values in numbers), own, form)

    def scaled(self, factor: float) -> AnyLaw:
        """What Phi depends on, for lambda."""
        if self.form is not None:
            numbers = self.two_mu, self.hardening, self.beta
            return EllipsoidLaw(*numbers, *np.linalg.eigh(self.form), factor)
        if self.resistance is not None:
            moduli = self.two_mu, self.hardening
            return NonlinearLaw(self.resistance, *moduli, factor)
        return ScaledLaw.of(self.two_mu, self.hardening, self.beta, factor)


@dataclass(frozen=True, eq=False)
class ResultOnCells:
    """What all goals of an error bound share, on the cells.

    ``sigma`` (cells, k, d) are coefficients of S, ``trial`` those of s/(2 mu_2), (cells, 1, d)
    where they are constant on the cells; ``mean`` (cells, k) those of B, divided by 2 K^(1/2);
    ``size`` (cells,) the volumes.
    """

    sigma: np.ndarray
    trial: np.ndarray
    mean: np.ndarray
    law: LawOnCells
    size: np.ndarray

    @cached_property
    def square(self) -> np.ndarray:
        """Integrals of the square of B/(2 K^(1/2)) over the cells, (cells,)."""
        return self.size * mean_squares(self.mean.T)

    @cached_property
    def of_factor(self) -> np.ndarray:
        """Integrals of -S : s over the cells, (cells,)."""
        return -self.size * mean_products(self.sigma, self.stress)

    @cached_property
    def stress(self) -> np.ndarray:
        """Coefficients of s, of the shape of ``trial``."""
        return self.law.two_mu[:, None, None] * self.trial

    @cached_property
    def of_trial(self) -> np.ndarray:
        """No less than the sizes of s/(2 mu_2) on the cells, (cells,)."""
        return largest_sizes(self.trial)

    @cached_property
    def of_sigma(self) -> np.ndarray:
        """The same for S."""
        return largest_sizes(self.sigma)

    def of(self, chosen: slice | np.ndarray) -> ResultOnCells:
        """Those on some of the cells."""
        values = (self.sigma, self.trial, self.mean)
        rest = self.law.of(chosen), self.size[chosen]
        return ResultOnCells(*(of_cells(value, chosen) for value in values), *rest)


@dataclass(frozen=True, eq=False)
class Sides:
    """The supremum for an adjoint.

    ``tau`` (cells, k, d) are coefficients of T, ``strain`` those of dev eps(z), (cells, 1, d) where
    they are constant on the cells.  ``squares`` (3, cells) are integrals of the products of
    A/(2 K^(1/2)) and B/(2 K^(1/2)): of A with itself, of both, of B with itself.  ``linear``
    (2, cells) are the integrals that are multiplied with the sign and with lambda.
    """

    result: ResultOnCells
    tau: np.ndarray
    strain: np.ndarray
    squares: np.ndarray
    linear: np.ndarray

    @classmethod
    def of_adjoint(
        cls,
        result: ResultOnCells,
        tau: np.ndarray,
        strain: np.ndarray,
        mean: np.ndarray,
        kept: np.ndarray,
    ) -> Sides:
        """Those of an adjoint: ``mean`` (cells, k) are coefficients of A/(2 K^(1/2)).

        ``kept`` (cells,) are the means of (s(eps_h) - dev alpha_0) : eps(z).
        """
        A = mean.T
        weighted = MEANS[len(A)] @ A
        size = result.size
        pairs = (
            size * np.einsum("kn,kn->n", weighted, other)
            for other in (A, result.mean.T)
        )
        squares = np.stack([*pairs, result.square])
        of_sign = size * (kept - mean_products(tau, result.stress))
        linear = np.stack([of_sign, result.of_factor])
        return cls(result, tau, strain, squares, linear)

    def of(self, chosen: slice | np.ndarray) -> Sides:
        """The supremum on some of the cells."""
        return Sides(
            self.result.of(chosen),
            of_cells(self.tau, chosen),
            of_cells(self.strain, chosen),
            self.squares[:, chosen],
            self.linear[:, chosen],
        )

    def energies(self) -> np.ndarray:
        """About the energies of tau - C eps(z) in an elastic body, (cells,)."""
        squares = np.empty(len(self.tau))
        for cells in portions(len(squares)):
            apart = self.tau[cells] - self.strain[cells]
            squares[cells] = np.einsum("nkd,nkd->n", apart, apart)
        factor = self.result.law.two_mu / (4 * self.tau.shape[1])
        return self.squares[0] + self.result.size * factor * squares

    @cached_property
    def _of_strain(self) -> np.ndarray:
        """No less than the sizes of eps(z) on the cells, (cells,)."""
        return largest_sizes(self.strain)

    @cached_property
    def _of_tau(self) -> np.ndarray:
        """The same for T."""
        return largest_sizes(self.tau)

    def elastic(self, factor: float) -> np.ndarray:
        """Cells where nothing yields for both signs, as booleans; some may be left out."""
        law = self.result.law
        none = np.zeros(len(law.beta), dtype=bool)
        if law.form is not None:
            return none
        limit = factor * law.beta / law.two_mu
        within = self._of_strain + factor * self.result.of_trial <= limit
        if within.mean() <= MANY:
            return none
        return within & (self._of_tau + factor * self.result.of_sigma <= limit)

    @cached_property
    def _elastic_squares(self) -> np.ndarray:
        """Like ``squares``, of G and R times the root of mu_2/2."""
        found = np.empty_like(self.squares)
        M = MEANS[self.tau.shape[1]]

        def means_of(x: np.ndarray) -> np.ndarray:
            """M times values whose first axis is that of the coefficients."""
            return (M @ x.reshape(len(M), -1)).reshape(x.shape)

        for cells in portions(len(self.tau)):
            G = pieces_last(self.tau[cells] - self.strain[cells])
            R = pieces_last(self.result.sigma[cells] + self.result.trial[cells])
            of_G = means_of(G)
            of_R = means_of(R)
            pairs = (of_G, G), (of_G, R), (of_R, R)
            found[:, cells] = [np.einsum("kdn,kdn->n", *pair) for pair in pairs]
        return self.result.size * self.result.law.two_mu / 4 * found

    def rest(self, sign: float, factor: float) -> np.ndarray:
        """Integrals of all but Phi over the cells, (cells,)."""
        of_sign, of_factor = self.linear
        rest = square_of_sum(self.squares, sign, factor)
        return rest + sign * of_sign + factor * of_factor

    def pulled(self, sign: float, factor: float) -> np.ndarray:
        """Coefficients of q/(2 mu_2), (cells, k, d)."""
        found = factor * self.result.sigma
        add = np.add if sign > 0 else np.subtract
        return add(found, self.tau, out=found)

    def w(self, sign: float, factor: float) -> np.ndarray:
        """Those of w, (cells, k or 1, d)."""
        return factor * self.result.trial - sign * self.strain

    def law(self, factor: float) -> AnyLaw:
        """What Phi depends on, for lambda."""
        return self.result.law.scaled(factor)

    def estimate(self, sign: float, factor: float) -> np.ndarray:
        """Integrals of the supremum over the cells by a rule, (cells,)."""
        k = self.tau.shape[1]
        table = RULE[k]
        pulled = applied(table, self.pulled(sign, factor))
        w = self.w(sign, factor)
        w = w if w.shape[1] == 1 else applied(table, w)
        means = self.law(factor).potential(pulled, w) @ WEIGHTS[k]
        return self.result.size * means + self.rest(sign, factor)

    def integrals(self, sign: float, factor: float) -> np.ndarray:
        """Integrals of the supremum over the cells from above, (cells,)."""
        rest = self.rest(sign, factor)
        elastic = self.elastic(factor)
        part = self
        cell = np.flatnonzero(~elastic)
        if len(cell) < len(elastic):
            potential = square_of_sum(self._elastic_squares, sign, factor)
            rest += np.where(elastic, potential, 0.0)
            part = self.of(cell)
        if not len(cell):
            return rest
        pulled = part.pulled(sign, factor)
        w = part.w(sign, factor)
        size = part.result.size
        return potential_integrals(part.law(factor), pulled, w, size, rest, cell)


def square_of_sum(squares: np.ndarray, sign: float, factor: float) -> np.ndarray:
    """|sign a + factor b|^2/factor, (n,), from ``squares`` (3, n): of a, of both, of b."""
    first, both, second = squares
    return first / factor + 2 * sign * both + factor * second
