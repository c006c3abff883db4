"""Upper bounds of integrals of the supremum of a goal for displacements of order two.

For a fixed strain E = eps_h + e the bracket under the supremum is, but for

    gauge = tau : eps_h + lambda eps_h : sigma^ - eps(z) : s(eps_h),

affine in tau, sigma^, eps_h and eps(z) together.  (For affine p_0 and alpha_0 the trial stress is
used in place of E, with stresses less alpha_0.)  Hence supremum + gauge is convex in them: its mean
over a part is at most the mean of its values at their Bernstein coefficients.  Products of
polynomials are integrated exactly.  The integral of eps(z) : s(eps_h) occurs in Q_0 with the other
sign: the error of its quadrature cancels.

The part of the mean stresses is quadratic.  Where no point yields, the whole supremum is quadratic
and quadrature is exact.  Elsewhere parts are cut until the bounds are close to quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.parts import RULE, SPLIT, WEIGHTS, portions
from ngepc.bounds.supremum import (
    PointData,
    Stresses,
    deviatoric_part,
    dots,
    kept_part,
    mean_part,
)

SPLITS = {4: 2, 6: 3}
"""Most levels of cutting, by the number of coefficients on a part."""
WORTH = 0.1
"""Bounds may exceed the integrals by this fraction."""
PORTION = 1000
"""Parts that are cut at a time."""
NAMES = ("tau", "sigma", "volume", "trial", "back", "trace", "strain")


@dataclass(frozen=True, eq=False)
class VaryingData:
    """Coefficients on parts (parts, k, .), and the law there (parts,).

    ``tau`` and ``sigma`` are stresses, mean and deviator; ``volume`` and ``trial`` are tr eps_h and
    s, ``back`` dev alpha_0, ``trace`` and ``strain`` belong to eps(z).
    """

    tau: np.ndarray
    sigma: np.ndarray
    volume: np.ndarray
    trial: np.ndarray
    back: np.ndarray
    trace: np.ndarray
    strain: np.ndarray
    law: dict[str, np.ndarray]
    size: np.ndarray
    owner: np.ndarray

    @property
    def k(self) -> int:
        """Coefficients on each part."""
        return self.tau.shape[1]

    def of(self, chosen: slice | np.ndarray) -> VaryingData:
        """The data on some of the parts."""
        return VaryingData(
            **{name: getattr(self, name)[chosen] for name in NAMES},
            law={name: value[chosen] for name, value in self.law.items()},
            size=self.size[chosen],
            owner=self.owner[chosen],
        )

    def cut(self) -> VaryingData:
        """The data on the children of all parts."""
        k = self.k
        count = len(SPLIT[k])
        table = SPLIT[k].reshape(-1, k)

        def on_children(values: np.ndarray) -> np.ndarray:
            """Coefficients on the children."""
            return np.matmul(table, values).reshape(-1, k, values.shape[2])

        return VaryingData(
            **{name: on_children(getattr(self, name)) for name in NAMES},
            law={name: np.repeat(v, count) for name, v in self.law.items()},
            size=np.repeat(self.size / count, count),
            owner=np.repeat(self.owner, count),
        )

    def turned(self) -> VaryingData:
        """The data for the negative goal."""
        return replace(self, tau=-self.tau, trace=-self.trace, strain=-self.strain)

    def work(self) -> np.ndarray:
        """The means of eps(z) : s(eps_h) over the parts, by the rule of ``integrals``."""
        at = self.at(RULE[self.k])
        data = at.data
        work = data.bulk * data.volume * at.strain.mean
        work += dots(data.stress, at.strain.deviator)
        return at.shaped(work) @ WEIGHTS[self.k]

    def at(self, table: np.ndarray) -> Sampled:
        """The data at the points of a table (points, k)."""
        points = len(table)
        values = {
            name: np.matmul(table, getattr(self, name)).reshape(
                -1, getattr(self, name).shape[2]
            )
            for name in NAMES
        }
        law = {name: np.repeat(value, points) for name, value in self.law.items()}
        trial = values["trial"]
        kept = kept_part(trial, law["two_mu"], law["hardening"], law["beta"])
        data = PointData(
            **law,
            volume=values["volume"][:, 0],
            trial=trial,
            back=values["back"],
            stress=kept[:, None] * trial + values["back"],
        )
        return Sampled(
            data,
            Stresses(values["tau"][:, 0], values["tau"][:, 1:]),
            Stresses(values["sigma"][:, 0], values["sigma"][:, 1:]),
            Stresses(values["trace"][:, 0], values["strain"]),
            dots(trial, trial) <= law["beta"] ** 2,
            points,
        )


@dataclass(frozen=True, eq=False)
class Sampled:
    """The data at ``points`` points of each part."""

    data: PointData
    tau: Stresses
    sigma: Stresses
    strain: Stresses
    elastic: np.ndarray
    points: int

    def shaped(self, values: np.ndarray) -> np.ndarray:
        """Values at the points by parts, (parts, points)."""
        return values.reshape(-1, self.points)

    @property
    def _arguments(self) -> tuple:
        return self.data, self.tau, self.sigma, self.strain

    def means(self, factor: float) -> np.ndarray:
        """The part of the supremum by mean stresses."""
        return self.shaped(mean_part(*self._arguments, factor))

    def deviators(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """The part by deviators, and where it is a quadratic."""
        count = len(self.elastic)
        found = np.empty(count)
        smooth = np.empty(count, dtype=bool)
        for part in portions(count, 20_000):
            chosen = (one.of(part) for one in self._arguments)
            found[part], smooth[part] = deviatoric_part(*chosen, factor)
        return self.shaped(found), self.shaped(smooth & self.elastic)

    def work(self) -> np.ndarray:
        """The deviatoric part of eps(z) : (s(eps_h) - alpha_0)."""
        own = self.data.stress - self.data.back
        return self.shaped(dots(own, self.strain.deviator))

    def products(self, factor: float) -> np.ndarray:
        """tau : eps_h + lambda eps_h : (sigma^ - alpha_0) by deviators, eps_h from s."""
        strain = self.data.trial / self.data.two_mu[:, None]
        sigma = self.sigma.deviator - self.data.back
        return self.shaped(dots(self.tau.deviator + factor * sigma, strain))


def estimated_integrals(data: VaryingData, factor: float) -> np.ndarray:
    """The integrals of the supremum over the parts by a rule."""
    at = data.at(RULE[data.k])
    return data.size * ((at.means(factor) + at.deviators(factor)[0]) @ WEIGHTS[data.k])


def integrals(data: VaryingData, factor: float, count: int) -> np.ndarray:
    """Upper bounds of the integrals over ``count`` cells.

    For the integral of eps(z) : s(eps_h) they use the rule of ``RULE``.
    """
    allowed = WORTH * estimated_integrals(data, factor).sum() / len(data.size)
    result = np.zeros(count)
    for part in portions(len(data.size), PORTION):
        chosen = data.of(part)
        at = chosen.at(RULE[data.k])
        given = chosen.size * ((at.means(factor) + at.work()) @ WEIGHTS[data.k])
        result += np.bincount(chosen.owner, given, minlength=count)
        result += _of_deviators(chosen, factor, allowed, count)
    return result


def _of_deviators(
    data: VaryingData, factor: float, allowed: float, count: int
) -> np.ndarray:
    """Upper bounds of the integrals of the part by deviators less eps(z) : s(eps_h)."""
    k = data.k
    result = np.zeros(count)
    for level in range(SPLITS[k] + 1):
        at = data.at(np.eye(k))
        found, smooth = at.deviators(factor)
        convex = found + at.products(factor) - at.work()
        rule = data.at(RULE[k])
        estimate = rule.deviators(factor)[0] - rule.work()
        estimate = data.size * (estimate @ WEIGHTS[k])
        products = rule.products(factor) @ WEIGHTS[k]
        bound = data.size * (convex.mean(axis=1) - products)
        bound = np.where(smooth.all(axis=1), estimate, bound)
        kept = bound - estimate <= allowed
        if level == SPLITS[k]:
            kept[:] = True
        result += np.bincount(data.owner[kept], bound[kept], minlength=count)
        if kept.all():
            break
        data = data.of(~kept).cut()
        allowed = allowed / len(SPLIT[k])
    return result
