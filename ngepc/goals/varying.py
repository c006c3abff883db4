"""Upper bounds of integrals of the supremum of a goal for displacements of order two.

The Phi(q, w) of ``supremum`` is convex in q and w together, which are polynomials on the parts of a
cell: its mean over a part is at most the mean of its values at their Bernstein coefficients.  Where
nothing may yield it is a quadratic, and a rule is exact.  Elsewhere parts are cut until bounds
differ little from a rule.

Of the rest of the supremum the part by mean stresses is a quadratic, and q : s a product of
polynomials.  The integral of eps(z) : s(eps_h) stands in Q_0 with the other sign: whatever a rule
says there cancels, and so does the difference between s(eps_h) and the stress of linear hardening,
which the rule is given for every law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.polynomials import RULE, SPLIT, WEIGHTS
from ngepc.discretisation.resistance import Resistance
from ngepc.goals.cutting import on_child_parts, potential_integrals
from ngepc.goals.supremum import (
    PointData,
    ScaledLaw,
    Stresses,
    dots,
    kept_part,
    mean_part,
)
from ngepc.goals.supremum_of_laws import NonlinearLaw

NAMES = ("tau", "sigma", "volume", "trial", "back", "trace", "strain")


@dataclass(frozen=True, eq=False)
class VaryingData:
    """Coefficients on parts (parts, k, .), and the law there (parts,).

    ``tau`` and ``sigma`` are stresses, mean and deviator; ``volume`` and ``trial`` are tr eps_h and
    s, ``back`` dev alpha_0, ``trace`` and ``strain`` belong to eps(z).  ``resistance`` is that of a
    nonlinear hardening law on the parts, None for linear hardening.
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
    resistance: Resistance | None = None

    @property
    def k(self) -> int:
        """Coefficients on each part."""
        return self.tau.shape[1]

    def of(self, chosen: slice | np.ndarray) -> VaryingData:
        """The data on some of the parts."""
        own = None if self.resistance is None else self.resistance.of(chosen)
        return VaryingData(
            **{name: getattr(self, name)[chosen] for name in NAMES},
            law={name: value[chosen] for name, value in self.law.items()},
            size=self.size[chosen],
            owner=self.owner[chosen],
            resistance=own,
        )

    def cut(self) -> VaryingData:
        """The data on the children of all parts."""
        k = self.k
        count = len(SPLIT[k])
        own = self.resistance
        if own is not None:
            own = own.of(np.repeat(np.arange(len(self.size)), count))
        return VaryingData(
            **{name: on_child_parts(getattr(self, name)) for name in NAMES},
            law={name: np.repeat(v, count) for name, v in self.law.items()},
            size=np.repeat(self.size / count, count),
            owner=np.repeat(self.owner, count),
            resistance=own,
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
        values = {}
        for name in NAMES:
            coefficients = getattr(self, name)
            at_points = np.matmul(table, coefficients)
            values[name] = at_points.reshape(-1, coefficients.shape[2])
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
        tau = Stresses(values["tau"][:, 0], values["tau"][:, 1:])
        sigma = Stresses(values["sigma"][:, 0], values["sigma"][:, 1:])
        strain = Stresses(values["trace"][:, 0], values["strain"])
        return Sampled(data, tau, sigma, strain, points)


@dataclass(frozen=True, eq=False)
class Sampled:
    """The data at ``points`` points of each part."""

    data: PointData
    tau: Stresses
    sigma: Stresses
    strain: Stresses
    points: int

    def shaped(self, values: np.ndarray) -> np.ndarray:
        """Values at the points by parts, (parts, points)."""
        return values.reshape(-1, self.points)

    def means(self, factor: float) -> np.ndarray:
        """The part of the supremum by mean stresses."""
        found = mean_part(self.data, self.tau, self.sigma, self.strain, factor)
        return self.shaped(found)

    def pulled(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """q/(2 mu_2) and w of ``supremum``, (parts, points, d)."""
        data = self.data
        two_mu = data.two_mu[:, None]
        q = self.tau.deviator + factor * (self.sigma.deviator - data.back)
        w = factor / two_mu * data.trial - self.strain.deviator
        shape = (-1, self.points, q.shape[1])
        return (q / two_mu).reshape(shape), w.reshape(shape)

    def work(self) -> np.ndarray:
        """The deviatoric part of eps(z) : (s(eps_h) - alpha_0)."""
        own = self.data.stress - self.data.back
        return self.shaped(dots(own, self.strain.deviator))

    def trials(self) -> np.ndarray:
        """S, the trial stress at eps_h, (parts, points, d)."""
        trial = self.data.trial
        return trial.reshape(-1, self.points, trial.shape[1])


def _at_rule(data: VaryingData, factor: float) -> tuple[np.ndarray, ...]:
    """Integrals of all but Phi over the parts, and q/(2 mu_2) and w at the points of the rule."""
    k = data.k
    at = data.at(RULE[k])
    pulled, w = at.pulled(factor)
    rest = at.means(factor) + at.work() - dots(pulled, at.trials())
    return data.size * (rest @ WEIGHTS[k]), pulled, w


def scaled_law(data: VaryingData, factor: float) -> ScaledLaw | NonlinearLaw:
    """The law and lambda on the parts."""
    law = data.law
    if data.resistance is not None:
        moduli = law["two_mu"], law["hardening"]
        return NonlinearLaw(data.resistance, *moduli, factor)
    return ScaledLaw.of(law["two_mu"], law["hardening"], law["beta"], factor)


def estimated_integrals(data: VaryingData, factor: float) -> np.ndarray:
    """The integrals of the supremum over the parts by a rule."""
    rest, pulled, w = _at_rule(data, factor)
    found = scaled_law(data, factor).potential(pulled, w)
    return data.size * (found @ WEIGHTS[data.k]) + rest


def integrals(data: VaryingData, factor: float, count: int) -> np.ndarray:
    """Upper bounds of the integrals over ``count`` cells.

    For the integral of eps(z) : s(eps_h) they use the rule of ``RULE``.
    """
    rest, *_ = _at_rule(data, factor)
    rest = np.bincount(data.owner, rest, minlength=count)
    pulled, w = data.at(np.eye(data.k)).pulled(factor)
    law = scaled_law(data, factor)
    return potential_integrals(law, pulled, w, (data.size, data.owner), rest)
