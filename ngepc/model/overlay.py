"""Sub-elements in parallel that yield one after the other: hardening of cyclic loading.

J. F. Besseling, A theory of elastic, plastic and creep deformations of an initially isotropic
material, J. Appl. Mech. 25 (1958); G. Masing (1926); L. Prandtl (1928).  All sub-elements have the
strain of the point and the elasticity of the material.  Each has a share w_i of the volume, a
plastic strain p_i of its own, and a bound k_i of its deviatoric stress:

    dev sigma = sum_i w_i 2 mu (dev e - p_i),    |2 mu (dev e - p_i)| <= k_i,    sum_i w_i = 1,

so that the plastic strain of the point is p = sum_i w_i p_i.  One that never yields hardens
linearly.  In a bar that is pulled for the first time all p_i have one direction, and the stress is
piecewise linear in the strain: any curve of straight lines that bends downwards is one of these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ngepc._deprecated import renamed
from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Declared
from ngepc.checks.kinds import require_sequence
from ngepc.checks.sentences import counted, in_words
from ngepc.model.hardening import Tabulated
from ngepc.model.tensile import PEEQ

EXACT = 1e-9
"""Difference of slopes, and of the sum of shares from one, that is rounding."""


@dataclass(frozen=True, eq=False)
class Overlay(Declared):
    """Sub-elements of a material, the one that yields first at the front.

    Parameters
    ----------
    shares
        w_i > 0, parts of the volume that yield (1).  What is missing from one never yields.
    bounds
        k_i > 0, bounds of the deviatoric stress in each of them (stress), increasing.

    Raises
    ------
    TypeError, ValueError
        If a number is out of its range, or the shares exceed one.
    """

    shares: Sequence[float]
    bounds: Sequence[float]

    def __post_init__(self) -> None:
        for name in ("shares", "bounds"):
            given = getattr(self, name)
            require_sequence(name, given, "numbers")
            if len(given) == 0:
                raise ValueError(
                    f"{name}={in_words(given)}: at least one number is needed"
                )
            values = tuple(require_number(name, one, 0, strict=True) for one in given)
            vars(self)[name] = values
        shares = self.shares
        bounds = self.bounds
        if len(shares) != len(bounds):
            raise ValueError(
                f"shares={in_words(shares)}, bounds={in_words(bounds)}: as many "
                "numbers each are needed"
            )
        if not all(one < next_one for one, next_one in pairwise(bounds)):
            raise ValueError(
                f"bounds={in_words(bounds)}: increasing numbers are needed"
            )
        if sum(shares) > 1 + EXACT:
            raise ValueError(
                f"shares={in_words(shares)}: a sum of at most 1 is needed, it is {sum(shares):g}"
            )

    spare = renamed("spare", "elastic_share")

    @property
    def elastic_share(self) -> float:
        """The share that never yields (1)."""
        rest = 1 - sum(self.shares)
        return rest if rest > EXACT else 0.0

    @property
    def count(self) -> int:
        """How many sub-elements there are, with the one that never yields."""
        return len(self.shares) + (self.elastic_share > 0)

    @classmethod
    def of_curve(cls, curve: Tabulated, lame_mu: float) -> Overlay:
        """The sub-elements whose bar has this stress over its plastic strain.

        The last line goes on beyond the last point.  With G = 2 mu a strain e of the bar has
        |G dev e| = (2/3)^(1/2) (sigma + 3 mu e_p), where the sub-element of a point yields, and its
        share is the part of the slope d |dev sigma| / d |G dev e| that the curve loses there.
        ValueError where the curve bends upwards.
        """
        stresses = [PEEQ * stress for stress in curve.stress_there]
        stretched = zip(stresses, curve.plastic_strain, strict=True)
        bounds = [
            stress + PEEQ * 3 * lame_mu * plastic for stress, plastic in stretched
        ]
        points = pairwise(zip(bounds, stresses, strict=True))
        slopes = [(d - b) / (c - a) for (a, b), (c, d) in points]
        if not slopes:
            raise ValueError(
                f"curve of {counted(len(bounds), 'point')}: two are needed at least"
            )
        shares = []
        for number, (before, after) in enumerate(pairwise([1.0, *slopes])):
            if after - before > EXACT:
                raise ValueError(
                    f"curve: it bends upwards at the stress {curve.stress_there[number]:g}, "
                    "a slope that does not grow is needed"
                )
            shares.append(max(before - after, 0.0))
        kept = [(w, k) for w, k in zip(shares, bounds, strict=False) if w > EXACT]
        return cls(*(list(column) for column in zip(*kept, strict=True)))
