"""Upper bounds of integrals of the supremum of a goal for displacements of order two.

Both q and w of ``supremum`` are polynomials on the parts of a cell.

Of the rest of the supremum the part by mean stresses is a quadratic, and q : s a product of
polynomials.  The integral of eps(z) : s(eps_h) stands in Q_0 with the other sign: whatever a rule
says there cancels, and so does the difference between s(eps_h) and the stress of linear hardening,
which the rule is given for every law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.simplices import of_cells
from ngepc.discretisation.resistance import Resistance
from ngepc.goals.pieces import WEIGHTS, at_rule, dots, mean_products
from ngepc.goals.sides import LawOnCells, ResultOnCells, Sides
from ngepc.goals.supremum import kept_part

NAMES = ("tau", "sigma", "volume", "trial", "back", "trace", "strain")


@dataclass(frozen=True, eq=False)
class VaryingData:
    """Coefficients on cells (cells, k, .), and the law there (cells,).

    ``tau`` and ``sigma`` are stresses, mean and deviator; ``volume`` and ``trial`` are tr eps_h and
    s, ``back`` dev alpha_0, ``trace`` and ``strain`` belong to eps(z).  ``law`` has the form of
    Hill's ellipsoid, (cells, d, d), where there is one; ``resistance`` is that of a
    nonlinear hardening law on the cells, None for linear hardening.
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
    resistance: Resistance | None = None

    @property
    def k(self) -> int:
        """Coefficients on each cell."""
        return self.tau.shape[1]

    def of(self, chosen: slice | np.ndarray) -> VaryingData:
        """The data on some of the cells."""
        own = None if self.resistance is None else self.resistance.of(chosen)
        return VaryingData(
            **{name: of_cells(getattr(self, name), chosen) for name in NAMES},
            law={name: value[chosen] for name, value in self.law.items()},
            size=self.size[chosen],
            resistance=own,
        )

    def turned(self) -> VaryingData:
        """The data for the negative goal."""
        return replace(self, tau=-self.tau, trace=-self.trace, strain=-self.strain)

    def kept_work(self) -> np.ndarray:
        """Means of (s(eps_h) - dev alpha_0) : dev eps(z) over the cells by the rule.

        The stress is that of linear hardening for every law.
        """
        trial = at_rule(self.trial)
        size = np.sqrt(dots(trial, trial))
        names = ("two_mu", "hardening", "beta")
        kept = kept_part(size, *(self.law[name][:, None] for name in names))
        return (kept * dots(trial, at_rule(self.strain))) @ WEIGHTS[self.k]

    def work(self) -> np.ndarray:
        """The means of eps(z) : s(eps_h) over the cells, by the same rule."""
        volume = self.law["bulk"] * mean_products(self.volume, self.trace)
        return volume + self.kept_work() + mean_products(self.back, self.strain)


def half_root(bulk: np.ndarray) -> np.ndarray:
    """1/(2 K^(1/2)), the factor of mean stresses in ``sides``."""
    return 1 / (2 * np.sqrt(bulk))


def sides_of(data: VaryingData) -> Sides:
    """The supremum for both signs and every lambda."""
    law = LawOnCells(
        data.law["two_mu"],
        data.law["hardening"],
        data.law["beta"],
        data.resistance,
        data.law.get("form"),
    )
    two_mu = law.two_mu[:, None, None]
    bulk = data.law["bulk"][:, None]
    half = half_root(bulk)
    result = ResultOnCells(
        sigma=(data.sigma[..., 1:] - data.back) / two_mu,
        trial=data.trial / two_mu,
        mean=half * (data.sigma[..., 0] - bulk * data.volume[..., 0]),
        law=law,
        size=data.size,
    )
    mean = half * (data.tau[..., 0] - bulk * data.trace[..., 0])
    tau = data.tau[..., 1:] / two_mu
    return Sides.of_adjoint(result, tau, data.strain, mean, data.kept_work())
