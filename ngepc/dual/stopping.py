"""When the loop of Algorithm 7.1 has done enough, and whether an iterate that seems so is.

The residual of the iteration is updated with each step, by factors of the condensed (7.1) whose
errors it cannot see.  Here y is solved for again and corrected with D itself, and what rounding
leaves in that is estimated.  CONVERGED is said only where the residual *and* its rounding together
meet the rule: any other way of computing it in the same precision then finds the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from ngepc.dual.functional import DualFunctional, NewtonSystem, ResidualNorms
from ngepc.dual.iterates import Iterate
from ngepc.results.outcome import IterationRecord, Status

CORRECTIONS = 3
"""Most steps with the last factors."""


class StoppingRule(Protocol):
    """When the loop of Algorithm 7.1 has done enough; its text is shown when it has not."""

    def met(self, record: IterationRecord) -> bool:
        """Whether the iterate with this record will do."""
        ...

    def __str__(self) -> str:
        """The rule as a text with its bounds."""
        ...


@dataclass(frozen=True)
class ResidualBelow:
    """||Psi_gamma||_{H*} < tolerance, the rule of Algorithm 7.1."""

    tolerance: float

    def met(self, record: IterationRecord) -> bool:
        """Whether the residual norm is below the tolerance."""
        return record.residual_norm < self.tolerance

    def __str__(self) -> str:
        """The tolerance."""
        return f"the tolerance {self.tolerance:.3g}"


@dataclass(frozen=True)
class Finding:
    """What the end of a step showed.

    Parameters
    ----------
    iterate, record
        The iterate to go on from or to return, and its record.
    status
        CONVERGED, STAGNATED or NONFINITE; None if further Newton steps may help.
    cause
        A sentence about rounding where it is in the way.
    """

    iterate: Iterate
    record: IterationRecord
    status: Status | None
    cause: str = ""


def judge(
    functional: DualFunctional,
    system: NewtonSystem,
    here: Iterate,
    before: Iterate,
    record: IterationRecord,
    rule: StoppingRule,
) -> Finding:
    """Whether the iteration ends with an iterate, by its residual.

    Parameters
    ----------
    functional
        J*_gamma.
    system
        The Newton system with the factors of the last step.
    here, before
        The iterate and the one before it, which stays where numbers are no longer finite.
    record
        The record of ``here``.
    rule
        The stopping rule.
    """
    if not math.isfinite(record.residual_norm + record.energy):
        return Finding(before, record, Status.NONFINITE)
    if not rule.met(record):
        return Finding(here, record, None)
    return final_check(functional, system, here, record.iteration, rule)


def final_check(
    functional: DualFunctional,
    system: NewtonSystem,
    here: Iterate,
    iteration: int,
    rule: StoppingRule,
) -> Finding:
    """Judge an iterate whose updated residual meets the rule: y and residual afresh, corrected."""
    here.refresh(functional)
    rounding, record = functional.rounding(here.y), here.record(functional, iteration)
    for _ in range(CORRECTIONS):
        if rule.met(with_residual(record, rounding, record)) or here.is_start:
            break
        following = corrected(functional, system, here)
        better = following.record(functional, iteration)
        if not better.residual_norm <= record.residual_norm / 2:
            break
        here, record = following, better
    if rule.met(with_residual(record, rounding, record)):
        return Finding(here, record, Status.CONVERGED)
    if rule.met(with_residual(record, rounding)):
        return Finding(here, record, None)
    reach = (record.residual_norm + rounding.total) / functional.residual_unit
    return Finding(here, record, Status.STAGNATED, out_of_reach(rounding, rule, reach))


def with_residual(
    record: IterationRecord, norms: ResidualNorms, more: IterationRecord | None = None
) -> IterationRecord:
    """The record with these residual norms, added to those of ``more``."""
    fields = {f"{name}_residual_norm": norm for name, norm in norms.by_part.items()}
    fields["residual_norm"] = norms.total
    if more is not None:
        fields = {name: value + getattr(more, name) for name, value in fields.items()}
    return replace(record, **fields)


def corrected(functional: DualFunctional, system: NewtonSystem, here: Iterate) -> Iterate:
    """One more step with the factors of the last one: near a solution the active sets stay."""
    _, dv = system.direction(here.v, here.residual)
    v = dv.CreateVector()
    v.data = here.v + dv
    functional.make_feasible(v)
    following = Iterate.at(functional, v)
    following.step = here.step
    return following


def out_of_reach(rounding: ResidualNorms, rule: StoppingRule, reach: float) -> str:
    """The sentences for a rule that rounding does not let any iterate meet.

    ``reach`` is the residual with its rounding in the units of ``NewtonOptions.tolerance``.
    """
    return (
        f"Rounding alone leaves about {rounding.total:.2g} of the residual, in whatever way it is "
        "computed: the hardening is small beside the elastic moduli, or the loads are large, for "
        f"{rule}. A tolerance above {1.1 * reach:.2g} is within reach."
    )
