"""The supremum of a goal on the parts of the cells, for both signs and every lambda.

With the letters of ``supremum``, and sigma = +1 or -1 for the upper and the lower bound,

    q/(2 mu_2) = sigma T + lambda S,   T = dev tau/(2 mu_2),  S = (sigma^ - dev alpha_0)/(2 mu_2),
    w = lambda s/(2 mu_2) - sigma eps(z),

and the supremum over the mean strain is that of sigma A + lambda B,

    (sigma A + lambda B)^2/(4 lambda K),   A = tau_m - K tr eps(z),  B = sigma^_m - K tr eps_h.

So all of the supremum but Phi is known for every lambda from five integrals over each part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.polynomials import RULE, WEIGHTS, portions
from ngepc.bounds.simplices import of_cells
from ngepc.discretisation.resistance import Resistance
from ngepc.goals.cutting import potential_integrals
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_ellipsoids import EllipsoidLaw
from ngepc.goals.supremum_of_laws import NonlinearLaw
from ngepc.goals.whole_cells import close_enough, whole_integrals

AnyLaw = ScaledLaw | NonlinearLaw | EllipsoidLaw
"""What Phi depends on, by the kind of law."""

AT_ONCE = 2000
"""Cells that are treated at once."""


@dataclass(frozen=True, eq=False)
class LawOnParts:
    """The numbers of the law on parts, (parts,); ``resistance`` is that of a nonlinear one.

    ``form`` (parts, d, d) is that of Hill's ellipsoid, None for von Mises.
    """

    two_mu: np.ndarray
    hardening: np.ndarray
    beta: np.ndarray
    resistance: Resistance | None = None
    form: np.ndarray | None = None

    def of(self, chosen: slice | np.ndarray) -> LawOnParts:
        """Those of some of the parts."""
        own = None if self.resistance is None else self.resistance.of(chosen)
        form = None if self.form is None else self.form[chosen]
        numbers = (self.two_mu, self.hardening, self.beta)
        return LawOnParts(*(values[chosen] for values in numbers), own, form)

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
class ResultOnParts:
    """What all goals of an error bound share, on the parts of the cells.

    ``sigma`` (parts, k, d) are coefficients of S, ``trial`` those of s/(2 mu_2), (parts, 1, d)
    where they are constant on the cells; ``mean`` (parts, k) those of B, divided by 2 K^(1/2).
    ``size`` and ``owner`` (parts,) are the volumes and the cells; all parts of a cell stand
    together.
    """

    sigma: np.ndarray
    trial: np.ndarray
    mean: np.ndarray
    law: LawOnParts
    size: np.ndarray
    owner: np.ndarray

    def of(self, chosen: slice | np.ndarray) -> ResultOnParts:
        """Those on some of the parts."""
        values = (self.sigma, self.trial, self.mean)
        rest = self.law.of(chosen), self.size[chosen], self.owner[chosen]
        return ResultOnParts(*(of_cells(value, chosen) for value in values), *rest)


def mean_products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Means over parts of products of vectors with coefficients (parts, k or 1, d), (parts,)."""
    k = max(a.shape[1], b.shape[1])
    if min(a.shape[1], b.shape[1]) == 1:
        return np.einsum("nd,nd->n", a.mean(axis=1), b.mean(axis=1))
    at_points = (np.matmul(RULE[k], values) for values in (a, b))
    return np.einsum("nqd,nqd->nq", *at_points) @ WEIGHTS[k]


