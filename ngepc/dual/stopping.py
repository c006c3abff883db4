"""When the loop of Algorithm 7.1 has done enough, and whether an iterate that seems so is.

The residual of the iteration is updated with each step, by factors of the condensed (7.1) whose
errors it cannot see.  Here y is solved for again and corrected with D itself, and what rounding
leaves in that is estimated.  CONVERGED is said only where the residual *and* its rounding together
meet the rule: any other way of computing it in the same precision then finds the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ngepc.dual.functional import ResidualNorms
from ngepc.dual.iterates import Iterate
from ngepc.dual.system import NewtonSystem
from ngepc.results.outcome import IterationRecord, Status

CORRECTIONS = 3
"""Most steps with the last factors."""


@dataclass(frozen=True)
class ResidualBelow:
    """||Psi_gamma||_{H*} < tolerance, the rule of Algorithm 7.1; its text stands in messages."""

    tolerance: float

    def met(self, record: IterationRecord) -> bool:
        """Whether the iterate with this record will do."""
        return record.residual_norm < self.tolerance

    def __str__(self) -> str:
        return f"the tolerance {self.tolerance:.3g}"


class End(Exception):
    """Why a run ends: a status, the iterate it ends with, a sentence where something went wrong."""

    def __init__(self, status: Status, here: Iterate, cause: str = "") -> None:
        super().__init__(status)
        self.status, self.here, self.cause = status, here, cause


def final_check(system: NewtonSystem, here: Iterate, rule: ResidualBelow) -> Iterate:
    """Judge an iterate whose updated residual meets the rule: y and residual afresh, corrected.

    Near a solution the active sets stay, so that a correction needs no new factors.

    Returns
    -------
    Iterate
        Where to go on from, if further Newton steps may help.

    Raises
    ------
    End
        Otherwise, CONVERGED or STAGNATED.
    """
    here = here.afresh()
    rounding = here.functional.rounding(here.y)
    for _ in range(CORRECTIONS):
        if rule.met(plus(here.record(), rounding)) or here.number == 0:
            break
        better = here.afresh(system.solve((-here.residual).Evaluate())[1])
        if not better.norms.total <= here.norms.total / 2:
            break
        here = better
    record = here.record()
    if rule.met(plus(record, rounding)):
        raise End(Status.CONVERGED, here)
    if rule.met(plus(record, rounding, part=0.0)):
        return here
    reach = 1.1 * (here.norms.total + rounding.total) / here.functional.blocks.residual_unit
    raise End(
        Status.STAGNATED,
        here,
        f"Rounding alone leaves about {rounding.total:.2g} of the residual, in whatever way it is "
        "computed: the hardening is small beside the elastic moduli, or the loads are large, for "
        f"{rule}. A tolerance above {reach:.2g} is within reach.",
    )


def plus(record: IterationRecord, norms: ResidualNorms, part: float = 1.0) -> IterationRecord:
    """The record with ``part`` of its residual norms and these added to them."""
    more = {f"{name}_residual_norm": norm for name, norm in norms.by_part.items()}
    more["residual_norm"] = norms.total
    sums = {name: part * getattr(record, name) + norm for name, norm in more.items()}
    return replace(record, **sums)
