"""The supremum of goals for sub-elements in parallel, which share the strain.

Their stresses add up, s(.) = sum_i s_i(.), and so do the integrands.  For every split of the stress
q = tau + lambda sigma^ into parts q_i

    sup over e of a sum  <=  the sum of the suprema over e,

each of which is that of an elastic, perfectly plastic law: finite if |q_i| <= lambda k_i.  The
split is q_i = lambda s_i(eps*) for the strain eps* of the stress q/lambda.  It is the best one
where the laws are linear between eps_h and eps*: the e of all suprema are then the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.discretisation.overlay_law import OverlayLaw
from ngepc.goals.goal_boundary import BoundaryTerms
from ngepc.goals.varying import VaryingData, sides_of

INSIDE = 1 - 1e-12
"""Stresses that yield are shortened by this factor: beyond the bound the supremum is infinite."""


@dataclass(frozen=True, eq=False)
class SubElements:
    """The suprema of all sub-elements, as ``VaryingIntegrand`` has that of one law.

    ``elements`` have the data of the sub-elements, but tau and sigma of the whole; ``law`` is that
    of the cells.
    """

    elements: tuple[VaryingData, ...]
    law: OverlayLaw
    cells: int
    residual: float
    opened: float
    sample: tuple[np.ndarray, np.ndarray]
    on_boundary: BoundaryTerms

    def split(
        self, sign: float, factor: float, chosen: slice | np.ndarray = slice(None)
    ) -> list[VaryingData]:
        """The data of the sub-elements with a part of the stress each, on some of the cells."""
        elements = [element.of(chosen) for element in self.elements]
        if sign < 0:
            elements = [element.turned() for element in elements]
        whole = elements[0].tau + factor * elements[0].sigma
        split = shares_of(self.law.of(chosen), whole / factor)
        mean = whole[..., :1]
        found = []
        for element, share, own in zip(elements, self.law.shares, split, strict=True):
            tau = np.concatenate([share * mean, factor * own], axis=2)
            found.append(replace(element, tau=tau, sigma=np.zeros_like(tau)))
        return found

    def estimate(self, factor: float) -> float:
        """About the width for a factor, by a rule on some of the cells."""
        rows, weights = self.sample
        total = 2 * factor * self.opened + self.on_boundary.width(factor)
        for sign in (1.0, -1.0):
            for data in self.split(sign, factor, rows):
                total += float(sides_of(data).estimate(1.0, factor) @ weights)
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        above, below = self.on_boundary.parts(factor, self.cells)
        for data in self.split(1.0, factor):
            above = above + sides_of(data).integrals(1.0, factor)
        for data in self.split(-1.0, factor):
            below = below + sides_of(data).integrals(1.0, factor)
        return above, below


def shares_of(law: OverlayLaw, stress: np.ndarray) -> list[np.ndarray]:
    """A split of stresses (cells, k, 1 + d) among sub-elements: deviators (cells, k, d).

    The strongest sub-element takes what Newton's method leaves.
    """
    cells, k, size = stress.shape
    deviator = stress[..., 1:].reshape(-1, size - 1)
    at_points = law.of(np.repeat(np.arange(cells), k))
    at = at_points.at_stress(deviator)
    split = []
    for part, one in zip(at_points.parts, at.parts, strict=True):
        kept = np.where(one.yields, INSIDE, 1.0)
        split.append(kept[:, None] * part.stress(one)[1])
    split[-1] = split[-1] + deviator - sum(split)
    return [own.reshape(cells, k, size - 1) for own in split]
