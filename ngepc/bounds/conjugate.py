"""The density of the dual functional: phi*(sigma), its derivatives, and an integrable upper bound.

In-plane stresses have the coordinates z = (a, b_0, b_1) = ((xx + yy)/2, (xx - yy)/2^(1/2),
2^(1/2) xy), whose product with (tr eps, e_0, e_1) is sigma : eps.  With the mean part m and the
deviatoric coordinates d of the stress

    phi*(sigma) = m^2 / (2 bulk) + |d + 2 mu_2 p_0|^2 / (4 mu_2)
                  + 1/(2 h) ([|d - dev alpha_0| - beta]_+)^2.

It is conjugate to the density of J, which leaves out mu_2 |p_0|^2.

In three dimensions the coordinates are m and the five of d, in the law of two dimensions m = a and
d = b.  In plane strain no equation restricts sigma_zz, that
is the coordinate d_1 = zeta of diag(1, 1, -2)/6^(1/2) with m = a - zeta/6^(1/2): every zeta bounds,
the one that is taken nearly minimises phi*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.bounds.parts import (
    NODES,
    RULE,
    SPLIT,
    SPLIT_LEVELS,
    WEIGHTS,
    WORTH,
    beyond,
    coefficients,
    excess_integrals,
    square_integrals,
)
from ngepc.bounds.simplices import sliced
from ngepc.discretisation.law import Law

R6 = np.sqrt(6.0)

ZETA_STEPS = 6  # Newton steps for zeta where the stress yields


class Completed(NamedTuple):
    """A stress with its third direction, shapes (...) and (..., d).

    ``mean`` m and ``deviator`` d; with s = d - dev alpha_0, ``over`` is [|s| - beta]_+,
    ``direction`` s/|s| and ``size`` |s|.
    """

    mean: np.ndarray
    deviator: np.ndarray
    over: np.ndarray
    direction: np.ndarray
    size: np.ndarray


OF_LAW = ("bulk", "two_mu", "hardening", "beta", "back", "initial")


class Conjugate:
    """phi* on cells that carry one set of material data each: the law's at every ``each``-th point.

    ``back`` and ``initial`` may differ from point to point of a cell, (cells, 1 or points, d).
    """

    def __init__(self, law: Law, each: int = 1) -> None:
        for name in OF_LAW[:4]:
            setattr(self, name, getattr(law, name)[::each])
        self.back = law.back[::each, None]
        self.initial = law.initial[::each, None]
        self.d = self.back.shape[2]
        self.whole = self.d != 3  # no direction without an equation

    def of(self, cells: np.ndarray | slice) -> Conjugate:
        """phi* on some of the cells."""
        return sliced(self, cells, OF_LAW)

    def completed(self, z: np.ndarray) -> Completed:
        """The whole stress for coordinates z (cells, points, c).

        Zeta is elastic where the stress that follows does not yield, elsewhere by Newton steps.
        """
        if self.whole:
            return self._completed(z[..., 0], z[..., 1:])
        bulk, two_mu, h = (v[:, None] for v in (self.bulk, self.two_mu, self.hardening))
        stiff = 1 / (6 * bulk) + 1 / two_mu
        free = z[..., 0] / (R6 * bulk) - self.initial[..., 1]
        zeta = free / stiff
        for step in range(ZETA_STEPS + 1):
            d = np.stack([z[..., 1], zeta, z[..., 2]], axis=-1)
            at = self._completed(z[..., 0] - zeta / R6, d)
            if step == ZETA_STEPS or not at.over.any():
                return at
            n = at.direction[..., 1]
            part = at.over / np.where(at.size > 0, at.size, 1.0)
            slope = stiff * zeta - free + n * at.over / h
            zeta = zeta - slope / (
                stiff + ((at.over > 0) * n**2 + part * (1 - n**2)) / h
            )

    def _completed(self, m: np.ndarray, d: np.ndarray) -> Completed:
        s = d - self.back
        size = np.sqrt(np.einsum("tqd,tqd->tq", s, s))
        over = np.maximum(size - self.beta[:, None], 0.0)
        return Completed(m, d, over, s / np.where(size > 0, size, 1.0)[..., None], size)

    def value(self, at: Completed) -> np.ndarray:
        """phi* at completed stresses, shape (triangles, points)."""
        bulk, two_mu, h = (v[:, None] for v in (self.bulk, self.two_mu, self.hardening))
        total = self._total(at)
        square = np.einsum("tqd,tqd->tq", total, total)
        return (at.mean**2 / bulk + square / two_mu + at.over**2 / h) / 2

    def _total(self, at: Completed) -> np.ndarray:
        """D + 2 mu_2 p_0: the deviatoric strain without p, as a stress."""
        return at.deviator + self.two_mu[:, None, None] * self.initial

    def gradient(self, at: Completed) -> np.ndarray:
        """The strain d phi* / dz, shape (triangles, points, 3)."""
        strain = at.deviator / self.two_mu[:, None, None] + self.initial
        strain = strain + (at.over / self.hardening[:, None])[..., None] * at.direction
        first = (at.mean / self.bulk[:, None])[..., None]
        return np.concatenate(
            [first, strain if self.whole else strain[..., [0, 2]]], axis=-1
        )

    def compliance(self, at: Completed) -> np.ndarray:
        """d2 phi*/dz2, shape (triangles, points, 3, 3)."""
        n = at.direction
        h = self.hardening[:, None]
        size = np.where(at.size > 0, at.size, 1.0)
        across = at.over / size / h
        along = (at.over > 0) / h - across
        whole = along[..., None, None] * n[..., :, None] * n[..., None, :]
        for k in range(self.d):
            whole[..., k, k] += across + 1 / self.two_mu[:, None]
        bulk = np.broadcast_to(1 / self.bulk[:, None], at.mean.shape)
        result = np.zeros((*at.mean.shape, self.d + 1, self.d + 1))
        result[..., 0, 0], result[..., 1:, 1:] = bulk, whole
        if self.whole:
            return result
        column = result[..., [0, 1, 3], 2]
        corner = bulk / 6 + whole[..., 1, 1]
        column[..., 0] = -bulk / R6  # the Schur complement of zeta, which m contains
        product = column[..., :, None] * column[..., None, :] / corner[..., None, None]
        return result[..., [[0], [1], [3]], [0, 1, 3]] - product

    def integrals(
        self, nodal: np.ndarray, volume: np.ndarray, rest: np.ndarray
    ) -> np.ndarray:
        """Upper bounds of int phi* over each cell, plus ``rest``, shape (cells,).

        The plastic term is the integral of the squared distance of s from the ball |q| <= beta.
        That is at most |s - q| for the q whose coefficients are the points of the ball that are
        nearest to those of s: q lies in their convex hull.  Parts are split where that exceeds a
        rule most, until what is left is small beside all integrals and ``rest``.

        ``nodal`` (cells, nodes, c) are stress coordinates at the nodes of the parts of each cell:
        the vertices of three or four parts, or vertices and edge midpoints of three.
        """
        at = self.completed(nodal)
        count = len(nodal)
        k = NODES[nodal.shape[1]]
        mean, total, s = (
            coefficients(v.reshape(count, -1, k, v[0, 0].size))
            for v in (at.mean, self._total(at), at.size[..., None] * at.direction)
        )
        part = volume[:, None] / mean.shape[1]
        smooth = square_integrals(mean, part) / self.bulk[:, None]
        smooth += square_integrals(total, part) / self.two_mu[:, None]
        result = rest + smooth.sum(axis=1) / 2
        outside = np.einsum("tkid,tkid->tki", s, s) > self.beta[:, None, None] ** 2
        cell, place = np.nonzero(outside.any(axis=2))
        s = s[cell, place]
        weight = part[cell, 0]
        bound, likely = self._plastic(s, weight, cell)
        allowed = WORTH[k] * max(result.sum() + likely.sum(), 0.0)
        for level in range(SPLIT_LEVELS[k] + 1):
            gain = bound - likely
            last = level == SPLIT_LEVELS[k]
            order = np.argsort(gain)
            kept = np.full(len(gain), last)
            kept[order[np.cumsum(gain[order]) <= allowed / 2]] = True
            result += np.bincount(cell[kept], bound[kept], minlength=count)
            allowed -= gain[kept].sum()
            if kept.all():
                break
            parts = len(SPLIT[k])
            s = np.matmul(SPLIT[k].reshape(-1, k), s[~kept]).reshape(-1, k, self.d)
            weight, cell = (np.repeat(v[~kept], parts) for v in (weight / parts, cell))
            bound, likely = self._plastic(s, weight, cell)
        return result

    def _plastic(
        self, s: np.ndarray, volume: np.ndarray, cell: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The bound and a rule for polynomials s (parts, k, d) on parts of cells."""
        two_h = 2 * self.hardening[cell]
        k = s.shape[1]
        bound = square_integrals(beyond(s, self.beta[cell]), volume) / two_h
        if k == 6:
            bound = np.minimum(
                bound, excess_integrals(s, self.beta[cell], volume) / two_h
            )
        inside = beyond(np.matmul(RULE[k], s), self.beta[cell])
        likely = (
            volume * (np.einsum("tqd,tqd->tq", inside, inside) @ WEIGHTS[k]) / two_h
        )
        return bound, np.minimum(likely, bound)
