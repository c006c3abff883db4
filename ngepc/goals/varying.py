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
from ngepc.goals.cutting import on_child_parts
from ngepc.goals.sides import LawOnParts, ResultOnParts, Sides, mean_products
from ngepc.goals.supremum import kept_part
from ngepc.goals.yielding import dots

NAMES = ("tau", "sigma", "volume", "trial", "back", "trace", "strain")


@dataclass(frozen=True, eq=False)
class VaryingData:
    """Coefficients on parts (parts, k, .), and the law there (parts,).

    ``tau`` and ``sigma`` are stresses, mean and deviator; ``volume`` and ``trial`` are tr eps_h and
    s, ``back`` dev alpha_0, ``trace`` and ``strain`` belong to eps(z).  ``law`` has the form of
    Hill's ellipsoid, (parts, d, d), where there is one; ``resistance`` is that of a
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
            law={name: v.repeat(count, axis=0) for name, v in self.law.items()},
            size=np.repeat(self.size / count, count),
            owner=np.repeat(self.owner, count),
            resistance=own,
        )

    def turned(self) -> VaryingData:
        """The data for the negative goal."""
        return replace(self, tau=-self.tau, trace=-self.trace, strain=-self.strain)

    def kept_work(self) -> np.ndarray:
        """Means of (s(eps_h) - dev alpha_0) : dev eps(z) over the parts by the rule.

        The stress is that of linear hardening for every law.
        """
        trial = self._at_rule("trial")
        size = np.sqrt(dots(trial, trial))
        names = ("two_mu", "hardening", "beta")
        kept = kept_part(size, *(self.law[name][:, None] for name in names))
        return (kept * dots(trial, self._at_rule("strain"))) @ WEIGHTS[self.k]

    def work(self) -> np.ndarray:
        """The means of eps(z) : s(eps_h) over the parts, by the same rule."""
        volume = self.law["bulk"] * mean_products(self.volume, self.trace)
        return volume + self.kept_work() + mean_products(self.back, self.strain)

    def _at_rule(self, name: str) -> np.ndarray:
        """Values at the points of the rule, (parts, points, .)."""
        return np.matmul(RULE[self.k], getattr(self, name))


def half_root(bulk: np.ndarray) -> np.ndarray:
    """1/(2 K^(1/2)), the factor of mean stresses in ``sides``."""
    return 1 / (2 * np.sqrt(bulk))


def sides_of(data: VaryingData) -> Sides:
    """The supremum for both signs and every lambda."""
    law = LawOnParts(
        data.law["two_mu"],
        data.law["hardening"],
        data.law["beta"],
        data.resistance,
        data.law.get("form"),
    )
    two_mu = law.two_mu[:, None, None]
    bulk = data.law["bulk"][:, None]
    half = half_root(bulk)
    result = ResultOnParts(
        sigma=(data.sigma[..., 1:] - data.back) / two_mu,
        trial=data.trial / two_mu,
        mean=half * (data.sigma[..., 0] - bulk * data.volume[..., 0]),
        law=law,
        size=data.size,
        owner=data.owner,
    )
    mean = half * (data.tau[..., 0] - bulk * data.trace[..., 0])
    tau = data.tau[..., 1:] / two_mu
    return Sides.of_adjoint(result, tau, data.strain, mean, data.kept_work())
