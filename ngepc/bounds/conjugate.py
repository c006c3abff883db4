"""The density of the dual functional: phi*(sigma), its derivatives, and an integrable upper bound.

In-plane stresses have the coordinates z = (a, b_0, b_1) = ((xx + yy)/2, (xx - yy)/2^(1/2),
2^(1/2) xy), whose product with (tr eps, e_0, e_1) is sigma : eps.  With the mean part m and the
deviatoric coordinates d of the stress

    phi*(sigma) = m^2 / (2 bulk) + |d + 2 mu_2 p_0|^2 / (4 mu_2) + F(|d - dev alpha_0|),

    F(r) = max over g >= 0 of  r g - h/2 g^2 - int_0^g beta,

where linear hardening has F = 1/(2 h) ([r - beta]_+)^2.  phi* is conjugate to the density of J
without the constant mu_2 |p_0|^2, as a function of the strain less the initial strain.  F is convex
and nondecreasing; F'(r) is the g of the maximum.  F is infinite for r that the law never reaches.

In three dimensions the coordinates are m and the five of d; in the law of two dimensions m = a and
d = b.  In plane strain no equation restricts sigma_zz, the coordinate d_1 = zeta along
diag(1, 1, -2)/6^(1/2) with m = a - zeta/6^(1/2): any zeta gives a bound.  The zeta computed here
nearly minimises phi* - zeta offset, where offset represents the initial strain eps_zz.  In plane
stress, sigma_zz = 0 determines zeta.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.bounds.flow_potentials import flow_potential, most_potential
from ngepc.bounds.polynomials import (
    NODES,
    RULE,
    SPLIT,
    SPLIT_LEVELS,
    TRIANGLES,
    WEIGHTS,
    WORTH,
    beyond,
    coefficients,
    excess_integrals,
    portions,
    square_integrals,
    worth_keeping,
)
from ngepc.bounds.simplices import by_cells, sliced, stored_by_cells
from ngepc.discretisation.law import SOFTEST, Law

R6 = np.sqrt(6.0)

ZETA_STEPS = 6  # most Newton steps for zeta where the stress yields
ZETA_ACCURACY = 1e-5
"""They end at a change of this size relative to the stress; what is left is about its square."""
UNREACHED = 0.01
"""Finite value used in place of an infinite |p| while a stress is searched.