@dataclass(frozen=True, eq=False)
class Sides:
    """The supremum for an adjoint.

    ``tau`` (parts, k, d) are coefficients of T, ``strain`` those of dev eps(z), (parts, 1, d) where
    they are constant on the cells.  ``squares`` (3, parts) are integrals of the products of
    A/(2 K^(1/2)) and B/(2 K^(1/2)): of A with itself, of both, of B with itself.  ``linear``
    (2, parts) are the integrals that are multiplied with the sign and with lambda.
    """

    result: ResultOnParts
    tau: np.ndarray
    strain: np.ndarray
    squares: np.ndarray
    linear: np.ndarray

    @classmethod
    def of_adjoint(
        cls,
        result: ResultOnParts,
        tau: np.ndarray,
        strain: np.ndarray,
        mean: np.ndarray,
        kept: np.ndarray,
    ) -> Sides:
        """Those of an adjoint: ``mean`` (parts, k) are coefficients of A/(2 K^(1/2)).

        ``kept`` (parts,) are the means of (s(eps_h) - dev alpha_0) : eps(z).
        """
        table = RULE[mean.shape[1]]
        weights = WEIGHTS[mean.shape[1]]
        A = mean @ table.T
        B = result.mean @ table.T
        squares = np.stack([(a * b) @ weights for a, b in ((A, A), (A, B), (B, B))])
        trial = result.law.two_mu[:, None, None] * result.trial
        of_sign = kept - mean_products(tau, trial)
        of_factor = -mean_products(result.sigma, trial)
        linear = np.stack([of_sign, of_factor])
        return cls(result, tau, strain, result.size * squares, result.size * linear)

    def of(self, chosen: slice | np.ndarray) -> Sides:
        """The supremum on some of the parts."""
        return Sides(
            self.result.of(chosen),
            of_cells(self.tau, chosen),
            of_cells(self.strain, chosen),
            self.squares[:, chosen],
            self.linear[:, chosen],
        )

    def rest(self, sign: float, factor: float) -> np.ndarray:
        """Integrals of all but Phi over the parts, (parts,)."""
        adjoint, both, own = self.squares
        squares = adjoint / factor + 2 * sign * both + factor * own
        of_sign, of_factor = self.linear
        return squares + sign * of_sign + factor * of_factor

    def pulled(self, sign: float, factor: float) -> np.ndarray:
        """Coefficients of q/(2 mu_2), (parts, k, d)."""
        return sign * self.tau + factor * self.result.sigma

    def w(self, sign: float, factor: float) -> np.ndarray:
        """Those of w, (parts, k or 1, d)."""
        return factor * self.result.trial - sign * self.strain

    def law(self, factor: float) -> AnyLaw:
        """What Phi depends on, for lambda."""
        return self.result.law.scaled(factor)

    def estimate(self, sign: float, factor: float) -> np.ndarray:
        """Integrals of the supremum over the parts by a rule, (parts,)."""
        k = self.tau.shape[1]
        pulled = np.matmul(RULE[k], self.pulled(sign, factor))
        w = self.w(sign, factor)
        if w.shape[1] > 1:
            w = np.matmul(RULE[k], w)
        found = self.law(factor).potential(pulled, w)
        return self.result.size * (found @ WEIGHTS[k]) + self.rest(sign, factor)

    def integrals(self, sign: float, factor: float, count: int) -> np.ndarray:
        """Integrals of the supremum over ``count`` cells from above.

        Where strains are constant on the cells, those of whole cells are taken where they are
        close.
        """
        if self.strain.shape[1] == 1:
            return self._by_cells(sign, factor, count)
        rest = np.bincount(self.result.owner, self.rest(sign, factor), minlength=count)
        return self._by_parts(sign, factor, rest)

    def _by_parts(self, sign: float, factor: float, rest: np.ndarray) -> np.ndarray:
        """Integrals by parts that are cut, and of a ``rest`` that is given, (cells,)."""
        law = self.law(factor)
        pulled = self.pulled(sign, factor)
        w = self.w(sign, factor)
        parts = self.result.size, self.result.owner
        return potential_integrals(law, pulled, w, parts, rest)

    def _by_cells(self, sign: float, factor: float, count: int) -> np.ndarray:
        """Integrals over whole cells first, by parts where these are not close."""
        parts = len(self.result.owner) // count
        whole = np.empty(count)
        estimate = np.empty(count)
        for cells in portions(count, AT_ONCE):
            some = self.of(slice(parts * cells.start, parts * cells.stop))
            whole[cells], estimate[cells] = some.of_whole_cells(sign, factor, parts)
        rest = self.rest(sign, factor).reshape(-1, parts).sum(axis=1)
        close = close_enough(whole, estimate, rest)
        left = self.of(np.flatnonzero(~close[self.result.owner]))
        known = np.where(close, rest + whole, rest)
        return np.maximum(left._by_parts(sign, factor, known), 0.0)

    def of_whole_cells(
        self, sign: float, factor: float, parts: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Integrals of Phi over the cells from above, and estimates, see ``whole_cells``."""
        first = np.s_[::parts]
        pulled = self.pulled(sign, factor)
        pulled = pulled.reshape(-1, parts, *pulled.shape[1:])
        law = self.law(factor).of_points(first)
        w = self.w(sign, factor)[first, 0]
        return whole_integrals(law, pulled, w, parts * self.result.size[first])