It is about the plastic strain where curves end: large ones draw the stress of few cells below the
largest one of the law, and with it that of others above it.
"""

# m, and the coordinates of d, by those in the plane where sigma_zz = 0
THIN = np.array([[2 / 3, 0, 0], [0, 1, 0], [R6 / 3, 0, 0], [0, 0, 1]])


class Completed(NamedTuple):
    """A stress with its component along the third direction, shapes (...) and (..., d).

    ``mean`` m and ``deviator`` d; with s = d - dev alpha_0, ``over`` is [|s| - beta]_+,
    ``direction`` s/|s|, ``size`` |s|, and ``gained`` is F'(|s|), inf where F is.
    """

    mean: np.ndarray
    deviator: np.ndarray
    over: np.ndarray
    direction: np.ndarray
    size: np.ndarray
    gained: np.ndarray

    @property
    def reached(self) -> np.ndarray:
        """``gained`` with ``UNREACHED`` in place of inf."""
        return np.where(np.isfinite(self.gained), self.gained, UNREACHED)


OF_LAW = ("bulk", "two_mu", "hardening", "beta", "offset", "back", "initial")


class Conjugate:
    """phi* on cells with constant material data, taken from every ``each``-th point of the law.

    ``back`` and ``initial`` may vary from point to point of a cell, (cells, 1 or points, d).
    ``resistance`` is the law's for the cells, ``columns`` the same for arrays (cells, points).
    """

    def __init__(self, law: Law, each: int = 1) -> None:
        for name in OF_LAW[:4]:
            setattr(self, name, getattr(law, name)[::each])
        self.resistance = law.resistance.of(np.s_[::each])
        self.columns = self.resistance.of(np.s_[:, None])
        self.back = law.back[::each, None]
        self.initial = law.initial[::each, None]
        self.d = self.back.shape[2]
        self.whole = self.d != 3  # no direction without an equation
        self.thin = law.across is not None
        self.offset = np.zeros(len(self.bulk))
        if not (self.whole or self.thin or np.ndim(law.distortion) == 0):
            offset = law.swelling / R6 - law.distortion[:, 1]
            self.offset = offset[::each]

    def of(self, cells: np.ndarray | slice) -> Conjugate:
        """phi* on some of the cells."""
        part = sliced(self, cells, OF_LAW)
        part.resistance = self.resistance.of(cells)
        part.columns = part.resistance.of(np.s_[:, None])
        return part

    def completed(self, z: np.ndarray) -> Completed:
        """The stress with all components for coordinates z (cells, points, c).

        zeta is the elastic one where the resulting stress does not yield; elsewhere it is computed
        by Newton steps.
        """
        return self._completed(*self.mean_and_deviator(z))

    def mean_and_deviator(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """m and d of the same stress, (cells, points) and (cells, points, d)."""
        if self.whole:
            return z[..., 0], z[..., 1:]
        if self.thin:
            whole = np.matmul(z, THIN.T)
            return whole[..., 0], whole[..., 1:]
        zeta = self._zeta(z)
        d = by_cells(*zeta.shape, 3)
        d[..., 0] = z[..., 1]
        d[..., 1] = zeta
        d[..., 2] = z[..., 2]
        return z[..., 0] - zeta / R6, d

    def yields(self, z: np.ndarray) -> np.ndarray:
        """Whether one of the stresses z (cells, points, c) of each cell yields, as booleans."""
        s = self.shifted(self.mean_and_deviator(z)[1])
        square = np.einsum("tqd,tqd->tq", s, s)
        return (square > self.beta[:, None] ** 2).any(axis=1)

    def _zeta(self, z: np.ndarray) -> np.ndarray:
        """The zeta that nearly minimises phi* - zeta offset, (cells, points)."""
        stiff = 1 / (6 * self.bulk) + 1 / self.two_mu
        free = z[..., 0] / (R6 * self.bulk[:, None])
        free = free - self.initial[..., 1] + self.offset[:, None]
        zeta = free / stiff[:, None]

        # |s|^2 without its third coordinate
        back = self.back
        across = (z[..., 1] - back[..., 0]) ** 2 + (z[..., 2] - back[..., 2]) ** 2
        square = across + (zeta - back[..., 1]) ** 2
        yields = (square > self.beta[:, None] ** 2).any(axis=1)
        yielding = np.flatnonzero(yields)
        for chosen in portions(len(yielding)):
            cells = yielding[chosen]
            part = self.of(cells)
            found = part._yielding_zeta(
                zeta[cells], across[cells], free[cells], stiff[cells, None]
            )
            zeta[cells] = found
        return zeta

    def _yielding_zeta(
        self, zeta: np.ndarray, across: np.ndarray, free: np.ndarray, stiff: np.ndarray
    ) -> np.ndarray:
        """The same by Newton steps that begin at ``zeta``, all arrays (cells, points)."""
        back = self.back[..., 1]
        hardening = self.hardening[:, None]
        beta = self.beta[:, None]
        softest = SOFTEST * self.two_mu[:, None]
        for _ in range(ZETA_STEPS):
            along = zeta - back
            size = np.sqrt(across + along**2)
            gained = self.columns.gained_at(size, hardening)
            gained = np.where(np.isfinite(gained), gained, UNREACHED)
            size = np.where(size > 0, size, 1.0)
            n = along / size
            stiffness = hardening + self.columns.slope(gained)
            bend = (gained > 0) / np.maximum(stiffness, softest)
            curvature = stiff + gained / size
            curvature += (bend - gained / size) * n**2
            change = (stiff * zeta - free + n * gained) / curvature
            zeta = zeta - change
            if (np.abs(change) <= ZETA_ACCURACY * (np.abs(zeta) + beta)).all():
                break
        return zeta

    def _completed(self, m: np.ndarray, d: np.ndarray) -> Completed:
        s = d - self.back
        size = np.sqrt(np.einsum("tqd,tqd->tq", s, s))
        over = np.maximum(size - self.beta[:, None], 0.0)
        direction = s / np.where(size > 0, size, 1.0)[..., None]
        gained = self.columns.gained_at(size, self.hardening[:, None])
        return Completed(m, d, over, direction, size, gained)

    def _plastic_compliance(self, at: Completed) -> tuple[np.ndarray, np.ndarray]:
        """F'' and F'/|s|, the compliances along and across s."""
        size = np.where(at.size > 0, at.size, 1.0)
        stiffness = self.hardening[:, None] + self.columns.slope(at.reached)
        stiffness = np.maximum(stiffness, SOFTEST * self.two_mu[:, None])
        return (at.over > 0) / stiffness, at.reached / size

    def sought(self, at: Completed) -> np.ndarray:
        """The function that searches minimise: ``value``, extended to a finite convex function."""
        return self.value(at._replace(gained=at.reached))

    def value(self, at: Completed) -> np.ndarray:
        """phi* at completed stresses, shape (cells, points), without zeta times the offset."""
        bulk = self.bulk[:, None]
        two_mu = self.two_mu[:, None]
        total = self._total(at.deviator)
        square = np.einsum("tqd,tqd->tq", total, total)
        h = self.hardening[:, None]
        if self.resistance.is_constant:
            plastic = at.gained * (at.over - h / 2 * at.gained)
        else:
            plastic = flow_potential(self.columns, h, at.size, at.gained)
        elastic = (at.mean**2 / bulk + square / two_mu) / 2
        if self.whole or self.thin:
            return elastic + plastic
        return elastic + plastic - self.offset[:, None] * at.deviator[..., 1]

    def _total(self, d: np.ndarray) -> np.ndarray:
        """D + 2 mu_2 p_0: the deviatoric strain without p, as a stress."""
        return d + self.two_mu[:, None, None] * self.initial

    def gradient(self, at: Completed) -> np.ndarray:
        """The strain d phi* / dz, shape (cells, points, c)."""
        strain = self.deviatoric_strain(at)
        first = (at.mean / self.bulk[:, None])[..., None]
        if self.thin:
            return np.matmul(np.concatenate([first, strain], axis=-1), THIN)
        return np.concatenate(
            [first, strain if self.whole else strain[..., [0, 2]]], axis=-1
        )

    def deviatoric_strain(self, at: Completed) -> np.ndarray:
        """The deviator of the strain of a stress, (cells, points, d)."""
        strain = at.deviator / self.two_mu[:, None, None] + self.initial
        return strain + at.reached[..., None] * at.direction

    def deviatoric_compliance(self, at: Completed) -> np.ndarray:
        """Its derivative by the deviator of the stress, (cells, points, d, d)."""
        n = at.direction
        along, across = self._plastic_compliance(at)
        whole = (along - across)[..., None, None] * n[..., :, None] * n[..., None, :]
        for k in range(self.d):
            whole[..., k, k] += across + 1 / self.two_mu[:, None]
        return whole

    def compliance(self, at: Completed) -> np.ndarray:
        """d2 phi*/dz2, shape (cells, points, c, c)."""
        whole = self.deviatoric_compliance(at)
        bulk = np.broadcast_to(1 / self.bulk[:, None], at.mean.shape)
        size = self.d + 1
        result = by_cells(*at.mean.shape, size, size)
        result[:] = 0.0
        result[..., 0, 0] = bulk
        result[..., 1:, 1:] = whole
        if self.whole:
            return result
        if self.thin:
            return np.matmul(np.matmul(THIN.T, result), THIN)
        column = result[..., [0, 1, 3], 2]
        corner = bulk / 6 + whole[..., 1, 1]
        column[..., 0] = -bulk / R6  # the Schur complement of zeta, which m contains
        product = column[..., :, None] * column[..., None, :] / corner[..., None, None]
        return result[..., [[0], [1], [3]], [0, 1, 3]] - product

    def integrals(
        self, nodal: np.ndarray, volume: np.ndarray, rest: np.ndarray
    ) -> np.ndarray:
        """Upper bounds of int phi* over each cell, plus ``rest``, shape (cells,).

        For linear hardening the plastic term is the integral of the squared distance of s from the
        ball |q| <= beta.  The distance is at most |s - q|, where the Bernstein coefficients of q
        are those of s projected onto the ball: q lies in their convex hull.  On triangles that
        yield everywhere ``excess_integrals`` is sharper.  For other laws see ``most_potential``.
        Where these bounds exceed a quadrature rule most ``_sharper`` is tried, and then parts are
        split, until the possible gain is small relative to the sum of all integrals and ``rest``.

        ``nodal`` (cells, nodes, c) are stress coordinates at the nodes of the parts of each cell:
        the vertices of three or four parts, or vertices and edge midpoints of three.
        """
        count = len(nodal)
        k = NODES[nodal.shape[1]]
        result = rest.copy()
        yielding = []
        for cells in portions(count):
            part = self.of(cells)
            smooth, cell, s = part._smooth_part(nodal[cells], volume[cells])
            result[cells] += smooth
            yielding.append((cells.start + cell, s))
        cell, s = map(np.concatenate, zip(*yielding, strict=True))
        weight = volume[cell] * k / nodal.shape[1]
        parts = len(SPLIT[k])
        allowed = None
        for level in range(SPLIT_LEVELS[k] + 1):
            bound, estimate = self._plastic(s, weight, cell)
            if np.isinf(
                estimate
            ).any():  # the integral is infinite, however it is split
                return result + np.bincount(cell, bound, minlength=count)
            if allowed is None:
                allowed = WORTH[k] * max(result.sum() + estimate.sum(), 0.0)
            left = ~worth_keeping(bound - estimate, allowed / 2)
            sharper = self._sharper(s[left], weight[left], cell[left])
            bound[left] = np.minimum(bound[left], sharper)
            gain = bound - estimate
            kept = worth_keeping(gain, allowed) | (level == SPLIT_LEVELS[k])
            result += np.bincount(cell[kept], bound[kept], minlength=count)
            allowed -= gain[kept].sum()
            if kept.all():
                break
            s = np.matmul(SPLIT[k].reshape(-1, k), s[~kept]).reshape(-1, k, self.d)
            weight, cell = (np.repeat(v[~kept], parts) for v in (weight / parts, cell))
        return result

    def _smooth_part(
        self, nodal: np.ndarray, volume: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrals (cells,) of phi* without its plastic part, and where that may not be zero.

        The latter are the cells (n,) of parts, and the coefficients (n, k, d) of ``shifted`` there.
        """
        k = NODES[nodal.shape[1]]
        m, d = self.mean_and_deviator(nodal)
        mean, total, s, d = (
            coefficients(v.reshape(len(nodal), -1, k, v[0, 0].size))
            for v in (m, self._total(d), self.shifted(d), d)
        )
        part = volume[:, None] / mean.shape[1]
        squares = square_integrals(mean, part) / self.bulk[:, None]
        squares += square_integrals(total, part) / self.two_mu[:, None]
        smooth = squares.sum(axis=1) / 2
        if self.offset.any():
            # mean of a polynomial = mean of its coefficients
            zeta = d[..., 1].mean(axis=2)
            smooth -= self.offset * (part * zeta).sum(axis=1)
        cell, place = np.nonzero(self.may_yield(s))
        return smooth, cell, s[cell, place]

    def shifted(self, d: np.ndarray) -> np.ndarray:
        """What the plastic part depends on: s = d - dev alpha_0, (cells, points, d)."""
        return d - self.back

    def may_yield(self, s: np.ndarray) -> np.ndarray:
        """Whether the plastic part is not zero on a part, (cells, parts)."""
        square = np.einsum("tkid,tkid->tki", s, s)
        return (square > self.beta[:, None, None] ** 2).any(axis=2)

    def _plastic(
        self, s: np.ndarray, volume: np.ndarray, cell: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The bound and a quadrature rule for polynomials s (parts, k, d) on parts of cells."""
        if not self.resistance.is_constant:
            law = self.resistance.of(cell)
            return most_potential(law, self.hardening[cell], s, volume)
        two_h = 2 * self.hardening[cell]
        beta = self.beta[cell]
        bound = np.empty(len(s))
        estimate = np.empty(len(s))
        for part in portions(len(s)):
            own = stored_by_cells(s[part])
            bound[part], estimate[part] = excess(own, beta[part], volume[part])
        return bound / two_h, np.minimum(estimate, bound) / two_h

    def _sharper(
        self, s: np.ndarray, volume: np.ndarray, cell: np.ndarray
    ) -> np.ndarray:
        """A second bound, which takes longer, infinite where there is none."""
        if s.shape[1] not in TRIANGLES or not self.resistance.is_constant:
            return np.full(len(s), np.inf)
        squares = excess_integrals(s, self.beta[cell], volume)
        return squares / (2 * self.hardening[cell])


def excess(
    s: np.ndarray, beta: np.ndarray, volume: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """int ([|s| - beta]_+)^2 over parts, an upper bound and a rule, from coefficients (n, k, d)."""
    k = s.shape[1]
    bound = square_integrals(beyond(s, beta), volume)
    if k in TRIANGLES:
        bound = np.minimum(bound, excess_integrals(s, beta, volume, power=2))
    at_rule = np.einsum("qk,nkd->nqd", RULE[k], s)
    inside = np.maximum(
        np.sqrt(np.einsum("nqd,nqd->nq", at_rule, at_rule)) - beta[:, None], 0.0
    )
    return bound, volume * (inside**2 @ WEIGHTS[k])
